"""Georeferences fitted to corners or to control points, with the checks that all methods share."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from webapp.core.geo.crs import WGS84
from webapp.core.geo.georeference import Georeference
from webapp.core.geo.local import LocalFrame, centre_of
from webapp.core.geo.types import LatLon, MapPixel
from webapp.core.texts import significant
from webapp.errors import GeoreferenceError

Model = Literal["similarity", "affine", "projective"]
NEEDED: dict[Model, int] = {"similarity": 2, "affine": 3, "projective": 4}
"""Least number of points of each model."""

_COLLINEAR_WARN = 0.1
_COLLINEAR_REFUSE = 1e-6
_COINCIDENT_M = 1e-3


class ControlPoint(NamedTuple):
    """A point on the image and its position on the Earth."""

    pixel: MapPixel
    position: LatLon


def from_control_points(
    points: Sequence[ControlPoint], *, width: int, height: int, model: Model | None = None
) -> GeoreferenceFit:
    """Fit a georeference to control points, by least squares in local metres.

    Args:
        model: "similarity", "affine" or "projective". Default: the one with the most parameters that the
            number of points allows (2, 3, 4 or more).

    Returns:
        Residuals in metres, one per point; warnings for points nearly on a line (with the ratio of the
            singular values of their coordinates: 1 isotropic, 0 a line) and for a fit without redundancy.

    Raises:
        GeoreferenceError: Too few points, an invalid position, coincident points, points on a line, a
            mirrored image, a horizon across the image.

    Notes:
        Coordinates are normalised before solving; the projective fit is the normalised direct linear
        transform of Hartley and Zisserman, "Multiple View Geometry", algorithm 4.2.
    """
    chosen = model or _richest(len(points))
    if len(points) < NEEDED[chosen]:
        message = f"{len(points)} control points, but {chosen} needs {NEEDED[chosen]}"
        raise GeoreferenceError(message, hint="add control points, far from each other")
    check_positions([p.position for p in points])
    latlon = np.array([p.position for p in points], dtype=np.float64)
    pixels = np.array([p.pixel for p in points], dtype=np.float64)
    if not np.isfinite(pixels).all():
        raise GeoreferenceError("a control point has no finite pixel position")
    frame = LocalFrame(centre_of(latlon))
    metres = frame.enu_from_latlon(latlon)
    warnings = _spread_warnings(pixels, metres, chosen)
    solve = {"similarity": _similarity, "affine": _affine, "projective": solve_homography}[chosen]
    matrix = solve(pixels, metres)
    georeference = Georeference(frame.plane, tuple(float(v) for v in matrix.ravel()), chosen)
    check_on_image(georeference, width=width, height=height)
    residuals = np.hypot(*(georeference.enu_from_pixel(pixels, frame) - metres).T)
    if len(points) == NEEDED[chosen]:
        warnings.append(f"{len(points)} points are the minimum for {chosen}: the fit cannot be checked")
    return GeoreferenceFit(georeference, tuple(float(r) for r in residuals), tuple(warnings))


def _richest(count: int) -> Model:
    if count < 2:
        raise GeoreferenceError(f"{count} control points, but at least 2 are needed", hint="add some")
    return "similarity" if count == 2 else "affine" if count == 3 else "projective"


def _spread_warnings(pixels: Array, metres: Array, model: Model) -> list[str]:
    """Return warnings of points nearly on a line; raise for coincident points and points on a line."""
    for i in range(len(pixels)):
        for other, points in (("pixel", pixels), ("position", metres)):
            distance = np.hypot(*(points[:i] - points[i]).T)
            if (distance < _COINCIDENT_M).any():
                first = int(np.argmin(distance)) + 1
                message = f"the control points {first} and {i + 1} have the same {other}"
                raise GeoreferenceError(message, hint="remove one of them")
    if model == "similarity":
        return []
    ratio = min(_roundness(pixels), _roundness(metres))
    if ratio < _COLLINEAR_REFUSE:
        hint = "add a point off the line, or choose a similarity"
        raise GeoreferenceError("the control points lie on one line", hint=hint)
    if ratio < _COLLINEAR_WARN:
        return [f"the control points lie nearly on a line (singular value ratio {ratio:.2g}); add one off it"]
    return []


def _roundness(points: Array) -> float:
    values = np.linalg.svd(points - points.mean(axis=0), compute_uv=False)
    return float(values[1] / values[0])


def _similarity(pixels: Array, metres: Array) -> Array:
    """Fit rotation, scale and translation by least squares, with a reflection as pixels have y down."""
    centre, target = pixels.mean(axis=0), metres.mean(axis=0)
    z = (pixels - centre) @ np.array([1.0, -1.0j])
    w = (metres - target) @ np.array([1.0, 1.0j])
    factor = np.vdot(z, w) / np.vdot(z, z).real
    if abs(factor) == 0.0:
        raise GeoreferenceError("the control points contradict each other", hint="check their order")
    a, b = float(factor.real), float(factor.imag)
    linear = np.array([[a, b], [b, -a]])
    return _affine_matrix(linear, target - linear @ centre)


def _affine(pixels: Array, metres: Array) -> Array:
    centre, target = pixels.mean(axis=0), metres.mean(axis=0)
    linear = np.linalg.lstsq(pixels - centre, metres - target, rcond=None)[0].T
    return _affine_matrix(linear, target - linear @ centre)


def _affine_matrix(linear: Array, shift: Array) -> Array:
    return np.vstack([np.column_stack([linear, shift]), [0.0, 0.0, 1.0]])


_RANK_REFUSE = 1e-7

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True)
class GeoreferenceFit:
    """A georeference, and how well it fits its input."""

    georeference: Georeference
    # Distance of each point between the fit and the given position, metres.
    residuals_m: tuple[float, ...] = ()
    warnings: tuple[str, ...] = ()  # Messages for the user


def check_positions(positions: Iterable[LatLon]) -> None:
    """Reject invalid latitudes and longitudes."""
    for lat, lon in positions:
        if abs(lat) <= 90.0 and abs(lon) <= 180.0:
            continue
        swapped = abs(lon) <= 90.0 < abs(lat) <= 180.0
        hint = "latitude and longitude seem to be swapped" if swapped else None
        message = f"latitude {lat:g}, longitude {lon:g} is not on the Earth"
        raise GeoreferenceError(message, hint=hint or "latitude is -90 to 90, longitude -180 to 180 degrees")


def check_on_image(georeference: Georeference, *, width: int, height: int) -> None:
    """Reject a georeference that is undefined on part of the image, or mirrored. Raises GeoreferenceError."""
    corners = [MapPixel(0, 0), MapPixel(width, 0), MapPixel(width, height), MapPixel(0, height)]
    if not np.isfinite(georeference.latlon_from_pixel(corners)).all():
        raise GeoreferenceError(
            "part of the image has no position on the Earth: it is beyond a horizon or the limits of the "
            "coordinate system",
            hint="check the points and the coordinate system, or choose an affine fit",
        )
    if np.linalg.det(georeference.jacobian(MapPixel(width / 2, height / 2))) > 0.0:
        raise GeoreferenceError(
            "the image would show the Earth mirrored",
            hint="two corners or points are swapped, or the image is flipped",
        )


def solve_homography(source: Array, target: Array) -> Array:
    """Estimate a homography by the normalised direct linear transform.

    Args:
        source, target: (n, 2) float64. At least four points.

    Returns:
        (3, 3) float64: `target` from `source`, third homogeneous coordinate positive on the points.

    Raises:
        GeoreferenceError: The points do not determine it (three of four on a line), or are on both sides of
            its horizon.
    """
    to_source, to_target = _normaliser(source), _normaliser(target)
    x, y = (source * to_source[0, 0] + to_source[:2, 2]).T
    u, v = (target * to_target[0, 0] + to_target[:2, 2]).T
    one, zero = np.ones_like(x), np.zeros_like(x)
    rows = np.concatenate(
        [
            np.column_stack([x, y, one, zero, zero, zero, -u * x, -u * y, -u]),
            np.column_stack([zero, zero, zero, x, y, one, -v * x, -v * y, -v]),
        ]
    )
    _, values, vectors = np.linalg.svd(rows)
    if values[7] < _RANK_REFUSE * values[0]:
        hint = "no three of four points may lie on one line"
        raise GeoreferenceError("the points do not determine a projective fit", hint=hint)
    matrix = np.linalg.inv(to_target) @ vectors[-1].reshape(3, 3) @ to_source
    w = source @ matrix[2, :2] + matrix[2, 2]
    if not ((w > 0).all() or (w < 0).all()):
        hint = "check the order of the points, or choose an affine fit"
        raise GeoreferenceError("the points contradict each other: the image would be folded", hint=hint)
    # scaled so that the mean of w over the points is 1
    return np.asarray(matrix / w.mean(), dtype=np.float64)


def _normaliser(points: Array) -> Array:
    """Return the (3, 3) translation and scaling of points to mean 0 and mean distance sqrt(2)."""
    centre = points.mean(axis=0)
    scale = np.sqrt(2.0) / np.hypot(*(points - centre).T).mean()
    return np.array([[scale, 0.0, -scale * centre[0]], [0.0, scale, -scale * centre[1]], [0.0, 0.0, 1.0]])


_WGS84_ACROSS_180 = "+proj=longlat +datum=WGS84 +lon_wrap=180 +no_defs"
"""Longitudes from 0 to 360, for an image across the 180th meridian."""

_SQUARE = 1.25
"""Largest ratio of the sides of a pixel without a warning."""


@dataclass(frozen=True, slots=True)
class Corners:
    """Positions of the outer corners of an image: two if north is up, or all four."""

    top_left: LatLon
    bottom_right: LatLon
    top_right: LatLon | None = None
    bottom_left: LatLon | None = None


def from_corners(corners: Corners, *, width: int, height: int) -> GeoreferenceFit:
    """Georeference an image by two corners (x linear in longitude, y in latitude) or four (projective).

    Four corners that form a rectangle in latitude and longitude are equivalent to two.

    Args:
        corners: With both or none of `top_right` and `bottom_left`.

    Returns:
        Without residuals, as it fits the corners exactly. With a warning if the pixels are far from square.

    Raises:
        GeoreferenceError: Three corners are given, or positions are invalid, coincident, on one line,
            mirrored or folded.
    """
    given = [corners.top_left, corners.top_right, corners.bottom_right, corners.bottom_left]
    known = [c for c in given if c is not None]
    if len(known) == 3:
        raise GeoreferenceError("three corners are given", hint="give top_left and bottom_right, or all four")
    check_positions(known)
    across = max(c.lon for c in known) - min(c.lon for c in known) > 180.0 and _crosses(corners)
    places = np.array([(c.lon % 360.0 if across else c.lon, c.lat) for c in known])
    plane = _WGS84_ACROSS_180 if across else WGS84
    if len(known) == 4:
        pixels = np.array([(0.0, 0.0), (width, 0.0), (width, height), (0.0, height)])
        _check_distinct(known)
        matrix = tuple(float(v) for v in solve_homography(pixels, places).ravel())
    else:
        matrix = _north_up(places[0], places[1], width=width, height=height)
    georeference = Georeference(plane, matrix, "corners")
    check_on_image(georeference, width=width, height=height)
    return GeoreferenceFit(georeference, warnings=_shape_warnings(georeference, width=width, height=height))


def _crosses(corners: Corners) -> bool:
    """Return whether an image crosses the 180th meridian, as opposed to one of the whole world."""
    right = [c for c in (corners.bottom_right, corners.top_right) if c is not None]
    left = [c for c in (corners.top_left, corners.bottom_left) if c is not None]
    return min(c.lon for c in left) > max(c.lon for c in right)


def _north_up(
    top_left: np.ndarray, bottom_right: np.ndarray, *, width: int, height: int
) -> tuple[float, ...]:
    west, north = (float(v) for v in top_left)
    east, south = (float(v) for v in bottom_right)
    if east == west or south == north:
        raise GeoreferenceError(
            "the two corners have the same latitude or longitude", hint="give opposite corners of the image"
        )
    if east < west or south > north:
        both = east < west and south > north
        hint = "the corners are swapped" if both else "top_left must be the north-west corner, north up"
        raise GeoreferenceError("bottom_right is not south-east of top_left", hint=hint)
    return ((east - west) / width, 0.0, west, 0.0, (south - north) / height, north, 0.0, 0.0, 1.0)


def _check_distinct(known: list[LatLon]) -> None:
    if len(set(known)) < len(known):
        raise GeoreferenceError(
            "two corners have the same position", hint="give the four corners of the image"
        )


def _shape_warnings(georeference: Georeference, *, width: int, height: int) -> tuple[str, ...]:
    jacobian = georeference.jacobian(MapPixel(width / 2, height / 2))
    across, down = (float(v) for v in np.hypot(jacobian[0], jacobian[1]))
    if max(across, down) < _SQUARE * min(across, down):
        return ()
    return (
        f"a pixel would be {significant(across)} m wide and {significant(down)} m high; "
        "are latitude and longitude swapped, or are these the corners of another image?",
    )
