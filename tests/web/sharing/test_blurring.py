"""Faces and plates are blurred in every picture of a photo, and outsiders do not get its file."""

import io
import zipfile
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from PIL import Image
from sqlalchemy import select

from tests.standin_models import install_blur_networks
from tests.web.sharing.stripes import BOX, blur, contrast, fetched, stripes
from webapp.core.hypotheses.model import Evidence
from webapp.errors import Busy, Conflict
from webapp.files.localize.models import blur_networks
from webapp.progress import Progress
from webapp.render import export_file
from webapp.render.answer_pictures import HEIGHT_PX, match_picture
from webapp.settings import Settings
from webapp.store.maps import maps
from webapp.store.maps.blurred import blurred_elsewhere
from webapp.store.schema import Job, MapRecord
from webapp.tasks.blur.find import PhotoToSearch, accept_in_library, search_photos
from webapp.tasks.exchange.export_source import of_folder, thumbnail
from webapp.tasks.maps import export, pictures
from webapp.tasks.maps.delete_map import delete_map
from webapp.web.state import KEY


def photo_of(browser, slug):
    return browser.get(f"/api/v1/maps/{slug}").json["photos"][0]


def test_every_picture_is_blurred_and_the_file_is_not(client, full):
    before = photo_of(client, full)
    assert contrast(fetched(client, before["preview"])) > 60
    answer = blur(client, full, BOX)
    assert answer.status_code == 200
    (after,) = answer.json["photos"]
    assert after["blurred"] == [BOX] and after["revision"] == answer.json["revision"] > before["revision"]
    for kind in ("preview", "thumb"):
        assert after[kind] != before[kind]
        assert contrast(fetched(client, after[kind])) < 20
    assert fetched(client, f"/api/v1/maps/{full}/photos/0/original") == stripes()


def test_pictures_that_are_made_again_are_blurred_too(client, full, library):
    blur(client, full, BOX)
    for file in (library.folder / full / "derived" / "previews").iterdir():
        file.unlink()
    assert contrast(fetched(client, photo_of(client, full)["preview"])) < 20


def test_previews_made_before_the_blur_and_written_after_it_are_not_shown(
    client, stranger, full, library, monkeypatch
):
    """For example, when a visitor opens the photo of a restored map while it is being blurred."""
    token = client.post(f"/api/v1/maps/{full}/shares", json={"photos": True}).json["url"].rpartition("/")[2]
    for file in (library.folder / full / "derived" / "previews").iterdir():
        file.unlink()
    write = pictures.write_previews

    def blurred_meanwhile(*args, **options):
        monkeypatch.setattr(pictures, "write_previews", write)
        assert blur(client, full, BOX).status_code == 200
        write(*args, **options)

    monkeypatch.setattr(pictures, "write_previews", blurred_meanwhile)
    fetched(stranger, f"/api/v1/shared/{token}/photos/0/preview")
    for kind in ("preview", "thumb"):
        assert contrast(fetched(stranger, f"/api/v1/shared/{token}/photos/0/{kind}")) < 20


@pytest.mark.parametrize("exported_again", [False, True])
def test_exports_with_pictures_are_blurred(client, full, library, exported_again):
    blur(client, full, BOX)
    if exported_again:
        for file in (library.folder / full / "derived" / "previews").iterdir():
            file.unlink()
    kmz = client.get(f"/api/v1/maps/{full}/export.kmz")
    assert kmz.status_code == 200, kmz.text
    with kmz, zipfile.ZipFile(io.BytesIO(kmz.get_data())) as archive:
        pictures = [name for name in archive.namelist() if name.endswith(".jpg") and "0" in name]
        assert pictures
        assert max(contrast(archive.read(name)) for name in pictures) < 20


def test_the_index_follows_where_the_photo_has_a_place(client, full, library):
    blur(client, full, BOX)
    with library.database.read() as session:
        record = session.scalars(select(MapRecord).where(MapRecord.slug == full)).one()
        assert record.photos_revision == record.revision


def test_it_can_be_taken_back(client, full):
    blur(client, full, BOX)
    (photo,) = blur(client, full).json["photos"]
    assert photo["blurred"] == []
    assert contrast(fetched(client, photo["preview"])) > 60
    assert blur(client, full).json["revision"] is None


