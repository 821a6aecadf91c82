"""Georeference from points known both on the image and on the Earth."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from webapp.core.geo.fit import GeoreferenceFit, check_on_image, check_positions, solve_homography
from webapp.core.geo.georeference import Georeference
from webapp.core.geo.local import LocalFrame, centre_of
from webapp.core.geo.types import LatLon, MapPixel
from webapp.errors import GeoreferenceError

Model = Literal["similarity", "affine", "projective"]
NEEDED: dict[Model, int] = {"similarity": 2, "affine": 3, "projective": 4}
"""Least number of points of each model."""

_COLLINEAR_WARN = 0.1
_COLLINEAR_REFUSE = 1e-6
_COINCIDENT_M = 1e-3

Array = NDArray[np.float64]


class ControlPoint(NamedTuple):
    """A point on the image and its position on the Earth."""

    pixel: MapPixel
    position: LatLon


def from_control_points(
    points: Sequence[ControlPoint], *, width: int, height: int, model: Model | None = None
) -> GeoreferenceFit:
    """Fit a georeference to control points, by least squares in local metres.

    Args:
        width, height: Of the image, pixels.
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
