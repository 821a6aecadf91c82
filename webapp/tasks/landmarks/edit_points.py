"""Changes the control points of a map, in a library or in a folder, also by a table; writes them to one."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import replace
from pathlib import Path, PurePosixPath

from webapp.core.geo.types import LatLon, MapPixel, inside
from webapp.core.mapmodel.control_points import GroundControlPoint, PhotoClick, facts_problem, name_problem
from webapp.core.mapmodel.model import Map
from webapp.core.texts import visible
from webapp.errors import NotFound, TableError, UsageError
from webapp.files.maps.control_point_table import PointRow, format_rows
from webapp.files.maps.folder import photo_path, read_map, write_map
from webapp.files.maps.lists import point_fields
from webapp.files.photos.photo import read_facts
from webapp.settings import PhotoLimits
from webapp.store.library import Library
from webapp.store.maps import edits
from webapp.tasks.landmarks.known import AnyPhoto, all_photos
from webapp.tasks.maps.library_map import as_map

Points = Mapping[str, GroundControlPoint | None]
"""New control points by name; None deletes one."""


def set_in_library(library: Library, map_id: int, *, points: Points, account_id: int) -> int | None:
    """Change control points as one edit that can be undone; return its revision, None if nothing changed.

    Raises:
        UsageError: The map has no image, or a point is not valid.
        NotFound: A point to delete, or a photo, does not exist.
    """
    with library.changing(map_id) as change:
        session, record = change.session, change.record
        the_map = as_map(session, record)
        if the_map is None:
            raise UsageError("the map has no satellite image yet", hint="add one, or start from a blank plan")
        _check(the_map, points)
        done = edits.apply(
            session,
            record,
            changes={
                f"point/{name}": None if point is None else point_fields(point)
                for name, point in points.items()
            },
            kind=edits.POINTS_KIND,
            account_id=account_id,
        )
    return None if done is None else done.revision


def set_in_folder(cfg: Path, points: Points) -> None:
    """Change control points in the files of a map outside a library.

    Raises MapError, UsageError, NotFound, StorageError.
    """
    the_map = read_map(cfg)
    _check(the_map, points)
    kept = {point.name: point for point in the_map.control_points} | dict(points)
    changed = tuple(point for _, point in sorted(kept.items()) if point is not None)
    write_map(cfg, replace(the_map, control_points=changed))


def _check(the_map: Map, points: Points) -> None:
    image = the_map.satellite
    there = {point.name for point in the_map.control_points}
    look = {visible(name): name for name in [*points, *there]}
    photos = {photo.id for photo in all_photos(the_map)}
    for name, point in points.items():
        if point is None and name not in there:
            raise NotFound(f"the map has no control point {name}")
        if point is None:
            continue
        problem = name_problem(name)
        if problem:
            raise UsageError(f"the name of a control point {problem}", where=name[:80])
        if name not in there and look[visible(name)] != name:
            raise UsageError(
                "another control point has a name that looks the same", where=name, hint="choose another one"
            )
        problem = facts_problem(point)
        if problem:
            raise UsageError(f"the control point {name} {problem}", where=name)
        at = point.position
        if at is not None and not inside(at, width=image.width, height=image.height):
            where = f"x {at.x:.1f}, y {at.y:.1f}"
            raise UsageError(f"the control point {name} is outside the image, at {where}", where=name)
        missing = [click.photo for click in point.clicks if click.photo not in photos]
        if missing:
            raise NotFound(f"the map has no photo {missing[0]}", where=name)


Size = Callable[[AnyPhoto], tuple[int, int]]


def photo_sizes(cfg: Path, limits: PhotoLimits) -> Size:
    """Return a function that reads the size of an upright photo of a map."""

    def size(photo: AnyPhoto) -> tuple[int, int]:
        facts = read_facts(photo_path(cfg, photo.photo), limits=limits)
        return facts.width, facts.height

    return size


def points_from(rows: Sequence[PointRow], the_map: Map, *, size: Size) -> dict[str, GroundControlPoint]:
    """Make control points from the rows of a table; several rows of a point must agree."""
    everyone = all_photos(the_map)
    together: dict[str, list[PointRow]] = {}
    for row in rows:
        together.setdefault(row.name, []).append(row)
    found = {}
    for name, some in together.items():
        clicks: dict[int, PhotoClick] = {}
        for row in some:
            if row.photo is None or row.click_px is None:
                continue
            photo = _photo(row, row.photo, everyone)
            if photo.id in clicks:
                raise TableError(f"the point {name} is clicked twice in {row.photo}", where=row.where)
            width, height = size(photo)
            x, y = row.click_px[0] / width, row.click_px[1] / height
            if not (0.0 <= x <= 1.0 and 0.0 <= y <= 1.0):
                raise TableError(
                    f"the click is outside the photo of {width} x {height} pixels", where=row.where
                )
            clicks[photo.id] = PhotoClick(photo.id, x, y)
        accuracy = _one(some, "accuracy_m")
        if accuracy is not None and accuracy <= 0.0:
            raise TableError("accuracy_m is not above 0", where=some[0].where)
        found[name] = GroundControlPoint(
            name,
            _pixel(_one(some, "position"), the_map, where=some[0].where),
            tuple(clicks[id] for id in sorted(clicks)),
            accuracy,
            _one(some, "height_m"),
            _one(some, "tag"),
            bool(_one(some, "is_check")),
        )
    return found


def with_checks(the_map: Map, changes: Points, *, checks: Mapping[str, bool]) -> Points:
    """Return the changes with some points made check points, or control points again.

    Raises NotFound.
    """
    there = {point.name: point for point in the_map.control_points} | dict(changes)
    found = dict(changes)
    for name, is_check in checks.items():
        point = there.get(name)
        if point is None:
            raise NotFound(f"the map has no control point {name}")
        found[name] = replace(point, is_check=is_check)
    return found


def table_of(the_map: Map, *, size: Size) -> str:
    georeference = the_map.georeference
    latlon = {
        point.name: georeference.latlon_of(point.position)
        for point in the_map.control_points
        if georeference is not None and point.position is not None
    }
    return format_rows(_rows(the_map, size), latlon)


def _rows(the_map: Map, size: Size) -> Iterator[PointRow]:
    photos = {photo.id: photo for photo in all_photos(the_map)}
    for point in the_map.control_points:
        facts = ("", point.position, point.height_m, point.accuracy_m)
        clicks = [click for click in point.clicks if click.photo in photos]
        if not clicks:
            yield PointRow(point.name, *facts, tag=point.tag, is_check=point.is_check)
        for click in clicks:
            photo = photos[click.photo]
            width, height = size(photo)
            at = (click.x * width, click.y * height)
            yield PointRow(point.name, *facts, photo.photo, at, point.tag, point.is_check)


def _photo(row: PointRow, name: str, photos: Sequence[AnyPhoto]) -> AnyPhoto:
    same = [photo for photo in photos if photo.photo == name]
    last = PurePosixPath(name.replace("\\", "/")).name
    same = same or [photo for photo in photos if last in (photo.name, PurePosixPath(photo.photo).name)]
    if len(same) != 1:
        problem = f"{len(same)} photos of the map are called" if same else "no photo of the map is called"
        raise TableError(f"{problem} {name!r}", where=row.where)
    return same[0]


def _one(rows: Sequence[PointRow], field: str):  # type: ignore[no-untyped-def]
    """Return a field of a point, on which all its rows must agree."""
    said = {value: row for row in rows if (value := getattr(row, field)) is not None}
    if len(said) > 1:
        where = [*said.values()][1].where
        raise TableError(f"{field} of the point {rows[0].name} differs from an earlier row", where=where)
    return next(iter(said), None)


def _pixel(position: MapPixel | LatLon | None, the_map: Map, *, where: str) -> MapPixel | None:
    if not isinstance(position, LatLon):
        return position
    if the_map.georeference is None:
        raise TableError("latitude and longitude need a map with a georeference", where=where)
    return the_map.georeference.pixel_of(position)