def test_visitors_get_no_file_of_it(client, stranger, full):
    wish = {"photos": True, "originals": True}
    token = client.post(f"/api/v1/maps/{full}/shares", json=wish).json["url"].rpartition("/")[2]
    assert fetched(stranger, f"/api/v1/shared/{token}/photos/0/original") == stripes()
    blur(client, full, BOX)
    (photo,) = stranger.get(f"/api/v1/shared/{token}").json["photos"]
    assert photo["original"] is None
    assert stranger.get(f"/api/v1/shared/{token}/photos/0/original").status_code == 404
    assert contrast(fetched(stranger, photo["preview"])) < 20


def test_a_copy_of_the_map_is_blurred_too(client, full, library):
    blur(client, full, BOX)
    copy = client.post(f"/api/v1/maps/{full}/duplicate", json={}).json
    assert copy["slug"] != full
    photo = photo_of(client, copy["slug"])
    assert photo["blurred"] == [BOX]
    assert contrast(fetched(client, photo["preview"])) < 20


@pytest.fixture
def on_mission(client, stranger):
    """Send the photo to a mission and share it; return how to fetch its picture as a visitor."""
    mission = client.post("/api/v1/missions", json={"name": "Walk"}).json["id"]
    data = {"file": (io.BytesIO(stripes()), "m.jpg")}
    sha256 = client.post(f"/api/v1/missions/{mission}/photos", data=data).json["sha256"]
    shared = client.post(f"/api/v1/missions/{mission}/shares", json={"photos": True}).json["url"]
    address = f"/api/v1/shared-missions/{shared.rpartition('/')[2]}/photos/{sha256}/preview"
    return lambda: fetched(stranger, address)


def test_the_boxes_outlive_the_map_until_they_are_changed_on_another(
    client, full, on_mission, library, new_map, owner, fill_map
):
    blur(client, full, BOX)
    assert client.delete(f"/api/v1/maps/{full}").status_code == 200
    with library.database.read() as session:
        record = session.scalars(select(MapRecord).where(MapRecord.slug == full)).one()
    assert contrast(on_mission()) < 20, "in the bin"
    delete_map(library, record.id)
    assert contrast(on_mission()) < 20, "deleted"
    again = fill_map(client, new_map(owner, name="Again"))
    assert photo_of(client, again)["blurred"] == [BOX]
    assert contrast(fetched(client, photo_of(client, again)["preview"])) < 20
    assert blur(client, again).status_code == 200
    assert contrast(on_mission()) > 60


def test_boxes_of_deleted_maps_are_forgotten_where_others_are_chosen(
    client, full, on_mission, library, new_map, owner, fill_map
):
    other = fill_map(client, new_map(owner, name="Other"))
    blur(client, full, BOX)
    client.delete(f"/api/v1/maps/{full}")
    with library.database.read() as session:
        record = session.scalars(select(MapRecord).where(MapRecord.slug == full)).one()
    delete_map(library, record.id)
    assert photo_of(client, other)["blurred"] == [] and contrast(on_mission()) < 20
    corner = {"x": 0.0, "y": 0.0, "width": 0.1, "height": 0.1}
    assert blur(client, other, corner).status_code == 200
    assert contrast(on_mission()) > 60


def test_landmarks_are_hidden_from_visitors_while_a_photo_is_blurred_only_on_another_map(
    client, full, library, owner, new_map, fill_map
):
    with library.database.read() as session:
        record = session.scalars(select(MapRecord).where(MapRecord.slug == full)).one()
        assert blurred_elsewhere(session, maps.photos(session, record)) == set()
    other = fill_map(client, new_map(owner, name="Other"))
    blur(client, other, BOX)
    with library.database.read() as session:
        assert blurred_elsewhere(session, maps.photos(session, record)) == {0}
    blur(client, full, BOX)
    with library.database.read() as session:
        assert blurred_elsewhere(session, maps.photos(session, record)) == set()


def test_what_is_blurred_during_an_export_is_blurred_in_the_rest_of_it(client, full, library):
    with library.database.read() as session:
        record = session.scalars(select(MapRecord).where(MapRecord.slug == full)).one()
    download = export_file.export_map_file(library, record.id, form="kmz", settings=Settings())
    blur(client, full, BOX)
    with zipfile.ZipFile(io.BytesIO(b"".join(download.pieces))) as archive:
        assert contrast(archive.read("files/0.jpg")) < 20


