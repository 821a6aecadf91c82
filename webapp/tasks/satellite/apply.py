"""Gives a library map a new satellite image or georeference, as one edit that also moves its photos."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from sqlalchemy import select
from sqlalchemy.orm import Session

from webapp.core.geo.affine import affine_through, apply_affine
from webapp.core.geo.floors import BASE_FLOOR
from webapp.core.geo.georeference import Georeference
from webapp.core.geo.types import LatLon, MapPixel, inside
from webapp.errors import Conflict, UsageError
from webapp.files.maps.lists import floor_fields, note_fields, point_fields
from webapp.files.maps.map_json import georeference_fields
from webapp.store.maps import edits, maps
from webapp.store.maps.changing import MapChange
from webapp.store.operate import jobs
from webapp.store.operate.job_views import PYRAMID_JOB
from webapp.store.schema import MapRecord, Photo, PlacedElsewhere
from webapp.tasks.maps.library_map import control_points, floors, notes
from webapp.tasks.maps.place_photos import MapImage
from webapp.tasks.maps.placing import image_of

DISPLAY_SIDE_PX = 4096
"""An image with a longer side is shown as tiles."""

Changing = Callable[[int], AbstractContextManager[MapChange]]
"""Opens a change of a map: `library.changing`, or a job's own, which checks its lease."""

_SAME_PX = 1e-6
"""Smaller moves are rounding errors."""

_AT_GPS_PX = 0.01
"""A photo this close to its GPS position counts as placed by it."""

_SAME_DEG = 0.05
TRAY: dict[str, Any] = {"x_px": None, "y_px": None, "floor": BASE_FLOOR}
"""Fields of a photo in the tray: it is on no floor."""


@dataclass(frozen=True, slots=True)
class NewImage:
    path: str  # Path of the existing file, relative to the map's folder
    image: MapImage  # Its size and georeference


@dataclass(frozen=True, slots=True)
class ImageChoice:
    """Options of a new image: author of the edit, and treatment of positions outside it."""

    account_id: int | None
    scale: bool = False  # Whether to scale positions with the image, if not both images are georeferenced
    tray: bool = False  # Whether photos outside go back to the tray; else the image is refused
    # Newest revision that the author has seen; an image that was changed later is a conflict.
    seen: int | None = None


@dataclass(frozen=True, slots=True)
class ImageEditResult:
    changed: tuple[int, ...]  # Ids of the photos whose position or heading changed
    # Number of positions that were dropped: photos moved to the tray, and photos in further placements.
    to_tray: int
    from_tray: int  # Number of photos that were placed from the tray, by their GPS


def set_image(changing: Changing, map_id: int, *, new: NewImage, choice: ImageChoice) -> ImageEditResult:
    """Set the image of a map.

    Photos in the tray that have a GPS position are placed if the map had no georeference before. Setting the
    same file without a georeference keeps that of the map.

    Raises:
        UsageError: Placed photos would not lie on it; nothing was changed.
    """
    with changing(map_id) as change:
        session, record = change.session, change.record
        old, image = image_of(record), new.image
        same_file = new.path == record.satellite_path
        if same_file and old is not None and image.georeference is None:
            image = old
        fields = {
            "satellite_path": new.path,
            "satellite_width": image.width,
            "satellite_height": image.height,
            "georeference": georeference_fields(image.georeference),
        }
        moves = ImageChange(old, image, same_file=same_file, scale=choice.scale)
        applied = _apply(session, record, moves, fields=fields, choice=choice)
        if max(image.width, image.height) > DISPLAY_SIDE_PX:
            jobs.enqueue(session, PYRAMID_JOB, map_id=map_id, account_id=choice.account_id, key=new.path)
    return applied


def set_georeference(
    changing: Changing, map_id: int, *, georeference: Georeference | None, choice: ImageChoice
) -> ImageEditResult:
    """Set the georeference of the current image; None removes it.

    Raises:
        UsageError: The map has no image.
    """
    with changing(map_id) as change:
        session, record = change.session, change.record
        old = image_of(record)
        if old is None:
            raise UsageError("the map has no satellite image yet", hint="add one, or start from a blank plan")
        moves = ImageChange(old, MapImage(old.width, old.height, georeference), same_file=True)
        fields = {"georeference": georeference_fields(georeference)}
        return _apply(session, record, moves, fields=fields, choice=choice)


