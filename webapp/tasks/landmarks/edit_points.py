"""Changes the control points of a map: in the library as one edit, in any other folder in its files."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

from webapp.core.geo.types import inside
from webapp.core.mapmodel.control_points import GroundControlPoint, facts_problem, name_problem
from webapp.core.mapmodel.model import Map
from webapp.core.texts import visible
from webapp.errors import NotFound, UsageError
from webapp.files.maps.folder import read_map, write_map
from webapp.files.maps.lists import point_fields
from webapp.store.library import Library
from webapp.store.maps import edits
from webapp.tasks.landmarks.known import all_photos
from webapp.tasks.maps.library_map import as_map

Points = Mapping[str, GroundControlPoint | None]
"""New control points by name; None deletes one."""


def set_in_library(library: Library, map_id: int, *, points: Points, account_id: int) -> int | None:
    """Change control points as one edit that can be undone.

    Returns:
        New revision of the map; None if nothing changed.

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
