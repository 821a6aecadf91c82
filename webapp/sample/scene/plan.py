"""The layout of the park, drawn at random without overlaps."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

WIDTH_M, DEPTH_M = 120.0, 90.0
"""Size of the park, east and north; the satellite image shows exactly this."""

PATH_WIDTH_M = 3.2
_CENTRE = np.array([WIDTH_M / 2, DEPTH_M / 2])


@dataclass(frozen=True, slots=True)
class Footprint:
    """A building seen from above."""

    centre: NDArray[np.float64]  # (2,) float64
    facing: NDArray[np.float64]  # (2,) float64. Unit vector out of the front door.
    # `width`, `depth`: Of the front, and at right angles to it, metres.
    width: float
    depth: float
    floors: int

    @property
    def side(self) -> NDArray[np.float64]:
        """Unit vector along the front, to the right as seen from outside."""
        return np.array([-self.facing[1], self.facing[0]])

    def corners(self, *, margin: float = 0.0) -> NDArray[np.float64]:
        """Return the (4, 2) corners counter-clockwise, the left one of the front first."""
        across, out = self.side * (self.width / 2 + margin), self.facing * (self.depth / 2 + margin)
        return np.stack(
            [
                self.centre - across + out,
                self.centre + across + out,
                self.centre + across - out,
                self.centre - across - out,
            ]
        )

    def distance(self, points: NDArray[np.float64]) -> NDArray[np.float64]:
        """Return the distances of (n, 2) points from the walls, metres; 0 inside."""
        local = points - self.centre
        beyond = np.stack(
            [np.abs(local @ self.side) - self.width / 2, np.abs(local @ self.facing) - self.depth / 2],
            axis=-1,
        )
        return np.asarray(np.linalg.norm(np.maximum(beyond, 0), axis=-1), np.float64)


@dataclass(frozen=True, slots=True)
class Tree:
    """A tree, a bush or flowers: position, height, radius, and kind."""

    east: float
    north: float
    height: float
    radius: float
    kind: str


@dataclass(frozen=True, slots=True)
class ParkPlan:
    # `loop`, `link`: (n, 2) float64. Middle lines of the path around and of the path across, a point every
    # half metre.
    loop: NDArray[np.float64]
    link: NDArray[np.float64]
    square: NDArray[np.float64]  # (2,) float64. The middle of the paved square.
    square_radius: float
    pond: NDArray[np.float64]  # (n, 2) float64. Outline of the water.
    buildings: tuple[Footprint, ...]
    trees: tuple[Tree, ...]

    @property
    def paths(self) -> NDArray[np.float64]:
        """Points of both paths, (n, 2)."""
        return np.concatenate([self.loop, self.link])


def draw_plan(rng: np.random.Generator) -> ParkPlan:
    loop = _loop(rng)
    link, square = _link(rng, loop)
    paths = np.concatenate([loop, link])
    pond = _pond(rng, paths, square)
    buildings = _buildings(rng, paths, pond, square=square)
    plan = ParkPlan(loop, link, square, 6.0, pond, buildings, ())
    trees = (*_trees(rng, plan), *_flowers(rng, plan))
    return ParkPlan(loop, link, square, 6.0, pond, buildings, trees)


def evenly(points: NDArray[np.float64], step: float) -> NDArray[np.float64]:
    """Resample an (n, 2) polyline every `step` metres."""
    lengths = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(points, axis=0), axis=1))])
    at = np.arange(0.0, lengths[-1], step)
    return np.stack([np.interp(at, lengths, points[:, axis]) for axis in (0, 1)], axis=1)


def nearest(points: NDArray[np.float64], to: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return the distance of each of (n, 2) points from the nearest of (m, 2) others, metres."""
    gaps = np.linalg.norm(points[:, None, :] - to[None, :, :], axis=2)
    return np.asarray(gaps.min(axis=1), np.float64)


def _loop(rng: np.random.Generator) -> NDArray[np.float64]:
    angle = np.linspace(0, 2 * np.pi, 400)
    stretch = 1 + sum(
        rng.uniform(0.02, 0.07) * np.sin(wave * angle + rng.uniform(0, 2 * np.pi)) for wave in (2, 3, 4)
    )
    ring = np.stack([41 * np.cos(angle), 27 * np.sin(angle)], axis=1) * np.asarray(stretch)[:, None]
    return evenly(_CENTRE + ring, 0.5)


