"""Plans and satellite images are upright, no matter in which format and on which way they arrive."""

import io
import json
import zipfile

import numpy as np
import piexif
import pillow_heif
import pytest
from PIL import Image

from webapp.core.geo.floors import Floor
from webapp.core.geo.types import MapPixel
from webapp.errors import UsageError
from webapp.files.maps.folder import read_map
from webapp.files.photos.photo import turn_upright
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.store.library import open_library
from webapp.store.schema import Account
from webapp.tasks.exchange import import_map
from webapp.tasks.maps import adopt_map, from_photos
from webapp.tasks.maps.from_photos import PlaceOptions
from webapp.tasks.satellite.floors import NewFloor, add_in_folder
from webapp.tasks.satellite.upright import as_shown

WIDE, HIGH = 160, 120
SPOT = (140, 20)
"""A dark spot, x and y in the stored pixels."""


def stored():
    pixels = np.full((HIGH, WIDE, 3), 230, np.uint8)
    pixels[SPOT[1] - 8 : SPOT[1] + 8, SPOT[0] - 8 : SPOT[0] + 8] = 10
    return pixels


def plan(kind, turn, *, pixels=None):
    """Encode the plan with an EXIF orientation; for HEIC, upright pixels are what the file shows."""
    image, file = Image.fromarray(stored() if pixels is None else pixels), io.BytesIO()
    if kind == "TIFF":
        image.save(file, "TIFF", tiffinfo={274: turn})
    elif kind == "HEIF":
        pillow_heif.register_heif_opener()
        Image.fromarray(turn_upright(stored(), turn)).save(file, "HEIF", quality=90)
    else:
        image.save(file, kind, exif=piexif.dump({"0th": {274: turn}}))
    return file.getvalue()


def spot_of(path):
    """Return size, format and the middle of the dark spot of an image, whose orientation must be dropped."""
    with Image.open(path) as image:
        assert image.getexif().get(274, 1) == 1
        grey, kind = np.asarray(image.convert("L")), image.format
    y, x = np.nonzero(grey < 100)
    return grey.shape[::-1], kind, (float(x.mean()), float(y.mean()))


@pytest.fixture
def bring(tmp_path):
    """Import a zip with a plan and a photo on it; return the image and the map."""
    library = open_library(tmp_path / "library")
    with library.database.write() as session:
        account = Account(name="ana", is_owner=True)
        session.add(account)

    def run(name, content, line, *, at=SPOT, further=()):
        photo = io.BytesIO()
        Image.new("RGB", (30, 20), (90, 90, 200)).save(photo, "JPEG")
        with zipfile.ZipFile(tmp_path / "map.zip", "w") as archive:
            archive.writestr("map.cfg", f"{line}\n0;a.jpg;{at[0]};{at[1]}\n")
            archive.writestr("a.jpg", photo.getvalue())
            archive.writestr(name, content)
            for other, text in further:
                archive.writestr(other, text)
        done = import_map.import_map(
            library, tmp_path / "map.zip", account_id=account.id, name="Plan", settings=Settings()
        )
        cfg = library.cfg(done.slug)
        map_ = read_map(cfg)
        return cfg.parent / map_.satellite.path, map_

    yield run
    library.database.close()


@pytest.mark.parametrize("kind", ["JPEG", "PNG", "TIFF", "HEIF", "WEBP"])
@pytest.mark.parametrize("turn", [3, 6, 8])
def test_an_imported_plan_is_upright(bring, kind, turn):
    name = f"plan.{kind.lower()[:4]}".replace("heif", "heic").replace("jpeg", "jpg")
    width, height = (HIGH, WIDE) if turn >= 5 else (WIDE, HIGH)
    image, map_ = bring(name, plan(kind, turn), f"{name};{width};{height}", at=(1, 2))
    size, shown, spot = spot_of(image)
    assert (map_.satellite.width, map_.satellite.height) == size == (width, height)
    assert shown in ("PNG", "JPEG")
    assert map_.experiences[0].position == MapPixel(1, 2)
    x, y = SPOT
    there = {3: (WIDE - x, HIGH - y), 6: (HIGH - y, x), 8: (y, WIDE - x)}[turn]
    assert np.allclose(spot, there, atol=1.5)
    assert [path.name for path in image.parent.glob("plan.*")] == []


@pytest.mark.parametrize("turn", [5, 6, 7, 8])
@pytest.mark.parametrize("kind", ["JPEG", "PNG", "TIFF"])
def test_positions_on_the_stored_pixels_are_turned_with_them(bring, kind, turn):
    name = f"plan.{kind.lower()[:4]}"
    image, map_ = bring(name, plan(kind, turn), f"{name};{WIDE};{HIGH}")
    size, _, spot = spot_of(image)
    assert (map_.satellite.width, map_.satellite.height) == size == (HIGH, WIDE)
    assert np.allclose(map_.experiences[0].position, spot, atol=1.5)


def test_in_a_map_with_records_the_pixels_stay_as_its_positions_have_them(bring):
    records = '{"format": "experience-map", "version": 1, "title": "Plan"}'
    image, map_ = bring(
        "plan.jpg", plan("JPEG", 6), f"plan.jpg;{WIDE};{HIGH}", further=[("map.json", records)]
    )
    size, _, spot = spot_of(image)
    assert (map_.satellite.width, map_.satellite.height) == size == (WIDE, HIGH)
    assert np.allclose(spot, SPOT, atol=1.5)
    assert map_.experiences[0].position == MapPixel(*SPOT)


