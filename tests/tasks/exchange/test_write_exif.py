"""Positions and headings of a map are written to its photos, copies or sidecars; nothing else changes."""

import csv
import io
import zipfile
from dataclasses import replace

import piexif
import pytest
from defusedxml.ElementTree import parse
from PIL import ExifTags, Image

from webapp.core.geo.georeference import Georeference
from webapp.core.geo.types import LatLon
from webapp.errors import PhotoError, UsageError
from webapp.files.maps.folder import read_map, write_map
from webapp.files.maps.positions import read_positions
from webapp.files.photos.exif import Gps, Heading
from webapp.files.photos.exif_write import Geotag, with_position
from webapp.files.photos.photo import read_facts
from webapp.settings import PhotoLimits
from webapp.store.library import DATABASE, INNER
from webapp.tasks.exchange.export_source import of_folder
from webapp.tasks.exchange.write_exif import (
    BACKUP,
    export_exiftool_csv,
    export_geotagged,
    export_sidecars,
    write_exif,
)

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
    data, note = with_position(photo, Geotag(HERE), limits=LIMITS)
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
    data, note = with_position(encoded(), Geotag(HERE, 360.0), limits=LIMITS)
    facts = read_facts(data, limits=LIMITS)
    assert (note, facts.heading, facts.orientation) == (None, Heading(0.0, "T"), 1)


def test_a_damaged_block_is_replaced_and_noted():
    photo = encoded(**{"0th": {piexif.ImageIFD.Make: b"Maker"}})
    photo = photo.replace(b"\x01\x0f\x00\x02", b"\x01\x0f\x00\x63", 1)  # a type that does not exist
    data, note = with_position(photo, Geotag(HERE, 1.0), limits=LIMITS)
    assert "damaged" in note
    assert isinstance(read_facts(data, limits=LIMITS).gps, Gps)


def test_a_file_that_is_not_a_photo_is_rejected():
    with pytest.raises(PhotoError):
        with_position(b"hello", Geotag(HERE), limits=LIMITS)


def picture_data(jpeg):
    """Return the picture data after the header of a JPEG."""
    return jpeg[jpeg.index(b"\xff\xda") :]


def gps_of(data):
    """Return GPS tags by name, read by Pillow."""
    with Image.open(io.BytesIO(data)) as image:
        tags = image.getexif().get_ifd(ExifTags.IFD.GPSInfo)
    return {ExifTags.GPSTAGS[tag]: value for tag, value in tags.items()}


@pytest.fixture
def measured(source):
    """The map with its first photo placed by its GPS of 4 m accuracy, which is also in the file."""
    first, *others = source.map.experiences
    at = TURNED.latlon_of(first.position)
    fix = with_position(encoded(), Geotag(at, by_gps=True, accuracy_m=4.0), limits=LIMITS)[0]
    (source.cfg.parent / first.photo).write_bytes(fix)
    return replace(source, map=replace(source.map, experiences=(first, *others)))


def unzipped(download):
    with zipfile.ZipFile(io.BytesIO(b"".join(download.pieces))) as archive:
        assert archive.testzip() is None
        return {name: archive.read(name) for name in archive.namelist()}


def test_a_zip_has_all_photos_with_their_positions(measured):
    first, second, _ = measured.map.experiences
    members = unzipped(export_geotagged(measured, limits=LIMITS))
    assert sorted(members) == sorted(e.photo.split("/")[-1] for e in measured.map.experiences)
    for e in measured.map.experiences:
        data = members[e.photo.split("/")[-1]]
        assert picture_data(data) == picture_data((measured.cfg.parent / e.photo).read_bytes())
        assert gps_of(data)["GPSMapDatum"] == "WGS-84"
    own, turned = (gps_of(members[e.photo.split("/")[-1]]) for e in (first, second))
    assert (float(own["GPSHPositioningError"]), "GPSProcessingMethod" in own) == (4.0, False)
    assert (float(turned["GPSImgDirection"]), turned["GPSImgDirectionRef"]) == (271.5, "T")
    assert "GPSHPositioningError" not in turned and turned["GPSProcessingMethod"].endswith(b"MANUAL")


