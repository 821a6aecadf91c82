"""The EXIF tags of a photo, even if they are damaged: time, field of view, position, heading."""

from __future__ import annotations

import math
import struct
import warnings
from collections.abc import Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime, timedelta
from numbers import Real
from typing import Any, Literal

import piexif
from PIL import Image

from webapp.files.decode import DAMAGED

_CAMERA_IFD = 0x8769
_GPS_IFD = 0x8825
_ORIENTATION = 0x0112
_INTEROP_IFD = 0xA005
_POINTERS = {_CAMERA_IFD, _GPS_IFD, _INTEROP_IFD}
_TABLES = ("0th", "Exif", "GPS")
_TYPE_BYTES = {1: 1, 2: 1, 3: 2, 4: 4, 5: 8, 6: 1, 7: 1, 8: 2, 9: 4, 10: 8, 11: 4, 12: 8}
"""Bytes of one value of each type of TIFF 6.0."""

_TIMES = ((0x9003, 0x9291, 0x9011), (0x9004, 0x9292, 0x9012))
"""DateTimeOriginal and DateTimeDigitized, each with its SubSecTime and OffsetTime."""

_GPS_TIME, _GPS_DATE = 7, 29
_FOCAL_MM, _FOCAL_35MM = 0x920A, 0xA405
_WIDTH, _HEIGHT = 0xA002, 0xA003
_PLANE_X, _PLANE_Y, _PLANE_UNIT = 0xA20E, 0xA20F, 0xA210
_UNIT_MM = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}
_DIAGONAL_35MM = math.hypot(36.0, 24.0)
_PLAUSIBLE_DEG = (1.0, 130.0)
"""Of a lens without fish-eye distortion: the widest has a focal length of 9 mm in 35 mm film."""

_CROPPED = 1.03
"""A photo whose aspect ratio differs by more than this factor from the camera's was cropped."""

FovSource = Literal["FocalLengthIn35mmFilm", "FocalPlaneResolution"]


@dataclass(frozen=True, slots=True)
class Exif:
    """Three tables of tag numbers and values; empty if missing."""

    # `image`, `camera`, `gps`: IFD 0, the Exif IFD and the GPS IFD. Values may be of any type.
    image: Mapping[int, object] = field(default_factory=dict)
    camera: Mapping[int, object] = field(default_factory=dict)
    gps: Mapping[int, object] = field(default_factory=dict)
    notes: tuple[str, ...] = ()  # Sentences about damaged parts


def read_exif(image: Image.Image) -> Exif:
    """Read the EXIF of an opened photo; damaged parts are left empty and noted, without an error.

    Pillow finds the block in any format of photo, piexif parses it if it is well-formed. EXIF that is
    malformed or not a separate block (in TIFF, or in texts of PNG) is read by Pillow, tag by tag.
    """
    raw = image.info.get("exif")
    tables = parse_block(raw) if isinstance(raw, bytes) else None
    if tables is None:
        return _read_tolerantly(image)
    if _ORIENTATION not in tables["0th"]:
        turned = _read_tolerantly(image).image.get(_ORIENTATION)  # which Pillow may find in the XMP
        if turned is not None:
            tables["0th"][_ORIENTATION] = turned
    first, camera, gps = (
        {tag: _plain(ifd, tag, value) for tag, value in tables[ifd].items()} for ifd in _TABLES
    )
    return Exif(first, camera, gps)


def parse_block(raw: bytes) -> dict[str, Any] | None:
    """Parse a well-formed EXIF block with piexif.

    Args:
        raw: With or without `Exif\\0\\0` before its TIFF header.

    Returns:
        As `piexif.load`; None for a block that is empty, damaged, unsafe to parse (piexif trusts any length)
        or that piexif would misread.
    """
    tiff = raw.removeprefix(b"Exif\0\0")
    try:
        if not _well_formed(tiff):
            return None
        tables: dict[str, Any] = piexif.load(b"Exif\0\0" + tiff)
    except (*DAMAGED, OSError):
        return None
    return tables if tables["0th"] else None


