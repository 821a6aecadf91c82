"""Association of detections without an id to objects: gated nearest neighbours, frame by frame.

Objects are assumed static: their position is the mean of their detections, weighted by the inverse of the
covariances. A detection with the covariance C, v metres away from an object of the same class whose position
has the covariance P, may belong to it if

    d^2 = v' S^-1 v <= GATE_2D,   S = P + C + (FLOOR_M^2 + min(DRIFT_M2_S dt, DRIFT_M^2)) I

and dt is the time between the detection and the interval in which the object was seen. The likeliest of these
objects has the least d^2 + ln det S (Bar-Shalom and Fortmann, Tracking and Data Association, 1988).
Detections of one class at one time come from one image and show different objects: they are assigned jointly,
at the least sum (see `assign`), which is approximate where more than MOST_TOGETHER
detections compete for the same objects.
"""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, field
from itertools import groupby

import numpy as np
from numpy.typing import NDArray

from webapp.core.geo.types import LatLon
from webapp.core.geometry.robust import GATE_2D
from webapp.missions.core.trajectory.distance import metres_per_degree
from webapp.missions.core.trajectory.records import Sighting

FLOOR_M = 0.5
"""Standard deviation of systematic errors of robot position and detector, which averaging does not reduce."""

DRIFT_M2_S = 0.01
DRIFT_M = 3.0
"""Drift of the robot's position between two visits, one standard deviation: 1 m after 100 s, 3 m at most."""

UNKNOWN_SIGMA_M = 5.0
"""Standard deviation of a detection without a stated accuracy."""

MIN_SIGMA_M = 0.1
"""Added to the stated standard deviation of a detection, in quadrature."""

_LEAST_M_PER_DEGREE = 110_000.0
"""Lower bound of the length of a degree of latitude."""

_BLOCK = 256
"""Least number of objects by which the arrays grow."""

Floats = NDArray[np.float64]
Bools = NDArray[np.bool_]

MOST_TOGETHER = 100
"""Largest number of rows solved exactly; so many columns per row are then enough."""

_UNMATCHED = 1e6
"""Cost of no column: more than the sum over any MOST_TOGETHER rows."""

_Floats = NDArray[np.float64]
_Costs = dict[int, float]
"""Costs of a row, by column; columns that it must not get are missing."""


@dataclass(frozen=True, slots=True)
class ObjectEstimate:
    """An object as estimated from its detections."""

    id: str
    kind: str
    latlon: LatLon
    # Of the position: variance east, variance north, covariance of the two.
    covariance_m2: tuple[float, float, float]
    # `first_time_s`, `last_time_s`: Interval in which it was seen, seconds since 1970, UTC.
    first_time_s: float
    last_time_s: float


@dataclass(slots=True)
class ObjectAssociation:
    """The objects of a mission, to which detections are associated.

    Args:
        new_id: Returns the id for a new object of a class.
    """

    new_id: Callable[[str], str]
    _kinds: dict[str, _Kind] = field(default_factory=dict, init=False)

    def add(self, known: ObjectEstimate) -> None:
        """Add an object that is known already."""
        self._kind(known.kind).append(known)

    def add_seen(self, known: ObjectEstimate, *, time_s: float, latlon: LatLon) -> None:
        """Note a sighting of an added object: further detections at that time show other objects."""
        kind = self._kind(known.kind)
        kind.seen.setdefault(time_s, {})[kind.numbers[known.id]] = latlon

    def join(self, seen: Sequence[Sighting]) -> list[str | None]:
        """Associate detections with objects, in the order of time, whatever order they are given in.

        Returns:
            Id of the object of each; None for a detection known already: same class, time and position.
        """
        ids: list[str | None] = [None] * len(seen)
        order = sorted(range(len(seen)), key=lambda n: (*_frame(seen[n]), seen[n].latlon))
        for (_, kind), frame in groupby(order, key=lambda n: _frame(seen[n])):
            numbers = list(frame)
            found = self._kind(kind).join([seen[n] for n in numbers], self.new_id)
            for number, id in zip(numbers, found, strict=True):
                ids[number] = id
        return ids

    def estimate(self, kind: str, id: str) -> ObjectEstimate:
        """Return the current estimate of an object of a class."""
        return self._kinds[kind].estimate(id)

    def _kind(self, kind: str) -> _Kind:
        return self._kinds.setdefault(kind, _Kind(kind))


def _frame(seen: Sighting) -> tuple[float, str]:
    return seen.time_s, seen.kind


