"""The 3D view of a shared map: data for visitors, and nothing beyond the share."""

import io
import zipfile
from contextlib import ExitStack, suppress
from dataclasses import replace

import numpy as np
import pytest

from tests.web.landmarks.conftest import AT
from webapp.core.boxes import BlurBox
from webapp.core.mapmodel.views import content_of_part
from webapp.errors import Busy
from webapp.files.landmarks.cloud import CLOUD_FILE, POINTS_FILE, StoredCloud, read_cloud, write_cloud
from webapp.store.schema import Job, MapRecord, Photo
from webapp.tasks.landmarks.show_cloud import align_in_library
from webapp.tasks.localize.index_location import landmarks_folder
from webapp.web.landmarks.cloud_answers import names_of
from webapp.web.sharing.api_shared import visitors_limit

NO_KEY = "0" * 32


@pytest.fixture
def seen(joined, yard, client, library):
    """A map with landmarks whose third photo is back in the tray: its record."""
    url, _slug = yard
    changes = [{"id": 2, "x_px": None, "y_px": None}]
    assert client.patch(f"{url}/experiences", json={"kind": "unplace", "changes": changes}).status_code == 200
    with library.database.read() as session:
        record = session.get(MapRecord, joined[1].id)
    align_in_library(library, record)
    return record


@pytest.fixture
def share(client, seen):
    """Share the map, and return the addresses of the page and its API."""

    def make(slug=seen.slug, **wish):
        answer = client.post(f"/api/v1/maps/{slug}/shares", json={"landmarks": True, **wish})
        assert answer.status_code == 201, answer.text
        page = answer.json["url"]
        return f"{page}/landmarks", f"/api/v1/shared/{page.rpartition('/')[2]}/landmarks", answer.json

    return make


def all_of(page, api, key):
    return [page, api, f"{api}/points/{key}/0", f"{api}/points.ply", f"{api}/colmap.zip"]


def statuses(browser, addresses):
    return [browser.get(address).status_code for address in addresses]


def test_visitors_see_the_points_and_the_placed_cameras_alone(stranger, share):
    page, api, _share = share()
    answer = stranger.get(api).json
    assert (answer["points"], answer["photos"], answer["unit"]) == (4, 2, "px")
    assert [camera["id"] for camera in answer["cameras"]] == [0, 1]
    assert {(camera["name"], camera["preview"], camera["placed"]) for camera in answer["cameras"]} == {
        (None, None, True)
    }
    assert not {"job", "left_out", "new_photos"} & set(answer), "who works on the map is not spoken of"
    plain = {"Accept-Encoding": "identity"}
    assert len(stranger.get(f"{api}/points/{answer['key']}/0", headers=plain).data) == 40
    shown = stranger.get(page)
    assert shown.status_code == 200 and "noindex" in shown.headers["X-Robots-Tag"]
    assert "colmap" not in shown.text and "/control-points" not in shown.text and "0.jpg" not in shown.text


def test_the_map_and_its_3d_view_lead_to_each_other(stranger, share):
    page, _api, shared = share()
    on_map, in_3d = stranger.get(shared["url"]).text, stranger.get(page).text
    path = page[page.index("/s/") :]
    assert f'href="{path}"' in on_map and f'href="{path.replace("/landmarks", "/map")}"' in in_3d
    assert path not in stranger.get(shared["url"].replace("/s/", "/embed/")).text


def test_without_the_choice_there_is_no_3d_view(client, stranger, share, seen):
    page, api, shared = share(originals=True)
    key = stranger.get(api).json["key"]
    assert statuses(stranger, all_of(page, api, key)[:4]) == [200] * 4
    change = f"/api/v1/maps/{seen.slug}/shares/{shared['id']}"
    assert client.patch(change, json={"originals": True}).json["landmarks"] is False
    assert statuses(stranger, all_of(page, api, key)) == [404] * 5
    assert stranger.get(api).json["error"] == {
        "code": "not_found",
        "message": "this map is not shared in 3D",
        "hint": "ask the person who sent it for a new one",
        "where": None,
    }
    assert page[page.index("/s/") :] not in stranger.get(shared["url"]).text


def test_a_link_that_was_revoked_or_is_none_shows_no_landmarks(client, stranger, share, seen):
    page, api, shared = share(originals=True)
    key = stranger.get(api).json["key"]
    assert client.delete(f"/api/v1/maps/{seen.slug}/shares/{shared['id']}").status_code == 204
    assert statuses(stranger, all_of(page, api, key)) == [404] * 5
    other = all_of(page.replace("/s/", "/s/x"), api.replace("/shared/", "/shared/x"), key)
    assert statuses(stranger, other) == [404] * 5


