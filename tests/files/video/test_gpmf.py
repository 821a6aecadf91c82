"""Positions in the telemetry of GoPro cameras."""

import math
import struct

import numpy as np
import pytest

from tests.video_clips import gps5, klv
from webapp.files.video.gpmf import GpmfError, read_positions

PLACES = [(50.2045, 15.8291), (-33.5, -70.25)]


def test_positions_are_those_that_the_camera_wrote():
    assert [tuple(place) for place in read_positions(gps5(PLACES))] == PLACES


def test_positions_without_a_fix_are_unknown():
    assert all(math.isnan(place.lat) for place in read_positions(gps5(PLACES, fix=0)))


def test_newer_cameras_state_the_fix_of_each_sample():
    scale = klv("SCAL", "l", 10**7, 10**7, 1000, 1000, 100, 1, 1000, 100, 1)
    rows = [
        struct.pack(">7i2H", *(round(value * 1e7) for value in place), 0, 0, 0, 9000, 36_000_000, 150, fix)
        for place, fix in zip(PLACES, (3, 0), strict=True)
    ]
    packet = klv(
        "STRM", "\0", scale, klv("TYPE", "c", b"lllllllSS"), klv("GPS9", "?", *rows, size=len(rows[0]))
    )
    first, second = read_positions(klv("DEVC", "\0", packet))
    assert tuple(first) == PLACES[0]
    assert math.isnan(second.lat)


def test_other_sensors_are_skipped():
    assert read_positions(klv("DEVC", "\0", klv("STRM", "\0", klv("ACCL", "l", (1, 2, 3))))) == []


@pytest.mark.parametrize(
    "damaged",
    [
        gps5(PLACES)[:-6],
        klv("STRM", "\0", klv("SCAL", "l", 1), klv("GPS5", "l", (1, 2, 3))),
        klv("STRM", "\0", klv("TYPE", "c", b"zz"), klv("GPS9", "?", b"1234", size=4)),
    ],
)
def test_damaged_telemetry_is_refused(damaged):
    with pytest.raises(GpmfError):
        read_positions(damaged)


def test_deep_nesting_is_refused():
    packet = b""
    for _ in range(40):
        packet = klv("STRM", "\0", packet) if packet else klv("STRM", "\0", klv("SCAL", "l", 1))
    with pytest.raises(GpmfError, match="too deeply"):
        read_positions(packet)


def test_any_bytes_are_read_or_refused():
    rng = np.random.default_rng(0)
    packet = gps5(PLACES)
    for _ in range(300):
        spoilt = bytearray(packet)
        for at in rng.integers(0, len(packet), 3):
            spoilt[at] = int(rng.integers(256))
        try:
            assert all(math.isnan(p.lat) or abs(p.lat) <= 90 for p in read_positions(bytes(spoilt)))
        except GpmfError:
            continue
