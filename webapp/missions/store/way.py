"""How far and how long a mission went, by its tracks, which may have recorded the same way."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

from webapp.missions.core.spans import Spans
from webapp.missions.store import tracks
from webapp.missions.store.schema import Track


@dataclass(frozen=True, slots=True)
class Way:
    distance_m: float
    duration_s: float
    first_time_s: float | None
    last_time_s: float | None


def of_tracks(found: Sequence[Track]) -> Way:
    """Return the length, duration and times of a mission.

    Length and duration are those of all tracks from the source of its best one, times those of all tracks.
    Other sources have recorded the same way. Of tracks that overlap in time, such as those of two receivers,
    the longer one counts, and of the other the share of its time that lies outside.
    """
    best = tracks.best(found)
    same = [] if best is None else [track for track in found if track.source == best.source]
    distance_m, covered = 0.0, Spans()
    for track in sorted(same, key=lambda one: one.distance_m, reverse=True):
        share = covered.add(track.first_time_s or 0.0, track.last_time_s or 0.0) if track.timed else 1.0
        distance_m += share * track.distance_m
    timed = [track for track in found if track.timed]
    return Way(
        distance_m,
        covered.length,
        min((t.first_time_s for t in timed if t.first_time_s is not None), default=None),
        max((t.last_time_s for t in timed if t.last_time_s is not None), default=None),
    )
