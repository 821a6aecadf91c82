"""Notations of a position: decimal degrees, degrees-minutes-seconds, UTM and MGRS.

UTM is the transverse Mercator projection in zones of 6 degrees, with the exceptions around Norway and
Svalbard; MGRS names its squares of 100 km by two letters. NGA.STND.0037, "Universal Grids and Grid Reference
Systems" (2014). Beyond 84 degrees north and 80 degrees south neither is used here.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

from webapp.core.geo.crs import plane_from_latlon
from webapp.core.geo.types import LatLon

SOUTH_END, NORTH_END = -80.0, 84.0
"""Range of latitudes with UTM zones."""

_BANDS = "CDEFGHJKLMNPQRSTUVWX"
_COLUMNS = ("ABCDEFGH", "JKLMNPQR", "STUVWXYZ")
"""Letters of the 100 km columns, for zones 1, 2 and 3, and repeated every three zones."""

_ROWS = "ABCDEFGHJKLMNPQRSTUV"
_SQUARE_M = 100_000
_DIGITS = 5
"""Digits of each number of an MGRS position: metres."""


@dataclass(frozen=True, slots=True)
class Utm:
    zone: int  # 1 to 60
    band: str  # Letter of the band of latitude: C to M are south, N to X north of the equator
    # `easting`, `northing`: Metres; the northing is measured from the equator, which is at 10 000 000 for the
    # southern hemisphere.
    easting: float
    northing: float

    def __str__(self) -> str:
        """Write it to a metre, such as `33U 558962 5562189`."""
        return f"{self.zone}{self.band} {math.floor(self.easting):06d} {math.floor(self.northing):07d}"


def utm(position: LatLon) -> Utm | None:
    """Convert a position to UTM; None outside the latitudes of the grid, and for an invalid position."""
    lat, lon = position
    if not (SOUTH_END <= lat <= NORTH_END and math.isfinite(lon)):
        return None
    band = _BANDS[min(int((lat - SOUTH_END) // 8), len(_BANDS) - 1)]
    zone = _zone(lat, (lon + 180.0) % 360.0 - 180.0)
    south = 700 if lat < 0 else 600
    ((easting, northing),) = plane_from_latlon(f"EPSG:32{south + zone}", [position]).tolist()
    # rounded to a millimetre, so that no rounding error moves a position on a grid line below that line
    return Utm(zone, band, round(easting, 3), round(northing, 3))


def mgrs(position: LatLon) -> str | None:
    """Write a position in the Military Grid Reference System, to a metre: `33U WR 58962 62189`.

    The digits are truncated, not rounded, so that they name the square of the position. None outside the
    latitudes of the grid.
    """
    found = utm(position)
    if found is None:
        return None
    easting, northing = math.floor(found.easting), math.floor(found.northing)
    column = _COLUMNS[(found.zone - 1) % 3][easting // _SQUARE_M - 1]
    shift = 0 if found.zone % 2 else 5  # in even zones the row letters are shifted by five
    row = _ROWS[(northing // _SQUARE_M + shift) % len(_ROWS)]
    digits = (f"{metres % _SQUARE_M:0{_DIGITS}d}" for metres in (easting, northing))
    return " ".join((f"{found.zone}{found.band}", f"{column}{row}", *digits))


def decimal(position: LatLon) -> str:
    """Write a position in degrees, to 0.1 m: `50.210400, 15.825200`, as search fields accept it."""
    return f"{position.lat:.6f}, {position.lon:.6f}"


def degrees_minutes_seconds(position: LatLon) -> str:
    """Write a position in degrees, minutes and seconds, to 0.3 m: `50°12'37.44"N 15°49'30.72"E`."""
    north = _sexagesimal(position.lat) + ("N" if position.lat >= 0 else "S")
    east = _sexagesimal(position.lon) + ("E" if position.lon >= 0 else "W")
    return f"{north} {east}"


def _sexagesimal(degrees: float) -> str:
    hundredths = round(abs(degrees) * 360_000)
    minutes, rest = divmod(hundredths, 6000)
    return f"{minutes // 60}°{minutes % 60:02d}'{rest / 100:05.2f}\""


def _zone(lat: float, lon: float) -> int:
    """Return the zone, with the exceptions for Norway and Svalbard."""
    if 56.0 <= lat < 64.0 and 3.0 <= lon < 12.0:
        return 32
    if lat >= 72.0 and 0.0 <= lon < 42.0:
        return 31 + 2 * int((lon + 3.0) // 12.0)
    return int((lon + 180.0) // 6.0) % 60 + 1