@dataclass(slots=True)
class _Kind:
    """The objects of one class, in arrays with spare rows at the end, which are NaN."""

    kind: str
    ids: list[str] = field(default_factory=list)
    numbers: dict[str, int] = field(default_factory=dict)
    latlon: Floats = field(default_factory=lambda: np.empty((0, 2)))
    covariance: Floats = field(default_factory=lambda: np.empty((0, 2, 2)))
    span_s: Floats = field(default_factory=lambda: np.empty((0, 2)))
    seen: dict[float, dict[int, LatLon]] = field(default_factory=dict)
    """Detected positions by time and number of the object."""

    def append(self, known: ObjectEstimate) -> None:
        number = self.numbers[known.id] = len(self.ids)
        self.ids.append(known.id)
        if number == len(self.latlon):
            self._grow()
        self.latlon[number] = known.latlon
        self.covariance[number] = _matrix(known.covariance_m2)
        self.span_s[number] = known.first_time_s, known.last_time_s

    def _grow(self) -> None:
        more = max(_BLOCK, len(self.latlon))
        self.latlon = np.concatenate([self.latlon, np.full((more, 2), np.nan)])
        self.covariance = np.concatenate([self.covariance, np.full((more, 2, 2), np.nan)])
        self.span_s = np.concatenate([self.span_s, np.full((more, 2), np.nan)])

    def estimate(self, id: str) -> ObjectEstimate:
        number = self.numbers[id]
        (var_e, both), (_, var_n) = self.covariance[number].tolist()
        lat, lon = self.latlon[number].tolist()
        return ObjectEstimate(
            id, self.kind, LatLon(lat, lon), (var_e, var_n, both), *self.span_s[number].tolist()
        )

    def join(self, frame: list[Sighting], new_id: Callable[[str], str]) -> list[str | None]:
        """Associate the detections of one time jointly; those without an object become new ones."""
        then = self.seen.setdefault(frame[0].time_s, {})
        known = set(then.values())
        fresh = [n for n, one in enumerate(frame) if one.latlon not in known]
        ids: list[str | None] = [None] * len(frame)
        free = np.ones(len(self.latlon), bool)
        free[list(then)] = False
        chosen = assign([self._costs(frame[n], free=free) for n in fresh])
        for place, n in enumerate(fresh):
            if place in chosen:
                number = chosen[place]
                ids[n], then[number] = self.ids[number], frame[n].latlon
                self._update(number, frame[n])
            else:
                ids[n] = self._new(frame[n], new_id(self.kind))
        return ids

    def _costs(self, one: Sighting, *, free: Bools) -> _Costs:
        """Return the costs of associating a detection with the likeliest objects inside the gate."""
        noise = _noise(one)
        near = np.flatnonzero(self._may_be_near(one, noise) & free)
        span_s = self.span_s[near]
        offset = _metres(self.latlon[near], one.latlon)
        waited = np.maximum(span_s[:, 0] - one.time_s, one.time_s - span_s[:, 1]).clip(min=0.0)
        spread = FLOOR_M**2 + np.minimum(DRIFT_M2_S * waited, DRIFT_M**2)
        total = self.covariance[near] + noise + spread[:, None, None] * np.eye(2)
        a, b, d = total[:, 0, 0], total[:, 0, 1], total[:, 1, 1]
        determinant = a * d - b * b
        east, north = offset.T
        distance = (d * east**2 - 2 * b * east * north + a * north**2) / determinant
        costs = distance + np.log(determinant)
        inside = np.flatnonzero(distance <= GATE_2D)
        likeliest = inside[np.argsort(costs[inside], kind="stable")[:MOST_TOGETHER]]
        return dict(zip(near[likeliest].tolist(), costs[likeliest].tolist(), strict=True))

    def _may_be_near(self, one: Sighting, noise: Floats) -> Bools:
        """Mark the objects that may be inside the gate, by latitude alone: a fast preselection."""
        most = self.covariance[:, 1, 1] + (noise[1, 1] + FLOOR_M**2 + DRIFT_M**2)
        north = (self.latlon[:, 0] - one.latlon.lat) * _LEAST_M_PER_DEGREE
        inside: Bools = north**2 <= GATE_2D * most
        return inside

    def _update(self, number: int, one: Sighting) -> None:
        """Update the estimate of an object with a detection."""
        before = self.covariance[number]
        gain = before @ np.linalg.inv(before + _noise(one))
        east, north = gain @ _metres(self.latlon[number : number + 1], one.latlon)[0]
        by_north, by_east = metres_per_degree(self.latlon[number, 0])
        lat, lon = self.latlon[number] + (north / by_north, east / by_east)
        self.latlon[number] = (lat, (lon + 180.0) % 360.0 - 180.0)
        after = before - gain @ before
        self.covariance[number] = (after + after.T) / 2
        self.span_s[number] = min(self.span_s[number, 0], one.time_s), max(self.span_s[number, 1], one.time_s)

    def _new(self, one: Sighting, id: str) -> str:
        (var_e, both), (_, var_n) = _noise(one).tolist()
        self.append(ObjectEstimate(id, self.kind, one.latlon, (var_e, var_n, both), one.time_s, one.time_s))
        self.seen[one.time_s][self.numbers[id]] = one.latlon
        return id


