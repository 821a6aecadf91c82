"""Common parts of all georeferencing methods: the result, the homography, the checks."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from webapp.core.geo.georeference import Georeference
from webapp.core.geo.types import LatLon, MapPixel
from webapp.errors import GeoreferenceError

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
    """Reject invalid latitudes and longitudes.

    Raises:
        GeoreferenceError: Not finite or out of range; the hint says when latitude and longitude seem to be
            swapped.
    """
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
