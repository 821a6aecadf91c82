"""Printed tags in the photos of a map: each counts as a click of its control point."""

from __future__ import annotations

import json
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from webapp.core.mapmodel.control_points import GroundControlPoint, PhotoClick
from webapp.core.mapmodel.model import Experience, Map, UnplacedPhoto
from webapp.core.tags.detect import find_tags
from webapp.errors import PhotoError
from webapp.files.atomic import write_text
from webapp.files.maps.folder import photo_path
from webapp.files.photos.photo import read_gray
from webapp.progress import Progress
from webapp.settings import PhotoLimits

_FILE = "tags.json"
"""Next to the features of photos: by content hash and family the ids, with the middles as shares."""

_MAX_SIDE_PX = 4096


def find_in_photos(
    cfg: Path,
    the_map: Map,
    *,
    photos: Mapping[str, Experience | UnplacedPhoto],
    folder: Path,
    limits: PhotoLimits,
    progress: Progress,
) -> None:
    """Find the tags of a map's families in photos that were not searched before, and keep them.

    Args:
        photos: By content hash; panoramas are left out.
        folder: Folder of the photos' features.
    """
    families = {point.tag.family for point in the_map.control_points if point.tag is not None}
    known = _read(folder)
    missing = {
        content: wanted
        for content, photo in photos.items()
        if photo.view is None
        and photo.panorama is None
        and (wanted := families - known.get(content, {}).keys())
    }
    if not missing:
        return
    progress.note("looking for printed tags")
    progress.size(len(missing))
    for content, wanted in missing.items():
        path = photo_path(cfg, photos[content].photo)
        try:
            pixels = read_gray(path, limits=limits, max_side=_MAX_SIDE_PX).pixels
        except PhotoError:  # reported where the photo is described
            progress.advance()
            continue
        height, width = pixels.shape
        found: dict[str, list[Any]] = {family: [] for family in wanted}
        for tag in find_tags(pixels, wanted):
            x, y = tag.middle
            found[tag.family].append([tag.number, (x + 0.5) / width, (y + 0.5) / height])
        known[content] = {**known.get(content, {}), **found}
        progress.advance()
    write_text(folder / _FILE, json.dumps(known))


def with_tag_clicks(
    the_map: Map,
    photos: Mapping[str, Experience | UnplacedPhoto],
    *,
    folder: Path,
) -> tuple[GroundControlPoint, ...]:
    """Return the control points with a click in each photo that shows their tag; those by hand stay.

    A tag that is at several control points, or several times in a photo, is left out there.

    Args:
        photos: By content hash.
    """
    points = the_map.control_points
    count = Counter(point.tag.title for point in points if point.tag is not None)
    known = _read(folder) if count else {}
    if not known:
        return points
    return tuple(
        point
        if point.tag is None or count[point.tag.title] > 1
        else replace(point, clicks=(*point.clicks, *_clicks(point, photos, known)))
        for point in points
    )


def _clicks(
    point: GroundControlPoint,
    photos: Mapping[str, Experience | UnplacedPhoto],
    known: Mapping[str, Mapping[str, list[Any]]],
) -> Iterator[PhotoClick]:
    clicked = {click.photo for click in point.clicks}
    if point.tag is None:
        return
    for content, photo in photos.items():
        seen = known.get(content, {}).get(point.tag.family, ())
        mine = [(x, y) for number, x, y in seen if number == point.tag.number]
        if len(mine) == 1 and photo.id not in clicked:
            yield PhotoClick(photo.id, *mine[0])


def _read(folder: Path) -> dict[str, dict[str, list[Any]]]:
    """Read what was found before; nothing if the file is missing or damaged, as it can be found again."""
    try:
        stored = json.loads((folder / _FILE).read_text("utf-8"))
    except (OSError, ValueError):
        return {}
    return stored if isinstance(stored, dict) else {}
