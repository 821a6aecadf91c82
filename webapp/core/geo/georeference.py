"""Georeference of a map image: exact transformations, and a sampled grid."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import ArrayLike, NDArray

from webapp.core.geo.crs import latlon_from_plane, parse_crs, plane_from_latlon
from webapp.core.geo.local import LocalFrame
from webapp.core.geo.types import LatLon, MapPixel
from webapp.errors import GeoreferenceError


@dataclass(frozen=True, slots=True)
class Georeference:
    """Map pixels <-> latitude and longitude, through a plane.

    Transformations are defined on the whole plane, also outside the image. A position without a counterpart
    (beyond the horizon of a projective image or the domain of the coordinate system, or NaN) becomes NaN; no
    method raises for a position.

    Raises:
        GeoreferenceError: On construction: unknown plane, or a matrix that is not nine finite numbers or has
            no inverse.
    """

    # Coordinate system that PROJ understands: `EPSG:4326` for longitude and latitude, a projected one, or a
    # local one (`LocalFrame.plane`).
    plane: str
    # Row-major 3x3 homography from map pixels (outer-corner convention) to plane coordinates x = east or
    # longitude, y = north or latitude. The sign is chosen so that the third homogeneous coordinate is
    # positive on the image.
    plane_from_pixel: tuple[float, ...]
    # How it was made: `corners`, `similarity`, `affine`, `projective`, `worldfile`, `geotiff`, `blank`,
    # `tiles`.
    method: str

    def __post_init__(self) -> None:
        """Reject an unusable plane or matrix."""
        parse_crs(self.plane)
        matrix = np.asarray(self.plane_from_pixel, dtype=np.float64)
        if matrix.shape != (9,) or not np.isfinite(matrix).all():
            raise GeoreferenceError("the matrix of a georeference must have nine finite numbers")
        with np.errstate(over="ignore", invalid="ignore"):
            determinant = np.linalg.det(matrix.reshape(3, 3))
        if not np.isfinite(determinant) or determinant == 0.0:
            raise GeoreferenceError("the matrix of a georeference must have an inverse")

    @property
    def matrix(self) -> NDArray[np.float64]:
        """`plane_from_pixel` as a (3, 3) float64 array."""
        return np.array(self.plane_from_pixel, dtype=np.float64).reshape(3, 3)

    def latlon_from_pixel(self, pixels: ArrayLike) -> NDArray[np.float64]:
        """Convert map pixels to latitude and longitude.

        Args:
            pixels: (n, 2) float64. x, y.

        Returns:
            (n, 2) float64: Degrees north, degrees east; NaN where there is none.
        """
        return latlon_from_plane(self.plane, _project(self.matrix, pixels))

    def pixel_from_latlon(self, latlon: ArrayLike) -> NDArray[np.float64]:
        """Convert latitude and longitude to map pixels: (n, 2) float64; NaN where there is none.

        Args:
            latlon: (n, 2) float64. Degrees north, degrees east.
        """
        return _project(_inverse(self.matrix), plane_from_latlon(self.plane, latlon))

    def enu_from_pixel(self, pixels: ArrayLike, frame: LocalFrame) -> NDArray[np.float64]:
        """Convert map pixels (n, 2) to metres east and north of the frame's origin, (n, 2) float64."""
        return frame.enu_from_latlon(self.latlon_from_pixel(pixels))

    def latlon_of(self, pixel: MapPixel) -> LatLon:
        """Convert one map pixel to latitude and longitude."""
        lat, lon = self.latlon_from_pixel([pixel])[0]
        return LatLon(float(lat), float(lon))

    def pixel_of(self, position: LatLon) -> MapPixel:
        """Convert one latitude and longitude to a map pixel."""
        x, y = self.pixel_from_latlon([position])[0]
        return MapPixel(float(x), float(y))

    def jacobian(self, pixel: MapPixel) -> NDArray[np.float64]:
        """Return the Jacobian of east and north by x and y at one map pixel.

        Returns:
            (2, 2) float64: [[d east / dx, d east / dy], [d north / dx, d north / dy]], metres a pixel;
                central differences over one pixel. The determinant is negative for an image seen from above
                (y points down).
        """
        x, y = pixel
        around = [(x + 0.5, y), (x - 0.5, y), (x, y + 0.5), (x, y - 0.5)]
        centre = self.latlon_of(pixel)
        if not math.isfinite(centre.lat):
            return np.full((2, 2), np.nan)
        right, left, below, above = self.enu_from_pixel(around, LocalFrame(centre))
        return np.column_stack([right - left, below - above])

    def metres_per_pixel(self, pixel: MapPixel) -> float:
        """Return the size of a pixel there, metres: the square root of its area on the ground."""
        (a, b), (c, d) = self.jacobian(pixel).tolist()
        return math.sqrt(abs(a * d - b * c))

    def north_deg(self, pixel: MapPixel) -> float:
        """Return the direction of true north at a pixel: degrees clockwise from image-up, in (-180, 180].

        NaN where the georeference is degenerate or undefined.

        A heading relative to north is `image_angle - north_deg`, with `image_angle` clockwise from image-up.
        """
        (a, b), (c, d) = self.jacobian(pixel).tolist()
        determinant = a * d - b * c
        if not math.isfinite(determinant) or determinant == 0.0:
            return math.nan
        sign = math.copysign(1.0, determinant)
        return math.degrees(math.atan2(-b * sign, -a * sign))


