"""Metadata of photos, in all variations of cameras and software."""

import io
import math
import random

import piexif
import pytest
from PIL import Image

from webapp.errors import PhotoError
from webapp.files.photos.exif import (
    METRES_PER_DOP,
    Exif,
    Gps,
    Heading,
    NoGps,
    number,
    orientation,
    read_fov,
    read_gps,
    read_heading,
    read_time,
    text,
)
from webapp.files.photos.photo import read_facts
from webapp.settings import PhotoLimits

LIMITS = PhotoLimits()
LAT, LON = ((50, 1), (5, 1), (3012, 100)), ((14, 1), (25, 1), (0, 1))
GOOD = {1: b"N", 2: LAT, 3: b"E", 4: LON}


def jpeg(*, image=None, camera=None, gps=None, size=(40, 30), exif=None):
    blob = piexif.dump({"0th": image or {}, "Exif": camera or {}, "GPS": gps or {}}) if exif is None else exif
    file = io.BytesIO()
    Image.new("RGB", size, (90, 120, 30)).save(file, "JPEG", exif=blob)
    return file.getvalue()


def facts(**tags):
    return read_facts(jpeg(**tags), limits=LIMITS)


def test_a_good_position():
    found = facts(
        gps={
            **GOOD,
            5: 1,
            6: (125, 10),
            9: b"A",
            11: (3, 1),
            16: b"T",
            17: (2705, 10),
            18: b"WGS-84",
            31: (8, 1),
        }
    )
    assert found.gps == Gps(
        50 + 5 / 60 + 30.12 / 3600, 14 + 25 / 60, accuracy_m=8.0, dop=3.0, altitude_m=-12.5
    )
    assert found.heading == Heading(270.5, "T")
    assert found.heading_deg == 270.5
    assert found.notes == ()


def test_south_and_west_are_negative():
    gps = facts(gps={1: b"S", 2: LAT, 3: b"W", 4: LON}).gps
    assert isinstance(gps, Gps)
    assert (gps.lat < -50, gps.lon < -14) == (True, True)


def test_precision_from_dop_alone():
    gps = facts(gps={**GOOD, 11: (25, 10)}).gps
    assert isinstance(gps, Gps)
    assert (gps.dop, gps.accuracy_m) == (2.5, 2.5 * METRES_PER_DOP)
    assert facts(gps={**GOOD, 11: (0, 1), 31: (0, 0)}).gps == Gps(gps.lat, gps.lon)


ZERO = ((0, 1), (0, 1), (0, 1))
NAN = ((0, 0), (0, 0), (0, 0))


@pytest.mark.parametrize(
    ("gps", "reason"),
    [
        ({}, "no GPS position"),
        ({29: b"2024:05:01"}, "no GPS position"),
        ({1: b"N", 2: ZERO, 3: b"E", 4: ZERO}, "0 N 0 E"),
        ({1: b"N", 2: NAN, 3: b"E", 4: NAN}, "latitude is empty"),
        ({**GOOD, 4: NAN}, "longitude is empty"),
        ({1: b"N", 3: b"E"}, "latitude is empty"),
        ({**GOOD, 2: ((50, 1), (5, 1), (1, 0))}, "latitude is incomplete"),
        ({**GOOD, 2: ((95, 1), (0, 1), (0, 1))}, "out of range"),
        ({**GOOD, 4: ((181, 1), (0, 1), (0, 1))}, "out of range"),
        ({**GOOD, 2: ((50, 1), (75, 1), (0, 1))}, "degrees, minutes and seconds"),
        ({2: LAT, 4: LON}, "N or S"),
        ({1: b"N", 2: LAT, 4: LON}, "E or W"),
        ({**GOOD, 1: b"\0"}, "N or S"),
        ({**GOOD, 3: b"x"}, "E or W"),
        ({**GOOD, 9: b"V"}, "status V"),
        ({**GOOD, 18: b"TOKYO"}, "datum TOKYO"),
    ],
)
def test_no_position_has_a_reason(gps, reason):
    found = facts(gps=gps).gps
    assert isinstance(found, NoGps)
    assert not found
    assert reason in found.reason


