"""Places many photos of a library map as one edit: by GPS, a list of positions, or a GPX track."""

from __future__ import annotations

import math
import re
import zoneinfo
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from datetime import UTC, datetime, timedelta, timezone, tzinfo
from pathlib import Path, PurePosixPath
from typing import Any

from sqlalchemy.orm import Session

from webapp.core.geo.types import LatLon, MapPixel, inside
from webapp.core.mapmodel.name_matching import match_names
from webapp.core.trajectory import ClockOffset, FixTrack, Match, NoMatch, estimate_offset, match
from webapp.errors import UsageError
from webapp.files.maps.positions import Positions, read_positions
from webapp.files.part_file import show_file_as
from webapp.store.library import Library
from webapp.store.maps import edits, maps
from webapp.store.schema import MapRecord, Photo
from webapp.tasks.maps.library_map import georeference
from webapp.tasks.maps.place_photos import MapImage, how_far


@dataclass(frozen=True, slots=True)
class RequestedPose:
    """Requested pose of a photo; None leaves what it is unchanged, a radius of None means exact."""

    photo: Photo
    position: LatLon | MapPixel
    heading_deg: float | None = None
    radius_px: float | None = None
    floor: int | None = None
    note: str | None = None  # Only for a photo without one


@dataclass(frozen=True, slots=True)
class PhotoSpot:
    """Resulting position of a photo on the image."""

    photo: Photo
    pixel: MapPixel  # May be outside the image, or NaN
    problem: str | None  # How far outside it is
    heading_deg: float | None = None
    radius_px: float | None = None
    floor: int | None = None
    note: str | None = None


@dataclass(frozen=True, slots=True)
class OutsidePhoto:
    """A photo that is not placed, as its position is outside the image."""

    id: int
    name: str
    reason: str


@dataclass(frozen=True, slots=True)
class PlacingResult:
    placed: tuple[int, ...]  # Ids of the photos, including those that have not moved
    outside: tuple[OutsidePhoto, ...]
    job: int | None = None  # Id of the job that updates the index, if the set of placed photos has changed


def image_of(record: MapRecord) -> MapImage | None:
    """Return the satellite image of a map; None if there is none yet."""
    if record.satellite_path is None or not record.satellite_width or not record.satellite_height:
        return None
    return MapImage(record.satellite_width, record.satellite_height, georeference(record))


def needed_image(record: MapRecord, *, with_georeference: bool) -> MapImage:
    """Return the satellite image of a map.

    Raises:
        UsageError: There is none, or it has no georeference and one is needed.
    """
    image = image_of(record)
    if image is None:
        raise UsageError("the map has no satellite image yet", hint="add one, or start from a blank plan")
    if with_georeference and image.georeference is None:
        raise UsageError("the satellite image has no georeference yet", hint="give it a georeference first")
    return image


def find_spots(image: MapImage, wanted: Iterable[RequestedPose]) -> list[PhotoSpot]:
    """Compute the pixels of photos on an image; positions in degrees require its georeference."""
    spots = []
    for one in wanted:
        pixel = one.position
        if isinstance(pixel, LatLon):
            assert image.georeference is not None
            pixel = image.georeference.pixel_of(pixel)
        is_on_image = inside(pixel, width=image.width, height=image.height)
        problem = None if is_on_image else how_far(pixel, image)
        note = None if one.photo.note else one.note
        spots.append(PhotoSpot(one.photo, pixel, problem, one.heading_deg, one.radius_px, one.floor, note))
    return spots


def place_spots(
    session: Session, record: MapRecord, *, spots: Iterable[PhotoSpot], kind: str, account_id: int
) -> PlacingResult:
    """Place the photos that are within the image, as one edit."""
    changes: dict[str, Mapping[str, Any]] = {}
    placed, outside = [], []
    for spot in spots:
        if spot.problem is not None:
            outside.append(OutsidePhoto(spot.photo.id, spot.photo.name, spot.problem))
            continue
        known = {
            "heading_deg": spot.heading_deg,
            "radius_px": spot.radius_px,
            "floor": spot.floor,
            "note": spot.note,
        }
        also = {name: value for name, value in known.items() if value is not None}
        changes[f"photo/{spot.photo.id}"] = {"x_px": spot.pixel.x, "y_px": spot.pixel.y, **also}
        placed.append(spot.photo.id)
    edits.apply(session, record, changes=changes, kind=kind, account_id=account_id)
    return PlacingResult(tuple(placed), tuple(outside))


