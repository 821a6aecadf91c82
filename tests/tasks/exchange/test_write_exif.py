"""Positions and headings of a map go into copies of its photos, and nothing else changes."""

import io
from dataclasses import replace

import piexif
import pytest
from PIL import Image

from webapp.core.geo.georeference import Georeference
from webapp.core.geo.types import LatLon
from webapp.errors import PhotoError, UsageError
from webapp.files.maps.folder import read_map, write_map
from webapp.files.photos.exif_gps import Gps, Heading
from webapp.files.photos.exif_write import with_position
from webapp.files.photos.photo import read_facts
from webapp.settings import PhotoLimits
from webapp.tasks.exchange.export_source import of_folder
from webapp.tasks.exchange.write_exif import write_exif

LIMITS = PhotoLimits()
TURNED = Georeference("EPSG:4326", (1e-5, 2e-6, 26.5, 2e-6, -1e-5, 60.4, 0, 0, 1), "affine")
HERE = LatLon(-12.3456789, -77.1234567)


def encoded(kind="JPEG", **exif):
    file = io.BytesIO()
    more = {"exif": piexif.dump(exif)} if exif else {}
    Image.new("RGB", (40, 30), (90, 120, 30)).save(file, kind, **more)
    return file.getvalue()


@pytest.fixture
def source(make_map, tmp_path):
    cfg = make_map(tmp_path / "folder", 3)
    map_ = read_map(cfg)
    first, second, third = map_.experiences
    write_map(
        cfg,
        replace(map_, experiences=(first, replace(second, heading_deg=271.5), third), georeference=TURNED),
    )
    return of_folder(cfg)


def test_copies_read_back_and_originals_stay(source, tmp_path):
    before = {path: path.read_bytes() for path in source.cfg.parent.rglob("*") if path.is_file()}
    out = tmp_path / "out"
    copies = list(write_exif(source, out, limits=LIMITS))
    assert [(one.id, one.reason) for one in copies] == [(e.id, None) for e in source.map.experiences]
    for e in source.map.experiences:
        facts = read_facts(out / e.photo, limits=LIMITS)
        assert TURNED.pixel_of(LatLon(facts.gps.lat, facts.gps.lon)) == pytest.approx(e.position, abs=1e-3)
        assert facts.heading == (None if e.heading_deg is None else Heading(e.heading_deg, "T"))
    assert {path: path.read_bytes() for path in source.cfg.parent.rglob("*") if path.is_file()} == before


def test_no_file_is_replaced(source, tmp_path):
    out = tmp_path / "out"
    name = source.map.experiences[1].photo
    (out / name).parent.mkdir(parents=True)
    (out / name).write_bytes(b"mine")
    copies = list(write_exif(source, out, limits=LIMITS))
    assert [one.position is None for one in copies] == [False, True, False]
    assert "already" in copies[1].reason
    assert (out / name).read_bytes() == b"mine"


def test_what_cannot_be_copied_has_a_reason(source, tmp_path):
    folder = source.cfg.parent
    first, second, _ = (folder / e.photo for e in source.map.experiences)
    first.unlink()
    Image.new("RGB", (40, 30)).save(second, "PNG")
    copies = list(write_exif(source, tmp_path / "out", limits=LIMITS))
    assert "not found" in copies[0].reason
    assert "PNG" in copies[1].reason
    assert copies[2].position is not None


def test_a_map_without_georeference_and_its_own_folder_are_rejected(source, tmp_path):
    with pytest.raises(UsageError, match="no georeference"):
        write_exif(replace(source, map=replace(source.map, georeference=None)), tmp_path / "o", limits=LIMITS)
    with pytest.raises(UsageError, match="originals"):
        write_exif(source, source.cfg.parent, limits=LIMITS)


@pytest.mark.parametrize("kind", ["JPEG", "WEBP"])
def test_pixels_and_other_tags_stay(kind):
    old = {
        "0th": {piexif.ImageIFD.Make: b"Maker", piexif.ImageIFD.Orientation: 6},
        "Exif": {
            piexif.ExifIFD.DateTimeOriginal: b"2024:05:01 10:20:30",
            piexif.ExifIFD.MakerNote: bytes(range(256)),
            piexif.ExifIFD.FocalLengthIn35mmFilm: 28,
        },
        "GPS": {
            1: b"N", 2: ((50, 1), (5, 1), (0, 1)), 3: b"E", 4: ((14, 1), (0, 1), (0, 1)), 5: 1, 6: (125, 10),
            9: b"V", 11: (3, 1), 16: b"M", 17: (900, 10), 18: b"TOKYO", 31: (8, 1),
        },
    }  # fmt: skip
    photo = encoded(kind, **old)
    data, note = with_position(photo, HERE, heading_deg=None, limits=LIMITS)
    assert note is None
    was, now = read_facts(photo, limits=LIMITS), read_facts(data, limits=LIMITS)
    assert (now.gps.lat, now.gps.lon) == pytest.approx(HERE, abs=1e-9)
    assert (now.gps.altitude_m, now.gps.dop, now.gps.accuracy_m) == (-12.5, None, None)
    assert now.heading == Heading(90.0, "M"), "kept where the map has none"
    assert (now.orientation, now.taken_at, now.fov, now.maker) == (6, was.taken_at, was.fov, "Maker")
    assert piexif.load(data)["Exif"][piexif.ExifIFD.MakerNote] == bytes(range(256))
    with Image.open(io.BytesIO(photo)) as a, Image.open(io.BytesIO(data)) as b:
        assert a.tobytes() == b.tobytes()


def test_a_photo_without_exif_and_a_heading(tmp_path):
    data, note = with_position(encoded(), HERE, heading_deg=360.0, limits=LIMITS)
    facts = read_facts(data, limits=LIMITS)
    assert (note, facts.heading, facts.orientation) == (None, Heading(0.0, "T"), 1)


def test_a_damaged_block_is_replaced_and_noted():
    photo = encoded(**{"0th": {piexif.ImageIFD.Make: b"Maker"}})
    photo = photo.replace(b"\x01\x0f\x00\x02", b"\x01\x0f\x00\x63", 1)  # a type that does not exist
    data, note = with_position(photo, HERE, heading_deg=1.0, limits=LIMITS)
    assert "damaged" in note
    assert isinstance(read_facts(data, limits=LIMITS).gps, Gps)


def test_a_file_that_is_not_a_photo_is_rejected():
    with pytest.raises(PhotoError):
        with_position(b"hello", HERE, heading_deg=None, limits=LIMITS)
