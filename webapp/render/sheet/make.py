"""Prints a map: reads its image, and draws the sheet."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable
from dataclasses import replace
from functools import partial

import cv2
import numpy as np

from webapp.core.geo.floors import BASE_FLOOR, Floor, FloorImage
from webapp.errors import UsageError
from webapp.files.maps.folder import photo_path
from webapp.files.part_file import show_file_as
from webapp.files.satellite.raster import Pixels, Raster, opened_raster, reduced, warp_to_map
from webapp.render.sheet.drawing import PdfDrawing
from webapp.render.sheet.options import SheetAnswer, SheetFormat, SheetOptions, SheetWords
from webapp.render.sheet.page import SheetContent, compose, draw_sheet, page_size, printed_part
from webapp.settings import Settings
from webapp.tasks.exchange.export_source import Source
from webapp.tasks.satellite.files import source_of

MEDIA_TYPES = {"pdf": "application/pdf", "png": "image/png"}

_FAINT = 0.35
"""Opacity of the map's image around a floor."""

_MOST_PX = 12_000
"""Maximum longer side at which the image is read, even if only a small part of it is printed."""

_MOST_BOOK_PX = 400_000_000
"""Maximum pixels of all pages of a PDF, which is held in memory until it is sent."""


def print_map(
    source: Source,
    *,
    form: SheetFormat,
    options: SheetOptions,
    words: SheetWords,
    settings: Settings,
    answers: tuple[SheetAnswer, ...] = (),
) -> bytes:
    """Print a map on one sheet of paper, as PDF or PNG; of several floors one, or each on a page of a PDF.

    Raises:
        UsageError: The map has no such floor, or its floors do not fit into one file.
        PhotoError: The satellite image cannot be used.
        MapError: Its path leads out of the map's folder.
    """
    if not options.attribution:
        known = source_of(source.cfg.parent, source.map.satellite.path).get("attribution")
        options = replace(options, attribution=known if isinstance(known, str) else "")
    draw = partial(_content, source, options=options, answers=answers, settings=settings)
    if options.floor is not None:
        return draw_sheet(draw(options.floor), form=form, options=options, words=words)
    if form != "pdf":
        raise UsageError("only a PDF has several pages", where="floor", hint="print one floor, or a PDF")
    title = options.title or source.map.title or source.title
    _check_size(len(source.map.floors), options)
    floors = sorted(source.map.floors, key=lambda floor: floor.level)
    contents = map(draw, [floor.id for floor in floors] or [BASE_FLOOR])
    # No title in the options: each page has that of its content, which names the floor.
    return draw_book(contents, title=title, options=replace(options, title=None), words=words)


def _content(
    source: Source,
    id: int,
    *,
    options: SheetOptions,
    answers: tuple[SheetAnswer, ...],
    settings: Settings,
) -> SheetContent:
    """Read the content of the sheet of a floor."""
    source, floor = _of_floor(source, id)
    map_, side = source.map, _side(source, options)
    satellite = _read(source, map_.satellite.path, lambda raster: reduced(raster, side), settings=settings)
    if floor is not None and floor.image is not None:
        satellite = _with_floor(source, satellite, floor.image, side=side, settings=settings)
    title = (options.title if options.floor is None else None) or map_.title or source.title
    if floor is not None:
        title = f"{title} – {floor.name}"
        answers = tuple(answer for answer in answers if answer.floor == floor.id)
    return SheetContent(map_, satellite, title, answers)


def _check_size(pages: int, options: SheetOptions) -> None:
    width, height = (side / 72 * options.dpi for side in options.page_sizes()[0])
    if pages * width * height > _MOST_BOOK_PX:
        raise UsageError(
            f"{pages} floors do not fit into one file", where="dpi", hint="choose fewer pixels per inch"
        )


def _of_floor(source: Source, id: int) -> tuple[Source, Floor | None]:
    """Return a floor, and the source without the photos and notes of other floors."""
    map_ = source.map
    floor = map_.floor_named(id)
    if floor is None and (map_.floors or id != BASE_FLOOR):
        names = ", ".join(one.name for one in map_.floors) or "none"
        raise UsageError(f"the map has no floor {id}", where="floor", hint=f"its floors are: {names}")
    there = tuple(e for e in map_.experiences if e.floor == id)
    notes = tuple(note for note in map_.notes if note.floor == id)
    return replace(source, map=replace(map_, experiences=there, notes=notes)), floor


def _with_floor(
    source: Source, satellite: Pixels, image: FloorImage, *, side: int, settings: Settings
) -> Pixels:
    """Overlay the image of a floor on that of the map, which is faint around it."""
    size = source.map.satellite.width, source.map.satellite.height
    laid = _read(
        source, image.path, lambda raster: warp_to_map(raster, image, size=size, side=side), settings=settings
    )
    base = cv2.resize(satellite, (laid.shape[1], laid.shape[0]), interpolation=cv2.INTER_AREA)
    opacity = laid[:, :, 3:].astype(np.float32) / 255.0
    faint = _FAINT * base.astype(np.float32) + (1.0 - _FAINT) * 255.0
    mixed = opacity * laid[:, :, :3] + (1.0 - opacity) * faint
    return np.asarray(np.rint(mixed), np.uint8)


def _read(source: Source, name: str, read: Callable[[Raster], Pixels], *, settings: Settings) -> Pixels:
    file = photo_path(source.cfg, name)
    with show_file_as(name, file), opened_raster(file, limits=settings.satellite) as raster:
        return read(raster)


def _side(source: Source, options: SheetOptions) -> int:
    """Return the longer side at which to read the image, for the resolution of its printed part."""
    part, image = printed_part(source.map, options), source.map.satellite
    needed = max(options.page_sizes()[0]) / 72 * options.dpi
    share = max((part.right - part.left) / image.width, (part.bottom - part.top) / image.height)
    return min(math.ceil(needed / share), _MOST_PX)


def draw_book(
    contents: Iterable[SheetContent], *, title: str, options: SheetOptions, words: SheetWords
) -> bytes:
    """Draw a PDF with a page for each content; one at a time is in memory.

    Args:
        title: Of the document; each page has that of its content.
    """
    drawing = PdfDrawing(options.page_sizes()[0], title=title)
    for number, content in enumerate(contents):
        size = page_size(content.map, options)
        drawing.page(size, first=number == 0)
        compose(drawing, content, size=size, options=options, words=words)
    return drawing.finish()