def test_pictures_made_from_the_folder_of_a_map_are_blurred(client, full, library):
    blur(client, full, BOX)
    with library.database.read() as session:
        record = session.scalars(select(MapRecord).where(MapRecord.slug == full)).one()
    export.export_map(library, record.id)
    cfg, limits = library.cfg(full), Settings().photo
    source = of_folder(cfg)
    (photo,) = source.map.experiences
    jpeg = thumbnail(source, photo, side=640, limits=limits)
    assert contrast(jpeg) < 20
    none = np.zeros((0, 2), np.float32)
    answer = SimpleNamespace(evidence=[Evidence(0, none, none, np.zeros(0, bool))])
    picture = match_picture(cfg, source.map, query=cfg.parent / photo.photo, answer=answer, limits=limits)
    pixels = np.asarray(picture.convert("L"), float)[:HEIGHT_PX]
    for half in (pixels[:, : pixels.shape[1] // 2], pixels[:, pixels.shape[1] // 2 :]):
        high, wide = half.shape
        assert half[high // 3 : 2 * high // 3, wide // 3 : 2 * wide // 3].std() < 20


@pytest.mark.parametrize(
    "box",
    [
        {**BOX, "x": -0.1},
        {**BOX, "x": 0.6},
        {**BOX, "height": 0.0},
        {**BOX, "width": 1.1},
    ],
)
def test_what_is_no_box_is_refused(client, full, box):
    assert blur(client, full, box).status_code == 400
    assert photo_of(client, full)["blurred"] == []


def test_who_may_only_look_cannot_blur(sign_in, new_account, new_map):
    ana, bob = new_account("Ana"), new_account("Bob")
    slug = new_map(ana, shared={bob: "viewer"})
    assert blur(sign_in(bob), slug, BOX).status_code == 403
    assert blur(sign_in(ana), slug, BOX).status_code == 404


@pytest.fixture
def finding(app, tmp_path, monkeypatch):
    """Stand-ins of the networks are installed."""
    folder = install_blur_networks(tmp_path / "models", monkeypatch.setitem)
    state = app.extensions[KEY]
    monkeypatch.setitem(app.extensions, KEY, replace(state, settings=replace(state.settings, models=folder)))


def spot():
    """A photo with a white spot."""
    pixels = np.zeros((120, 160, 3), np.uint8)
    pixels[40:56, 64:80] = 255
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "PNG")
    return file.getvalue()


def test_faces_and_plates_are_suggested_and_nothing_is_changed(client, park, finding):
    client.post(f"/api/v1/maps/{park}/photos", data={"file": [(io.BytesIO(spot()), "a.png")]})
    url = f"/api/v1/maps/{park}/photos/0/blur"
    answer = client.get(f"{url}/suggestions").json
    assert {box["kind"] for box in answer["boxes"]} == {"face", "plate"}
    assert all(box["score"] > 0.99 for box in answer["boxes"])
    assert answer["missing"] == []
    assert client.get(f"/api/v1/maps/{park}").json["photos"][0]["blurred"] == []
    boxes = [{side: box[side] for side in BOX} for box in answer["boxes"]]
    assert client.put(url, json={"boxes": boxes}).status_code == 200
    assert client.get(f"{url}/suggestions").json["boxes"] == []
    assert client.get(f"/api/v1/maps/{park}/photos/7/blur/suggestions").status_code == 404


def test_a_map_lists_what_was_found_in_its_photos(client, park, finding, library):
    files = [(io.BytesIO(spot()), "a.png"), (io.BytesIO(stripes()), "b.jpg")]
    client.post(f"/api/v1/maps/{park}/photos", data={"file": files})
    url = f"/api/v1/maps/{park}/blur/suggestions"
    before = client.get(url).json
    assert (before["photos"], before["searched"], before["total"], before["job"]) == ([], 0, 2, None)
    assert client.get(f"/api/v1/maps/{park}/photos/0/blur/suggestions").status_code == 200
    answer = client.post(url, json={"accept": True, "least_score": 0.8})
    assert answer.status_code == 202
    assert (answer.json["searched"], [photo["id"] for photo in answer.json["photos"]]) == (1, [0])
    assert answer.json["photos"] == client.get(url).json["photos"]
    assert answer.json["photos"][0]["boxes"]
    assert client.get(f"{url}?boxes=0").json["photos"] == [{"id": 0, "name": "a.png", "left": 0}]
    with library.database.read() as session:
        job = session.get_one(Job, answer.json["job"])
        assert (job.kind, job.arguments) == ("blur", {"accept": True, "least_score": 0.8})
    assert client.post(url, json={"least_score": 1.5}).status_code == 422


def test_who_may_only_look_gets_no_suggestions(sign_in, new_account, new_map):
    ana, bob = new_account("Ana"), new_account("Bob")
    slug = new_map(ana, shared={bob: "viewer"})
    assert sign_in(bob).get(f"/api/v1/maps/{slug}/blur/suggestions").status_code == 403
    assert sign_in(bob).post(f"/api/v1/maps/{slug}/blur/suggestions", json={}).status_code == 403


@pytest.fixture
def meanwhile(client, monkeypatch):
    """Blur a box while the next pictures of a photo are being made."""

    def blur_another(slug, box):
        make = pictures.make_previews

        def blur_first(*args, **options):
            monkeypatch.setattr(pictures, "make_previews", make)
            assert blur(client, slug, box).status_code == 200
            return make(*args, **options)

        monkeypatch.setattr(pictures, "make_previews", blur_first)

    return blur_another


def test_boxes_that_somebody_else_drew_meanwhile_are_not_lost(client, full, meanwhile):
    other = {**BOX, "x": 0.0}
    meanwhile(full, other)
    assert blur(client, full, BOX).status_code == 409
    assert photo_of(client, full)["blurred"] == [other]


def test_boxes_that_were_chosen_without_those_of_others_are_refused(client, full):
    url, other = f"/api/v1/maps/{full}/photos/0/blur", {**BOX, "x": 0.0}
    assert blur(client, full, other).status_code == 200
    answer = client.put(url, json={"boxes": [BOX], "seen": []})
    assert answer.status_code == 409
    assert answer.json["error"]["where"] == "a.jpg"
    assert photo_of(client, full)["blurred"] == [other]
    assert client.put(url, json={"boxes": [other, BOX], "seen": [other]}).status_code == 200
    assert photo_of(client, full)["blurred"] == [other, BOX]


@pytest.fixture
def accepting(client, park, finding, library, tmp_path):
    """Accept the suggestions for a photo, and return the result of `accept_in_library`."""
    client.post(f"/api/v1/maps/{park}/photos", data={"file": [(io.BytesIO(spot()), "a.png")]})
    with library.database.read() as session:
        map_id = session.scalars(select(MapRecord.id).where(MapRecord.slug == park)).one()
        photos = [PhotoToSearch(0, maps.photo(session, session.get_one(MapRecord, map_id), 0).path, ())]
    networks, limits = blur_networks(tmp_path / "models"), Settings().photo
    report = search_photos(library.cfg(park), photos, networks=networks, limits=limits, progress=Progress())

    def accept(**options):
        return accept_in_library(
            library,
            map_id,
            suggested=report.suggested,
            settings=Settings(),
            progress=Progress(),
            **options,
        )

    return accept


def test_a_box_that_is_drawn_while_suggestions_are_accepted_stays(client, park, accepting, meanwhile):
    other = {"x": 0.0, "y": 0.0, "width": 0.1, "height": 0.1}
    meanwhile(park, other)
    assert accepting() == ([0], [])
    kept = client.get(f"/api/v1/maps/{park}").json["photos"][0]["blurred"]
    assert kept[0] == other
    assert len(kept) > 1


def test_what_may_work_later_is_not_noted_as_failed(client, park, accepting, monkeypatch):
    def busy(*args, **options):
        raise Busy("the server is busy", wait_s=1)

    monkeypatch.setattr(pictures, "make_previews", busy)
    with pytest.raises(Busy):
        accepting()
    monkeypatch.undo()

    def taken_over(map_id):
        raise Conflict("another worker has taken over this job")

    with pytest.raises(Conflict):
        accepting(changing=taken_over)


def test_a_damaged_photo_is_named_and_does_not_stop_the_others(client, park, accepting, library):
    for file in (library.map_folder(park) / "photos").iterdir():
        file.write_bytes(b"no photo")
    blurred, failed = accepting()
    assert blurred == []
    assert [one.id for one in failed] == [0]


def test_the_editor_asks_for_what_was_found_also_where_no_model_is(client, full):
    answer = client.get(f"/api/v1/maps/{full}/blur/suggestions")
    assert answer.status_code == 200
    assert (answer.json["photos"], answer.json["missing"]) == ([], ["faces", "plates"])


def test_without_the_models_it_is_said_how_to_get_them(client, full, park):
    for answer in (
        client.get(f"/api/v1/maps/{park}/photos/0/blur/suggestions"),
        client.post(f"/api/v1/maps/{park}/blur/suggestions", json={}),
    ):
        assert answer.status_code == 422
        error = answer.json["error"]
        assert error["message"] == "no network that finds faces or number plates is installed"
        assert "expmap models fetch faces plates" in error["hint"]
