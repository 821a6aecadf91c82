"""When a photo was taken, and how wide it looks."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass
from datetime import UTC, datetime, timedelta
from typing import Literal

from webapp.files.photos.exif import Exif, number, text

_TIMES = ((0x9003, 0x9291, 0x9011), (0x9004, 0x9292, 0x9012))
"""DateTimeOriginal and DateTimeDigitized, each with its SubSecTime and OffsetTime."""

_GPS_TIME, _GPS_DATE = 7, 29
_FOCAL_MM, _FOCAL_35MM = 0x920A, 0xA405
_WIDTH, _HEIGHT = 0xA002, 0xA003
_PLANE_X, _PLANE_Y, _PLANE_UNIT = 0xA20E, 0xA20F, 0xA210
_UNIT_MM = {2: 25.4, 3: 10.0, 4: 1.0, 5: 0.001}
_DIAGONAL_35MM = math.hypot(36.0, 24.0)
_PLAUSIBLE_DEG = (1.0, 175.0)
_CROPPED = 1.03
"""A shape that differs by more than this factor from the camera's was cropped."""

FovSource = Literal["FocalLengthIn35mmFilm", "FocalPlaneResolution"]


@dataclass(frozen=True, slots=True)
class Fov:
    """Horizontal field of view of the upright photo, degrees, and the EXIF tag it comes from."""

    deg: float
    source: FovSource


def read_time(exif: Exif) -> str | None:
    """Read when the photo was taken.

    Returns
    -------
    str or None
        ISO 8601: the camera's clock, with fraction and offset where the camera wrote them; without an offset
        it is local time. Where only the GPS has a time, that, with the offset +00:00.
    """
    for when, fraction, offset in _TIMES:
        moment = _moment(text(exif.camera.get(when)), text(exif.camera.get(fraction)))
        if moment is not None:
            return moment.isoformat() + _offset(text(exif.camera.get(offset)))
    return _gps_time(exif.gps)


def read_fov(exif: Exif, *, width: int, height: int) -> Fov | None:
    """Read the horizontal field of view.

    Parameters
    ----------
    width, height : int
        Of the upright photo, pixels.

    Returns
    -------
    Fov or None
        None when EXIF does not say, says 0 or the impossible, or the photo was cropped since.

    Notes
    -----
    The focal length "in 35 mm film" is taken over the diagonal (43.27 mm), as CIPA DCG-001 defines it.
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


def _from_35mm(camera: Mapping[int, object], diagonal_px: float) -> float | None:
    focal = number(camera.get(_FOCAL_35MM))
    return None if focal is None else focal / _DIAGONAL_35MM * diagonal_px


def _from_plane(
    camera: Mapping[int, object], camera_size: tuple[float | None, float | None], long_side: float
) -> float | None:
    """Focal length in pixels of this photo, from that in millimetres and the sensor's pixels per length."""
    focal = number(camera.get(_FOCAL_MM))
    density = number(camera.get(_PLANE_X)) or number(camera.get(_PLANE_Y))
    unit = camera.get(_PLANE_UNIT, 2)
    mm = _UNIT_MM.get(unit) if isinstance(unit, int) else None
    width, height = camera_size
    if focal is None or not density or mm is None or not width or not height:
        return None
    return focal * density / mm * long_side / max(width, height)


def _was_cropped(camera_size: tuple[float | None, float | None], size: tuple[int, int]) -> bool:
    """Compare shapes, not turned: software that turns a photo often leaves the camera's size in EXIF."""
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
