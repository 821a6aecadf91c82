"""Faces and plates are blurred in every picture of a photo, and nobody outside gets its file."""

import io
import json
import zipfile

import numpy as np
import pytest
from PIL import Image
from sqlalchemy import select

from webapp.core.blur import BlurBox
from webapp.store.schema import MapRecord
from webapp.tasks.maps import show_photo
from webapp.web.maps import api_photos

BOX = {"x": 0.25, "y": 0.25, "width": 0.5, "height": 0.5}


def stripes():
    """A JPEG of stripes: blurred, they are grey."""
    pixels = np.zeros((120, 160, 3), np.uint8)
    pixels[:, ::2] = 255
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "JPEG", quality=95)
    return file.getvalue()


def contrast(picture):
    """Of the middle of a picture."""
    grey = np.asarray(Image.open(io.BytesIO(picture)).convert("L"), float)
    height, width = grey.shape
    return grey[height // 3 : 2 * height // 3, width // 3 : 2 * width // 3].std()


def fetched(browser, address):
    with browser.get(address) as answer:
        assert answer.status_code == 200, address
        return answer.get_data()


@pytest.fixture
def full(client, park):
    """A map with an image and a photo that has a place."""
    image = io.BytesIO()
    Image.new("RGB", (300, 200), "green").save(image, "PNG")
    image.seek(0)
    corners = {"top_left": {"lat": 50.1, "lon": 14.4}, "bottom_right": {"lat": 50.09, "lon": 14.42}}
    data = {"file": (image, "s.png"), "corners": json.dumps(corners)}
    client.put(f"/api/v1/maps/{park}/satellite", data=data)
    client.post(f"/api/v1/maps/{park}/photos", data={"file": [(io.BytesIO(stripes()), "a.jpg")]})
    client.patch(
        f"/api/v1/maps/{park}/experiences", json={"changes": [{"id": 0, "x_px": 50.0, "y_px": 60.0}]}
    )
    return park


def blur(browser, slug, *boxes, id=0):
    return browser.put(f"/api/v1/maps/{slug}/photos/{id}/blur", json={"boxes": list(boxes)})


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
    """As by a visitor who opens the photo of a restored map while it is being blurred."""
    token = client.post(f"/api/v1/maps/{full}/shares", json={"photos": True}).json["url"].rpartition("/")[2]
    for file in (library.folder / full / "derived" / "previews").iterdir():
        file.unlink()
    write = show_photo.write_previews

    def blurred_meanwhile(*args, **options):
        monkeypatch.setattr(show_photo, "write_previews", write)
        assert blur(client, full, BOX).status_code == 200
        write(*args, **options)

    monkeypatch.setattr(show_photo, "write_previews", blurred_meanwhile)
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


def test_faces_are_suggested_and_nothing_is_changed(client, full, park, monkeypatch):
    class StandIn:
        def detect(self, pixels):
            assert pixels.shape == (120, 160, 3)
            return [BlurBox(0.4, 0.4, 0.1, 0.2), BlurBox(0.8, 0.1, 0.1, 0.1)]

    monkeypatch.setattr(api_photos, "face_detector", lambda chosen: StandIn())
    url = f"/api/v1/maps/{park}/photos/0/blur"
    first, second = client.get(f"{url}/suggestions").json["boxes"]
    assert first == pytest.approx({"x": 0.38, "y": 0.36, "width": 0.14, "height": 0.28})
    assert client.get(f"/api/v1/maps/{park}").json["photos"][0]["blurred"] == []
    assert client.put(url, json={"boxes": [first]}).status_code == 200
    assert client.get(f"{url}/suggestions").json["boxes"] == [second]
    assert client.get(f"/api/v1/maps/{park}/photos/7/blur/suggestions").status_code == 404


def test_without_the_model_it_is_said_how_to_get_it(client, full, park):
    answer = client.get(f"/api/v1/maps/{park}/photos/0/blur/suggestions")
    assert answer.status_code == 422
    assert answer.json["error"]["message"] == "the weights of faces are not here"
    assert "expmap models fetch" in answer.json["error"]["hint"]