def _well_formed(tiff: bytes) -> bool:
    """Check that all values of all tables have known types, are inside the block, and texts end with NUL."""
    order = {b"II*\0": "<", b"MM\0*": ">"}.get(tiff[:4])
    if order is None:
        return False
    todo, seen = [struct.unpack_from(f"{order}L", tiff, 4)[0]], set()
    while todo:
        at = todo.pop()
        if at in seen:
            return False
        seen.add(at)
        (count,) = struct.unpack_from(f"{order}H", tiff, at)
        for entry in range(at + 2, at + 2 + 12 * count, 12):
            tag, kind, number_, value = struct.unpack_from(f"{order}HHLL", tiff, entry)
            size = _TYPE_BYTES.get(kind, 0) * number_
            begin = entry + 8 if size <= 4 else value
            if size == 0 or begin + size > len(tiff):
                return False
            if kind == piexif.TYPES.Ascii and tiff[begin + size - 1] != 0:
                return False
            if tag in _POINTERS:
                todo.append(value)
        if len(seen) == 1:  # only the first table is followed by another one, that of the thumbnail
            (following,) = struct.unpack_from(f"{order}L", tiff, at + 2 + 12 * count)
            todo += [following] if following else []
    return True


def _plain(ifd: str, tag: int, value: object) -> object:
    """Convert a value of piexif to a number, a text or a tuple: rationals become floats, 0/0 NaN."""
    kind = piexif.TAGS["Image" if ifd == "0th" else ifd][tag]["type"]
    if kind == piexif.TYPES.Ascii and isinstance(value, bytes):
        return value.decode("latin-1")
    if kind not in (piexif.TYPES.Rational, piexif.TYPES.SRational) or not isinstance(value, tuple):
        return value
    if all(isinstance(part, tuple) for part in value):
        return tuple(_quotient(*part) for part in value)
    return _quotient(*value) if len(value) == 2 else value


def _quotient(numerator: int, denominator: int) -> float:
    return numerator / denominator if denominator else math.nan


def _read_tolerantly(image: Image.Image) -> Exif:
    notes: list[str] = []
    tables: list[Mapping[int, object]] = []
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # Pillow warns about each odd tag
        try:
            exif = image.getexif()
            tables.append(dict(exif))
        except (*DAMAGED, OSError):
            return Exif(notes=("its EXIF is damaged and was left out",))
        if image.info.get("exif") and not tables[0]:
            notes.append("its EXIF is empty or damaged")
        for name, ifd in (("camera", _CAMERA_IFD), ("GPS", _GPS_IFD)):
            try:
                tables.append(dict(exif.get_ifd(ifd)))
            except (*DAMAGED, OSError):
                tables.append({})
                notes.append(f"the {name} part of its EXIF is damaged and was left out")
    return Exif(tables[0], tables[1], tables[2], tuple(notes))


def orientation(exif: Exif) -> tuple[int, str | None]:
    """Return the EXIF orientation: how the stored pixels must be turned to be upright.

    Returns:
        value: 1 to 8 as in EXIF; 1 (as stored) if missing or invalid.
        note: A sentence if it is invalid.
    """
    value = exif.image.get(_ORIENTATION)
    if value is None:
        return 1, None
    if isinstance(value, int) and 1 <= value <= 8:
        return value, None
    return 1, f"its EXIF orientation {str(value)[:20]!r} is none of 1 to 8; the photo is taken as stored"


def number(value: object) -> float | None:
    """Return a finite number, or None for anything else (0/0, text, a list)."""
    if isinstance(value, bool) or not isinstance(value, Real):
        return None
    try:
        result = float(value)
    except (ZeroDivisionError, OverflowError, ValueError):
        return None
    return result if math.isfinite(result) else None


def text(value: object) -> str:
    """Return a text without the padding that cameras add; empty for anything else."""
    if isinstance(value, bytes):
        value = value.decode("ascii", "replace")
    return value.strip("\0 \t\r\n") if isinstance(value, str) else ""


@dataclass(frozen=True, slots=True)
class Fov:
    """Horizontal field of view of the upright photo, degrees, and its EXIF tag."""

    deg: float
    source: FovSource


def read_time(exif: Exif) -> str | None:
    """Read when the photo was taken.

    Returns:
        ISO 8601: the camera's clock, with fraction and offset if the camera wrote them; without an offset it
            is local time. If only the GPS has a time, that, with the offset +00:00.
    """
    for when, fraction, offset in _TIMES:
        moment = _moment(text(exif.camera.get(when)), text(exif.camera.get(fraction)))
        if moment is not None:
            return moment.isoformat() + _offset(text(exif.camera.get(offset)))
    return _gps_time(exif.gps)


