"""Reprojects a satellite image to Web Mercator, the projection of slippy maps."""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from webapp.core.geo.georeference import Georeference, latlon_grid

_CELLS = 32
_LIMIT_DEG = 85.0


@dataclass(frozen=True, slots=True, eq=False)
class MercatorPicture:
    pixels: NDArray[np.uint8]  # (h, w, 4) uint8. Blue, green, red, opacity; transparent outside the image.
    # `south`, `west`, `north`, `east`: Degrees of its edges.
    south: float
    west: float
    north: float
    east: float


def to_mercator(
    picture: NDArray[np.uint8], georeference: Georeference, *, size: tuple[int, int]
) -> MercatorPicture | None:
    """Reproject a picture of a satellite image.

    Positions are computed exactly on a grid of points, and interpolated between them.

    Args:
        picture: (h, w, 3) uint8. Blue, green, red; perhaps scaled down.

    Returns:
        With about as many pixels. None if a part of the image has no position, or one beyond 85 degrees.
    """
    known = [point for point in latlon_grid(georeference, size).latlon if point is not None]
    latlon = np.array(known)
    if len(known) < len(latlon_grid(georeference, size).latlon) or np.abs(latlon[:, 0]).max() > _LIMIT_DEG:
        return None
    west, east = latlon[:, 1].min(), latlon[:, 1].max()
    low, high = (_northing(latlon[:, 0]).min(), _northing(latlon[:, 0]).max())
    height, width = picture.shape[:2]
    scale = max(width, height) / max(np.radians(east - west), high - low)
    out = (max(1, round(np.radians(east - west) * scale)), max(1, round((high - low) * scale)))
    lon, northing = np.meshgrid(np.linspace(west, east, _CELLS + 1), np.linspace(high, low, _CELLS + 1))
    lat = np.degrees(np.arctan(np.sinh(northing)))
    at = georeference.pixel_from_latlon(np.column_stack([lat.ravel(), lon.ravel()]))
    at *= np.array([width / size[0], height / size[1]])
    opaque = np.dstack([picture, np.full(picture.shape[:2], 255, np.uint8)])
    nodes = at.reshape(_CELLS + 1, _CELLS + 1, 2).astype(np.float32)
    pixels = cv2.remap(opaque, *_spread(nodes, out), cv2.INTER_LINEAR, borderMode=cv2.BORDER_CONSTANT)
    south, north = (float(np.degrees(np.arctan(np.sinh(y)))) for y in (low, high))
    return MercatorPicture(np.asarray(pixels, np.uint8), south, float(west), north, float(east))


def _northing(lat: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return Web Mercator's y for a sphere of radius 1."""
    return np.asarray(np.arcsinh(np.tan(np.radians(lat))), np.float64)


def _spread(
    nodes: NDArray[np.float32], size: tuple[int, int]
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Interpolate the source position of each pixel's centre between the nodes of the grid."""
    width, height = size
    columns = np.tile((np.arange(width, dtype=np.float32) + 0.5) / width * _CELLS, (height, 1))
    rows = np.tile(((np.arange(height, dtype=np.float32) + 0.5) / height * _CELLS)[:, None], (1, width))
    at = cv2.remap(nodes, columns, rows, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    # outer corners -> pixel centres
    return np.ascontiguousarray(at[:, :, 0] - 0.5), np.ascontiguousarray(at[:, :, 1] - 0.5)