@pytest.mark.parametrize(
    "value",
    [-1.0, "50", b"50", None, (), (1, 2, 3, 4), math.nan, math.inf, ("a", "b", "c"), (50, -5, 0), True],
)
def test_a_latitude_of_a_wrong_kind_is_none(value):
    assert isinstance(read_gps({1: "N", 2: value, 3: "E", 4: (14.0, 0.0, 0.0)}), NoGps)
    assert read_gps({1: "N", 2: (50.0,), 3: "E", 4: (14.0, 30.0)}) == Gps(50.0, 14.5)


@pytest.mark.parametrize(
    ("tags", "wanted"),
    [
        ({17: 360.0, 16: "T"}, Heading(0.0, "T")),
        ({17: 12.5, 16: "M"}, Heading(12.5, "M")),
        ({17: 12.5}, Heading(12.5, None)),
        ({17: 361.0, 16: "T"}, None),
        ({17: -1.0, 16: "T"}, None),
        ({17: math.nan, 16: "T"}, None),
        ({16: "T"}, None),
    ],
)
def test_heading(tags, wanted):
    assert read_heading(tags) == wanted


@pytest.mark.parametrize(
    ("camera", "gps", "wanted"),
    [
        ({0x9003: "2024:05:01 10:20:30"}, {}, "2024-05-01T10:20:30"),
        (
            {0x9003: "2024:05:01 10:20:30", 0x9291: "25", 0x9011: "+02:00"},
            {},
            "2024-05-01T10:20:30.250000+02:00",
        ),
        ({0x9003: "2024-05-01 10:20:30\0", 0x9011: "    "}, {}, "2024-05-01T10:20:30"),
        ({0x9003: "2024:05:01 10:20:30", 0x9011: "+99:99"}, {}, "2024-05-01T10:20:30"),
        ({0x9003: "0000:00:00 00:00:00"}, {}, None),
        ({0x9003: "    :  :     :  :  ", 0x9004: "2024:05:01 10:20:30"}, {}, "2024-05-01T10:20:30"),
        ({}, {29: "2024:05:01", 7: (8.0, 20.0, 30.5)}, "2024-05-01T08:20:30.500000+00:00"),
        ({}, {29: "2024:05:01", 7: (8.0, math.nan, 30.5)}, None),
        ({}, {29: "", 7: (8.0, 20.0, 30.5)}, None),
        ({0x9003: 5}, {}, None),
    ],
)
def test_time(camera, gps, wanted):
    assert read_time(Exif(camera=camera, gps=gps)) == wanted


def test_field_of_view_from_35_mm():
    # 36 x 24 mm: by definition 2 atan(18/f) over the width, 2 atan(12/f) over the height
    wide = read_fov(Exif(camera={0xA405: 28}), width=600, height=400)
    tall = read_fov(Exif(camera={0xA405: 28}), width=400, height=600)
    assert wide is not None
    assert tall is not None
    assert wide.deg == pytest.approx(math.degrees(2 * math.atan(18 / 28)))
    assert tall.deg == pytest.approx(math.degrees(2 * math.atan(12 / 28)))
    assert wide.source == "FocalLengthIn35mmFilm"


def test_field_of_view_from_the_sensor():
    # a sensor 6.4 mm wide with 3200 pixels: 500 per mm, 12700 per inch; the photo was scaled down later
    for unit, density in ((2, 12700.0), (3, 5000.0), (4, 500.0)):
        camera = {0x920A: 4.8, 0xA20E: density, 0xA210: unit, 0xA002: 3200, 0xA003: 2400}
        fov = read_fov(Exif(camera=camera), width=800, height=600)
        assert fov is not None
        assert fov.deg == pytest.approx(math.degrees(2 * math.atan(3.2 / 4.8)))
        assert fov.source == "FocalPlaneResolution"


@pytest.mark.parametrize(
    "camera",
    [
        {},
        {0xA405: 0},
        {0xA405: math.nan},
        {0xA405: "28"},
        {0xA405: 65535},
        {0xA405: 28, 0xA002: 3000, 0xA003: 1000},
        {0x920A: 4.8, 0xA20E: 500.0, 0xA210: 9, 0xA002: 3200, 0xA003: 2400},
        {0x920A: 4.8, 0xA20E: 0.0, 0xA210: 4, 0xA002: 3200, 0xA003: 2400},
        {0x920A: 4.8, 0xA20E: 500.0, 0xA210: 4},
    ],
)
def test_no_field_of_view(camera):
    assert read_fov(Exif(camera=camera), width=800, height=600) is None


