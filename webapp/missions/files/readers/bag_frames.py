"""Transforms between the frames of a bag (REP 105), by which objects get into a frame that has poses.

Between the stamps of two transforms the position is interpolated linearly, and the orientation on the shorter
arc (slerp: Shoemake, "Animating Rotation with Quaternion Curves", 1985).
"""

from __future__ import annotations

import math
from array import array
from collections.abc import Collection, Iterator
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from webapp.missions.files.readers.bag_limits import is_possible
from webapp.missions.files.track_chunks import Findings, RobotObjects

_MOST_FRAMES = 2000
_MOST_STEPS = 50
_MOST_KEPT = 1_000_000
"""Transforms in memory, 64 MB; of the frame with the most, every other one is dropped then."""

_GAP_S = 10.0
"""Across a longer gap, and as long before the first transform, the nearest one counts."""

_OUTSIDE_S = 1.0
"""So far outside of the known times, a transform is doubtful."""

OUTSIDE = "objects seen when a transform was not known: the nearest in time was taken"
_ROW = 8

Transform = NDArray[np.float64]
"""(4, 4) float64: positions in a frame -> in its parent, metres."""


@dataclass(slots=True)
class _History:
    """Where a frame is in its parent, over time."""

    static: bool
    rows: array[float] = field(default_factory=lambda: array("d"))  # Time, position, quaternion
    stride: int = 1  # Every so many transforms one is kept
    seen: int = 0
    _table: NDArray[np.float64] | None = None

    def add(self, time_s: float, found: tuple[float, ...]) -> int:
        """Keep a transform; return by how many there are more."""
        if self.static:
            self.rows = array("d", (time_s, *found))
            return 0
        self.seen += 1
        if (self.seen - 1) % self.stride:
            return 0
        self.rows.extend((time_s, *found))
        return 1

    def halve(self) -> int:
        """Drop every other transform; return how many."""
        table = np.frombuffer(self.rows, np.float64).reshape(-1, _ROW)
        kept = table[::2].copy()
        dropped = len(table) - len(kept)
        self.rows, self.stride = array("d", kept.ravel().tolist()), 2 * self.stride
        return dropped

    def at(self, time_s: float) -> tuple[Transform, float] | None:
        """Return the transform at a time, and how far outside of the known times that is, seconds.

        None long before the first one.
        """
        if self._table is None:
            table = np.frombuffer(self.rows, np.float64).reshape(-1, _ROW)
            self._table = table[np.argsort(table[:, 0], kind="stable")]
        table = self._table
        if self.static:
            return _matrix(table[0, 1:4], table[0, 4:]), 0.0
        if time_s < table[0, 0] - _GAP_S:
            return None
        after = int(np.searchsorted(table[:, 0], time_s, side="right"))
        if after == 0 or after == len(table):
            end = table[min(after, len(table) - 1)]
            return _matrix(end[1:4], end[4:]), abs(time_s - float(end[0]))
        first, second = table[after - 1], table[after]
        share = (time_s - first[0]) / (second[0] - first[0])
        if second[0] - first[0] > _GAP_S:
            near = first if share <= 0.5 else second
            return _matrix(near[1:4], near[4:]), abs(time_s - float(near[0]))
        place = first[1:4] + share * (second[1:4] - first[1:4])
        return _matrix(place, slerp(first[4:], second[4:], share=float(share))), 0.0