def _inverse(homography: NDArray[np.float64]) -> NDArray[np.float64]:
    """Invert a homography without rescaling it, so that `w` stays positive in front of the horizon."""
    return np.asarray(np.linalg.inv(homography), dtype=np.float64)


def _project(homography: NDArray[np.float64], points: ArrayLike) -> NDArray[np.float64]:
    """Apply a homography to (n, 2) points; NaN on and behind the horizon."""
    xy = np.asarray(points, dtype=np.float64).reshape(-1, 2)
    projected = xy @ homography[:, :2].T + homography[:, 2]
    w = projected[:, 2]
    out = np.full(xy.shape, np.nan)
    front = w > 0.0
    out[front] = projected[front, :2] / w[front, None]
    return out


@dataclass(frozen=True, slots=True)
class LatLonGrid:
    """Latitude and longitude of the corners of equal cells that cover a map image."""

    # `columns`, `rows`: Number of cells across and down; there is one more corner in each direction.
    columns: int
    rows: int
    # tuple of (lat, lon) or None. Degrees, row by row from the top-left corner of the image; None where there
    # is no position. Longitudes are continuous across the 180th meridian, beyond 180, so that they can be
    # interpolated.
    latlon: tuple[tuple[float, float] | None, ...]


def latlon_grid(georeference: Georeference, size: tuple[int, int], *, cells: int = 16) -> LatLonGrid:
    """Sample a georeference on a grid.

    Without perspective, linear interpolation in a cell of size s has an error of about s^2 / (8 R), R being
    the Earth's radius: 2 mm for an image of 5 km with 16 cells.
    """
    width, height = size
    x, y = np.meshgrid(np.linspace(0.0, width, cells + 1), np.linspace(0.0, height, cells + 1))
    latlon = georeference.latlon_from_pixel(np.column_stack([x.ravel(), y.ravel()]))
    known: NDArray[np.bool_] = np.asarray(np.isfinite(latlon).all(axis=1))
    latlon[:, 1] = _continuous(latlon[:, 1], known)
    return LatLonGrid(
        columns=cells,
        rows=cells,
        latlon=tuple(
            (float(lat), float(lon)) if ok else None for (lat, lon), ok in zip(latlon, known, strict=True)
        ),
    )


def _continuous(longitudes: NDArray[np.float64], known: NDArray[np.bool_]) -> NDArray[np.float64]:
    """Shift longitudes by whole turns to within 180 degrees of the first known one."""
    if not known.any():
        return longitudes
    first = longitudes[known][0]
    return np.asarray(first + (longitudes - first + 180.0) % 360.0 - 180.0, dtype=np.float64)
