"""What the spool has already, so that a message that comes again is known, whatever came in between."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from typing import Any

Identity = tuple[Any, ...]

_MOST = 20_000
"""So many messages are known, the newest."""


class SentMessages:
    """The newest messages that became records.

    A message is known by what it says, not by its place in time: one that is late, or that was published
    while the bridge was down, is new.

    Parameters
    ----------
    records : iterable of mapping
        Of the spool, the newest first.
    """

    def __init__(self, records: Iterable[Mapping[str, Any]]) -> None:
        found = [_identity(record) for record in records if record["type"] != "end"][:_MOST]
        self._known = dict.fromkeys(reversed(found))

    def __contains__(self, identity: Identity) -> bool:
        return identity in self._known

    def add(self, identity: Identity) -> None:
        """Know a message that has just become a record."""
        self._known[identity] = None
        if len(self._known) > _MOST:
            del self._known[next(iter(self._known))]


def pose_identity(source: str, track: str, time_s: float, *, lat: float, lon: float) -> Identity:
    """Identify a pose: drivers that cut the fraction off their stamps send several with one stamp."""
    return (source, track, time_s, lat, lon)


def object_identity(id: str, time_s: float) -> Identity:
    """Identify a sighting: where it was depends on what the bridge knew of the robot at that moment."""
    return ("object", id, time_s)


def _identity(record: Mapping[str, Any]) -> Identity:
    if record["type"] == "object":
        if (id := record.get("id")) is None:  # by another program: this bridge sends objects with ids only
            return ("object", None, record["time"], record["lat"], record["lon"])
        return object_identity(id, record["time"])
    source, track = record.get("source", "gps"), record.get("track", "")
    return pose_identity(source, track, record["time"], lat=record["lat"], lon=record["lon"])
