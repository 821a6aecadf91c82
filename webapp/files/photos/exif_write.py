"""The EXIF block of a photo whose place, direction and camera are known."""

from __future__ import annotations

from dataclasses import dataclass
from datetime import datetime

import piexif

from webapp.core.geo.types import LatLon


@dataclass(frozen=True, slots=True)
class CameraTags:
    """What is written; None is left out.

    Attributes
    ----------
    taken_at : datetime
        The camera's clock.
    focal_35mm : int
        Focal length in 35 mm film, mm, over the diagonal.
    position : LatLon or None
    heading_deg : float or None
        Where the camera looked, degrees clockwise from true north.
    accuracy_m : float or None
        68 % radius of the position.
    """

    taken_at: datetime
    focal_35mm: int
    position: LatLon | None = None
    heading_deg: float | None = None
    accuracy_m: float | None = None


def exif_bytes(tags: CameraTags) -> bytes:
    """Write an EXIF block as a JPEG holds it; positions to 0.1 mm, directions to 0.0001 degree."""
    gps: dict[int, object] = {}
    if tags.position is not None:
        lat, lon = tags.position
        gps |= {
            piexif.GPSIFD.GPSVersionID: (2, 3, 0, 0),
            piexif.GPSIFD.GPSLatitudeRef: "N" if lat >= 0 else "S",
            piexif.GPSIFD.GPSLatitude: _degrees(lat),
            piexif.GPSIFD.GPSLongitudeRef: "E" if lon >= 0 else "W",
            piexif.GPSIFD.GPSLongitude: _degrees(lon),
            piexif.GPSIFD.GPSMapDatum: "WGS-84",
        }
    if tags.heading_deg is not None:
        turn = round(tags.heading_deg * 10_000) % 3_600_000
        gps |= {piexif.GPSIFD.GPSImgDirectionRef: "T", piexif.GPSIFD.GPSImgDirection: (turn, 10_000)}
    if tags.accuracy_m is not None:
        gps[piexif.GPSIFD.GPSHPositioningError] = (round(tags.accuracy_m * 1000), 1000)
    camera = {
        piexif.ExifIFD.DateTimeOriginal: tags.taken_at.strftime("%Y:%m:%d %H:%M:%S"),
        piexif.ExifIFD.FocalLengthIn35mmFilm: tags.focal_35mm,
    }
    return bytes(piexif.dump({"Exif": camera, "GPS": gps}))


def _degrees(value: float) -> tuple[tuple[int, int], ...]:
    """Degrees, minutes and seconds, as whole numbers over whole numbers."""
    scale = 400_000  # of a second: 0.08 mm on the ground
    total = round(abs(value) * 3600 * scale)
    minutes, rest = divmod(total, 60 * scale)
    return (minutes // 60, 1), (minutes % 60, 1), (rest, scale)
