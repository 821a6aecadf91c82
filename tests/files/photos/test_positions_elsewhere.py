"""Positions of photos in XMP, and in files beside the photos."""

import io
import json
import time

import piexif
import pillow_heif
import pytest
from PIL import Image, PngImagePlugin

from webapp.core.geo.types import LatLon
from webapp.files.decode import open_image
from webapp.files.photos.exif import Gps, NoGps
from webapp.files.photos.exif_write import Geotag, format_xmp
from webapp.files.photos.photo import read_facts
from webapp.files.photos.sidecars import Sidecar, Sidecars, choose, with_sidecars
from webapp.files.photos.xmp import MAX_BYTES, parse_xmp
from webapp.settings import PhotoLimits

LIMITS = PhotoLimits()
RDF = 'xmlns:rdf="http://www.w3.org/1999/02/22-rdf-syntax-ns#"'
EXIF = 'xmlns:exif="http://ns.adobe.com/exif/1.0/"'
DJI = 'xmlns:drone-dji="http://www.dji.com/drone-dji/1.0/"'


def packet(attributes="", elements="", *, before=""):
    text = (
        f'{before}<x:xmpmeta xmlns:x="adobe:ns:meta/"><rdf:RDF {RDF}><rdf:Description rdf:about="" {EXIF} '
        f"{DJI} {attributes}>{elements}</rdf:Description></rdf:RDF></x:xmpmeta>"
    )
    return text.encode()


HERE = packet('exif:GPSLatitude="50,6.0N" exif:GPSLongitude="14,24.0W"')


def photo(kind="JPEG", *, xmp=None, exif=None):
    pillow_heif.register_heif_opener()
    file, image, options = io.BytesIO(), Image.new("RGB", (40, 30)), {}
    if exif is not None:
        options["exif"] = piexif.dump(exif)
    if xmp is not None and kind == "PNG":
        info = PngImagePlugin.PngInfo()
        info.add_itxt("XML:com.adobe.xmp", xmp.decode())
        options["pnginfo"] = info
    elif xmp is not None and kind == "TIFF":
        options["tiffinfo"] = {700: xmp}
    elif xmp is not None:
        options["xmp"] = xmp
    image.save(file, kind, **options)
    return file.getvalue()


def facts(data):
    return read_facts(data, limits=LIMITS)


AT = {"GPS": {1: b"N", 2: ((10, 1), (0, 1), (0, 1)), 3: b"E", 4: ((20, 1), (0, 1), (0, 1))}}


@pytest.mark.parametrize("kind", ["JPEG", "PNG", "TIFF", "HEIF", "WEBP"])
def test_a_position_in_xmp_is_read_in_every_format(kind):
    gps = facts(photo(kind, xmp=HERE)).gps
    assert (gps.lat, gps.lon, gps.source) == (pytest.approx(50.1), pytest.approx(-14.4), "XMP")


@pytest.mark.parametrize(
    ("lat", "lon", "there"),
    [
        ("50,6,30.0S", "14,24,0E", (-50.1083333, 14.4)),
        ("-50.5", "14.25", (-50.5, 14.25)),
        ("50.5N", "14.25 w", (50.5, -14.25)),
    ],
)
def test_positions_as_elements_in_the_forms_that_programs_write(lat, lon, there):
    fields = f"<exif:GPSLatitude>{lat}</exif:GPSLatitude><exif:GPSLongitude>{lon}</exif:GPSLongitude>"
    more = "<exif:GPSAltitude>125/10</exif:GPSAltitude><exif:GPSAltitudeRef>1</exif:GPSAltitudeRef>"
    gps = facts(photo(xmp=packet(elements=fields + more))).gps
    assert (gps.lat, gps.lon) == pytest.approx(there)
    assert gps.altitude_m == -12.5


def test_exif_counts_more_than_xmp_and_what_is_no_position_has_a_reason():
    gps = facts(photo(xmp=HERE, exif=AT)).gps
    assert (gps.lat, gps.lon, gps.source) == (10, 20, "EXIF")
    zero = packet('exif:GPSLatitude="0,0N" exif:GPSLongitude="0,0E"')
    assert "no fix" in facts(photo(xmp=zero)).gps.reason
    assert isinstance(facts(photo(xmp=packet('exif:GPSLatitude="x"'))).gps, NoGps)


