"""Detects repeated messages by the records that are already in the spool."""

from __future__ import annotations

from collections import Counter
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from typing import Any

Identity = tuple[Any, ...]

_MOST = 20_000
"""Maximum number of messages remembered, the newest."""


class SentMessages:
    """The newest messages that were stored as records.

    Messages are identified by content, not by order of time: one that is late, or that was published while
    the bridge was down, is new.

    Args:
        records: Records of the spool, newest first.
    """

    def __init__(self, records: Iterable[Mapping[str, Any]]) -> None:
        numbering = Numbering()
        found = [_identity(record, numbering) for record in records if record["type"] != "end"][:_MOST]
        self._known = dict.fromkeys(reversed(found))

    def __contains__(self, identity: Identity) -> bool:
        return identity in self._known

    def add(self, identity: Identity) -> None:
        """Remember a message that was just stored as a record."""
        self._known[identity] = None
        if len(self._known) > _MOST:
            del self._known[next(iter(self._known))]


def pose_identity(source: str, track: str, time_s: float, *, lat: float, lon: float) -> Identity:
    """Identify a pose, including its position: drivers that truncate stamps send several with one stamp."""
    return (source, track, time_s, lat, lon)


def object_identity(id: str, time_s: float) -> Identity:
    """Identify a sighting, without its position, which depends on the robot's pose known at the time."""
    return ("object", id, time_s)


@dataclass(slots=True)
class Numbering:
    """Numbers equal detections without an id, within one message or among all records."""

    _seen: Counter[Identity] = field(default_factory=Counter)

    def identity(
        self, kind: str, time_s: float, *, confidence: float | None, size_m: Any, in_image: bool
    ) -> Identity:
        """Identify the next detection without an id.

        The position is left out, since it depends on the robot's pose that the bridge knew at the time.
        """
        alike = ("detection", kind, time_s, confidence, size_m and tuple(size_m), in_image)
        self._seen[alike] += 1
        return (*alike, self._seen[alike])


def _identity(record: Mapping[str, Any], numbering: Numbering) -> Identity:
    if record["type"] == "object":
        if (id := record.get("id")) is None:
            return numbering.identity(
                record["class"],
                record["time"],
                confidence=record.get("confidence"),
                size_m=record.get("size_m"),
                in_image="height_m" not in record,
            )
        return object_identity(id, record["time"])
    source, track = record.get("source", "gps"), record.get("track", "")
    return pose_identity(source, track, record["time"], lat=record["lat"], lon=record["lon"])