def test_the_focal_length_of_a_turned_photo():
    stored_wide = facts(image={274: 6}, camera={0xA405: 28, 0xA002: 600, 0xA003: 400}, size=(600, 400))
    assert (stored_wide.width, stored_wide.height) == (400, 600)
    assert stored_wide.fov_deg == pytest.approx(math.degrees(2 * math.atan(12 / 28)))


@pytest.mark.parametrize("value", [0, 9, 65535, "6", b"6", (6, 6), -1, 6.5])
def test_an_invalid_orientation_is_one_with_a_note(value):
    turn, note = orientation(Exif(image={274: value}))
    assert turn == 1
    assert note is not None


def test_orientation():
    assert [orientation(Exif(image={274: o})) for o in range(1, 9)] == [(o, None) for o in range(1, 9)]
    assert orientation(Exif()) == (1, None)
    assert "65535" in facts(image={274: 65535}).notes[0]


def test_damaged_exif_is_left_out_and_noted():
    found = read_facts(jpeg(exif=b"Exif\0\0this is no EXIF at all"), limits=LIMITS)
    assert (found.width, found.height) == (40, 30)
    assert "damaged" in found.notes[0]
    assert isinstance(found.gps, NoGps)


def test_no_byte_of_exif_can_stop_an_import():
    good = jpeg(image={274: 6}, camera={0x9003: b"2024:05:01 10:20:30", 0xA405: 28}, gps={**GOOD, 17: (1, 1)})
    start = good.index(b"Exif\0\0") + 6
    end = start + len(piexif.dump({"0th": {274: 6}, "GPS": GOOD}))
    rng, seen = random.Random(4), set()
    for _ in range(400):
        bad = bytearray(good)
        for _ in range(rng.randrange(1, 6)):
            bad[rng.randrange(start, end)] = rng.choice([0, 1, 2, 5, 255, rng.randrange(256)])
        try:
            seen.add(type(read_facts(bytes(bad), limits=LIMITS).gps))
        except PhotoError:
            pytest.fail("damaged EXIF made the photo unreadable")
    assert seen == {Gps, NoGps}


def test_numbers_and_texts():
    assert [number(v) for v in (1, 1.5, math.nan, math.inf, "1", None, True, (1,))] == [1.0, 1.5] + [None] * 6
    assert [text(v) for v in (b"N\0", " x ", "\0", 5, None, b"\xff")] == ["N", "x", "", "", "", "�"]


@pytest.mark.parametrize(("reference", "sign"), [(0, 1), (1, -1), (2, 1), (3, -1)])
def test_altitudes_above_and_below_the_sea_and_the_ellipsoid(reference, sign):
    assert (
        read_gps(
            {**dict(zip((1, 3), "NE", strict=True)), 2: (50.0,), 4: (14.0,), 5: reference, 6: 12.5}
        ).altitude_m
        == sign * 12.5
    )


def test_degrees_minutes_and_seconds_may_all_be_negative_in_the_south_and_west():
    found = read_gps({1: "S", 2: (-33.0, -51.0, -30.0), 3: "W", 4: (-70.0, -30.0, 0.0)})
    assert found == Gps(-33.858333333333334, -70.5)
    contradicting = read_gps({1: "N", 2: (-33.0, -51.0, -30.0), 3: "E", 4: (151.2,)})
    assert not contradicting and "contradict" in contradicting.reason
    assert not read_gps({1: "S", 2: (33.0, -51.0, 30.0), 3: "E", 4: (151.2,)})


@pytest.mark.parametrize("focal", [1, 4])
def test_focal_lengths_that_no_lens_has_are_ignored_with_a_note(focal):
    found = facts(camera={0xA405: focal}, size=(400, 300))
    assert found.fov is None and f"{focal} mm in 35 mm film" in found.notes[-1]
    wide = facts(camera={0xA405: 13}, size=(400, 300))
    assert wide.fov_deg == pytest.approx(106, abs=3) and wide.notes == ()