def test_a_share_shows_no_landmarks_of_another_map(stranger, share, new_map, owner):
    key = stranger.get(share()[1]).json["key"]
    page, api, shared = share(new_map(owner, name="Empty"), originals=True)
    answer = stranger.get(api).json
    assert (answer["key"], answer["points"], answer["cameras"]) == (None, 0, [])
    assert statuses(stranger, all_of(page, api, key)) == [200, 200, 404, 404, 404]
    assert "/landmarks" not in stranger.get(shared["url"]).text, "there is nothing to see"


def test_files_are_for_shares_that_give_files_out(stranger, share, seen, library, tmp_path):
    pycolmap = pytest.importorskip("pycolmap")
    model = pycolmap.synthesize_dataset(
        pycolmap.SyntheticDatasetOptions(num_rigs=1, num_cameras_per_rig=1, num_frames_per_rig=3)
    )
    contents = _contents(library, seen)
    for image, content in zip(model.images.values(), contents, strict=True):
        image.name = content
    folder = landmarks_folder(library.cfg(seen.slug)) / "models" / "0"
    folder.mkdir(parents=True)
    model.write(folder)
    page, api, _share = share(photos=True)
    assert statuses(stranger, [f"{api}/points.ply", f"{api}/colmap.zip"]) == [404] * 2
    assert "/points.ply" not in stranger.get(page).text

    page, api, _share = share(photos=True, originals=True)
    cameras = stranger.get(api).json["cameras"]
    assert [camera["name"] for camera in cameras] == ["0.jpg", "1.jpg"]
    for camera in cameras:
        picture = stranger.get(camera["preview"])
        assert picture.status_code == 200
        picture.close()
    assert "/points.ply" in stranger.get(page).text
    assert b"element vertex 4\n" in stranger.get(f"{api}/points.ply").data[:300]
    data = stranger.get(f"{api}/colmap.zip?form=text", buffered=True).data
    zipfile.ZipFile(io.BytesIO(data)).extractall(tmp_path)
    written = pycolmap.Reconstruction(tmp_path / "0")
    assert sorted(image.name for image in written.images.values()) == ["0-0.jpg", "1-1.jpg"]
    assert contents[2] not in (tmp_path / "0" / "images.txt").read_text()


def _contents(library, record):
    with library.database.read() as session:
        return [photo.sha256 for photo in session.get(MapRecord, record.id).photos][: len(AT)]


def test_a_visit_lays_them_anew_in_nobodys_name(client, stranger, share, yard, library):
    _page, api, _share = share()
    before = stranger.get(api).json["key"]
    changes = [{"id": 1, "x_px": 190, "y_px": 45}]
    client.patch(f"{yard[0]}/experiences", json={"kind": "place", "changes": changes})
    assert stranger.get(api).json["key"] == before, "those that are there are shown meanwhile"
    with library.database.read() as session:
        (job,) = session.query(Job).filter_by(kind="landmarks").all()
    assert (job.account_id, job.arguments) == (None, {"only_lay": True})


@pytest.mark.parametrize("ended", ["failed", "cancelled"])
def test_what_failed_is_not_queued_by_each_visit(client, stranger, share, yard, library, ended):
    _page, api, _share = share()

    def place(x):
        changes = [{"id": 1, "x_px": x, "y_px": 45}]
        client.patch(f"{yard[0]}/experiences", json={"kind": "place", "changes": changes})

    def states():
        with library.database.read() as session:
            return [job.state for job in session.query(Job).filter_by(kind="landmarks").order_by(Job.id)]

    place(190)
    stranger.get(api)
    with library.database.write() as session:
        session.query(Job).filter_by(kind="landmarks").one().state = ended
    stranger.get(api)
    assert states() == [ended]
    place(180)  # a change, after which it may succeed
    stranger.get(api)
    assert states() == [ended, "queued"]


