"""The way through the photos of a map: their order, and from each the photos that one can step to."""

from __future__ import annotations

from bisect import bisect_left
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from itertools import groupby
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

NEIGHBOURS = 20
"""Nearest spots among which the next one of a tour, and the steps of a photo, are looked for."""
STEPS = 6
"""Maximum number of steps from a photo."""
APART_DEG = 40.0
"""Minimum angle between two steps."""
_FAR = 4.0
"""A step is at most so many times as long as usual, or as the shortest one there."""
_SAME_SPOT = 0.15
"""Photos closer than this part of the usual distance are on the same spot; a step between them is a turn."""
_LEAST_TURN_DEG = 20.0
"""Photos on the same spot that look in more similar directions show the same."""
_KD_TREE = {"algorithm": 4}
"""The exact search of FLANN for few dimensions."""


@dataclass(frozen=True, slots=True)
class Stop:
    id: int
    # `east`, `north`: On the ground, metres; map pixels without a georeference.
    east: float
    north: float
    floor: int = 0
    level: float = 0.0  # Of its floor: orders the floors
    heading_deg: float | None = None  # Clockwise from north
    taken_at: str | None = None  # ISO 8601
    name: str = ""
    all_around: bool = False  # A panorama


class Step(NamedTuple):
    """A photo that one can step to from another."""

    id: int
    bearing_deg: float  # Clockwise from north; of a photo on the same spot, its heading
    distance: float  # In the unit of the positions; 0 on the same spot


@dataclass(frozen=True, slots=True)
class Walk:
    """Orders of all photos of a map, and the steps between them, by id."""

    by_time: tuple[int, ...]  # Empty if no photo has a time
    by_place: tuple[int, ...]
    steps: Mapping[int, tuple[Step, ...]]


def plan_walk(stops: Sequence[Stop]) -> Walk:
    """Order photos by time and by place, and find the steps from each.

    By time: those with a time, then a tour of the others. By place: a tour of each floor, the lowest first.
    """
    timed = sorted((s for s in stops if s.taken_at), key=lambda s: (s.taken_at, s.name, s.id))
    untimed = [s for s in stops if not s.taken_at]
    by_time = [*timed, *_tour_of_floors(untimed, after=timed[-1])] if timed else []
    return Walk(
        tuple(s.id for s in by_time),
        tuple(s.id for s in _tour_of_floors(stops)),
        {id: steps for floor in _floors(stops) for id, steps in _steps(floor)},
    )


def _floors(stops: Iterable[Stop]) -> list[list[Stop]]:
    """Group photos by floor, the lowest first, in the order of their names."""
    ordered = sorted(stops, key=lambda s: (s.level, s.floor, s.name, s.id))
    return [list(group) for _, group in groupby(ordered, key=lambda s: (s.level, s.floor))]


def _tour_of_floors(stops: Iterable[Stop], *, after: Stop | None = None) -> list[Stop]:
    tour: list[Stop] = []
    for floor in _floors(stops):
        ground, spots = _spots(floor)
        last = tour[-1] if tour else after
        # A tour begins at an end of the place, or near where one comes from.
        if last is None:
            start = _end(ground, np.mean([(s.east, s.north) for s in floor], 0))
        else:
            start = int(_distances(ground, np.array((last.east, last.north))).argmin())
        tour += [stop for n in _tour(ground, start) for stop in spots[n]]
    return tour


def _end(ground: NDArray[np.float64], centre: NDArray[np.float64]) -> int:
    """Return that of the two ends of a place whose photo is first by name: positions have that order."""
    one = int(_distances(ground, centre).argmax())
    return min(one, int(_distances(ground, ground[one]).argmax()))


def _distances(ground: NDArray[np.float64], spot: NDArray[np.float64]) -> NDArray[np.float64]:
    away: NDArray[np.float64] = np.hypot(*(ground - spot).T)
    return away


def _spots(stops: Sequence[Stop]) -> tuple[NDArray[np.float64], list[list[Stop]]]:
    """Group photos by position, so that many on one spot cost no more than as many spots."""
    ground = np.array([(s.east, s.north) for s in stops], np.float64)
    of_search = _of_search(ground)
    spots: dict[bytes, list[int]] = {}
    for n, position in enumerate(of_search):
        spots.setdefault(position.tobytes(), []).append(n)
    return ground[[members[0] for members in spots.values()]], [
        [stops[n] for n in members] for members in spots.values()
    ]


def _tour(ground: NDArray[np.float64], start: int) -> list[int]:
    """Go to the nearest spot that was not visited yet, again and again."""
    near, _ = _nearest(ground)
    left = np.ones(len(ground), bool)
    tour = [start]
    left[start] = False
    for _ in range(len(ground) - 1):
        at = tour[-1]
        free = near[at][left[near[at]]]
        if free.size:
            following = int(free[0])
        else:
            rest = np.flatnonzero(left)
            following = int(rest[np.hypot(*(ground[rest] - ground[at]).T).argmin()])
        left[following] = False
        tour.append(following)
    return tour