def _apply(
    session: Session,
    record: MapRecord,
    change: ImageChange,
    *,
    fields: Mapping[str, Any],
    choice: ImageChoice,
) -> ImageEditResult:
    if choice.seen is not None and record.satellite_revision > choice.seen:
        raise Conflict("somebody has changed the satellite image in the meantime", hint="reload the page")
    changes: dict[str, Mapping[str, Any] | None] = {"map": fields}
    photos = maps.photos(session, record)
    standing = [p for p in photos if p.x_px is not None and p.y_px is not None]
    spots = change.moved([MapPixel(float(p.x_px or 0.0), float(p.y_px or 0.0)) for p in standing])
    outside, from_tray = 0, 0
    for photo, spot in zip(standing, spots, strict=True):
        moved = change.placed(photo, spot)
        if not change.shows(MapPixel(moved["x_px"], moved["y_px"])):
            moved = TRAY
            outside += not photo.removed
        changes[f"photo/{photo.id}"] = moved
    for photo in photos:
        by_gps = change.from_tray(photo) if photo.x_px is None and not photo.removed else None
        if by_gps is not None:
            changes[f"photo/{photo.id}"] = by_gps
            from_tray += 1
    outside += _move_placements(session, record, change, changes=changes)
    _move_control_points(record, change, changes=changes)
    _move_notes(record, change, changes=changes)
    _move_floors(record, change, changes=changes)
    # with the same image, never refuse: photos that leave it by the new georeference go to the tray
    if outside and not choice.tray and not change.same_file:
        raise _refusal(outside, change)
    edit = edits.apply(
        session,
        record,
        changes=changes,
        kind="satellite" if "satellite_path" in fields else "georeference",
        account_id=choice.account_id,
    )
    done = [] if edit is None else [step["target"] for step in edit.changes]
    ids = sorted({int(target.rsplit("/", 1)[1]) for target in done if edits.is_of_photo(target)})
    return ImageEditResult(tuple(ids), outside, from_tray)


def _move_placements(
    session: Session, record: MapRecord, change: ImageChange, *, changes: dict[str, Mapping[str, Any] | None]
) -> int:
    """Move the further placements; return how many positions are outside."""
    rows = list(session.scalars(select(PlacedElsewhere).where(PlacedElsewhere.map_id == record.id)))
    spots = change.moved([MapPixel(row.x_px, row.y_px) for row in rows])
    for row, spot in zip(rows, spots, strict=True):
        at = {"x_px": spot.x, "y_px": spot.y} if change.shows(spot) else None
        changes[f"placed/{row.placement}/{row.photo_id}"] = at
    return sum(not change.shows(spot) for spot in spots)


def _move_control_points(
    record: MapRecord, change: ImageChange, *, changes: dict[str, Mapping[str, Any] | None]
) -> None:
    """Move the control points; those outside lose their position, but keep their clicks."""
    points = [point for point in control_points(record) if point.position is not None]
    spots = change.moved([point.position for point in points if point.position is not None])
    for point, spot in zip(points, spots, strict=True):
        moved = replace(point, position=spot if change.shows(spot) else None)
        if moved != point:
            changes[f"point/{point.name}"] = point_fields(moved)


def _move_notes(
    record: MapRecord, change: ImageChange, *, changes: dict[str, Mapping[str, Any] | None]
) -> None:
    """Move the notes; those outside lose their position, but keep their content."""
    there = [(note, note.position) for note in notes(record) if note.position is not None]
    for (note, _), spot in zip(there, change.moved([position for _, position in there]), strict=True):
        moved = replace(note, position=spot if change.shows(spot) else None)
        if moved != note:
            changes[f"note/{note.id}"] = note_fields(moved)


def _move_floors(
    record: MapRecord, change: ImageChange, *, changes: dict[str, Mapping[str, Any] | None]
) -> None:
    """Align the images of floors with the new image, so that they cover the same spots."""
    for floor in floors(record):
        if floor.image is None:
            continue
        width, height = float(floor.image.width), float(floor.image.height)
        corners = [MapPixel(0.0, 0.0), MapPixel(width, 0.0), MapPixel(0.0, height)]
        moved = change.moved([apply_affine(floor.image.map_from_image, corner) for corner in corners])
        laid = affine_through(np.asarray(corners), np.asarray(moved))
        if laid is not None:
            image = replace(floor.image, map_from_image=laid)
            changes[f"floor/{floor.id}"] = floor_fields(replace(floor, image=image))


def _refusal(outside: int, change: ImageChange) -> UsageError:
    size = f"{change.new.width} x {change.new.height} pixels"
    both = change.old is not None and change.old.georeference is not None
    on_earth = both and change.new.georeference is not None
    hint = "take a larger area" if on_earth else "scale the positions with the image (scale=1)"
    return UsageError(
        f"{outside} placed photos would lie outside of the new image of {size}",
        where="file",
        hint=f"{hint}, or put those photos back into the tray (tray=1)",
    )


