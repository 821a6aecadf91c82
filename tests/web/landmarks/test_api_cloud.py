"""The landmarks of a map through the API: laid by its placed photos, sent in blocks, downloaded."""

import gzip
import io
import json
import zipfile
from dataclasses import replace

import numpy as np
import pytest

from tests.web.landmarks.conftest import AT, UP, place
from webapp.core.landmarks.submodels import Submodel, view_rotation
from webapp.core.mapmodel.panorama import Panorama
from webapp.extras import install_line
from webapp.files.landmarks.cloud import CLOUD_FILE, StoredCloud, read_cloud, write_cloud
from webapp.files.landmarks.colmap import SUBMODELS_FILE, StoredSubmodels, write_submodels
from webapp.jobs.context import Context, JobProgress
from webapp.jobs.kinds import KINDS
from webapp.jobs.map_jobs import build_landmarks
from webapp.store.operate.jobs import Lease
from webapp.store.schema import Job, MapRecord, Photo
from webapp.tasks.landmarks import show_cloud
from webapp.tasks.landmarks.reconstruct import SURROUNDINGS
from webapp.tasks.landmarks.show_cloud import align_in_library
from webapp.tasks.localize.index_location import landmarks_folder
from webapp.web.localize import pages as localize_pages


@pytest.fixture
def laid(joined, library):
    """The same, laid on the map: the address, and the data of the page."""
    url, record = joined
    align_in_library(library, record)
    return url


def unpacked(data):
    count = len(data) // 10
    steps = np.frombuffer(data, "<u2", 3 * count).reshape(-1, 3)
    return steps, np.frombuffer(data, np.uint8, offset=6 * count).reshape(-1, 4)


def test_a_map_without_landmarks_says_so(client, yard):
    url = f"{yard[0]}/landmarks"
    answer = client.get(url).json
    assert (answer["key"], answer["job"], answer["points"], answer["photos"]) == (None, None, 0, 4)
    assert client.get(f"{url}/points.ply").status_code == 404
    assert client.get(f"{url}/colmap.zip").json["error"]["message"] == "the map has no landmarks"


def test_points_and_cameras_are_where_the_photos_say(client, laid):
    answer = client.get(laid).json
    assert answer["job"] is None
    assert (answer["unit"], answer["origin"], answer["points"], answer["blocks"]) == ("px", None, 4, 1)
    assert answer["corners"] == [[-200, 150], [200, 150], [200, -150], [-200, -150]]
    assert [(c["name"], c["placed"], c["focal_px"]) for c in answer["cameras"]] == [
        (f"{n}.jpg", True, 30.0) for n in range(3)
    ]
    assert answer["cameras"][1]["at"] == pytest.approx([0, 110, 0], abs=0.01)
    assert answer["cameras"][1]["rotation"][2] == pytest.approx([0, 1, 0], abs=1e-3)
    response = client.get(f"{laid}/points/{answer['key']}/0", headers={"Accept-Encoding": "identity"})
    assert response.headers["Cache-Control"] == "private, max-age=31536000, immutable"
    steps, colours = unpacked(response.data)
    xyz = steps * answer["scale"] + np.array(answer["offset"])
    order = np.lexsort(xyz.T)
    assert xyz[order] == pytest.approx(
        np.array([(-170, 0, 0), (-150, 90, 5), (-110, 130, 8), (-50, 50, -3)])[
            np.lexsort(np.array([(-170, 0, 0), (-150, 90, 5), (-110, 130, 8), (-50, 50, -3)]).T)
        ],
        abs=0.01,
    )
    assert colours[:, 3].tolist() == [3] * 4
    packed = client.get(f"{laid}/points/{answer['key']}/0", headers={"Accept-Encoding": "gzip"})
    assert gzip.decompress(packed.data) == response.data


def test_a_panorama_is_one_camera_that_looks_as_its_middle_does(client, joined, library):
    url, record = joined
    folder = landmarks_folder(library.cfg(record.slug))
    with library.database.write() as session:
        photos = [session.query(Photo).filter_by(map_id=record.id, id=n).one() for n in range(2)]
        photos[0].panorama = {}
        views = Panorama().views()[1:3]
        contents = (*(view.content(photos[0].sha256) for view in views), photos[1].sha256)
    rotation = np.array([*(view_rotation(view.turn_deg) @ UP for view in views), UP])
    centre = np.array([(x, -y, 0.0) for x, y in (AT[0], AT[0], AT[1])], float)
    submodel = Submodel(np.arange(3), centre, rotation)
    write_submodels(folder / SUBMODELS_FILE, StoredSubmodels((submodel,), contents, "key"))
    cloud = read_cloud(folder / CLOUD_FILE).cloud
    write_cloud(folder / CLOUD_FILE, StoredCloud(replace(cloud, contents=contents), "key"))
    align_in_library(library, record)
    cameras = client.get(url).json["cameras"]
    assert [(c["id"], c["panorama"]) for c in cameras] == [(0, True), (1, False)]
    assert cameras[0]["at"] == pytest.approx([-190, 140, 0], abs=0.01)
    assert cameras[0]["rotation"][2] == pytest.approx([0, 1, 0], abs=1e-3)