def _steps(stops: Sequence[Stop]) -> Iterable[tuple[int, tuple[Step, ...]]]:
    """Find the steps of the photos of one floor."""
    ground, members = _spots(stops)
    spots = [_Spot(found) for found in members]
    near, away = _nearest(ground)
    usual = _usual_distance(away)
    offsets = ground[near] - ground[:, None]
    angles = np.degrees(np.arctan2(offsets[..., 0], offsets[..., 1])) % 360.0
    bearings = angles.tolist()
    for n, spot in enumerate(spots):
        beyond = away[n][away[n] > _SAME_SPOT * usual]
        most = _FAR * max(usual, beyond.min(initial=np.inf) if beyond.size else 0.0)
        around = [
            (spots[other], bearing, distance)
            for other, bearing, distance in zip(near[n].tolist(), bearings[n], away[n].tolist(), strict=True)
            if other != n and distance <= most
        ]
        for stop in members[n]:
            options = []
            for other in spot.turns:
                if other is not stop:
                    options += _option(stop, other, bearing=0.0, distance=0.0, usual=usual)
            for there, bearing, distance in around:
                found = there.most_alike(stop)
                options += _option(stop, found, bearing=bearing, distance=distance, usual=usual)
            yield stop.id, _spread(options)


class _Spot:
    """The photos of one spot, arranged so that few of them are looked at for each step."""

    def __init__(self, stops: Sequence[Stop]) -> None:
        by_id = sorted(stops, key=lambda s: s.id)
        self._first = next((s for s in by_id if s.all_around), by_id[0])
        self._one = len(by_id) == 1 or self._first.all_around
        self._unknown = [s for s in by_id if s.heading_deg is None][:1]
        directed = [(s.heading_deg % 360.0, s) for s in by_id if s.heading_deg is not None]
        directed.sort(key=lambda one: one[0])
        self._headings = [heading for heading, _ in directed]
        self._directed = [s for _, s in directed]
        self.turns = by_id
        if len(by_id) > 360.0 / APART_DEG:  # one for each direction, as no more of them are steps
            self.turns = [*{heading // APART_DEG: s for heading, s in reversed(directed)}.values()]

    def most_alike(self, stop: Stop) -> Stop:
        """Return the photo that looks most like the same way as another; a panorama looks every way."""
        if self._one or stop.heading_deg is None or not self._directed:
            return self._first
        at = bisect_left(self._headings, stop.heading_deg % 360.0)
        options = [self._directed[at - 1], self._directed[at % len(self._directed)], *self._unknown]
        return min(options, key=lambda other: (_cost_of_turn(_turn(stop, other)), other.id))


def _option(
    stop: Stop, other: Stop, *, bearing: float, distance: float, usual: float
) -> list[tuple[float, Step]]:
    """Return the step to another photo and its cost, lower if that looks the same way; or nothing."""
    turn = _turn(stop, other)
    if distance > _SAME_SPOT * usual:
        return [(distance * _cost_of_turn(turn), Step(other.id, bearing, distance))]
    if turn is None or turn < _LEAST_TURN_DEG or other.heading_deg is None or other.all_around:
        return []
    return [(_SAME_SPOT * usual * _cost_of_turn(turn), Step(other.id, other.heading_deg, 0.0))]


def _cost_of_turn(turn: float | None) -> float:
    return 1.0 + (45.0 if turn is None else turn) / 90.0


def _turn(stop: Stop, other: Stop) -> float | None:
    """Return the angle between two viewing directions, degrees; None if one is unknown."""
    if other.all_around:
        return 0.0
    if stop.heading_deg is None or other.heading_deg is None:
        return None
    return _between(stop.heading_deg, other.heading_deg)


def _spread(options: list[tuple[float, Step]]) -> tuple[Step, ...]:
    """Choose the steps of lowest cost in directions that are apart."""
    chosen: list[Step] = []
    for _, step in sorted(options, key=lambda one: (one[0], one[1].id)):
        if all(_between(step.bearing_deg, other.bearing_deg) >= APART_DEG for other in chosen):
            chosen.append(step)
        if len(chosen) == STEPS:
            break
    return tuple(chosen)


def _between(a_deg: float, b_deg: float) -> float:
    return abs((a_deg - b_deg + 180.0) % 360.0 - 180.0)


def _usual_distance(away: NDArray[np.float64]) -> float:
    """Return the median distance from a spot to the nearest other one; 0 if there is only one."""
    apart = np.where(away > 1e-6 * away.max(initial=0.0), away, np.inf).min(axis=1, initial=np.inf)
    return float(np.median(apart[np.isfinite(apart)])) if np.isfinite(apart).any() else 0.0


def _of_search(ground: NDArray[np.float64]) -> NDArray[np.float32]:
    """Return positions as the search compares them."""
    found: NDArray[np.float32] = (ground - ground.mean(0)).astype(np.float32) + np.float32(0.0)  # no -0
    return found


def _nearest(ground: NDArray[np.float64]) -> tuple[NDArray[np.int32], NDArray[np.float64]]:
    """Find the nearest spots of each, itself included, and their distances."""
    centred = _of_search(ground)
    count = min(NEIGHBOURS + 1, len(ground))
    near, _ = cv2.flann.Index(centred, _KD_TREE).knnSearch(centred, count, params={"checks": -1})
    away = np.hypot(*np.moveaxis(ground[near] - ground[:, None], -1, 0))
    return near, away
