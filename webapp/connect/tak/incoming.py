"""Events of TAK as records of a mission: positions become poses, markers become objects."""

from __future__ import annotations

import hashlib
import math
from collections import Counter
from collections.abc import Iterable, Iterator
from typing import Any

from webapp.connect.tak.events import UNKNOWN_M, CotEvent
from webapp.core.landmarks.radii import RADIUS_OVER_SIGMA
from webapp.errors import InputError
from webapp.missions.core.trajectory.batch import parse
from webapp.missions.core.trajectory.outgoing import MissionExport

_OBJECTS = {
    "b-a-": "emergency",
    "b-r-": "casualty",
    "b-m-p-": "marker",
}
"""Classes of objects by the beginning of the type."""

_AHEAD_S = 300.0
"""How far the clock of a device may be ahead; a later time would keep out what it sends from then on."""

_MOST_REASONS = 50


class Incoming:
    """Turns events into records, each position and each marker once.

    Args:
        own: Events whose `uid` begins with this come from the mission itself, and are left out.
        newest: As `newest_times` returns it.
    """

    def __init__(self, own: str, newest: dict[str, float]) -> None:
        self._own, self._newest = own, newest
        self.left_out: Counter[str] = Counter()  # By reason, or by type what a mission has no place for

    def records(self, events: Iterable[CotEvent], *, now_s: float) -> Iterator[dict[str, Any]]:
        """Yield the records of events, as `batch.parse` reads them."""
        for event in events:
            if event.uid.startswith(self._own) or event.type.startswith("t-"):
                continue
            name = _name(event)
            if event.time_s <= self._newest.get(name, -math.inf):
                continue
            record = _record(event, name)
            if event.time_s > now_s + _AHEAD_S:
                self.left_out["times in the future"] += 1
            elif record is None:
                self._leave_out(event.type)
            else:
                self._newest[name] = event.time_s
                yield record

    def _leave_out(self, type_: str) -> None:
        """Count a type, which any sender may have chosen."""
        reason = "".join(filter(str.isprintable, type_))[:40]
        known = reason in self.left_out or len(self.left_out) < _MOST_REASONS
        self.left_out[reason if known else "other types"] += 1


def newest_times(mission: MissionExport) -> dict[str, float]:
    """Return when each track and object of a mission was last seen, by name or id: seconds since 1970."""
    newest = {found.id: found.last_time_s for found in mission.objects()}
    for track in mission.tracks:
        for part in track.poses():
            newest[track.name] = float(part.times_s[-1])
    return newest


def _record(event: CotEvent, name: str) -> dict[str, Any] | None:
    """Return the record of an event; None for what is neither a position nor a marker, or has no fix."""
    if tuple(event.latlon) == (0.0, 0.0):  # ATAK without a fix
        return None
    place: dict[str, Any] = {"time": event.time_s, "lat": event.latlon.lat, "lon": event.latlon.lon}
    if event.height_m != UNKNOWN_M:
        place["height_m"] = event.height_m
    if 0.0 < event.radius_m < UNKNOWN_M:
        variance = (event.radius_m / RADIUS_OVER_SIGMA) ** 2
        place["covariance"] = [variance, variance, 0.0]
    kind = next((name for begin, name in _OBJECTS.items() if event.type.startswith(begin)), None)
    if event.type.startswith("a-"):
        record = {"type": "pose", "track": name, **place}
        record["source"] = "manual" if event.how.startswith("h") else "gps"
        if event.course_deg is not None:
            record["heading_deg"] = event.course_deg
    elif kind is not None:
        record = {"type": "object", "id": name, "class": kind, **place}
    else:
        return None
    try:
        parse([record])
    except InputError:
        return None
    return record


def _name(event: CotEvent) -> str:
    """Return the callsign with four characters that distinguish those who share one."""
    digest = hashlib.sha256(event.uid.encode("utf-8", "replace")).hexdigest()[:4]
    callsign = "".join(filter(str.isprintable, event.callsign)).strip() or "unnamed"
    return f"{callsign[:100]} ({digest})"