def test_what_a_drone_writes():
    wrote = packet(
        'drone-dji:GpsLatitude="+50.1" drone-dji:GpsLongtitude="-14.4" drone-dji:AbsoluteAltitude="+300.5" '
        'drone-dji:RelativeAltitude="+60.1" drone-dji:GimbalYawDegree="-90.5" '
        'drone-dji:GimbalPitchDegree="-30" drone-dji:RtkStdLat="0.03" drone-dji:RtkStdLon="0.04"'
    )
    of_drone = facts(photo(xmp=wrote))
    assert of_drone.gps == Gps(
        50.1, -14.4, pytest.approx(0.05), altitude_m=300.5, relative_altitude_m=60.1, source="DJI XMP"
    )
    assert (of_drone.heading_deg, of_drone.heading.reference, of_drone.pitch_deg) == (269.5, "T", -30)
    both = facts(photo(xmp=wrote, exif=AT))
    assert (both.gps.lat, both.gps.source, both.gps.accuracy_m) == (10, "EXIF", pytest.approx(0.05))


SHOWN = (
    "<i:LocationShown><rdf:Bag><rdf:li>{}<exif:GPSLatitude>1,0N</exif:GPSLatitude>"
    "<exif:GPSLongitude>2,0E</exif:GPSLongitude>{}</rdf:li></rdf:Bag></i:LocationShown>"
)
AS_ATTRIBUTES = '<rdf:Description exif:GPSLatitude="1,0N" exif:GPSLongitude="2,0E"/>'


@pytest.mark.parametrize(
    "shown",
    [
        SHOWN.format("", ""),
        SHOWN.format("<rdf:Description>", "</rdf:Description>"),
        SHOWN.format(AS_ATTRIBUTES, ""),
    ],
)
def test_the_place_that_a_photo_shows_is_not_where_it_was_taken(shown):
    ns = 'xmlns:i="http://iptc.org/std/Iptc4xmpExt/2008-02-29/"'
    assert isinstance(facts(photo(xmp=packet(ns, shown))).gps, NoGps)
    here = f'{ns} exif:GPSLatitude="50,6.0N" exif:GPSLongitude="14,24.0W"'
    assert facts(photo(xmp=packet(here, shown))).gps.lat == pytest.approx(50.1)
    below = "<exif:GPSLatitude>50,6.0N</exif:GPSLatitude><exif:GPSLongitude>14,24.0W</exif:GPSLongitude>"
    assert facts(photo(xmp=packet(ns, shown + below))).gps.lat == pytest.approx(50.1)


def degrees(lat, lon):
    return {1: b"N", 2: ((lat, 1), (0, 1), (0, 1)), 3: b"E", 4: ((lon, 1), (0, 1), (0, 1))}


@pytest.mark.parametrize(("tag", "why"), [({9: b"V"}, "no fix"), ({18: b"TOKYO"}, "datum TOKYO")])
def test_a_copy_of_a_refused_position_is_refused_too(tag, why):
    refused = {"GPS": degrees(50, 14) | tag}
    copied = packet('exif:GPSLatitude="50,0.0004N" exif:GPSLongitude="14,0.0E"')
    of_google = google(geo={"latitude": 50.0, "longitude": 14.0})
    assert why in facts(photo(xmp=copied, exif=refused)).gps.reason
    plain = facts(photo(exif=refused))
    assert why in with_sidecars(plain, [Sidecar("a.xmp", copied)]).gps.reason
    assert why in with_sidecars(plain, [Sidecar("a.jpg.json", of_google)]).gps.reason
    assert facts(photo(xmp=HERE, exif=refused)).gps.source == "XMP"
    assert with_sidecars(plain, [Sidecar("a.jpg.json", google())]).gps.lat == 50.5
    empty = {"GPS": {9: b"V"}}
    assert facts(photo(xmp=copied, exif=empty)).gps.source == "XMP"


def test_a_sidecar_that_repeats_the_position_of_the_photo_leaves_what_it_does_not_say():
    exif = {"GPS": degrees(50, 14) | {5: 0, 6: (210, 1), 31: (3, 1)}}
    before = facts(photo(exif=exif))
    same = packet('exif:GPSLatitude="50,0.0004N" exif:GPSLongitude="14,0.0E" exif:GPSDOP="7"')
    gps = with_sidecars(before, [Sidecar("a.xmp", same)]).gps
    assert (gps.altitude_m, gps.accuracy_m, gps.dop, gps.source) == (210, 3, 7, "EXIF")
    moved = packet('exif:GPSLatitude="50,0.1N" exif:GPSLongitude="14,0.0E"')
    corrected = with_sidecars(before, [Sidecar("a.xmp", moved)]).gps
    assert (corrected.accuracy_m, corrected.source) == (None, "a.xmp")


BOMB = "<!DOCTYPE r [" + '<!ENTITY a "aaaaaaaaaa">' + '<!ENTITY b "&a;&a;&a;&a;">' + "]>"


