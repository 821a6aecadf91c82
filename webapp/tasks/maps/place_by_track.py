"""Places photos in the tray by a GPX track and their capture times."""

from __future__ import annotations

import math
import re
import zoneinfo
from collections.abc import Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta, timezone, tzinfo

from sqlalchemy.orm import Session

from webapp.core.geo.types import LatLon
from webapp.core.trajectory import ClockOffset, FixTrack, Match, NoMatch, estimate_offset, match
from webapp.errors import UsageError
from webapp.store.library import Library
from webapp.store.maps import maps
from webapp.store.schema import MapRecord, Photo
from webapp.tasks.maps.placing import (
    PhotoSpot,
    PlacingResult,
    RequestedPose,
    find_spots,
    needed_image,
    place_spots,
)

_OFFSET = re.compile(r"([+-])(\d{2}):?(\d{2})")
_EPOCH = datetime(1970, 1, 1)
_MAX_S = 10 * 366 * 86400.0


@dataclass(frozen=True, slots=True)
class Clock:
    """Conversion of photo times to track times."""

    offset_s: float = 0.0  # Added to each photo time
    zone: tzinfo = UTC  # Time zone of photo times without one
    max_gap_s: float = 60.0  # Longest gap between two fixes of the track that is interpolated

    def __post_init__(self) -> None:
        """Reject invalid time spans. Raises UsageError."""
        if not (math.isfinite(self.offset_s) and abs(self.offset_s) <= _MAX_S):
            raise UsageError("the clock offset is not a number of seconds", where="offset_s")
        if not (math.isfinite(self.max_gap_s) and 0.0 < self.max_gap_s <= _MAX_S):
            raise UsageError("the largest gap must be above 0 seconds", where="max_gap_s")

    def seconds(self, taken_at: str) -> float:
        """Convert a photo time (ISO 8601) to seconds since 1970, UTC, without the offset."""
        moment = datetime.fromisoformat(taken_at)
        ahead = moment.utcoffset() if moment.tzinfo else self.zone.utcoffset(moment)
        # in two steps, as a conversion to UTC would overflow for 1 January of year 1 in Prague
        return (moment.replace(tzinfo=None) - _EPOCH - (ahead or timedelta())).total_seconds()


@dataclass(frozen=True, slots=True)
class UnmatchedPhoto:
    id: int
    name: str
    reason: str


@dataclass(frozen=True, slots=True)
class MatchedPhoto:
    spot: PhotoSpot
    latlon: LatLon
    gap_s: float


@dataclass(frozen=True, slots=True)
class Preview:
    found: tuple[MatchedPhoto, ...]  # Including those outside the image, whose spot has a problem
    unmatched: tuple[UnmatchedPhoto, ...]
    suggested: ClockOffset | NoMatch  # The clock offset with which photos with GPS fit the track best


def parse_zone(text: str) -> tzinfo:
    """Read a time zone: `Europe/Prague`, `UTC`, or an offset such as `+02:00`. Raises UsageError."""
    found = _OFFSET.fullmatch(text.strip())
    if found and int(found[2]) < 24 and int(found[3]) < 60:
        span = timedelta(hours=int(found[2]), minutes=int(found[3]))
        return timezone(span if found[1] == "+" else -span)
    try:
        return UTC if text.strip() in ("", "UTC", "Z") else zoneinfo.ZoneInfo(text.strip())
    except (zoneinfo.ZoneInfoNotFoundError, ValueError, OSError) as error:
        hint = "name it like Europe/Prague, or give the offset like +02:00"
        raise UsageError(f"{text[:60]!r} is not a time zone", where="time_zone", hint=hint) from error


def preview_track(library: Library, map_id: int, *, track: FixTrack, clock: Clock) -> Preview:
    """Preview where the photos in the tray would be placed; nothing is changed.

    Raises:
        UsageError: The map has no satellite image, or the image has no georeference.
    """
    with library.database.read() as session:
        return _match_track(session, session.get_one(MapRecord, map_id), track=track, clock=clock)


def place_by_track(
    library: Library, map_id: int, *, track: FixTrack, clock: Clock, account_id: int
) -> tuple[PlacingResult, Preview]:
    """Place the photos in the tray that match the track, as one edit.

    Returns:
        As from `preview` just before.
    """
    with library.changing(map_id) as change:
        session, record = change.session, change.record
        seen = _match_track(session, record, track=track, clock=clock)
        spots = [found.spot for found in seen.found]
        placing = place_spots(session, record, spots=spots, kind="place-gpx", account_id=account_id)
    return replace(placing, job=change.job), seen


def _match_track(session: Session, record: MapRecord, *, track: FixTrack, clock: Clock) -> Preview:
    image = needed_image(record, with_georeference=True)
    photos = [photo for photo in maps.photos(session, record) if not photo.removed]
    tray = [photo for photo in photos if photo.x_px is None]
    timed = [photo for photo in tray if photo.taken_at]
    times = [clock.seconds(photo.taken_at or "") + clock.offset_s for photo in timed]
    matches = match(track, times, max_gap_s=clock.max_gap_s)
    unmatched = [UnmatchedPhoto(p.id, p.name, "it has no capture time") for p in tray if not p.taken_at]
    unmatched += [
        UnmatchedPhoto(p.id, p.name, m.reason)
        for p, m in zip(timed, matches, strict=True)
        if isinstance(m, NoMatch)
    ]
    hits = [(p, m) for p, m in zip(timed, matches, strict=True) if isinstance(m, Match)]
    spots = find_spots(image, [RequestedPose(p, m.position) for p, m in hits])
    found = tuple(MatchedPhoto(s, m.position, m.gap_s) for s, (_, m) in zip(spots, hits, strict=True))
    return Preview(found, tuple(unmatched), _suggested(photos, track, clock))


def _suggested(photos: Sequence[Photo], track: FixTrack, clock: Clock) -> ClockOffset | NoMatch:
    known = [
        (clock.seconds(p.taken_at), LatLon(p.gps_lat, p.gps_lon))
        for p in photos
        if p.taken_at and p.gps_lat is not None and p.gps_lon is not None
    ]
    return estimate_offset(track, [t for t, _ in known], latlon=[position for _, position in known])
