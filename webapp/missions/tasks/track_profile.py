"""The profile of a track: way, speed and height over time, in as few points as a diagram shows."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray
from sqlalchemy.orm import Session

from webapp.core.trajectory.profile import profile
from webapp.missions.store import track_pieces, tracks
from webapp.missions.store.schema import Track

_DIRECT = 40_000
"""Poses that are read as they are; of a longer track, what was prepared."""


def track_profile(session: Session, track: Track, *, points: int) -> NDArray[np.float64]:
    """Read the profile of a track.

    Parameters
    ----------
    points : int
        At most so many.

    Returns
    -------
    (n, 4) float64
        time_s, travelled_m, speed_mps, height_m; NaN where something is not known.
    """
    table = np.empty((0, 4)) if track.poses <= _DIRECT else track_pieces.profiles(session, track)
    first = track.built_to if len(table) else 0
    if track.poses - first <= _DIRECT:
        tail = tracks.read(session, track, first=first)
    else:
        numbers = np.unique(np.linspace(first, track.poses - 1, points).astype(np.int64))
        tail = tracks.at(session, track, numbers.tolist())
    return profile(
        np.concatenate([table[:, 0], tail.times_s]),
        np.concatenate([table[:, 1], tail.travelled_m]),
        height_m=np.concatenate([table[:, 3], tail.height_m]),
        points=points,
    )