def test_photos_that_were_moved_lose_the_accuracy_of_their_gps(measured):
    first, *others = measured.map.experiences
    elsewhere = replace(first, position=first.position._replace(x=first.position.x + 3))
    moved = replace(measured, map=replace(measured.map, experiences=(elsewhere, *others)))
    members = unzipped(export_geotagged(moved, limits=LIMITS))
    assert "GPSHPositioningError" not in gps_of(members[first.photo.split("/")[-1]])


def test_a_zip_has_a_sidecar_for_what_cannot_be_written_and_says_so(source):
    first = source.map.experiences[0]
    Image.new("RGB", (40, 30)).save(source.cfg.parent / first.photo, "PNG")
    members = unzipped(export_geotagged(source, limits=LIMITS))
    name = first.photo.split("/")[-1]
    assert name not in members and f"{name}.xmp" in members
    assert members["not-written.txt"].decode().startswith(f"{name}: positions cannot be written to PNG files")


def test_names_that_two_photos_share_become_paths(source):
    experiences = [replace(e, name="same.jpg") for e in source.map.experiences[:2]]
    both = replace(source, map=replace(source.map, experiences=tuple(experiences)))
    assert sorted(unzipped(export_geotagged(both, limits=LIMITS))) == sorted(e.photo for e in experiences)


def test_sidecars_have_the_properties_of_exif(measured):
    files = unzipped(export_sidecars(measured, limits=LIMITS))
    for e in measured.map.experiences:
        document = parse(io.BytesIO(files[e.photo.split("/")[-1] + ".xmp"]))
        fields = [one for one in document.iter() if "ns.adobe.com/exif" in one.tag]
        exif = {one.tag.rpartition("}")[2]: one.text for one in fields}
        at = TURNED.latlon_of(e.position)
        for name, value in (("GPSLatitude", at.lat), ("GPSLongitude", at.lon)):
            degrees, minutes = exif[name][:-1].split(",")
            sign = 1 if exif[name][-1] in "NE" else -1
            assert sign * (int(degrees) + float(minutes) / 60) == pytest.approx(value, abs=1e-9)
        assert exif.get("GPSImgDirection") == (None if e.heading_deg is None else "27150/100")
        assert exif.get("GPSHPositioningError") == ("4000/1000" if e is measured.map.experiences[0] else None)


def test_the_table_for_exiftool_reads_back_as_a_list_of_positions(measured, tmp_path):
    table = tmp_path / "park.csv"
    table.write_bytes(b"".join(export_exiftool_csv(measured, limits=LIMITS).pieces))
    rows = list(csv.DictReader(table.read_text("utf-8").splitlines()))
    for row, e in zip(rows, measured.map.experiences, strict=True):
        at = TURNED.latlon_of(e.position)
        assert row["SourceFile"] == e.photo.split("/")[-1]
        assert (float(row["GPSLatitude"]), float(row["GPSLongitude"])) == pytest.approx(at, abs=1e-8)
        assert (row["GPSLatitudeRef"], row["GPSLongitudeRef"], row["GPSMapDatum"]) == ("N", "E", "WGS-84")
    assert [row["GPSImgDirection"] for row in rows] == ["", "271.50", ""]
    assert [row["GPSHPositioningError"] for row in rows] == ["4.000", "", ""]
    again = read_positions(table)
    assert again.headings_deg == {rows[1]["SourceFile"]: 271.5}
    for row in rows:
        position = float(row["GPSLatitude"]), float(row["GPSLongitude"])
        assert again.by_name[row["SourceFile"]] == pytest.approx(position)


def test_in_place_keeps_the_first_original(source):
    folder = source.cfg.parent
    photos = [folder / e.photo for e in source.map.experiences]
    before = [path.read_bytes() for path in photos]
    for _ in range(2):  # the second run overwrites the first
        assert all(one.position for one in write_exif(source, None, limits=LIMITS))
        for path, was in zip(photos, before, strict=True):
            assert path.with_name(path.name + BACKUP).read_bytes() == was
            assert picture_data(path.read_bytes()) == picture_data(was)
            assert gps_of(path.read_bytes())["GPSLatitudeRef"] == "N"


def test_photos_of_a_library_are_not_changed(source):
    library = source.cfg.parent.parent
    (library / INNER).mkdir()
    (library / INNER / DATABASE).touch()
    with pytest.raises(UsageError, match="library"):
        write_exif(source, None, limits=LIMITS)
