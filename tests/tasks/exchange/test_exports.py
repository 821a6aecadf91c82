"""Exports can be read by other programs, and contain nothing confidential."""

import io
import json
import zipfile
from dataclasses import replace
from xml.etree import ElementTree as ET

import piexif
import pytest
from PIL import Image

from webapp.core.geo.georeference import Georeference
from webapp.core.geo.types import LatLon
from webapp.core.mapmodel.model import PhotoSource
from webapp.errors import NotFound, UsageError
from webapp.files.maps.folder import read_map, write_map
from webapp.settings import Settings
from webapp.store.schema import MapRecord
from webapp.tasks.exchange import export_files
from webapp.tasks.exchange.export_source import of_folder, of_library, plain_name

TURNED = Georeference("EPSG:4326", (1e-5, 2e-6, 26.5, 2e-6, -1e-5, 60.4, 0, 0, 1), "affine")
HOSTILE = "photos/<b>&amp ]]><![CDATA[ <script>alert(1) <img src=x> \"'.jpg"
KML = "{http://www.opengis.net/kml/2.2}"


def whole(download):
    return b"".join(download.pieces)


@pytest.fixture
def source(make_map, tmp_path):
    """A map in a folder, with a georeference, a heading and a hostile name."""
    cfg = make_map(tmp_path / "folder", 3)
    (tmp_path / "folder" / "photos" / "1.jpg").rename(tmp_path / "folder" / HOSTILE)
    map_ = read_map(cfg)
    first, second, third = map_.experiences
    second = replace(second, photo=HOSTILE, heading_deg=271.5, taken_at="2026-04-30T14:05:00+02:00")
    write_map(cfg, replace(map_, experiences=(first, second, third), georeference=TURNED))
    return of_folder(cfg, title="A <park> & more")


def test_geojson_has_longitude_first(source):
    content = json.loads(whole(export_files.export_map_geojson(source)))
    assert content["name"] == "A <park> & more"
    for e, feature in zip(source.map.experiences, content["features"], strict=True):
        lon, lat = feature["geometry"]["coordinates"]
        assert TURNED.pixel_of(LatLon(lat, lon)) == pytest.approx(e.position, abs=1e-3)
        assert (feature["id"], feature["properties"]["photo"]) == (e.id, e.photo)
    assert content["features"][1]["properties"]["heading_deg"] == 271.5


def test_whom_a_photo_is_from_leaves_with_it(source, tmp_path):
    first, *others = source.map.experiences
    first = replace(first, source=PhotoSource("Street", "s-1", "CC BY 4.0", "Ana <b>"))
    credited = replace(source, map=replace(source.map, experiences=(first, *others)))
    content = json.loads(whole(export_files.export_map_geojson(credited)))
    credits_ = [feature["properties"]["credit"] for feature in content["features"]]
    assert credits_ == ["© Ana <b>, Street (CC BY 4.0)", None, None]
    kml = ET.fromstring(whole(export_files.export_map_kml(credited)))
    assert [
        data.findtext(f"{KML}value") for data in kml.iter(f"{KML}Data") if data.get("name") == "credit"
    ] == ["© Ana <b>, Street (CC BY 4.0)"]


def test_a_photo_beyond_the_horizon_has_no_geometry(source):
    horizon = Georeference(
        "EPSG:4326", (1e-5 - 26.5 / 150, 0, 26.5, -60.4 / 150, -1e-5, 60.4, -1 / 150, 0, 1), "projective"
    )
    far = replace(source, map=replace(source.map, georeference=horizon))
    content = json.loads(whole(export_files.export_map_geojson(far)))
    assert [f["geometry"] is None for f in content["features"]] == [False, True, True]
    assert len(ET.fromstring(whole(export_files.export_map_kml(far))).findall(f".//{KML}Placemark")) == 1


def test_kml_reads_back(source):
    marks = ET.fromstring(whole(export_files.export_map_kml(source))).findall(f".//{KML}Placemark")
    for e, mark in zip(source.map.experiences, marks, strict=True):
        lon, lat = map(float, mark.find(f"{KML}Point/{KML}coordinates").text.split(","))
        assert TURNED.pixel_of(LatLon(lat, lon)) == pytest.approx(e.position, abs=1e-3)
        facts = {d.get("name"): d[0].text for d in mark.iter(f"{KML}Data")}
        assert (facts["id"], facts["photo"]) == (str(e.id), e.photo)
    assert marks[1].find(f"{KML}Style/{KML}IconStyle/{KML}heading").text == "271.5"
    assert marks[1].find(f"{KML}TimeStamp/{KML}when").text == "2026-04-30T14:05:00+02:00"
    assert marks[1].find(f"{KML}name").text == HOSTILE.rsplit("/", 1)[-1]


def test_kml_replaces_what_xml_cannot_hold(source):
    named = replace(source, title="bell \x07 \ufffe")
    root = ET.fromstring(whole(export_files.export_map_kml(named)))
    assert root.find(f"{KML}Document/{KML}name").text == "bell ? ?"