@pytest.mark.parametrize(
    "bad",
    [HERE[:-30], packet(before=BOMB), b"<a>" * 5000, b"\xff\xfe\x00", b"<" + b"x" * 1000],
)
def test_damaged_and_hostile_xmp_is_left_out_and_noted(bad):
    read = facts(photo("WEBP", xmp=bad, exif=AT))
    assert (read.gps.lat, read.gps.source) == (10, "EXIF")
    assert any("XMP" in note for note in read.notes)


def test_xmp_has_a_limit_of_bytes():
    large = packet('exif:GPSLatitude="50,6N" exif:GPSLongitude="1,2E"', " " * MAX_BYTES)
    assert "MB" in parse_xmp(large).note


TAKEOUT = {
    "a.jpg": [
        "a.jpg.json",
        "a.jpg.supplemental-metadata.json",
        "a.jpg.suppl.json",
        "a.jpg..json",
        "A.JPG.JSON",
    ],
    "a(2).jpg": ["a.jpg(2).json", "a.jpg.supplemental-metadata(2).json"],
    "a.jpeg": ["a.json"],
    "a-edited.jpg": ["a.jpg.json", "a.jpg.supplemental-metadata.json"],
    "a(3).jpg": ["a(3).jpg.supplemental-metadata.json", "a(3).jpg.supplemental-met.json", "a(3).json"],
    "a.heic": ["a.heic.supplemental-meta.json", "a.heic.su.json"],
    "a-bearbeitet.jpg": ["a.jpg.json"],
    "a-edited(1).jpg": ["a.jpg(1).json", "a.jpg.supplemental-metadata(1).json", "a(1).jpg.json"],
    "a-effects.jpg": ["a.jpg.supplemental-metadata.json"],
    "a-upraveno.jpg": ["a.jpg.supplemental-metad.json"],
    "a-modifie\u0301.jpg": ["a.jpg.json"],
    f"{'z' * 40}-edite.jpg": [f"{'z' * 40}.jpg.json", f"{'z' * 40}.jpg.sup.json"],
    f"{'z' * 40}-ed.jpg": [f"{'z' * 40}.jpg.suppl.json"],
    f"{'x' * 47}.jpg": [f"{'x' * 46}.json"],
    f"{'y' * 42}.jpg": [f"{'y' * 42}.jpg.json", f"{'y' * 42}.jpg.s.json", f"{'y' * 42}.jp.json"],
    "cafe\u0301.jpg": ["caf\u00e9.jpg.json"],
}


@pytest.mark.parametrize(("name", "json_name"), [(n, j) for n, found in TAKEOUT.items() for j in found])
def test_the_json_of_google_is_found_under_all_its_names(name, json_name):
    assert choose(f"in/{name}", [f"in/{json_name}"]) == [f"in/{json_name}"]


@pytest.mark.parametrize(
    ("name", "other"),
    [
        ("a.jpg", "b.jpg.json"),
        ("a.jpg", "a.jpg(1).json"),
        ("a(1).jpg", "a.jpg.json"),
        ("a.jpg", "metadata.json"),
        ("a-ed.jpg", "a.jpg.json"),
        ("a-edited(1).jpg", "a.jpg.json"),
        ("a(1).jpg", "a.jpg.supplemental-metadata(2).json"),
        ("a.jpg", "aa.xmp"),
    ],
)
def test_the_file_of_another_photo_is_not_taken(name, other):
    assert choose(name, [other]) == []


def test_files_beside_photos_are_looked_up_in_their_folder():
    names = ["in/a.jpg", "in/a.xmp", "in/a.jpg.xmp", "in/a.jpg.json", "b/a.jpg", "b/map.json"]
    beside = Sidecars(names)
    assert beside.of("in/a.jpg") == ["in/a.jpg.xmp", "in/a.jpg.json"]
    assert beside.of("b/a.jpg") == ()
    assert (beside.photo_of("in/a.jpg.xmp"), beside.photo_of("b/map.json")) == ("in/a.jpg", None)


def test_a_folder_of_thousands_of_photos_takes_no_time():
    photos = [f"in/p{number:05}.jpg" for number in range(3000)]
    begin = time.process_time()
    beside = Sidecars([*photos, *(f"{photo}.supplemental-metadata.json" for photo in photos)])
    assert time.process_time() - begin < 3.0  # comparing all with all takes ten times as long
    assert beside.of(photos[7]) == ["in/p00007.jpg.supplemental-metadata.json"]


def google(**parts):
    place = {"latitude": 50.5, "longitude": -14.5, "altitude": 210.0}
    none = {"latitude": 0.0, "longitude": 0.0, "altitude": 0.0}
    return json.dumps(
        {
            "geoData": parts.get("geo", place),
            "geoDataExif": parts.get("exif", none),
            "photoTakenTime": {"timestamp": "1777629600"},
        }
    ).encode()