def _matrix(covariance_m2: tuple[float, float, float]) -> Floats:
    var_e, var_n, both = covariance_m2
    return np.array([[var_e, both], [both, var_n]])


def _noise(seen: Sighting) -> Floats:
    """Return the covariance of a detection (2, 2), which is never singular."""
    if seen.covariance_m2 is None:
        return UNKNOWN_SIGMA_M**2 * np.eye(2)
    return _matrix(seen.covariance_m2) + MIN_SIGMA_M**2 * np.eye(2)


def _metres(origins: Floats, position: LatLon) -> Floats:
    """Return the east and north offset of a position from each origin (n, 2): (n, 2), for short distances."""
    by_north, by_east = metres_per_degree(origins[:, 0])
    east = (position.lon - origins[:, 1] + 180.0) % 360.0 - 180.0
    return np.column_stack([east * by_east, (position.lat - origins[:, 0]) * by_north])


def assign(rows: Sequence[_Costs]) -> dict[int, int]:
    """Assign columns to as many rows as possible, at the least sum of costs; other rows are left out.

    Connected components are solved separately; one of more than MOST_TOGETHER rows greedily, the cheapest
    pair first, as the exact solution takes time cubic in the number of rows.
    """
    chosen: dict[int, int] = {}
    for together in _components(rows):
        some = {row: rows[row] for row in together}
        chosen.update(_exact(some) if len(some) <= MOST_TOGETHER else _greedy(some))
    return chosen


def _components(rows: Sequence[_Costs]) -> Iterator[list[int]]:
    """Group rows that share columns, directly or through other rows; rows without columns are left out."""
    rows_of: dict[int, list[int]] = defaultdict(list)
    for row, costs in enumerate(rows):
        for column in costs:
            rows_of[column].append(row)
    seen: set[int] = set()
    for first, costs in enumerate(rows):
        if first in seen or not costs:
            continue
        seen.add(first)
        found = [first]
        for row in found:  # the list grows in the loop
            for column in rows[row]:
                fresh = [other for other in rows_of.pop(column, ()) if other not in seen]
                seen.update(fresh)
                found.extend(fresh)
        yield sorted(found)


def _exact(some: dict[int, _Costs]) -> dict[int, int]:
    """Assign at the least sum; a row may also stay without a column, at the cost `_UNMATCHED`."""
    columns = sorted({column for costs in some.values() for column in costs})
    place = {column: number for number, column in enumerate(columns)}
    table = np.full((len(some), len(columns) + len(some)), _UNMATCHED)
    for n, costs in enumerate(some.values()):
        table[n, [place[column] for column in costs]] = list(costs.values())
    found = zip(some, linear_assignment(table), strict=True)
    return {row: columns[n] for row, n in found if n < len(columns) and columns[n] in some[row]}


def _greedy(some: dict[int, _Costs]) -> dict[int, int]:
    pairs = sorted((cost, row, column) for row, costs in some.items() for column, cost in costs.items())
    chosen: dict[int, int] = {}
    taken: set[int] = set()
    for _, row, column in pairs:
        if row not in chosen and column not in taken:
            chosen[row] = column
            taken.add(column)
    return chosen


def linear_assignment(costs: _Floats) -> list[int]:
    """Choose a column for each row of (n, m) costs, n <= m, at the least sum: Kuhn's method with potentials.

    R. Burkard, M. Dell'Amico and S. Martello, Assignment Problems (2009), section 4.2.
    """
    n, m = costs.shape
    of_row, of_column = np.zeros(n), np.zeros(m)
    row_of: NDArray[np.intp] = np.full(m, -1)
    for first in range(n):
        least, way = np.full(m, np.inf), np.full(m, -1)
        reached: list[int] = []
        row, column = first, -1
        while row >= 0:
            slack = costs[row] - of_row[row] - of_column
            better = slack < least
            better[reached] = False
            least[better], way[better] = slack[better], column
            open_ = least.copy()
            open_[reached] = np.inf
            column = int(np.argmin(open_))
            step = open_[column]
            of_row[[first, *row_of[reached]]] += step
            of_column[reached] -= step
            least -= step
            reached.append(column)
            row = int(row_of[column])
        while column >= 0:
            before = int(way[column])
            row_of[column] = row_of[before] if before >= 0 else first
            column = before
    return [int(np.flatnonzero(row_of == row)[0]) for row in range(n)]
