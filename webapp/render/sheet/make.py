"""Prints a map: reads its image, and draws the sheet."""

from __future__ import annotations

import math
from dataclasses import replace

from webapp.files.maps.folder import photo_path
from webapp.files.part_file import show_file_as
from webapp.files.satellite.raster import opened_raster, reduced
from webapp.render.sheet.options import SheetAnswer, SheetFormat, SheetOptions, SheetWords
from webapp.render.sheet.page import SheetContent, draw_sheet, printed_part
from webapp.settings import Settings
from webapp.tasks.exchange.export_source import Source
from webapp.tasks.satellite.files import source_of

MEDIA_TYPES = {"pdf": "application/pdf", "png": "image/png"}

_MOST_PX = 12_000
"""Longer side of the image that is read, however small the part of it that is printed."""


def print_map(
    source: Source,
    *,
    form: SheetFormat,
    options: SheetOptions,
    words: SheetWords,
    settings: Settings,
    answers: tuple[SheetAnswer, ...] = (),
) -> bytes:
    """Print a map on one sheet of paper, as PDF or PNG.

    Raises
    ------
    PhotoError
        The satellite image cannot be used.
    MapError
        Its path leads out of the map's folder.
    """
    map_ = source.map
    file = photo_path(source.cfg, map_.satellite.path)
    with (
        show_file_as(map_.satellite.path, file),
        opened_raster(file, limits=settings.satellite) as raster,
    ):
        satellite = reduced(raster, _side(source, options))
    if not options.attribution:
        known = source_of(source.cfg.parent, map_.satellite.path).get("attribution")
        options = replace(options, attribution=known if isinstance(known, str) else "")
    content = SheetContent(map_, satellite, map_.title or source.title, answers)
    return draw_sheet(content, form=form, options=options, words=words)


def _side(source: Source, options: SheetOptions) -> int:
    """Choose how large the image is read: as fine as the printed part of it needs."""
    part, image = printed_part(source.map, options), source.map.satellite
    needed = max(options.page_sizes()[0]) / 72 * options.dpi
    share = max((part.right - part.left) / image.width, (part.bottom - part.top) / image.height)
    return min(math.ceil(needed / share), _MOST_PX)