def test_what_failed_before_an_update_is_tried_again(client, stranger, share, yard, library):
    _page, api, _share = share()
    changes = [{"id": 1, "x_px": 190, "y_px": 45}]
    client.patch(f"{yard[0]}/experiences", json={"kind": "place", "changes": changes})
    stranger.get(api)
    with library.database.write() as session:
        job = session.query(Job).filter_by(kind="landmarks").one()
        job.state, job.key = "failed", "lay"  # the key of the earlier version
    stranger.get(api)
    with library.database.read() as session:
        states = [job.state for job in session.query(Job).filter_by(kind="landmarks").order_by(Job.id)]
    assert states == ["failed", "queued"]


def test_visitors_take_their_slot_of_the_server(app, stranger, share, seen):
    page, api, _share = share(originals=True)
    key = stranger.get(api).json["key"]
    with app.app_context(), ExitStack() as held:
        with suppress(Busy):
            while True:
                held.enter_context(visitors_limit.slot())
        assert statuses(stranger, all_of(page, api, key)) == [200, 503, 503, 503, 503]
    assert statuses(stranger, all_of(page, api, key)[:4]) == [200] * 4


def test_points_that_only_photos_in_the_tray_see_are_not_given_out(client, stranger, share, seen, library):
    folder = landmarks_folder(library.cfg(seen.slug))
    stored = read_cloud(folder / CLOUD_FILE)
    alone = replace(  # the fourth point is only seen by the third photo, which is in the tray
        stored.cloud,
        first=np.array([0, 3, 6, 10]),
        seen_point=np.array([0, 1, 2, 0, 1, 2, 0, 1, 2, 3], np.int32),
        seen_xy=np.zeros((10, 2), np.float32),
        descriptors=np.zeros((10, 128), np.uint8),
    )
    write_cloud(folder / CLOUD_FILE, StoredCloud(alone, stored.key))
    (folder / POINTS_FILE).unlink()
    align_in_library(library, seen)
    _page, api, _share = share(originals=True)
    own, theirs = client.get(f"/api/v1/maps/{seen.slug}/landmarks").json, stranger.get(api).json
    assert (own["points"], theirs["points"]) == (4, 3)
    plain = {"Accept-Encoding": "identity"}
    assert len(stranger.get(f"{api}/points/{theirs['key']}/0", headers=plain).data) == 30
    assert b"element vertex 3\n" in stranger.get(f"{api}/points.ply").data[:300]


BOXES = {"boxes": [{"x": 0.1, "y": 0.2, "width": 0.3, "height": 0.4}]}


def unplace(client, url):
    changes = [{"id": 1, "x_px": None, "y_px": None}]
    assert client.patch(f"{url}/experiences", json={"kind": "unplace", "changes": changes}).status_code == 200


def blur(client, url):
    assert client.put(f"{url}/photos/1/blur", json=BOXES).status_code == 200


def take_away(client, url):
    assert client.delete(f"{url}/experiences/1").status_code == 200


@pytest.mark.parametrize("change", [unplace, blur, take_away])
def test_points_are_hidden_until_it_is_known_which_ones_the_others_see(
    client, stranger, share, seen, yard, library, change
):
    page, api, _share = share(originals=True)
    key = stranger.get(api).json["key"]
    change(client, yard[0])
    assert stranger.get(api).json["points"] == 0
    assert statuses(stranger, all_of(page, api, key)[2:4]) == [404] * 2
    assert client.get(f"/api/v1/maps/{seen.slug}/landmarks").json["points"] == 4
    with library.database.read() as session:
        record = session.get(MapRecord, seen.id)
    align_in_library(library, record)
    assert stranger.get(api).json["key"] not in (None, key)


def test_models_name_a_blurred_photo_by_what_is_not_blurred_in_it(client, seen, library):
    box = {"x": 0.1, "y": 0.2, "width": 0.3, "height": 0.4}
    url = f"/api/v1/maps/{seen.slug}/photos/0/blur"
    assert client.put(url, json={"boxes": [box]}).status_code == 200
    with library.database.read() as session:
        photo = session.query(Photo).filter_by(map_id=seen.id, id=0).one()
    content = content_of_part(photo.sha256, view=None, blurred=(BlurBox(**box),))
    # a model from before the blur, which includes the box, is stored under the SHA-256 of the whole file
    assert names_of({"0-0.jpg": photo}) == {content: "0-0.jpg"}


def test_the_dialog_offers_it_where_there_are_landmarks(client, seen, new_map, owner):
    assert client.get(f"/api/v1/maps/{seen.slug}/shares").json["in_3d"] is True
    assert client.get(f"/api/v1/maps/{new_map(owner, name='Bare')}/shares").json["in_3d"] is False
