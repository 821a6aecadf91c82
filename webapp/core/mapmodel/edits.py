"""Every change of a map as a function from map to map; undo is to keep the previous value."""

from __future__ import annotations

import math
from collections.abc import Collection, Mapping, Sequence
from dataclasses import replace

from webapp.core.geo.types import MapPixel
from webapp.core.mapmodel.checks import MAX_NUMBER
from webapp.core.mapmodel.model import Experience, Map, Placement
from webapp.core.mapmodel.paths import name_problem
from webapp.core.mapmodel.positions import inside
from webapp.errors import UsageError


def add(map_: Map, experiences: Sequence[Experience]) -> Map:
    """Add photos at the end of the map.

    Parameters
    ----------
    map_ : Map
    experiences : sequence of Experience
        Their ids are new: ascending from `map_.next_id` on, so that no id is ever used again.

    Raises
    ------
    UsageError
        An id that is or was in use, a position outside the image, a name that a map cannot hold.
    """
    next_id = map_.next_id
    for new in experiences:
        if not next_id <= new.id <= MAX_NUMBER:
            raise UsageError(f"the id {new.id} is not free", hint=f"the next free id is {next_id}")
        problem = name_problem(new.photo)
        if problem:
            raise UsageError(
                problem.message, hint="rename the photo" if problem.better is None else problem.better
            )
        _check_positions(map_, {new.id: new.position})
        next_id = new.id + 1
    both = (*map_.experiences, *experiences)
    return replace(map_, experiences=both, next_id=next_id, revision=map_.revision + 1)


def place(map_: Map, positions: Mapping[int, MapPixel]) -> Map:
    """Move experiences to other positions, all of them or none.

    Parameters
    ----------
    map_ : Map
    positions : mapping of int to MapPixel
        New positions by id.

    Raises
    ------
    UsageError
        An unknown id, or a position outside the image.
    """
    _check_ids(map_, positions)
    _check_positions(map_, positions)
    moved = (replace(e, position=positions.get(e.id, e.position)) for e in map_.experiences)
    return replace(map_, experiences=tuple(moved), revision=map_.revision + 1)


def set_heading(map_: Map, id: int, *, heading_deg: float | None) -> Map:
    """Say where the camera of one experience looked.

    Parameters
    ----------
    map_ : Map
    id : int
    heading_deg : float or None
        Degrees clockwise from north, any finite number; kept as 0 <= heading < 360. None: unknown.

    Raises
    ------
    UsageError
        An unknown id, or a heading that is not a finite number.
    """
    _check_ids(map_, [id])
    if heading_deg is not None and not math.isfinite(heading_deg):
        raise UsageError(f"{heading_deg} is not a heading", hint="give degrees clockwise from north")
    heading = None if heading_deg is None else heading_deg % 360.0 % 360.0  # -1e-20 % 360 is 360
    turned = (replace(e, heading_deg=heading) if e.id == id else e for e in map_.experiences)
    return replace(map_, experiences=tuple(turned), revision=map_.revision + 1)


def remove(map_: Map, ids: Collection[int]) -> Map:
    """Take experiences out of the map and out of all its placements; their ids stay used.

    Raises
    ------
    UsageError
        An unknown id.
    """
    _check_ids(map_, ids)
    gone = set(ids)
    placements = (
        replace(p, positions={i: position for i, position in p.positions.items() if i not in gone})
        for p in map_.placements
    )
    left = tuple(e for e in map_.experiences if e.id not in gone)
    return replace(map_, experiences=left, placements=tuple(placements), revision=map_.revision + 1)


def set_placement(map_: Map, placement: Placement) -> Map:
    """Add a placement, or replace the one of the same name.

    Raises
    ------
    UsageError
        An unknown id, or a position outside the image.
    """
    _check_ids(map_, placement.positions)
    _check_positions(map_, placement.positions)
    others = tuple(p for p in map_.placements if p.name != placement.name)
    return replace(map_, placements=(*others, placement), revision=map_.revision + 1)


def _check_ids(map_: Map, ids: Collection[int]) -> None:
    known = {e.id for e in map_.experiences}
    for unknown in sorted(set(ids) - known):
        raise UsageError(
            f"the map has no experience {unknown}", hint="reload the map: it may have been removed"
        )


def _check_positions(map_: Map, positions: Mapping[int, MapPixel]) -> None:
    width, height = map_.satellite.width, map_.satellite.height
    for id, position in positions.items():
        if not inside(position, width=width, height=height):
            message = f"the position ({position.x:g}, {position.y:g}) of experience {id} is outside the image"
            raise UsageError(message, hint=f"x is from 0 to {width}, y from 0 to {height} pixels")