class FrameTree:
    """Frames, and where each is in its parent at which time."""

    def __init__(self) -> None:
        self._parents: dict[str, dict[str, _History]] = {}
        self._kept = 0

    def add(self, message: Any, *, recorded_s: float, static: bool) -> None:
        """Take the transforms of a message; those that are no rotation and translation are left out."""
        for one in message.transforms:
            child, parent = one.child_frame_id.strip("/"), one.header.frame_id.strip("/")
            found = _values(one.transform.translation, one.transform.rotation)
            if found is None or (child not in self._parents and len(self._parents) >= _MOST_FRAMES):
                continue
            stamp_s = one.header.stamp.sec + one.header.stamp.nanosec * 1e-9
            time_s = stamp_s if stamp_s and is_possible(stamp_s, recorded_s) else recorded_s
            above = self._parents.setdefault(child, {})
            self._kept += above.setdefault(parent, _History(static)).add(time_s, found)
        if self._kept > _MOST_KEPT:
            every = (history for above in self._parents.values() for history in above.values())
            self._kept -= max(every, key=lambda history: len(history.rows)).halve()

    def nearest(
        self, frame: str, *, time_s: float, fixed: Collection[str], bodies: Collection[str]
    ) -> tuple[str, Transform, float] | None:
        """Find a frame of which poses are known: one above, rather a fixed one than a body, or else beside.

        Args:
            fixed: Names of the frames that poses are in.
            bodies: Names of the frames that poses are of.

        Returns:
            Its name, the transform of positions in `frame` to it, and how far outside of the known times one
                on the way was, seconds; None if there is none.
        """
        above = self._above(frame, time_s)
        for known in (fixed, bodies):
            for name, (chain, outside_s) in above.items():
                if name in known and (known is fixed or name not in fixed):
                    return name, chain, outside_s
        beside = [
            (steps, one, name, found)
            for one in sorted({*fixed, *bodies})
            for steps, (name, found) in enumerate(self._above(one, time_s).items())
            if name in above
        ]
        if not beside:
            return None
        _, one, name, (chain, outside_s) = min(beside, key=lambda found: found[:2])
        return one, np.linalg.inv(chain) @ above[name][0], max(outside_s, above[name][1])

    def _above(self, frame: str, time_s: float) -> dict[str, tuple[Transform, float]]:
        """Return the transforms of positions in a frame to itself and those above, in their order."""
        chain, outside_s = np.eye(4), 0.0
        found = {frame: (chain, outside_s)}
        while len(found) < _MOST_STEPS:
            step = self._step(frame, time_s)
            if step is None or step[0] in found:  # They refer to each other in a circle
                break
            frame, chain, outside_s = step[0], step[1] @ chain, max(outside_s, step[2])
            found[frame] = (chain, outside_s)
        return found

    def _step(self, frame: str, time_s: float) -> tuple[str, Transform, float] | None:
        """Return the parent of a frame at a time: of several, that with the nearest transform."""
        steps = [
            (parent, *found)
            for parent, history in self._parents.get(frame, {}).items()
            if (found := history.at(time_s)) is not None
        ]
        return min(steps, key=lambda step: step[2], default=None)


def in_known_frame(
    piece: RobotObjects,
    tree: FrameTree,
    *,
    fixed: Collection[str],
    bodies: Collection[str],
    findings: Findings,
) -> Iterator[RobotObjects]:
    """Transform objects to the nearest frame with poses; without one they stay as they are.

    Args:
        fixed, bodies: As for `FrameTree.nearest`; no name has slashes around it.
        findings: Counts objects seen when a transform was not known.
    """
    moved: dict[str, list[Any]] = {}
    for one in piece.sightings:
        found = tree.nearest(piece.frame, time_s=one.time_s, fixed=fixed, bodies=bodies)
        if found is None:
            moved.setdefault(piece.frame, []).append(one)
            continue
        frame, transform, outside_s = found
        if outside_s > _OUTSIDE_S:
            findings.doubt(OUTSIDE, where=piece.frame)
        xyz = transform[:3, :3] @ np.array(one.xyz_m) + transform[:3, 3]
        same = frame == piece.frame
        moved.setdefault(frame, []).append(one if same else replace(one, xyz_m=tuple(xyz.tolist())))
    for frame, sightings in moved.items():
        yield RobotObjects(frame, tuple(sightings))


def slerp(first: NDArray[np.float64], second: NDArray[np.float64], *, share: float) -> NDArray[np.float64]:
    """Interpolate unit quaternions on the shorter arc; `share` is 0 at the first and 1 at the second."""
    cosine = float(first @ second)
    if cosine < 0.0:  # the same rotation has two quaternions
        second, cosine = -second, -cosine
    if cosine > 1.0 - 1e-9:
        return np.asarray(first + share * (second - first), np.float64)
    angle = math.acos(min(cosine, 1.0))
    one, other = math.sin((1.0 - share) * angle), math.sin(share * angle)
    return np.asarray((one * first + other * second) / math.sin(angle), np.float64)


def _values(at: Any, turn: Any) -> tuple[float, ...] | None:
    """Return position and unit quaternion of a transform; None if they are none."""
    place = (float(at.x), float(at.y), float(at.z))
    turns = [float(part) for part in (turn.x, turn.y, turn.z, turn.w)]
    norm = math.hypot(*turns)
    if not (all(map(math.isfinite, place)) and 0.5 < norm < 2.0):
        return None
    return (*place, *(part / norm for part in turns))


def _matrix(place: NDArray[np.float64], turn: NDArray[np.float64]) -> Transform:
    x, y, z, w = (turn / np.linalg.norm(turn)).tolist()
    found = np.eye(4)
    found[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    found[:3, 3] = place
    return found