def read_fov(exif: Exif, *, width: int, height: int) -> Fov | None:
    """Read the horizontal field of view; None if it is missing or implausible, or the photo is cropped.

    Args:
        width, height: Of the upright photo, pixels.

    Notes:
        The focal length "in 35 mm film" refers to the diagonal (43.27 mm), as CIPA DCG-001 defines it.
    """
    camera_size = (number(exif.camera.get(_WIDTH)), number(exif.camera.get(_HEIGHT)))
    if _was_cropped(camera_size, (width, height)):
        return None
    candidates: tuple[tuple[float | None, FovSource], ...] = (
        (_from_35mm(exif.camera, math.hypot(width, height)), "FocalLengthIn35mmFilm"),
        (_from_plane(exif.camera, camera_size, max(width, height)), "FocalPlaneResolution"),
    )
    for focal_px, source in candidates:
        if focal_px is None or focal_px <= 0.0:
            continue
        deg = math.degrees(2.0 * math.atan(width / 2.0 / focal_px))
        if _PLAUSIBLE_DEG[0] <= deg <= _PLAUSIBLE_DEG[1]:
            return Fov(deg, source)
    return None


def fov_note(exif: Exif, *, width: int, height: int) -> str | None:
    """Return a sentence where `read_fov` ignores a focal length because no such lens exists; else None."""
    focal = number(exif.camera.get(_FOCAL_35MM))
    if not focal or focal < 0.0:
        return None
    deg = math.degrees(2.0 * math.atan(width / 2.0 / (focal / _DIAGONAL_35MM * math.hypot(width, height))))
    if _PLAUSIBLE_DEG[0] <= deg <= _PLAUSIBLE_DEG[1]:
        return None
    return f"its focal length of {focal:g} mm in 35 mm film is implausible and was ignored"


def _from_35mm(camera: Mapping[int, object], diagonal_px: float) -> float | None:
    focal = number(camera.get(_FOCAL_35MM))
    return None if focal is None else focal / _DIAGONAL_35MM * diagonal_px


def _from_plane(
    camera: Mapping[int, object], camera_size: tuple[float | None, float | None], long_side: float
) -> float | None:
    """Compute the focal length in pixels from that in millimetres and the sensor's pixel density."""
    focal = number(camera.get(_FOCAL_MM))
    density = number(camera.get(_PLANE_X)) or number(camera.get(_PLANE_Y))
    unit = camera.get(_PLANE_UNIT, 2)
    mm = _UNIT_MM.get(unit) if isinstance(unit, int) else None
    width, height = camera_size
    if focal is None or not density or mm is None or not width or not height:
        return None
    return focal * density / mm * long_side / max(width, height)


def _was_cropped(camera_size: tuple[float | None, float | None], size: tuple[int, int]) -> bool:
    """Compare aspect ratios regardless of rotation: software that turns photos often keeps the old size."""
    width, height = camera_size
    if not width or not height or min(width, height) < 0:
        return False
    before = max(width, height) / min(width, height)
    now = max(size) / min(size)
    return not 1 / _CROPPED < before / now < _CROPPED


def _moment(stamp: str, fraction: str) -> datetime | None:
    digits = fraction if fraction.isascii() and fraction.isdigit() else ""
    try:
        moment = datetime.strptime(stamp[:19].replace("-", ":"), "%Y:%m:%d %H:%M:%S")
    except ValueError:
        return None
    return moment.replace(microsecond=int(digits[:6].ljust(6, "0")) if digits else 0)


def _offset(stamp: str) -> str:
    try:
        zone = datetime.strptime(stamp, "%z")
    except ValueError:
        return ""
    return zone.isoformat()[19:]


def _gps_time(gps: Mapping[int, object]) -> str | None:
    clock = gps.get(_GPS_TIME)
    parts = [number(part) for part in clock] if isinstance(clock, tuple | list) else []
    if len(parts) != 3 or None in parts:
        return None
    hours, minutes, seconds = (part or 0.0 for part in parts)
    try:
        day = datetime.strptime(text(gps.get(_GPS_DATE)).replace("-", ":"), "%Y:%m:%d")
        moment = day.replace(tzinfo=UTC) + timedelta(hours=hours, minutes=minutes, seconds=seconds)
    except (ValueError, OverflowError):
        return None
    return moment.isoformat()


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
        return False


ABSENT = NoGps("it has no GPS position")
"""EXIF has no tag of a position."""


@dataclass(frozen=True, slots=True)
class Heading:
    """Viewing direction, degrees clockwise from true (`T`) or magnetic (`M`) north (None: unknown which)."""

    deg: float
    reference: Literal["T", "M"] | None


def read_gps(tags: Mapping[int, object]) -> Gps | NoGps:
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