def test_points_are_sent_in_blocks(client, laid, monkeypatch):
    monkeypatch.setattr(show_cloud, "BLOCK_POINTS", 3)
    key = client.get(laid).json["key"]
    plain = {"Accept-Encoding": "identity"}
    sizes = [len(client.get(f"{laid}/points/{key}/{n}", headers=plain).data) for n in range(2)]
    assert sizes == [30, 10]
    assert client.get(f"{laid}/points/{key}/2").status_code == 404
    other = client.get(f"{laid}/points/{'0' * 32}/0")
    assert other.json["error"]["message"] == "these landmarks have changed"


def test_they_are_laid_anew_by_a_job_when_a_photo_has_moved(client, laid, joined, yard, library):
    before = client.get(laid).json
    place(client, yard[0], 1, at=(210, 45))
    after = client.get(laid).json
    assert after["key"] == before["key"], "those that are there are shown meanwhile"
    with library.database.read() as session:
        job = session.get(Job, after["job"])
    assert (job.kind, job.arguments) == ("landmarks", {"only_lay": True})
    assert job.kind in KINDS
    with library.database.read() as session:
        record = session.get(MapRecord, joined[1].id)
    align_in_library(library, record)
    assert client.get(laid).json["key"] != before["key"]


def test_what_cannot_be_laid_and_what_is_new_is_named(client, laid, joined, yard, library):
    changes = [{"id": id, "x_px": None, "y_px": None} for id in (0, 1)]
    client.patch(f"{yard[0]}/experiences", json={"kind": "unplace", "changes": changes})
    with library.database.read() as session:
        record = session.get(MapRecord, joined[1].id)
    align_in_library(library, record)
    answer = client.get(laid).json
    assert answer["left_out"] == [{"photos": [0, 1, 2], "reason": "only one of them is placed"}]
    assert (answer["points"], answer["blocks"], answer["cameras"]) == (0, 0, [])
    assert answer["new_photos"] == 4, "none of them has been described"


def test_computing_them_is_a_job_of_those_who_may_edit(
    client, yard, library, sign_in, new_account, absent, owner
):
    url = f"{yard[0]}/landmarks"
    answer = client.post(url)
    assert answer.status_code == 202
    with library.database.read() as session:
        assert session.get(Job, answer.json["job"]).arguments == {"only_lay": False}
    assert sign_in(new_account("nora")).get(url).status_code == 404
    absent("sfm")
    assert client.post(url).json["error"]["hint"] == install_line("sfm")


def test_points_are_taken_away_as_ply(client, laid):
    response = client.get(f"{laid}/points.ply")
    assert response.headers["Content-Disposition"].startswith("attachment; filename=park")
    assert b"element vertex 4\n" in response.data[:300]
    assert b"comment map pixels right, towards the top of the image and up" in response.data[:300]


@pytest.mark.parametrize("form", ["text", "binary"])
def test_models_are_taken_away_for_colmap(client, laid, joined, library, tmp_path, form):
    pycolmap = pytest.importorskip("pycolmap")
    model = pycolmap.Reconstruction()
    folder = landmarks_folder(library.cfg(joined[1].slug)) / "models" / "0"
    folder.mkdir(parents=True)
    model.write(folder)
    response = client.get(f"{laid}/colmap.zip?form={form}", buffered=True)
    assert response.mimetype == "application/zip"
    names = zipfile.ZipFile(io.BytesIO(response.data)).namelist()
    ending = {"text": "txt", "binary": "bin"}[form]
    assert {f"0/images.{ending}", f"0/cameras.{ending}", "0/points.ply"} <= set(names)


def test_the_page_opens_with_and_without_landmarks(client, laid, new_map, owner):
    page = client.get(laid.removeprefix("/api/v1"))
    assert page.status_code == 200
    assert b'type="importmap"' in page.data
    policy = page.headers["Content-Security-Policy"]
    assert "script-src 'self' 'sha256-" in policy
    assert "sha256-" not in client.get("/").headers["Content-Security-Policy"]
    empty = client.get(f"/maps/{new_map(owner, name='Bare')}/landmarks")
    assert b"Add photos first" in empty.data


def test_the_page_that_localizes_offers_them_where_they_are_or_can_be_made(
    client, joined, new_map, owner, monkeypatch
):
    with_them = client.get(joined[0].removeprefix("/api/v1").replace("/landmarks", "/localize"))
    assert b'<option value="landmarks">' in with_them.data
    bare = f"/maps/{new_map(owner, name='Bare')}/localize"
    assert b'<option value="landmarks">' in client.get(bare).data
    monkeypatch.setattr(localize_pages, "can_reconstruct", lambda _settings: False)
    assert b'<option value="landmarks">' not in client.get(bare).data


def test_a_job_reconstructs_the_photos_that_it_names(yard, library, settings):
    cfg = library.cfg(yard[1])
    with library.database.read() as session:
        map_id = session.query(MapRecord).filter_by(slug=yard[1]).one().id
    context = Context(library, settings, JobProgress(), Lease(0, 0), map_id, None, {"photos": [0, 99]})
    assert build_landmarks(context) == {"photos": 1}
    (tried,) = (landmarks_folder(cfg) / SURROUNDINGS).glob("*/photos.json")
    assert len(json.loads(tried.read_text())["photos"]) == 1
    assert not (landmarks_folder(cfg) / CLOUD_FILE).exists()
