"""Converts a file with tracks to the records that a robot would have sent while it recorded them."""

from __future__ import annotations

import heapq
import math
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from webapp.missions.core.trajectory.records import Sighting
from webapp.missions.core.trajectory.robotframe import Start
from webapp.missions.core.trajectory.thinning import MinMove, Thinner
from webapp.missions.files.track_chunks import Skipped
from webapp.missions.tasks import read_track
from webapp.missions.tasks.place_track import ReadOptions
from webapp.missions.tasks.read_track import ReadTrack
from webapp.progress import Progress


class Event(NamedTuple):
    """A record, and the time at which a robot would have sent it."""

    time_s: float  # Seconds since 1970, UTC
    record: dict[str, Any]  # In the format of batches


@dataclass(frozen=True, slots=True)
class Replay:
    """The content of a file as events."""

    events: list[Event]  # Merged by time; each track keeps its own order
    left_out: tuple[Skipped, ...]  # Items of the file that could not be used, with reasons
    skipped: int  # Number of poses that `min_move` left out
    # Tracks whose last poses were left out, as in the record of the end: `source`, `track`, `skipped`,
    # `travelled_m`.
    rest: list[dict[str, Any]]


def replay_track(
    path: Path,
    *,
    min_move: MinMove,
    topics: tuple[str, ...] = (),
    start: Start | None = None,
    progress: Progress | None = None,
) -> Replay:
    """Read a file; the same file with the same options gives the same events.

    Args:
        path: In any format that `read_track` reads.
        min_move: Poses that moved by no more than this are left out, after the distance has been measured.
        topics: Only these topics of a bag; empty for all.
        start: Start pose of the robot; without it, poses in its own frame are left out.

    Raises:
        TrackError: The file is damaged, of an unknown format, or has no usable content.
    """
    options = ReadOptions(start=start, min_move=MinMove(0.0), topics=topics)
    found = read_track.read_track(path, options=options, progress=progress)
    kept = {id(track): Thinner(min_move).keep(track.poses.latlon) for track in found.tracks}
    parts = [_poses(track, kept[id(track)], file=path.name) for track in found.tracks]
    events = list(heapq.merge(*parts, _objects(found.sightings), key=lambda event: event.time_s))
    skipped = sum(int(np.count_nonzero(~mask)) for mask in kept.values())
    return Replay(events, found.skipped, skipped, [*_rests(found.tracks, kept, file=path.name)])


def _poses(track: ReadTrack, kept: np.ndarray, *, file: str) -> Iterator[Event]:
    """Yield a record of each pose for which `kept` (n,) bool is true, with the number left out before it."""
    usual = {"type": "pose", "source": track.source, "track": read_track.title(file, track.name)}
    poses, before = track.poses, -1
    for place in np.flatnonzero(kept).tolist():
        lat, lon = poses.latlon[place].tolist()
        time_s = float(poses.times_s[place])
        record = usual | {"time": time_s, "lat": lat, "lon": lon}
        for name in ("height_m", "heading_deg", "travelled_m"):
            value = float(getattr(poses, name)[place])
            if math.isfinite(value):
                record[name] = value
        covariance = poses.covariance_m2[place].tolist()
        if all(map(math.isfinite, covariance)):
            record["covariance"] = covariance
        if place - before > 1:
            record["skipped"] = place - before - 1
        before = place
        yield Event(time_s, record)


def _rests(
    found: Sequence[ReadTrack], kept: Mapping[int, np.ndarray], *, file: str
) -> Iterator[dict[str, Any]]:
    for track in found:
        skipped = len(track.poses) - 1 - int(np.flatnonzero(kept[id(track)])[-1])
        if skipped:
            which = {"source": track.source, "track": read_track.title(file, track.name)}
            yield {**which, "skipped": skipped, "travelled_m": track.distance_m}


def _objects(sightings: tuple[Sighting, ...]) -> Iterator[Event]:
    for seen in sightings:
        record: dict[str, Any] = {
            "type": "object",
            "class": seen.kind,
            "time": seen.time_s,
            "lat": seen.latlon.lat,
            "lon": seen.latlon.lon,
        }
        more = {
            "id": seen.object_id,
            "height_m": seen.height_m,
            "covariance": seen.covariance_m2 and [*seen.covariance_m2],
            "confidence": seen.confidence,
            "size_m": seen.size_m and [*seen.size_m],
            "photo": seen.photo,
        }
        yield Event(seen.time_s, record | {name: value for name, value in more.items() if value is not None})
