"""Shapes that people draw on a mission: search areas, lines and markers; their checks and sizes."""

from __future__ import annotations

from typing import Literal, get_args

import numpy as np
from numpy.typing import NDArray

from webapp.core.geo.local import LocalFrame, centre_of
from webapp.errors import UsageError

Kind = Literal["area", "line", "marker"]
"""A polygon to be searched, without its first point repeated; a line; a point."""

KINDS: tuple[Kind, ...] = get_args(Kind)

MOST_POINTS = 1000
"""Maximum number of points of a drawing."""

MAX_NAME, MAX_NOTE = 120, 2000
"""Characters."""

MAX_ACROSS_M = 50_000.0
"""Maximum extent of an area or a line: in its plane, lengths are then right to a few millionths."""

LEAST_RADIUS_M, MOST_RADIUS_M, RADIUS_M = 0.5, 200.0, 5.0
"""Limits, and default, of the distance at which somebody who passes has searched a spot."""

_LEAST: dict[Kind, int] = {"area": 3, "line": 2, "marker": 1}
_LEAST_AREA_M2 = 1.0
_WHERE = "points"


def checked_points(kind: Kind, points: list[tuple[float, float]]) -> list[tuple[float, float]]:
    """Check the shape of a drawing.

    Args:
        points: Degrees north, degrees east.

    Returns:
        The points without repetitions of the one before; of an area also without its first point at the end.

    Raises:
        UsageError: Too few or too many points, one that is not on the Earth, or a shape that is too large,
            empty, or crosses itself.
    """
    if len(points) > MOST_POINTS + 1:
        raise UsageError(
            f"a drawing has at most {MOST_POINTS} points", where=_WHERE, hint="simplify it, or divide it"
        )
    table = np.asarray(points, dtype=np.float64).reshape(-1, 2)
    if not (np.isfinite(table).all() and (np.abs(table) <= (90.0, 180.0)).all()):
        raise UsageError(
            "a point is not on the Earth",
            where=_WHERE,
            hint="latitudes are -90 to 90, longitudes -180 to 180",
        )
    kept = [point for n, point in enumerate(points) if n == 0 or tuple(point) != tuple(points[n - 1])]
    if kind == "area" and len(kept) > 1 and tuple(kept[0]) == tuple(kept[-1]):
        kept.pop()
    if len(kept) < _LEAST[kind] or (kind == "marker" and len(kept) > 1) or len(kept) > MOST_POINTS:
        wanted = "exactly 1" if kind == "marker" else f"{_LEAST[kind]} to {MOST_POINTS}"
        raise UsageError(f"a drawing of this kind has {wanted} different points", where=_WHERE)
    metres = to_metres(kept)
    if not float(np.ptp(metres, axis=0).max()) <= MAX_ACROSS_M:  # NaN neither
        message = f"a drawing is at most {MAX_ACROSS_M / 1000:g} km across"
        raise UsageError(message, where=_WHERE, hint="divide it")
    if kind == "area":
        _check_area(metres)
    return [(float(lat), float(lon)) for lat, lon in kept]


def _check_area(metres: NDArray[np.float64]) -> None:
    if crosses_itself(metres):
        raise UsageError(
            "the outline of the area crosses or touches itself",
            where=_WHERE,
            hint="give its corners in the order in which one walks around it",
        )
    if area_m2(metres) < _LEAST_AREA_M2:
        raise UsageError("the area is smaller than a square metre", where=_WHERE)


def to_metres(points: list[tuple[float, float]]) -> NDArray[np.float64]:
    """Convert to metres east and north of the centre, (n, 2) float64."""
    return LocalFrame(centre_of(points)).enu_from_latlon(points)


def area_m2(metres: NDArray[np.float64]) -> float:
    """Return the area of a polygon, (n, 2) float64."""
    x, y = metres.T
    return float(abs(np.dot(x, np.roll(y, -1)) - np.dot(y, np.roll(x, -1))) / 2)


def length_m(metres: NDArray[np.float64]) -> float:
    """Return the length of a line, (n, 2) float64."""
    return float(np.hypot(*np.diff(metres, axis=0).T).sum())


def crosses_itself(metres: NDArray[np.float64]) -> bool:
    """Return whether two sides of a polygon, (n, 2) float64, meet anywhere but at their common corner."""
    n = len(metres)
    begin, end = metres, np.roll(metres, -1, axis=0)
    first, second = np.triu_indices(n, k=1)
    neighbours = (second - first == 1) | ((first == 0) & (second == n - 1))
    folds = _fold_back(begin, end)
    first, second = first[~neighbours], second[~neighbours]
    a, b, c, d = begin[first], end[first], begin[second], end[second]
    one, two = _side(a, b, c), _side(a, b, d)
    three, four = _side(c, d, a), _side(c, d, b)
    across = (one * two < 0) & (three * four < 0)
    touch = (
        ((one == 0) & _between(a, b, c))
        | ((two == 0) & _between(a, b, d))
        | ((three == 0) & _between(c, d, a))
        | ((four == 0) & _between(c, d, b))
    )
    return bool(folds or (across | touch).any())


def _fold_back(begin: NDArray[np.float64], end: NDArray[np.float64]) -> bool:
    """Return whether a side runs back along the one before it."""
    here, following = end - begin, np.roll(end - begin, -1, axis=0)
    turn = here[:, 0] * following[:, 1] - here[:, 1] * following[:, 0]
    return bool(((turn == 0) & ((here * following).sum(axis=1) < 0)).any())


def _side(a: NDArray[np.float64], b: NDArray[np.float64], p: NDArray[np.float64]) -> NDArray[np.float64]:
    return np.sign((b[:, 0] - a[:, 0]) * (p[:, 1] - a[:, 1]) - (b[:, 1] - a[:, 1]) * (p[:, 0] - a[:, 0]))


def _between(a: NDArray[np.float64], b: NDArray[np.float64], p: NDArray[np.float64]) -> NDArray[np.bool_]:
    inside: NDArray[np.bool_] = (np.minimum(a, b) <= p) & (p <= np.maximum(a, b))
    return np.logical_and(inside[:, 0], inside[:, 1])
