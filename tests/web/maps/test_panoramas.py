"""Panoramas in the library: recognised when added, one experience each, masked and unmasked by edits."""

import io
import json
import zipfile

import cv2
import numpy as np
import pytest
from PIL import Image

from tests.tasks.localize.test_panorama_query import save, texture
from tests.tasks.maps.test_cut_panoramas import POSE
from webapp.core.boxes import BlurBox
from webapp.core.geometry.tilt import Tilt
from webapp.core.mapmodel.panorama import Panorama
from webapp.files.maps.folder import read_map
from webapp.files.photos.panorama import read_panorama
from webapp.settings import Settings
from webapp.store.schema import MapRecord
from webapp.tasks.exchange import export_files, import_map

BOX = {"x": 0.0, "y": 0.75, "width": 1.0, "height": 0.25}


@pytest.fixture
def full(client, park, tmp_path):
    """A map with an image, a panorama with the heading of its middle, and one without."""
    image = io.BytesIO()
    Image.new("RGB", (300, 200), "green").save(image, "PNG")
    image.seek(0)
    client.put(f"/api/v1/maps/{park}/satellite", data={"file": (image, "s.png")})
    silent = save(tmp_path / "b.jpg", texture(2)[::4, ::4], xmp=b"")
    said = save(tmp_path / "a.jpg", texture(1)[::4, ::4])
    said.write_bytes(said.read_bytes().replace(b'Degrees="0.0"', b'Degrees="9.5"'))
    files = [(io.BytesIO(path.read_bytes()), path.name) for path in (said, silent)]
    client.post(f"/api/v1/maps/{park}/photos", data={"file": files})
    return park


def photos_of(client, slug):
    return client.get(f"/api/v1/maps/{slug}").json["photos"]


def edit(client, slug, id, **fields):
    return client.patch(f"/api/v1/maps/{slug}/experiences/{id}", json=fields)


def test_a_panorama_is_recognised_when_it_is_uploaded(client, full):
    said, silent = photos_of(client, full)
    assert (said["panorama"], said["heading_deg"], said["fov_deg"]) == ({"masked": []}, 9.5, 360.0)
    assert (silent["panorama"], silent["heading_deg"], silent["fov_deg"]) == (None, None, None)


def test_its_tilt_is_read_kept_when_a_mask_is_changed_and_exported(client, full, tmp_path, library):
    said = save(tmp_path / "c.jpg", texture(3)[::4, ::4])
    said.write_bytes(
        said.read_bytes().replace(b'Degrees="0.0"/>', b'Degrees="0"' + POSE).replace(b"%p", b"-4")
    )
    tilted = said.read_bytes().replace(b"%r", b"358")
    client.post(f"/api/v1/maps/{full}/photos", data={"file": [(io.BytesIO(tilted), "c.jpg")]})
    tilt = {"pitch_deg": -4.0, "roll_deg": -2.0}
    assert photos_of(client, full)[2]["panorama"] == {"masked": [], **tilt}
    (changed,) = edit(client, full, 2, panorama={"masked": [BOX]}).json["photos"]
    assert changed["panorama"] == {"masked": [BOX], **tilt}
    (level,) = edit(client, full, 2, panorama={"masked": [], "pitch_deg": 0.0, "roll_deg": 0.0}).json[
        "photos"
    ]
    assert level["panorama"] == {"masked": []}
    client.post(f"/api/v1/maps/{full}/undo")
    assert edit(client, full, 2, panorama={"pitch_deg": 91.0}).status_code == 422
    edit(client, full, 2, x_px=50.0, y_px=60.0)
    with client.get(f"/api/v1/maps/{full}/map.cfg"):
        (one,) = read_map(library.cfg(full)).experiences
    assert one.panorama == Panorama((BlurBox(**BOX),), Tilt(-4.0, -2.0))


def test_it_is_one_experience_with_one_line(client, full, library):
    edit(client, full, 0, x_px=50.0, y_px=60.0)
    with client.get(f"/api/v1/maps/{full}/map.cfg") as answer:
        lines = answer.get_data(as_text=True).splitlines()
    assert lines[1:] == ["0;photos/a.jpg;50;60"]
    (one,) = read_map(library.cfg(full)).experiences
    assert one.panorama is not None and one.view is None


