"""68 % radii of the positions of a submodel's photos."""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from webapp.core.landmarks.submodels import Points, Submodel

Array = NDArray[np.float64]

_RELATIVE_ERROR, _AS_IF = 0.25, 3.0
"""Prior of the error over the distance to the nearest placed photo, and the number of measurements that it is
worth."""

_MOST_RELATIVE = 2.0
_RADIUS_OVER_RMS = 1.07
"""68 % radius over the RMS of errors that are normal in the plane."""

RADIUS_OVER_SIGMA = 1.515
"""68 % radius over the standard deviation along one axis."""

_SHARE = 0.68
_LEAST_OF_KNOWN = 0.5
"""Least radius that known positions can measure, as a fraction of their own."""


class PlacedPhotos(NamedTuple):
    """Placed photos, (k,) each: row in the submodel, position on the map, its standard deviation, map pixels,
    and whether the position was derived from other photos."""

    row: NDArray[np.int64]
    at: Points
    sigma_px: Array
    derived: NDArray[np.bool_]

    def subset(self, kept: NDArray[np.bool_]) -> PlacedPhotos:
        """Keep some of them, (k,)."""
        return PlacedPhotos(self.row[kept], self.at[kept], self.sigma_px[kept], self.derived[kept])

    @property
    def judges(self) -> NDArray[np.bool_]:
        """Mask (k,) of the photos that measure errors: those with positions that were not derived.

        A derived position agrees with its sources. If all are derived, all are used.
        """
        given = ~self.derived
        return given if given.any() else np.ones_like(given)


def error_rate_of(relative: Array) -> float:
    """Return the RMS error over the distance to the nearest placed photo, with a prior; NaN is ignored."""
    measured = np.minimum(relative[np.isfinite(relative)], _MOST_RELATIVE)
    return float(np.sqrt((_AS_IF * _RELATIVE_ERROR**2 + (measured**2).sum()) / (_AS_IF + len(measured))))


def radius_by_distance(plan: Points, known: PlacedPhotos, *, factor: Points, rate: float) -> Array:
    """Compute 68 % radii (n,), map pixels, from the distance to the nearest placed photo.

    Args:
        plan: (n,) complex128. Plan view of the submodel.
        factor: (n,) complex128. Rotation and scale from the plan view to the map.
        rate: Error over that distance.
    """
    apart = np.abs(plan[:, None] - plan[known.row])
    nearest = apart.argmin(1)
    away = apart[np.arange(len(plan)), nearest] * np.abs(factor)
    radius: Array = _RADIUS_OVER_RMS * np.hypot(np.sqrt(2.0) * known.sigma_px[nearest], rate * away)
    return radius


def radius_by_covariance(submodel: Submodel, known: PlacedPhotos) -> Array | None:
    """Compute 68 % radii (n,), map pixels, from the covariances of an adjusted submodel.

    Covariances show which photos are weakly connected, but not the error of the model as a whole, which is
    measured by leaving out each placed photo in turn. Each such error is divided by the photo's uncertainty
    relative to the median; the 68 % quantile of these scores, times a photo's relative uncertainty, is its
    radius (split conformal prediction with scaled residuals: J. Lei, M. G'Sell, A. Rinaldo, R. Tibshirani,
    L. Wasserman, "Distribution-free predictive inference for regression", 2018).

    The errors of the known positions themselves are subtracted.

    Returns:
        array or None: None for a submodel without covariances, or with too few placed photos.
    """
    if submodel.covariance is None:
        return None
    known = known.subset(known.judges)
    if submodel.left_out is not None:
        known = known.subset(np.isfinite(submodel.left_out[known.row, 0]))
    rank = math.ceil(_SHARE * (len(known.row) + 1))
    if rank > len(known.row):
        return None
    sigma = sigma_of(submodel.covariance)
    usual = float(np.median(sigma))
    error, relative = _left_out(submodel, submodel.covariance, known)
    score = float(np.sort(error / np.maximum(relative, 1.0))[rank - 1])
    own = RADIUS_OVER_SIGMA * float(np.median(known.sigma_px))
    score = math.sqrt(max(score**2 - own**2, (_LEAST_OF_KNOWN * own) ** 2))
    radius: Array = np.maximum(score * np.maximum(sigma / usual, 1.0), RADIUS_OVER_SIGMA * sigma)
    return radius


def _left_out(submodel: Submodel, covariance: Array, known: PlacedPhotos) -> tuple[Array, Array]:
    """Return the errors of placed photos without their positions, and their standard deviations then, over
    the median.

    Where the model was not adjusted without them, both follow from it: without an observation, its residual
    in a least-squares estimate grows by its own contribution (leverage).
    """
    if submodel.left_out is not None:
        x, y, relative = submodel.left_out[known.row].T
        return np.abs(known.at - (x + 1j * y)), relative
    off = known.at - (submodel.centre[:, 0] + 1j * submodel.centre[:, 1])[known.row]
    residual = np.stack([off.real, off.imag], 1)[:, :, None]
    own = covariance[known.row]
    contributed = own / known.sigma_px[:, None, None] ** 2
    left = np.eye(2) - contributed
    # positions left out of the adjustment, because they contradicted others, have contributed nothing
    used = np.linalg.eigvalsh(left @ own + own @ np.swapaxes(left, 1, 2)).min(1) > 0.0
    left[~used] = np.eye(2)
    away = np.linalg.solve(left, residual)[:, :, 0]
    without = np.asarray(np.linalg.solve(left, own), np.float64)
    usual = float(np.median(sigma_of(covariance)))
    return np.hypot(away[:, 0], away[:, 1]), sigma_of(without) / usual


def sigma_of(covariance: Array) -> Array:
    """Compute the standard deviations (n,) along one axis, of covariances (n, 2, 2)."""
    sigma: Array = np.sqrt(np.trace(covariance, axis1=1, axis2=2) / 2.0)
    return sigma
