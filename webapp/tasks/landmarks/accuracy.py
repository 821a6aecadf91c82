"""How accurate a fit is: the RMSE of its control points and of its check points; residuals as JSON."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Any

from webapp.core.mapmodel.model import Map
from webapp.tasks.landmarks.control_points import Residual


@dataclass(frozen=True, slots=True)
class Rmse:
    """Root mean square errors of n points."""

    points: int
    px: float | None = None  # Of the distances; None without points
    # On a map with a georeference: of the distances, to the east, to the north, and of known heights.
    m: float | None = None
    east_m: float | None = None
    north_m: float | None = None
    height_m: float | None = None
    heights: int = 0  # Number of points with a height residual

    @property
    def uncertainty(self) -> float | None:
        """Relative standard deviation of `px` and `m` themselves, for normal errors: 1 / sqrt(4 n)."""
        return 1.0 / math.sqrt(4.0 * self.points) if self.points else None


@dataclass(frozen=True, slots=True)
class Accuracy:
    """Of a fit."""

    control: Rmse  # Each point predicted from all others; without those that were left out
    check: Rmse


def accuracy_of(residuals: Iterable[Residual], the_map: Map) -> Accuracy:
    """Compute the RMSE of the control points and of the check points."""
    points = [
        one for one in residuals if one.photo is None and one.shift_px is not None and not one.contradicts
    ]
    control, check = ([one for one in points if one.is_check == wanted] for wanted in (False, True))
    return Accuracy(_rmse(control, the_map), _rmse(check, the_map))


def _rmse(points: Sequence[Residual], the_map: Map) -> Rmse:
    shifts = [shift for one in points if (shift := one.shift_m(the_map)) is not None]
    heights = [up for one in points if (up := one.in_metres(one.height_off_px, the_map)) is not None]
    east, north = ([shift[axis] for shift in shifts] for axis in (0, 1))
    return Rmse(
        len(points),
        _rms([one.residual_px or 0.0 for one in points]),
        _rms([math.hypot(*shift) for shift in shifts]),
        _rms(east),
        _rms(north),
        _rms(heights),
        len(heights),
    )


def _rms(values: Sequence[float]) -> float | None:
    return math.sqrt(sum(value**2 for value in values) / len(values)) if values else None


def accuracy_fields(accuracy: Accuracy) -> dict[str, Any]:
    """Return the JSON of an accuracy: `control` and `check`."""
    return {"control": _rmse_fields(accuracy.control), "check": _rmse_fields(accuracy.check)}


def _rmse_fields(rmse: Rmse) -> dict[str, Any]:
    return {
        "points": rmse.points,
        "rmse_px": _rounded(rmse.px, 2),
        "rmse_m": _rounded(rmse.m, 3),
        "rmse_east_m": _rounded(rmse.east_m, 3),
        "rmse_north_m": _rounded(rmse.north_m, 3),
        "rmse_height_m": _rounded(rmse.height_m, 3),
        "heights": rmse.heights,
        "uncertainty": _rounded(rmse.uncertainty, 3),
    }


def residual_fields(one: Residual, the_map: Map) -> dict[str, Any]:
    """Return the JSON of a residual that commands and the API share."""
    right, down = one.shift_px or (None, None)
    east, north = one.shift_m(the_map) or (None, None)
    return {
        "photo": one.photo,
        "name": one.name,
        "check": one.is_check,
        "photos": one.photos if one.photo is None else None,
        "residual_px": _rounded(one.residual_px, 2),
        "residual_m": _rounded(one.residual_m(the_map), 3),
        "dx_px": _rounded(right, 2),
        "dy_px": _rounded(down, 2),
        "east_m": _rounded(east, 3),
        "north_m": _rounded(north, 3),
        "height_off_m": _rounded(one.in_metres(one.height_off_px, the_map), 3),
        "sigma_px": _rounded(one.sigma_px, 2),
        "sigma_m": _rounded(one.in_metres(one.sigma_px, the_map), 3),
        "contradicts": one.contradicts,
        "wrong_clicks": list(one.wrong),
    }


def _rounded(value: float | None, digits: int) -> float | None:
    return None if value is None else round(value, digits)