def test_a_photo_that_says_nothing_becomes_one_by_an_edit_that_can_be_undone(client, full, library):
    edit(client, full, 1, x_px=50.0, y_px=60.0)
    with library.database.read() as session:
        before = session.query(MapRecord).one().photos_revision
    made = edit(client, full, 1, panorama={"masked": [BOX]}).json
    (photo,) = made["photos"]
    assert (photo["panorama"], photo["fov_deg"]) == ({"masked": [BOX]}, 360.0)
    assert made["undo"] == {"kind": "panorama", "count": 1}
    with library.database.read() as session:
        assert session.query(MapRecord).one().photos_revision > before, "the index has to follow"
    client.post(f"/api/v1/maps/{full}/undo")
    assert [photos_of(client, full)[1][field] for field in ("panorama", "fov_deg")] == [None, None]
    client.post(f"/api/v1/maps/{full}/redo")
    assert edit(client, full, 1, panorama=None).json["photos"][0]["fov_deg"] is None


def test_other_shapes_are_refused(client, full):
    photo = io.BytesIO()
    Image.new("RGB", (60, 40)).save(photo, "JPEG")
    photo.seek(0)
    client.post(f"/api/v1/maps/{full}/photos", data={"file": [(photo, "c.jpg")]})
    refused = edit(client, full, 2, panorama={})
    assert refused.status_code == 400
    assert refused.json["error"]["message"] == "c.jpg is not a full panorama, twice as wide as high"
    beyond = edit(client, full, 0, panorama={"masked": [{**BOX, "width": 2.0}]})
    assert beyond.status_code == 422
    assert "not a box inside the photo" in beyond.json["error"]["message"]


def test_a_mask_that_is_an_image_becomes_boxes(client, full):
    mask = np.full((100, 200), 255, np.uint8)
    mask[70:, 40:90] = 0

    def send(pixels):
        png = io.BytesIO(cv2.imencode(".png", pixels)[1].tobytes())
        return client.post(f"/api/v1/maps/{full}/photos/mask", data={"file": (png, "mask.png")})

    (box,) = send(mask).json["masked"]
    assert box == pytest.approx({"x": 0.2, "y": 0.7, "width": 0.25, "height": 0.3})
    assert send(mask[:, :120]).status_code == 422
    noise = np.random.default_rng(1).integers(0, 2, (180, 360), dtype=np.uint8) * 255
    assert send(noise).json["error"]["message"].startswith("the mask is too ragged: ")
    disc = cv2.circle(np.full((1800, 3600), 255, np.uint8), (1801, 900), 700, 0, -1)
    boxes = send(disc).json["masked"]
    assert all(round(side, 5) == side for box in boxes for side in box.values())
    assert len(json.dumps(boxes)) < 75 * len(boxes)
    assert photos_of(client, full)[0]["panorama"] == {"masked": []}, "nothing is changed"


def test_a_zip_keeps_it_placed_or_not(client, full, library, owner, tmp_path):
    edit(client, full, 0, x_px=50.0, y_px=60.0, panorama={"masked": [BOX]})
    edit(client, full, 1, panorama={})
    with library.database.read() as session:
        id = session.query(MapRecord).one().id
    path = tmp_path / "map.zip"
    path.write_bytes(b"".join(export_files.export_map_zip(library, id).pieces))
    assert len([n for n in zipfile.ZipFile(path).namelist() if n.endswith(".jpg")]) == 2
    done = import_map.import_map(library, path, account_id=owner.id, name="Again", settings=Settings())
    again = photos_of(client, done.slug)
    assert [photo["panorama"] for photo in again] == [{"masked": [BOX]}, {"masked": []}]
    assert [photo["fov_deg"] for photo in again] == [360.0, 360.0]


def test_tags_in_either_order_are_read():
    assert read_panorama(b"<GPano:ProjectionType>equirectangular</GPano", (20, 10)).is_marked