def test_kmz_has_pictures_without_exif(source):
    photo = source.cfg.parent / "photos" / "0.jpg"
    gps = {piexif.GPSIFD.GPSLatitude: ((60, 1), (0, 1), (0, 1)), piexif.GPSIFD.GPSLatitudeRef: b"N"}
    piexif.insert(piexif.dump({"GPS": gps}), str(photo))
    with Image.open(photo) as with_exif:
        assert with_exif.getexif()
    (source.cfg.parent / "photos" / "2.jpg").unlink()
    with zipfile.ZipFile(io.BytesIO(whole(export_files.export_map_kmz(source, settings=Settings())))) as kmz:
        assert set(kmz.namelist()) == {"doc.kml", "files/0.jpg", "files/1.jpg", "files/satellite.jpg"}
        picture = Image.open(io.BytesIO(kmz.read("files/0.jpg")))
        assert not picture.getexif() and "exif" not in picture.info
        root = ET.fromstring(kmz.read("doc.kml"))
    described = [mark.findtext(f"{KML}description") for mark in root.iter(f"{KML}Placemark")]
    assert 'src="files/0.jpg"' in described[0] and described[2] is None
    assert "<script>" not in described[1] and "&lt;script&gt;" in described[1]
    quad = (
        root.findtext(".//{http://www.google.com/kml/ext/2.2}LatLonQuad/coordinates")
        or root.find(".//{http://www.google.com/kml/ext/2.2}LatLonQuad")[0].text
    )
    lon, lat = map(float, quad.split()[3].split(","))
    assert (lat, lon) == pytest.approx((60.4, 26.5))


@pytest.mark.parametrize("export", [export_files.export_map_geojson, export_files.export_map_kml])
def test_without_georeference_it_says_what_to_do(source, export):
    plain = replace(source, map=replace(source.map, georeference=None))
    with pytest.raises(UsageError) as caught:
        export(plain)
    assert "georeference" in caught.value.hint


def test_kmz_without_georeference_fails_before_it_begins(source):
    plain = replace(source, map=replace(source.map, georeference=None))
    with pytest.raises(UsageError):
        export_files.export_map_kmz(plain, settings=Settings())


@pytest.mark.parametrize("name", ["../../etc", "a\r\nSet-Cookie: x", "Парк", "", "x" * 300, "a/b\\c"])
def test_names_of_downloads_are_plain(name):
    plain = plain_name(name)
    assert (
        plain and len(plain) <= 80 and plain.isascii() and plain.replace("-", "").replace("_", "").isalnum()
    )


def test_the_zip_of_a_map_is_the_map(adopt, library, tmp_path):
    map_id = adopt()
    with zipfile.ZipFile(io.BytesIO(whole(export_files.export_map_zip(library, map_id)))) as archive:
        assert archive.testzip() is None
        archive.extractall(tmp_path / "out")
    assert read_map(tmp_path / "out" / "map.cfg") == read_map(library.cfg("park"))
    for name in ("plan.png", "photos/0.jpg", "photos/2.jpg", "map.cfg"):
        assert (tmp_path / "out" / name).read_bytes() == (library.map_folder("park") / name).read_bytes()


def test_a_zip_goes_out_in_pieces(adopt, library):
    map_id = adopt()
    (library.map_folder("park") / "photos" / "1.jpg").write_bytes(bytes(5_000_000))
    pieces = list(export_files.export_map_zip(library, map_id).pieces)
    assert max(map(len, pieces)) < 2_500_000


def test_the_cfg_is_the_file_on_the_disk(adopt, library):
    unusual = "\ufeffplan.png;400;200\r\n 2;photos/2.jpg;07;8\r\n0;photos/0.jpg;1;2"
    map_id = adopt(change=lambda cfg: cfg.write_bytes(unusual.encode()))
    download = export_files.export_map_cfg(library, map_id)
    assert (download.name, whole(download)) == ("park.cfg", unusual.encode())


def test_the_cfg_holds_the_newest_edit(adopt, library, edit):
    map_id = adopt()
    edit(map_id, {"photo/1": {"x_px": 5.0, "y_px": 6.0}})
    assert b"1;photos/1.jpg;5;6\n" in whole(export_files.export_map_cfg(library, map_id))


def test_a_cfg_that_somebody_changed_is_left_alone(adopt, library, edit):
    map_id = adopt()
    library.cfg("park").write_text("plan.png;400;200\n")
    edit(map_id, {"photo/1": {"x_px": 5.0, "y_px": 6.0}})
    assert b"1;photos/1.jpg;5;6\n" in whole(export_files.export_map_cfg(library, map_id))
    assert library.cfg("park").read_text() == "plan.png;400;200\n"


def test_the_cfg_of_a_placement(adopt, library, edit):
    map_id = adopt()
    edit(map_id, {"placed/clusters/1": {"x_px": 7.0, "y_px": 8.0}})
    download = export_files.export_map_cfg(library, map_id, placement="clusters")
    assert whole(download) == b"plan.png;400;200\n1;photos/1.jpg;7;8\n"
    assert download.name == "park-clusters.cfg"
    with pytest.raises(NotFound):
        export_files.export_map_cfg(library, map_id, placement="../map")


def test_a_map_without_image_has_nothing_to_export(library, owner):
    with library.database.write() as session:
        record = MapRecord(slug="empty", name="Empty")
        session.add(record)
    with pytest.raises(UsageError, match="no satellite image"):
        of_library(library, record.id)
