"""Previews of missions for lists: the line of the best track, and the objects."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from sqlalchemy import and_, func, select
from sqlalchemy.orm import Session

from webapp.core.geo.local import LocalFrame, centre_of
from webapp.missions.store import tracks
from webapp.missions.store.missions import Entry
from webapp.missions.store.schema import MissionObject
from webapp.store.schema import MapRecord
from webapp.tasks.maps.library_map import georeference

_MOST_POINTS = 80
_MOST_OBJECTS = 100
_MOST_COUNTED = 2000
"""For missions with more objects only the first are drawn, as an even choice would have to read all."""

_AT_ONCE = 500
"""Number of missions whose objects are read in one query."""

_NONE = np.empty((0, 2))
_MARGIN = 0.15
"""Margin of previews without an image, relative to the larger side of their content."""

_LEAST_M = 5.0
"""Minimum size of that larger side, for robots that stand still."""


@dataclass(frozen=True, slots=True, eq=False)
class MissionPreview:
    map: MapRecord | None  # Map whose image is the background; None if no part of the mission lies on it
    size: tuple[float, float]  # Width and height: map pixels, or metres without a map
    # `line`, `dots`: (n, 2) float64. The track and the objects: x to the right, y down.
    line: NDArray[np.float64]
    dots: NDArray[np.float64]


def preview_missions(session: Session, entries: Sequence[Entry]) -> list[MissionPreview | None]:
    """Return previews of the missions of a list; None for missions without positions."""
    drawn: list[MissionPreview | None] = []
    for begin in range(0, len(entries), _AT_ONCE):
        some = entries[begin : begin + _AT_ONCE]
        counted = [entry.mission.id for entry in some if 0 < entry.objects <= _MOST_COUNTED]
        dots = _objects(session, counted)
        dots |= {e.mission.id: _first(session, e.mission.id) for e in some if e.objects > _MOST_COUNTED}
        drawn += [_draw(session, entry, dots.get(entry.mission.id, _NONE)) for entry in some]
    return drawn


def _draw(session: Session, entry: Entry, dots: NDArray[np.float64]) -> MissionPreview | None:
    line = _line(session, entry)
    if not len(line) and not len(dots):
        return None
    record = None if entry.mission.map_id is None else session.get(MapRecord, entry.mission.map_id)
    return (None if record is None else _on_image(record, line, dots)) or _in_metres(line, dots)


def _line(session: Session, entry: Entry) -> NDArray[np.float64]:
    best = tracks.best(entry.tracks)
    if best is None or not best.poses:
        return _NONE
    numbers = np.linspace(0, best.poses - 1, min(best.poses, _MOST_POINTS)).astype(int)
    return tracks.at(session, best, np.unique(numbers).tolist()).latlon


def _objects(session: Session, mission_ids: Sequence[int]) -> dict[int, NDArray[np.float64]]:
    """Read the positions of the objects of missions, at most `_MOST_OBJECTS` each, evenly spaced by id."""
    mission, id = MissionObject.mission_id, MissionObject.object_id
    keys = select(
        mission,
        id,
        func.row_number().over(partition_by=mission, order_by=id).label("number"),
        func.count().over(partition_by=mission).label("count"),
    )
    key = keys.where(mission.in_(mission_ids)).subquery()
    found = select(mission, MissionObject.lat, MissionObject.lon).join(
        key, and_(key.c.mission_id == mission, key.c.object_id == id)
    )
    # As in Bresenham's algorithm: true for `_MOST_OBJECTS` evenly spaced numbers, or for all if fewer.
    is_taken = key.c.number * _MOST_OBJECTS % key.c.count < _MOST_OBJECTS
    at: defaultdict[int, list[tuple[float, float]]] = defaultdict(list)
    for mission_id, lat, lon in session.execute(found.where(is_taken).order_by(mission, id)):
        at[mission_id].append((lat, lon))
    return {mission_id: np.array(rows, np.float64) for mission_id, rows in at.items()}


def _first(session: Session, mission_id: int) -> NDArray[np.float64]:
    """Read the positions of the first `_MOST_OBJECTS` objects of a mission."""
    found = select(MissionObject.lat, MissionObject.lon).where(MissionObject.mission_id == mission_id)
    rows = session.execute(found.order_by(MissionObject.object_id).limit(_MOST_OBJECTS))
    return np.array([tuple(row) for row in rows], np.float64).reshape(-1, 2)


def _on_image(
    record: MapRecord, line: NDArray[np.float64], dots: NDArray[np.float64]
) -> MissionPreview | None:
    where = georeference(record)
    if where is None or not record.satellite_width or not record.satellite_height:
        return None
    size = (float(record.satellite_width), float(record.satellite_height))
    line, dots = (where.pixel_from_latlon(part) if len(part) else part for part in (line, dots))
    line, dots = (part[np.isfinite(part).all(1)] for part in (line, dots))
    every = np.concatenate([line, dots])
    if not ((every >= 0) & (every <= size)).all(1).any():
        return None
    return MissionPreview(record, size, line, dots)


def _in_metres(line: NDArray[np.float64], dots: NDArray[np.float64]) -> MissionPreview:
    every = np.concatenate([line, dots])
    at = LocalFrame(centre_of(every)).enu_from_latlon(every) * (1.0, -1.0)
    low, high = at.min(0), at.max(0)
    larger = max(float((high - low).max()), _LEAST_M)
    width, height = (high - low + 2 * _MARGIN * larger).tolist()
    at = at - low + _MARGIN * larger
    return MissionPreview(None, (width, height), at[: len(line)], at[len(line) :])