def place_by_gps(library: Library, map_id: int, *, account_id: int) -> PlacingResult:
    """Place all photos in the tray whose GPS positions are within the image, as one edit.

    Raises:
        UsageError: The map has no satellite image, or the image has no georeference.
    """
    with library.changing(map_id) as change:
        session, record = change.session, change.record
        image = needed_image(record, with_georeference=True)
        wanted = [
            RequestedPose(photo, LatLon(photo.gps_lat, photo.gps_lon))
            for photo in maps.photos(session, record)
            if not photo.removed
            and photo.x_px is None
            and photo.gps_lat is not None
            and photo.gps_lon is not None
        ]
        spots = find_spots(image, wanted)
        placing = place_spots(session, record, spots=spots, kind="place-gps", account_id=account_id)
    return replace(placing, job=change.job)


_SAME_PX = 1e-3
"""A smaller displacement does not count as a move."""


@dataclass(frozen=True, slots=True)
class PositionList:
    file: Path  # A `.cfg` is recognised by its suffix, other formats by their content
    name: str  # Original name, for error messages
    columns: str | None = None  # Meaning of the columns of a table; None to guess it from the header
    move_placed: bool = True  # Whether to move photos that have a position already


@dataclass(frozen=True, slots=True)
class ListedPhoto:
    spot: PhotoSpot
    before: MapPixel | None  # Current position
    # `moved_px`, `moved_m`: Distance from it; None without a current position, `moved_m` also without a
    # georeference.
    moved_px: float | None
    moved_m: float | None

    @property
    def moves(self) -> bool:
        """Whether it has a position, and a different one in the list."""
        return self.spot.problem is None and self.moved_px is not None and self.moved_px >= _SAME_PX


@dataclass(frozen=True, slots=True)
class ListPreview:
    photos: tuple[ListedPhoto, ...]
    unknown: tuple[str, ...]  # Names in the list that match no photo of the map
    # Names in the list that match several photos, that match the same photo as another name, or that occur
    # several times.
    ambiguous: tuple[str, ...]
    missing: int  # Number of photos of the map without a position that are not in the list


def preview_list(library: Library, map_id: int, *, listed: PositionList) -> ListPreview:
    """Preview where the photos would be placed; nothing is changed.

    Raises:
        TableError, TrackError, MapError: The list is not valid in its format.
        UsageError: The map has no satellite image, or no georeference although the list needs one; the list
            was made on an image of another size; or the columns do not fit.
    """
    positions = _read(listed)
    with library.database.read() as session:
        return _match(session, session.get_one(MapRecord, map_id), positions)


def place_by_list(
    library: Library, map_id: int, *, listed: PositionList, account_id: int
) -> tuple[PlacingResult, ListPreview]:
    """Place the photos of a list, as one edit; placed photos are moved only with `listed.move_placed`.

    Returns:
        As from `preview` just before.
    """
    positions = _read(listed)
    with library.changing(map_id) as change:
        session, record = change.session, change.record
        seen = _match(session, record, positions)
        spots = [one.spot for one in seen.photos if one.before is None or listed.move_placed]
        placing = place_spots(session, record, spots=spots, kind="place-file", account_id=account_id)
    return replace(placing, job=change.job), seen


def _read(listed: PositionList) -> Positions:
    with show_file_as(listed.name, listed.file):
        return read_positions(listed.file, columns=listed.columns)


def _match(session: Session, record: MapRecord, positions: Positions) -> ListPreview:
    image = needed_image(record, with_georeference=bool(positions.by_name) and not positions.in_pixels)
    _check_same_image(positions, image)
    photos = {photo.id: photo for photo in maps.photos(session, record) if not photo.removed}
    called = [(id, (p.name, p.path, PurePosixPath(p.name).stem)) for id, p in photos.items()]
    matched = match_names(positions.by_name, called)
    wanted = [
        RequestedPose(
            photos[id],
            positions.by_name[entry],
            positions.headings_deg.get(entry),
            note=positions.notes.get(entry),
        )
        for entry, id in matched.photo.items()
    ]
    found = tuple(_listed(spot, image) for spot in find_spots(image, wanted))
    named = set(matched.photo.values())
    missing = sum(photo.x_px is None and id not in named for id, photo in photos.items())
    return ListPreview(found, matched.unknown, (*matched.ambiguous, *positions.repeated), missing)


def _listed(spot: PhotoSpot, image: MapImage) -> ListedPhoto:
    x, y = spot.photo.x_px, spot.photo.y_px
    if x is None or y is None:
        return ListedPhoto(spot, None, None, None)
    before = MapPixel(x, y)
    moved_px = math.dist(before, spot.pixel)
    moved_m = None
    if image.georeference is not None and spot.problem is None:
        moved_m = moved_px * image.georeference.metres_per_pixel(spot.pixel)
    return ListedPhoto(spot, before, moved_px, moved_m)


def _check_same_image(positions: Positions, image: MapImage) -> None:
    size = positions.image_size
    if size is not None and size != (image.width, image.height):
        raise UsageError(
            f"the positions are on an image of {size[0]} x {size[1]} pixels, the satellite image has "
            f"{image.width} x {image.height}",
            hint="use the image that they were made on",
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
