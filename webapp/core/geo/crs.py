"""Latitude and longitude <-> the x, y of any coordinate system; no other module transforms with pyproj.

The order is always x = east or longitude, y = north or latitude, whatever axis order an authority defines.

Coordinate systems are untrusted input, and PROJ opens any file that one names (`+init`, `+nadgrids`,
`PARAMETERFILE`). Therefore only three forms are accepted, none of which can name a file.
"""

from __future__ import annotations

import re
from functools import lru_cache
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from webapp.errors import GeoreferenceError

if TYPE_CHECKING:
    from pyproj import CRS, Transformer

WGS84 = "EPSG:4326"

_MAX_CHARACTERS = 20_000
_CODE = re.compile(r"(EPSG|ESRI|IGNF|OGC):\w+", re.ASCII | re.IGNORECASE)
_PROJ_KEYS = (
    "proj|type|datum|ellps|a|b|R|f|rf|pm|towgs84|units|to_meter|axis|zone|south|lat_0|lat_1|lat_2|lat_ts|"
    "lon_0|lon_1|lon_2|lon_wrap|lonc|alpha|gamma|k|k_0|x_0|y_0|h|sweep|no_uoff|no_off|no_rot|no_defs|wktext|over"
)
_PROJ_ITEM = rf"\+?(?:(?:{_PROJ_KEYS})(?:=[-+.,\w]+)?|nadgrids=@null)"
_PROJ_STRING = re.compile(rf"\s*{_PROJ_ITEM}(?:\s+{_PROJ_ITEM})*\s*", re.ASCII)
"""Parameters that name no file. WKT of web Mercator has `nadgrids=@null`: no grid."""

_WKT = re.compile(r"\s*[A-Z][A-Z0-9_]*\s*\[.*\]\s*", re.DOTALL | re.IGNORECASE)
_WKT_TEXT = re.compile(r'"([^"]*)"')
_WKT_PROJ = re.compile(r"PROJ[ -]|.*(proj|init|grids)\s*=", re.DOTALL | re.IGNORECASE)
"""Quoted text that PROJ reads as part of a PROJ string: in an EXTENSION, or as the name of a METHOD."""


@lru_cache(maxsize=64)
def parse_crs(plane: str) -> CRS:
    """Read the name of a coordinate system.

    Args:
        plane: An authority code (`EPSG:4326`, `EPSG:32633`), a PROJ string, or WKT.

    Raises:
        GeoreferenceError: PROJ does not know it, it is neither geographic nor projected, or it may name a
            file.
    """
    from pyproj import CRS  # imported lazily: only needed for positions on the Earth
    from pyproj.exceptions import CRSError

    hint = "use a name such as EPSG:4326 (longitude and latitude) or EPSG:32633 (UTM zone 33 north)"
    if not _is_plain(plane):
        raise GeoreferenceError(f"unknown coordinate system {plane[:80]!r}", hint=hint)
    try:
        crs = CRS.from_user_input(plane)
    except CRSError as error:
        raise GeoreferenceError(f"unknown coordinate system {plane[:80]!r}", hint=hint) from error
    if not (crs.is_geographic or crs.is_projected):
        raise GeoreferenceError(f"{crs.name} is not a map coordinate system", hint=hint)
    return crs


def _is_plain(plane: str) -> bool:
    """Return whether a coordinate system has one of the forms that cannot name a file."""
    if len(plane) > _MAX_CHARACTERS:
        return False
    if _CODE.fullmatch(plane) or _PROJ_STRING.fullmatch(plane):
        return True
    if not _WKT.fullmatch(plane) or "PARAMETERFILE" in plane.upper():
        return False
    texts, around = _WKT_TEXT.findall(plane), _WKT_TEXT.sub("", plane)
    return "=" not in around and all(_PROJ_STRING.fullmatch(t) for t in texts if _WKT_PROJ.match(t))


def crs_name(text: str) -> str:
    """Return the EPSG code of a coordinate system (`EPSG:32633`) if it is just that, else the text."""
    code = parse_crs(text).to_epsg(min_confidence=100)
    return f"EPSG:{code}" if code else text


@lru_cache(maxsize=64)
def _transformer(plane: str) -> Transformer:
    from pyproj import Transformer
    from pyproj.exceptions import ProjError

    try:
        return Transformer.from_crs(parse_crs(plane), WGS84, always_xy=True)
    except ProjError as error:
        raise GeoreferenceError(
            f"no transformation from the coordinate system {plane[:80]!r} to latitude and longitude",
            hint="use one that is tied to the Earth, such as EPSG:4326",
        ) from error


def latlon_from_plane(plane: str, xy: ArrayLike) -> NDArray[np.float64]:
    """Convert points of a plane to latitude and longitude.

    Args:
        xy: (n, 2) float64. East (or longitude), north (or latitude), in the plane's unit.

    Returns:
        (n, 2) float64: Degrees north, degrees east in [-180, 180]; NaN outside the domain of the plane.
    """
    x, y = np.asarray(xy, dtype=np.float64).reshape(-1, 2).T
    lon, lat = _transformer(plane).transform(x, y)
    out = _nan_outside(np.column_stack([lat, lon]), lat=np.asarray(lat))
    beyond = np.abs(out[:, 1]) > 180.0
    out[beyond, 1] = (out[beyond, 1] + 180.0) % 360.0 - 180.0
    return out


def plane_from_latlon(plane: str, latlon: ArrayLike) -> NDArray[np.float64]:
    """Convert latitude and longitude to points of a plane.

    Args:
        latlon: (n, 2) float64. Degrees north, degrees east.

    Returns:
        (n, 2) float64: East (or longitude), north (or latitude), in the plane's unit; NaN outside the domain
            of the plane.
    """
    lat, lon = np.asarray(latlon, dtype=np.float64).reshape(-1, 2).T
    x, y = _transformer(plane).transform(lon, lat, direction="INVERSE")
    return _nan_outside(np.column_stack([x, y]), lat=lat)


def _nan_outside(points: NDArray[np.float64], *, lat: NDArray[np.float64]) -> NDArray[np.float64]:
    bad = ~np.isfinite(points).all(axis=1) | ~(np.abs(lat) <= 90.0)
    points[bad] = np.nan
    return points