def test_which_source_wins():
    xmp, of_google = Sidecar("a.xmp", HERE), Sidecar("a.jpg.json", google())
    with_exif, plain = facts(photo(exif=AT)), facts(photo())
    assert with_sidecars(with_exif, [xmp, of_google]).gps.source == "a.xmp"
    assert with_sidecars(with_exif, [of_google]).gps.source == "EXIF"
    found = with_sidecars(plain, [of_google])
    assert found.gps == Gps(50.5, -14.5, altitude_m=210.0, source="a.jpg.json")
    assert found.taken_at == "2026-05-01T10:00:00+00:00"
    nowhere = google(geo={"latitude": 0, "longitude": 0})
    assert isinstance(with_sidecars(plain, [Sidecar("a.jpg.json", nowhere)]).gps, NoGps)


def test_our_own_sidecar_is_read_back():
    tag = Geotag(LatLon(-33.8583, 151.2), heading_deg=123.25, accuracy_m=4.5)
    found = with_sidecars(facts(photo(exif=AT)), [Sidecar("a.jpg.xmp", format_xmp(tag))])
    assert (found.gps.lat, found.gps.lon) == pytest.approx((-33.8583, 151.2))
    assert (found.gps.accuracy_m, found.heading_deg, found.heading.reference) == (4.5, 123.25, "T")


@pytest.mark.parametrize("data", [None, b"", b"{", b"[1]", b'{"geoData": 3}', b" " * (MAX_BYTES + 1)])
@pytest.mark.parametrize("name", ["a.jpg.xmp", "a.jpg.json"])
def test_a_file_beside_a_photo_that_cannot_be_read_leaves_the_photo_as_it_is(name, data):
    before = facts(photo(exif=AT))
    after = with_sidecars(before, [Sidecar(name, data)])
    assert after.gps == before.gps
    if data is None or data.startswith((b" ", b"{\n")):
        assert name in after.notes[-1]


@pytest.mark.parametrize("kind", ["LAB"])
def test_colours_that_cannot_be_converted_are_named(kind):
    file = io.BytesIO()
    Image.new(kind, (40, 30)).save(file, "TIFF")
    with pytest.raises(Exception, match="unsupported colours"):
        facts(file.getvalue())


def test_jpeg_xl_is_named():
    for start in (b"\xff\x0a", b"\0\0\0\x0cJXL \r\n\x87\n"):
        with pytest.raises(Exception, match="JPEG XL"), open_image(start + bytes(50), limits=LIMITS):
            pass


PANO = 'xmlns:GPano="http://ns.google.com/photos/1.0/panorama/" GPano:ProjectionType="equirectangular" '


@pytest.mark.parametrize(
    ("size", "xmp", "camera", "said"),
    [
        ((240, 60), None, {}, "as wide as a part of a panorama"),
        ((60, 240), None, {}, "as wide as a part of a panorama"),
        ((200, 100), None, {}, "do not mark it"),
        ((200, 100), None, {0xA405: 28}, None),
        ((160, 90), None, {}, None),
        ((240, 60), PANO, {}, "is a part of a panorama"),
        (
            (200, 100),
            f'{PANO} GPano:FullPanoWidthPixels="400" GPano:CroppedAreaImageWidthPixels="200"',
            {},
            "is a part of a panorama",
        ),
        (
            (200, 100),
            f'{PANO} GPano:PosePitchDegrees="-12" GPano:PoseRollDegrees="1"',
            {},
            "levelled by the pitch and roll",
        ),
        ((200, 100), f'{PANO} GPano:PosePitchDegrees="0" GPano:PoseRollDegrees="360"', {}, None),
        ((200, 100), f'{PANO} GPano:PosePitchDegrees="400"', {}, "PosePitchDegrees is not a number"),
        ((200, 100), f'{PANO} GPano:PoseRollDegrees="NaN"', {}, "PoseRollDegrees is not a number"),
        ((200, 100), f'{PANO} GPano:PoseRollDegrees="steep"', {}, "from -360 to 360: it is taken as level"),
    ],
)
def test_panoramas_that_are_not_taken_as_they_are(size, xmp, camera, said):
    file, options = io.BytesIO(), {} if xmp is None else {"xmp": packet(xmp)}
    Image.new("RGB", size).save(
        file, "JPEG", exif=piexif.dump({"0th": {271: b"x"}, "Exif": camera}), **options
    )
    notes = facts(file.getvalue()).notes
    assert notes == () if said is None else said in notes[-1]