@pytest.mark.parametrize("kind", ["JPEG", "PNG", "TIFF", "HEIF"])
def test_a_map_made_on_the_command_line_has_an_upright_plan(tmp_path, kind):
    (tmp_path / "photos").mkdir()
    Image.new("RGB", (30, 20)).save(tmp_path / "photos" / "a.jpg")
    (tmp_path / "plan.img").write_bytes(plan(kind, 6))
    (tmp_path / "list.csv").write_text("name;x;y\na.jpg;100;140\n")
    options = PlaceOptions(tmp_path / "map.cfg", tmp_path / "plan.img", positions=tmp_path / "list.csv")
    for again in (False, True):
        report = from_photos.map_from_photos(
            tmp_path,
            options=PlaceOptions(options.cfg, options.satellite, positions=options.positions, force=again),
            settings=Settings(),
            progress=Progress(),
        )
        map_ = read_map(tmp_path / "map.cfg")
        assert (map_.satellite.width, map_.satellite.height) == (HIGH, WIDE)
        size, shown, spot = spot_of(tmp_path / map_.satellite.path)
        assert (size, shown) == ((HIGH, WIDE), "JPEG" if kind in ("JPEG", "HEIF") else "PNG")
        assert np.allclose(spot, (HIGH - SPOT[1], SPOT[0]), atol=1.5)
        assert sum(file.state == "placed" for file in report.files) == 1


def test_a_floor_added_on_the_command_line_is_upright(make_map, tmp_path):
    cfg = make_map(tmp_path / "park", 1)
    (tmp_path / "first.jpg").write_bytes(plan("JPEG", 6))
    new = NewFloor(Floor(0, "First", 1), file=tmp_path / "first.jpg", base=Floor(0, "Ground", 0))
    add_in_folder(cfg, new=new, settings=Settings())
    image = read_map(cfg).floors[1].image
    assert (image.path, image.width, image.height) == ("first.upright.jpg", HIGH, WIDE)
    assert spot_of(cfg.parent / image.path)[0] == (HIGH, WIDE)


@pytest.mark.parametrize(
    ("kind", "shown"), [("HEIF", "JPEG"), ("WEBP", "JPEG"), ("GIF", "PNG"), ("BMP", "PNG")]
)
def test_an_uploaded_image_of_any_format_of_photos_is_shown(tmp_path, kind, shown):
    (tmp_path / "plan").write_bytes(plan(kind, 6))
    copy = as_shown(tmp_path / "plan", scratch=tmp_path, settings=Settings())
    turned = kind in ("HEIF", "WEBP")  # the others have no EXIF
    assert spot_of(copy)[:2] == ((HIGH, WIDE) if turned else (WIDE, HIGH), shown)


def test_transparent_parts_of_a_plan_are_white(tmp_path):
    Image.new("RGBA", (20, 20), (0, 0, 0, 0)).save(tmp_path / "plan", "WEBP", lossless=True)
    copy = as_shown(tmp_path / "plan", scratch=tmp_path, settings=Settings())
    assert np.asarray(Image.open(copy)).min() > 250


@pytest.mark.parametrize("kind", ["JPEG", "PNG", "HEIF"])
@pytest.mark.parametrize("size", [(HIGH, WIDE), (WIDE, HIGH)])
def test_the_image_of_a_floor_in_a_zip_is_upright(bring, kind, size):
    """Or keeps its stored pixels, if the map's positions refer to those."""
    image = {"path": "first.img.png", "width": size[0], "height": size[1]}
    floors = [
        {"id": 0, "name": "Ground", "level": 0},
        {"id": 1, "name": "First", "level": 1, "image": {**image, "map_from_image": [[1, 0, 0], [0, 1, 0]]}},
    ]
    records = json.dumps({"format": "experience-map", "version": 1, "floors": floors})
    further = [("map.json", records), ("first.img.png", plan(kind, 6))]
    base, map_ = bring("plan.png", plan("PNG", 1), f"plan.png;{WIDE};{HIGH}", further=further)
    found = map_.floors[1].image
    shown, _, spot = spot_of(base.parent / found.path)
    if kind == "HEIF":  # its decoder shows upright pixels only
        assert shown == (HIGH, WIDE)
    else:
        assert shown == size == (found.width, found.height)
        assert np.allclose(spot, SPOT if size == (WIDE, HIGH) else (HIGH - SPOT[1], SPOT[0]), atol=1.5)


def test_a_folder_with_a_turned_image_is_not_adopted_as_it_is(make_map, tmp_path):
    library = open_library(tmp_path / "library")
    cfg = make_map(library.map_folder("park"), 1)
    (cfg.parent / read_map(cfg).satellite.path).write_bytes(plan("JPEG", 6))
    with library.database.write() as session:
        account = Account(name="ana", is_owner=True)
        session.add(account)
    with pytest.raises(UsageError, match="is turned by its EXIF orientation") as caught:
        adopt_map.adopt_map(library, "park", account_id=account.id)
    assert "import a zip" in caught.value.hint
    library.database.close()


def test_a_plan_of_few_of_its_16_bits_is_stretched(tmp_path):
    """A PNG of 12 bits, as scanners and CAD programs write it, is nearly black in a browser."""
    ramp = np.tile(np.arange(WIDE) * 4095 // WIDE, (HIGH, 1)).astype(np.uint16)
    Image.fromarray(ramp).save(tmp_path / "plan", "PNG")
    Image.fromarray(ramp * 16).save(tmp_path / "full", "PNG")
    shown = np.asarray(Image.open(as_shown(tmp_path / "plan", scratch=tmp_path, settings=Settings())))
    assert shown.dtype == np.uint8 and shown.min() < 5 and shown.max() > 250
    assert as_shown(tmp_path / "full", scratch=tmp_path, settings=Settings()) == tmp_path / "full"