def _link(
    rng: np.random.Generator, loop: NDArray[np.float64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Draw a curved path across the park, and the centre of the square on it."""
    start = int(rng.integers(len(loop)))
    ends = loop[start], loop[(start + len(loop) // 2) % len(loop)]
    square = _CENTRE + rng.uniform(-1, 1, 2) * (9, 6)
    share = np.linspace(0, 1, 60)[:, None]
    control = 2 * square - (ends[0] + ends[1]) / 2  # the curve passes through the square half way
    curve = (1 - share) ** 2 * ends[0] + 2 * share * (1 - share) * control + share**2 * ends[1]
    return evenly(curve, 0.5), square


def _pond(
    rng: np.random.Generator, paths: NDArray[np.float64], square: NDArray[np.float64]
) -> NDArray[np.float64]:
    spots = _CENTRE + rng.uniform(-1, 1, (400, 2)) * (26, 15)
    room = np.minimum(nearest(spots, paths) - 11, np.linalg.norm(spots - square, axis=1) - 18)
    centre = spots[np.argmax(room > 0) if (room > 0).any() else room.argmax()]
    angle = np.linspace(0, 2 * np.pi, 80, endpoint=False)
    radius = 6.5 * (1 + 0.16 * np.sin(2 * angle + rng.uniform(0, 6)) + 0.08 * np.sin(3 * angle))
    return np.asarray(centre + np.stack([1.25 * np.cos(angle), np.sin(angle)], 1) * radius[:, None])


def _buildings(
    rng: np.random.Generator,
    paths: NDArray[np.float64],
    water: NDArray[np.float64],
    *,
    square: NDArray[np.float64],
) -> tuple[Footprint, ...]:
    """Place up to eight houses, each facing a path a few metres away."""
    placed: list[Footprint] = []
    for _ in range(500):
        if len(placed) == 8:
            break
        at = int(rng.integers(1, len(paths) - 1))
        ahead = paths[at + 1] - paths[at - 1]
        normal = np.array([-ahead[1], ahead[0]]) / max(float(np.linalg.norm(ahead)), 1e-6)
        if rng.random() < 0.85:  # most of them outside the loop
            normal *= np.sign((paths[at] - _CENTRE) @ normal) or 1.0
        width, depth = float(rng.uniform(10, 19)), float(rng.uniform(7, 10))
        centre = paths[at] + normal * (depth / 2 + rng.uniform(4.5, 8))
        house = Footprint(centre, -normal, width, depth, int(rng.choice([1, 2, 2, 3])))
        corners = house.corners(margin=1.5)
        inside = (corners > 1.0).all() and (corners < (WIDTH_M - 1.0, DEPTH_M - 1.0)).all()
        apart = all(other.distance(_outline(house)).min() > 5 for other in placed)
        clear = (
            house.distance(paths).min() > 3.2
            and house.distance(water).min() > 5
            and house.distance(square[None])[0] > 9.5
        )
        if inside and apart and clear:
            placed.append(house)
    return tuple(placed)


def _outline(house: Footprint) -> NDArray[np.float64]:
    corners = house.corners()
    share = np.linspace(0, 1, 8)[:, None]
    sides = [a + share * (b - a) for a, b in zip(corners, np.roll(corners, -1, axis=0), strict=True)]
    return np.concatenate([*sides, house.centre[None]])


def _trees(rng: np.random.Generator, plan: ParkPlan) -> tuple[Tree, ...]:
    placed: list[Tree] = []
    for _ in range(900):
        if len(placed) >= 95:
            break
        spot = rng.uniform((1.5, 1.5), (WIDTH_M - 1.5, DEPTH_M - 1.5))
        bush = len(placed) >= 62
        radius = float(rng.uniform(0.7, 1.2) if bush else rng.uniform(1.7, 3.0))
        kind = "bush" if bush else str(rng.choice(["broad", "broad", "broad", "birch", "conifer"]))
        point = spot[None]
        free = (
            nearest(point, plan.paths)[0] > (2.6 if bush else 3.4)
            and nearest(point, plan.pond)[0] > 1.5
            and np.linalg.norm(spot - plan.pond.mean(0)) > 7
            and np.linalg.norm(spot - plan.square) > plan.square_radius + 2.0
            and all(house.distance(point)[0] > (0.9 if bush else radius + 1.0) for house in plan.buildings)
            and all(np.hypot(t.east - spot[0], t.north - spot[1]) > radius + t.radius * 0.6 for t in placed)
        )
        if free:
            height = {"bush": 1.3, "birch": 9.0, "conifer": 10.0}.get(kind, 7.5) * float(
                rng.uniform(0.8, 1.25)
            )
            placed.append(Tree(float(spot[0]), float(spot[1]), height, radius, kind))
    return tuple(placed)


def _flowers(rng: np.random.Generator, plan: ParkPlan) -> tuple[Tree, ...]:
    """Place a ring of flowers around the square, open where a path comes in."""
    angle = np.arange(0, 2 * np.pi, 0.085)
    ring = plan.square + (plan.square_radius + 0.9) * np.stack([np.cos(angle), np.sin(angle)], 1)
    free = nearest(ring, plan.paths) > PATH_WIDTH_M / 2 + 0.7
    return tuple(
        Tree(float(east), float(north), float(rng.uniform(0.4, 0.65)), 0.45, "flowers")
        for east, north in ring[free] + rng.normal(0, 0.12, (int(free.sum()), 2))
    )