@dataclass(frozen=True, slots=True)
class ImageChange:
    """A change from one image to the next.

    If the image is replaced and both are georeferenced, positions keep their latitude and longitude; else
    they keep their pixels, or are scaled with the image. If only the georeference changes, photos at their
    GPS positions follow these; all others keep their pixels, and their directions in the image.
    """

    old: MapImage | None
    new: MapImage
    same_file: bool  # Whether it is the same image, with another georeference
    scale: bool = False  # Whether positions are scaled with the image

    def moved(self, positions: Sequence[MapPixel]) -> list[MapPixel]:
        """Return the positions on the new image; NaN where there is none."""
        if not positions or self.old is None or self.same_file:
            return list(positions)
        before, after = self.old.georeference, self.new.georeference
        pixels = np.asarray(positions, dtype=np.float64)
        if before is not None and after is not None:
            pixels = after.pixel_from_latlon(before.latlon_from_pixel(pixels))
        elif self.scale:
            pixels = pixels * (self.new.width / self.old.width, self.new.height / self.old.height)
        return [
            self._tidy(MapPixel(*after), before=before)
            for after, before in zip(pixels.tolist(), positions, strict=True)
        ]

    def shows(self, position: MapPixel) -> bool:
        return inside(position, width=self.new.width, height=self.new.height)

    def placed(self, photo: Photo, at: MapPixel) -> dict[str, Any]:
        """Return the fields of a placed photo that moves to `at`, unless it follows its GPS position."""
        before = _position(photo)
        gps = _gps(photo)
        if not self.same_file or self.old is None:
            return {"x_px": at.x, "y_px": at.y, **self._radius(photo, at)}
        if gps is not None and _stands_at(before, gps, self.old):
            there = self.new.georeference.pixel_of(gps) if self.new.georeference else before
            at = self._tidy(there, before=before)
            return {"x_px": at.x, "y_px": at.y}
        fields: dict[str, Any] = {"x_px": at.x, "y_px": at.y, **self._radius(photo, at)}
        turn = _north(self.old, before) - _north(self.new, at)
        if photo.heading_deg is not None and abs(turn) > _SAME_DEG:
            fields["heading_deg"] = (photo.heading_deg + turn) % 360.0
        return fields

    def _radius(self, photo: Photo, at: MapPixel) -> dict[str, float]:
        """Return the radius of an inexact position, converted to the scale of the new image."""
        if photo.radius_px is None:
            return {}
        grown = 1.0
        if self.old is not None and not self.same_file:
            before, after = self.old.georeference, self.new.georeference
            if before is not None and after is not None:
                grown = before.metres_per_pixel(_position(photo)) / after.metres_per_pixel(at)
            elif self.scale:
                grown = math.sqrt(self.new.width * self.new.height / (self.old.width * self.old.height))
        return {"radius_px": photo.radius_px * grown} if math.isfinite(grown) else {}

    def from_tray(self, photo: Photo) -> dict[str, Any] | None:
        """Return the GPS position of a photo in the tray, if the map gets its first georeference."""
        gps = _gps(photo)
        if gps is None or self.new.georeference is None:
            return None
        if self.old is not None and self.old.georeference is not None:
            return None
        at = self.new.georeference.pixel_of(gps)
        return {"x_px": at.x, "y_px": at.y} if self.shows(at) else None

    def _tidy(self, after: MapPixel, *, before: MapPixel) -> MapPixel:
        """Remove rounding errors: keep unmoved positions exactly, and those on the border inside."""
        if math.dist(after, before) < _SAME_PX:
            return before
        inner = MapPixel(min(max(after.x, 0.0), self.new.width), min(max(after.y, 0.0), self.new.height))
        return inner if math.dist(after, inner) < _SAME_PX else after


def _position(photo: Photo) -> MapPixel:
    assert photo.x_px is not None
    assert photo.y_px is not None
    return MapPixel(photo.x_px, photo.y_px)


def _gps(photo: Photo) -> LatLon | None:
    if photo.gps_lat is None or photo.gps_lon is None:
        return None
    return LatLon(photo.gps_lat, photo.gps_lon)


def _stands_at(position: MapPixel, gps: LatLon, image: MapImage) -> bool:
    if image.georeference is None:
        return False
    return math.dist(image.georeference.pixel_of(gps), position) < _AT_GPS_PX


def _north(image: MapImage, at: MapPixel) -> float:
    """Return the direction of north in an image; up if unknown."""
    if image.georeference is None:
        return 0.0
    north = image.georeference.north_deg(at)
    return north if math.isfinite(north) else 0.0
