"""Transforms between the frames of a bag (REP 105), by which objects get into a frame that has poses.

Of each transform the last one counts, as for the poses of the robot itself.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from webapp.missions.files.track_chunks import RobotObjects

_MOST_FRAMES = 2000
_MOST_STEPS = 50

Transform = NDArray[np.float64]
"""(4, 4) float64: positions in a frame -> in its parent, metres."""


class FrameTree:
    """Frames, and where each is in its parent."""

    def __init__(self) -> None:
        self._parents: dict[str, tuple[str, Transform]] = {}

    def add(self, message: Any) -> None:
        """Take the transforms of a message; those that are no rotation and translation are left out."""
        for one in message.transforms:
            child, parent = one.child_frame_id.strip("/"), one.header.frame_id.strip("/")
            found = _matrix(one.transform.translation, one.transform.rotation)
            if found is not None and (child in self._parents or len(self._parents) < _MOST_FRAMES):
                self._parents[child] = (parent, found)

    def nearest(self, frame: str, *, known: Collection[str]) -> tuple[str, Transform] | None:
        """Find a frame of which poses are known: the nearest one above, or else beside.

        Returns:
            Its name, and the transform of positions in `frame` to it; None if there is none.
        """
        above = self._above(frame)
        for name, chain in above.items():
            if name in known:
                return name, chain
        beside = [
            (steps, one, name, chain)
            for one in sorted(known)
            for steps, (name, chain) in enumerate(self._above(one).items())
            if name in above
        ]
        if not beside:
            return None
        _, one, name, chain = min(beside, key=lambda found: found[:2])
        return one, np.linalg.inv(chain) @ above[name]

    def _above(self, frame: str) -> dict[str, Transform]:
        """Return the transforms of positions in a frame to itself and those above, in their order."""
        found, chain = {frame: np.eye(4)}, np.eye(4)
        while frame in self._parents and len(found) < _MOST_STEPS:
            frame, step = self._parents[frame]
            if frame in found:  # They refer to each other in a circle
                break
            chain = step @ chain
            found[frame] = chain
        return found


def in_known_frame(piece: RobotObjects, tree: FrameTree, *, known: Collection[str]) -> RobotObjects:
    """Transform objects to the nearest frame with poses; without one they stay as they are.

    Args:
        known: Names of the frames with poses; no name has slashes around it.
    """
    found = tree.nearest(piece.frame, known=known)
    if found is None or found[0] == piece.frame:
        return piece
    frame, transform = found
    places = np.array([one.xyz_m for one in piece.sightings]) @ transform[:3, :3].T + transform[:3, 3]
    moved = zip(piece.sightings, places.tolist(), strict=True)
    return RobotObjects(frame, tuple(replace(one, xyz_m=tuple(xyz)) for one, xyz in moved))


def _matrix(at: Any, turn: Any) -> Transform | None:
    x, y, z, w = (float(part) for part in (turn.x, turn.y, turn.z, turn.w))
    place = np.array([at.x, at.y, at.z], dtype=np.float64)
    norm = float(np.sqrt(x * x + y * y + z * z + w * w))
    if not (np.isfinite(place).all() and 0.5 < norm < 2.0):
        return None
    x, y, z, w = x / norm, y / norm, z / norm, w / norm
    found = np.eye(4)
    found[:3, :3] = [
        [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
    ]
    found[:3, 3] = place
    return found
