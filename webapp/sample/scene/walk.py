"""Where the photographer stands and looks: along all paths, turning from side to side."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from webapp.sample.scene.camera import EYE_HEIGHT_M, Camera
from webapp.sample.scene.plan import Plan

_SWING_DEG, _SWING_STOPS = 28.0, 6.0
_PITCH_DEG = 2.0
_MONUMENT_M = 3.5


@dataclass(frozen=True, slots=True)
class View:
    """A place and a direction.

    Attributes
    ----------
    east, north : float
        Metres.
    heading_deg : float
        Degrees clockwise from north, 0 to 360.
    pitch_deg : float
        Degrees above the horizon: nobody holds a camera quite level.
    """

    east: float
    north: float
    heading_deg: float
    pitch_deg: float

    def camera(self, *, fov_deg: float, width: int, height: int) -> Camera:
        """Hold a camera there at eye height."""
        position = (self.east, self.north, EYE_HEIGHT_M)
        return Camera(position, self.heading_deg, fov_deg, width, height, self.pitch_deg)


def map_views(rng: np.random.Generator, plan: Plan, *, count: int) -> list[View]:
    """Walk all paths and take `count` photos, evenly spread."""
    return [_view(rng, plan, float(stop), stops=count, stray=0.5) for stop in range(count)]


def query_views(rng: np.random.Generator, plan: Plan, *, count: int, stops: int) -> list[View]:
    """Walk the same way another day: `count` photos between the `stops` of the map, on other lines."""
    between = [int((number + 0.5) * stops / count) + 0.5 for number in range(count)]
    return [_view(rng, plan, stop, stops=stops, stray=1.0) for stop in between]


def _view(rng: np.random.Generator, plan: Plan, stop: float, *, stops: int, stray: float) -> View:
    """Look ahead, turned to one side and the other; `stray` says how far from the middle and the rule."""
    paths = plan.paths
    at = min(max(int((stop + 0.5) / stops * len(paths)), 1), len(paths) - 2)
    line, at = (plan.loop, at) if at < len(plan.loop) else (plan.link, at - len(plan.loop))
    at = min(max(at, 1), len(line) - 2)
    ahead = line[at + 1] - line[at - 1]
    ahead = ahead / np.linalg.norm(ahead)
    aside = float(rng.uniform(-1.4, 1.4)) * stray
    spot = _clear(plan, line[at] + aside * np.array([ahead[1], -ahead[0]]))
    swing = _SWING_DEG * np.sin(2 * np.pi * stop / _SWING_STOPS) + rng.uniform(-12, 12) * stray
    heading = np.degrees(np.arctan2(ahead[0], ahead[1])) + swing
    return View(float(spot[0]), float(spot[1]), float(heading % 360), float(rng.normal(0, _PITCH_DEG)))


def _clear(plan: Plan, spot: NDArray[np.float64]) -> NDArray[np.float64]:
    """Step back from the monument in the middle of the square."""
    away = spot - plan.square
    distance = float(np.linalg.norm(away))
    if distance >= _MONUMENT_M:
        return spot
    outwards = away / distance if distance > 0 else np.array([1.0, 0.0])
    return np.asarray(plan.square + outwards * _MONUMENT_M, np.float64)
