"""The GPS position and heading in a photo's EXIF, or why it has no position."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Literal

from webapp.files.photos.exif import number, text

EXIF = "EXIF"
"""Source of a position in the EXIF of a photo."""

METRES_PER_DOP = 5.0
"""Metres of 68 % radius for each unit of dilution of precision: the usual range error of a civil receiver."""

_LAT_REF, _LAT, _LON_REF, _LON, _ALT_REF, _ALT = 1, 2, 3, 4, 5, 6
_STATUS, _DOP, _DIRECTION_REF, _DIRECTION, _DATUM, _ERROR = 9, 11, 16, 17, 18, 31
_BELOW = (1, 3, b"\x01", b"\x03")
"""References of altitudes that count downwards: from sea level, and since Exif 3.0 from the ellipsoid."""

_SAME_M, _METRES_PER_DEGREE = 1.5, 111_320.0
"""Copies of a position differ by their rounding, to 0.001 minutes (1.9 m) in many programs."""

_FAR_DATUMS = frozenset({"TOKYO", "NAD27", "ED50", "PULKOVO1942", "PULKOVO42"})
"""Datums hundreds of metres from WGS 84."""


@dataclass(frozen=True, slots=True)
class Gps:
    """The position of a photo, from its EXIF unless `source` says otherwise."""

    # `lat`, `lon`: Degrees north and east, WGS 84.
    lat: float
    lon: float
    # 68 % radius: GPSHPositioningError as stated by the device, or else `dop` * `METRES_PER_DOP`.
    accuracy_m: float | None = None
    dop: float | None = None  # Dilution of precision
    altitude_m: float | None = None  # Above sea level (below: negative), according to the device
    relative_altitude_m: float | None = None  # Above where a drone has started
    source: str = EXIF  # What it is from: `EXIF`, `XMP`, `DJI XMP`, or the name of a file beside the photo


@dataclass(frozen=True, slots=True)
class NoGps:
    """No position, and the reason in a sentence. Falsy."""

    reason: str
    refused: Gps | None = None  # What it says, if it is complete but not to be trusted

    def refuses(self, other: Gps) -> bool:
        """Return whether another position is only a copy of the refused one."""
        return self.refused is not None and agree(self.refused, other)

    def __bool__(self) -> bool:
        """Return False: there is no position."""
        return False


ABSENT = NoGps("it has no GPS position")
"""EXIF has no tag of a position."""


@dataclass(frozen=True, slots=True)
class Heading:
    """Viewing direction, degrees clockwise from true (`T`) or magnetic (`M`) north (None: unknown which)."""

    deg: float
    reference: Literal["T", "M"] | None


def read_gps(tags: Mapping[int, object]) -> Gps | NoGps:
    """Read the position from the tags of the GPS IFD."""
    if not any(tag in tags for tag in (_LAT, _LON, _LAT_REF, _LON_REF)):
        return ABSENT
    found = _position(tags)
    if text(tags.get(_STATUS)).upper() == "V":
        return NoGps("its GPS had no fix (status V)", None if isinstance(found, NoGps) else found)
    datum = "".join(c for c in text(tags.get(_DATUM)).upper() if c.isalnum())
    if isinstance(found, Gps) and datum in _FAR_DATUMS:
        return NoGps(f"its GPS position is in the datum {datum}, not in WGS 84", found)
    return found


def agree(one: Gps, other: Gps) -> bool:
    """Return whether two positions are the same but for rounding."""
    east_deg = math.remainder(one.lon - other.lon, 360.0) * math.cos(math.radians(one.lat))
    return math.hypot(one.lat - other.lat, east_deg) * _METRES_PER_DEGREE <= _SAME_M


def _position(tags: Mapping[int, object]) -> Gps | NoGps:
    lat = _degrees(tags.get(_LAT), "latitude")
    lon = _degrees(tags.get(_LON), "longitude")
    for value in (lat, lon):
        if isinstance(value, NoGps):
            return value
    assert not isinstance(lat, NoGps) and not isinstance(lon, NoGps)
    if abs(lat) < 1e-9 and abs(lon) < 1e-9:
        return NoGps("its GPS position is 0 N 0 E, which devices write when they have no fix")
    lat, lon = _signed(lat, tags.get(_LAT_REF), "NS"), _signed(lon, tags.get(_LON_REF), "EW")
    for value in (lat, lon):
        if isinstance(value, NoGps):
            return value
    assert not isinstance(lat, NoGps) and not isinstance(lon, NoGps)
    if abs(lat) > 90.0 or abs(lon) > 180.0:
        return NoGps(f"its GPS position {lat:g} {lon:g} is out of range")
    return _with_precision(lat, lon, tags)


def read_heading(tags: Mapping[int, object]) -> Heading | None:
    """Read the direction of the image (GPSImgDirection); None if missing or not from 0 to 360."""
    value = number(tags.get(_DIRECTION))
    if value is None or not 0.0 <= value <= 360.0:
        return None
    reference = text(tags.get(_DIRECTION_REF)).upper()
    return Heading(value % 360.0, "T" if reference == "T" else "M" if reference == "M" else None)


def _with_precision(lat: float, lon: float, tags: Mapping[int, object]) -> Gps:
    dop, error, altitude = number(tags.get(_DOP)), number(tags.get(_ERROR)), number(tags.get(_ALT))
    dop = dop if dop is not None and dop > 0.0 else None
    accuracy = error if error is not None and error > 0.0 else None
    if accuracy is None and dop is not None:
        accuracy = dop * METRES_PER_DOP
    below = tags.get(_ALT_REF) in _BELOW
    return Gps(lat, lon, accuracy, dop, -altitude if below and altitude is not None else altitude)


def _degrees(value: object, name: str) -> float | NoGps:
    """Sum degrees, minutes and seconds; in the south or west some programs write all of them as negative."""
    parts = value if isinstance(value, tuple | list) else (value,)
    numbers = [number(part) for part in parts]
    if not any(n is not None for n in numbers):
        return NoGps(f"its GPS {name} is empty")
    if None in numbers or not 1 <= len(numbers) <= 3:
        return NoGps(f"its GPS {name} is incomplete")
    known = [n for n in numbers if n is not None]
    mixed = min(known) < 0.0 < max(known)
    if mixed or any(abs(n) > 60.0 for n in known[1:]):
        return NoGps(f"its GPS {name} is not in degrees, minutes and seconds")
    return sum(n / 60.0**i for i, n in enumerate(known))


def _signed(degrees: float, reference: object, letters: str) -> float | NoGps:
    """Apply the reference, one of two letters of which the second counts negative."""
    letter = text(reference).upper()[:1]
    if not letter or letter not in letters:
        return NoGps(f"its GPS position lacks {letters[0]} or {letters[1]}")
    if degrees < 0.0 and letter == letters[0]:
        return NoGps(f"its GPS position is negative and {letter}, which contradict each other")
    return degrees if letter == letters[0] else -abs(degrees)
