"""Prints a map: reads its image, lays it out on a sheet of paper, and draws it."""

from __future__ import annotations

import math
from collections import defaultdict
from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import PurePosixPath

import cv2
import numpy as np
from numpy.typing import NDArray

from webapp.core.geo.floors import BASE_FLOOR, Floor, FloorImage
from webapp.core.geo.types import MapPixel
from webapp.core.mapmodel.model import Experience, Map
from webapp.core.mapmodel.notes import MapNote
from webapp.errors import UsageError
from webapp.files.maps.folder import photo_path
from webapp.files.part_file import show_file_as
from webapp.files.satellite.raster import Pixels, Raster, opened_raster, reduced, warp_to_map
from webapp.render.canvas import Point
from webapp.render.colours import INK, QUIET, probability_colour
from webapp.render.sheet import marks
from webapp.render.sheet.drawing import (
    Box,
    Drawing,
    LabelWanted,
    PdfDrawing,
    PngDrawing,
    TextStyle,
    place_labels,
    shorten,
    text_width,
)
from webapp.render.sheet.marks import SheetView
from webapp.render.sheet.options import SheetAnswer, SheetFormat, SheetOptions, SheetWords
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


_MARGIN = 34.0
_TITLE, _TEXT, _SMALL = 20.0, 9.0, 7.5
_TITLE_LINES = 2
_FOOT = 62.0
"""Height of legend, scale and attribution."""

_MEASURES = 190.0
"""Width of scale and north at the right of the foot."""

_BAR = 120.0
_LABEL = 7.0
_LABEL_WIDTH = 110.0
_AROUND = 0.06
"""Margin around the photos, as a share of their extent."""


@dataclass(frozen=True, slots=True)
class SheetContent:
    map: Map
    # (h, w, 3) uint8. Red, green, blue; it may have another size than the map states.
    satellite: NDArray[np.uint8]
    title: str  # Used unless the options have a title
    answers: tuple[SheetAnswer, ...] = ()  # Those outside of the image are left out


def draw_sheet(
    content: SheetContent, *, form: SheetFormat, options: SheetOptions, words: SheetWords
) -> bytes:
    """Draw a map on one sheet of paper, as PDF or PNG; the same content gives the same bytes."""
    size = page_size(content.map, options)
    title = options.title or content.title
    drawing: Drawing = PdfDrawing(size, title=title) if form == "pdf" else PngDrawing(size, dpi=options.dpi)
    compose(drawing, content, size=size, options=options, words=words)
    return drawing.finish()


def page_size(map_: Map, options: SheetOptions) -> tuple[float, float]:
    """Return the size of the paper in points: the allowed one on which the map is largest."""
    part = printed_part(map_, options)
    return max(options.page_sizes(), key=lambda size: _map_scale(part, size, top=_MARGIN + 50))


def compose(
    drawing: Drawing,
    content: SheetContent,
    *,
    size: tuple[float, float],
    options: SheetOptions,
    words: SheetWords,
) -> None:
    """Draw the parts of a sheet; `size` is in points."""
    _Page(drawing, size, content, options, words).draw(printed_part(content.map, options))


def _map_scale(part: Box, size: tuple[float, float], *, top: float) -> float:
    """Return the scale at which a part of the image fits on a sheet, points per map pixel."""
    room_x, room_y = size[0] - 2 * _MARGIN, size[1] - top - _FOOT - _MARGIN + 6
    return min(room_x / (part.right - part.left), room_y / (part.bottom - part.top))


def printed_part(map_: Map, options: SheetOptions) -> Box:
    """Return the part of the image to print, map pixels; around photos at least a tenth of the long side."""
    width, height = map_.satellite.width, map_.satellite.height
    if options.extent == "image" or not map_.experiences:
        return Box(0, 0, width, height)
    at = np.array([e.position for e in map_.experiences], np.float64)
    low, high = at.min(axis=0), at.max(axis=0)
    spread = (high - low) * (1 + 2 * _AROUND)
    spread = np.minimum(np.maximum(spread, max(spread.max() / 2, max(width, height) / 10)), (width, height))
    corner = np.clip((low + high - spread) / 2, 0, np.array([width, height]) - spread)
    return Box(*corner.tolist(), *(corner + spread).tolist())


@dataclass(frozen=True, slots=True)
class _Label:
    text: str
    at: Point
    reach: float
    bold: bool = False


@dataclass(slots=True)
class _Page:
    drawing: Drawing
    size: tuple[float, float]
    content: SheetContent
    options: SheetOptions
    words: SheetWords

    def draw(self, part: Box) -> None:
        """Draw everything, from the top to the bottom."""
        view = self._map(part, top=self._head())
        left_out = self._marks(view)
        foot = view.frame.bottom + 20
        self._measures(view, foot)
        self._legend(foot, left_out=left_out)
        self._attribution(foot + _FOOT - 24)
        self._notes(view, foot + _FOOT)

    def _head(self) -> float:
        """Write title, number of photos and date; return where the map begins."""
        width = self.size[0] - 2 * _MARGIN
        y = _MARGIN - 6
        for line in _wrapped(self.options.title or self.content.title, width=width):
            y += _TITLE + 2
            self.drawing.text((_MARGIN, y), line, style=TextStyle(_TITLE, bold=True))
        y += _TEXT + 6
        about = f"{self.words.photos(len(self.content.map.experiences))}  ·  {self.words.date}"
        self.drawing.text((_MARGIN, y), about, style=TextStyle(_TEXT, colour=QUIET))
        return y + 10

    def _map(self, part: Box, *, top: float) -> SheetView:
        """Draw the image as large as it fits, in the middle of the width."""
        scale = _map_scale(part, self.size, top=top)
        width, height = (part.right - part.left) * scale, (part.bottom - part.top) * scale
        left = (self.size[0] - width) / 2
        frame = Box(left, top, left + width, top + height)
        most = math.ceil(max(width, height) * self.options.dpi / 72)
        self.drawing.image(_cut(self.content, part, most=most), frame)
        corners = [
            (x, y)
            for x, y in ((left, top), (left + width, top), (left + width, top + height), (left, top + height))
        ]
        for start, end in zip(corners, [*corners[1:], corners[0]], strict=True):
            self.drawing.line(start, end, colour=INK, width=0.6)
        return SheetView(part, frame)

    def _marks(self, view: SheetView) -> int:
        """Draw photos, points and answers with their labels; return how many labels did not fit."""
        answers = [answer for answer in self.content.answers if view.shows(answer.position)]
        for answer in answers:
            marks.draw_answer_area(self.drawing, answer, view=view)
        photos = [e for e in self.content.map.experiences if view.shows(e.position)]
        at = [view.shown(e.position) for e in photos]
        radius = marks.dot_radius(np.array(at).reshape(-1, 2))
        for e, point, turn in zip(photos, at, self._norths([e.position for e in photos]), strict=True):
            angle = None if e.heading_deg is None or not self.options.headings else e.heading_deg + turn
            marks.draw_photo(self.drawing, point, radius=radius, angle_deg=angle)
        points = self._control_points(view)
        taken = [_square(view.shown(at), marks.NOTE_PT + 1) for at in self._draw_notes(view)]
        for answer, turn in zip(answers, self._norths([a.position for a in answers]), strict=True):
            angle = None if answer.heading_deg is None else answer.heading_deg + turn
            marks.draw_answer(self.drawing, answer, view=view, angle_deg=angle)
        labels = [_Label(a.name, view.shown(a.position), marks.ANSWER_PT + 2, bold=True) for a in answers]
        labels += points
        taken += [_square(label.at, label.reach) for label in labels] + [_square(p, radius) for p in at]
        if self.options.labels != "none":
            labels += self._photo_labels(photos, at, reach=1.5 * radius)
        return self._write(labels, taken=taken, frame=view.frame)

    def _norths(self, positions: Sequence[MapPixel]) -> list[float]:
        return [float(turn) for turn in marks.norths(self.content.map.georeference, positions)]

    def _control_points(self, view: SheetView) -> list[_Label]:
        if not self.options.control_points:
            return []
        labels = []
        for point in self.content.map.control_points:
            if point.position is not None and view.shows(point.position):
                at = view.shown(point.position)
                marks.draw_control_point(self.drawing, at)
                labels.append(_Label(point.name, at, marks.CROSS_PT + 1, bold=True))
        return labels

    def _photo_labels(
        self, photos: Sequence[Experience], at: Sequence[Point], *, reach: float
    ) -> list[_Label]:
        """Make the labels of the photos; photos at the same position share one."""
        spots: dict[Point, list[Experience]] = defaultdict(list)
        for e, (x, y) in zip(photos, at, strict=True):
            spots[round(x, 1), round(y, 1)].append(e)
        return [
            _Label(self._name(here[0]) + (f" +{len(here) - 1}" if len(here) > 1 else ""), spot, reach)
            for spot, here in spots.items()
        ]

    def _shown_notes(self, view: SheetView) -> list[tuple[MapNote, MapPixel]]:
        found = self.content.map.notes if self.options.notes else ()
        return [(note, note.position) for note in found if note.position and view.shows(note.position)]

    def _draw_notes(self, view: SheetView) -> list[MapPixel]:
        """Draw the notes as numbers, from 1 on; return their positions."""
        found = self._shown_notes(view)
        for number, (_, position) in enumerate(found, start=1):
            marks.draw_note(self.drawing, view.shown(position), number=number)
        return [position for _, position in found]

    def _notes(self, view: SheetView, top: float) -> None:
        """Write the texts of the notes below the map, and how many of them do not fit there."""
        found = self._shown_notes(view)
        bottom, width = self.size[1] - _MARGIN + 6, self.size[0] - 2 * _MARGIN - 22
        y = top
        for number, (note, _) in enumerate(found, start=1):
            lines = _lines(note.text, width=width)
            needed = 14 + 11 * len(lines) + (0 if number == len(found) else 12)
            if y + needed > bottom:
                rest = self.words.notes_left_out.format(n=len(found) - number + 1)
                self.drawing.text((_MARGIN, y + 8), rest, style=TextStyle(_SMALL, colour=QUIET))
                return
            y += 14
            marks.draw_note(self.drawing, (_MARGIN + 8, y - 3), number=number)
            title = shorten(note.title, _TEXT, width=width, bold=True)
            self.drawing.text((_MARGIN + 22, y), title, style=TextStyle(_TEXT, bold=True))
            for line in lines:
                y += 11
                self.drawing.text((_MARGIN + 22, y), line, style=TextStyle(_TEXT))

    def _name(self, e: Experience) -> str:
        if self.options.labels == "numbers":
            return str(e.id)
        return PurePosixPath(e.name or e.photo).stem

    def _write(self, labels: Sequence[_Label], *, taken: Sequence[Box], frame: Box) -> int:
        texts = [_fitted(label) for label in labels]
        wanted = [
            LabelWanted(*label.at, label.reach + 0.8, text_width(text, _LABEL, bold=label.bold), _LABEL)
            for label, text in zip(labels, texts, strict=True)
        ]
        boxes = place_labels(wanted, taken=taken, frame=frame)
        for label, text, box in zip(labels, texts, boxes, strict=True):
            if box is not None:
                style = TextStyle(_LABEL, bold=label.bold, halo=0.9)
                self.drawing.text((box.left, box.bottom - 0.2 * _LABEL), text, style=style)
        return sum(box is None for box in boxes)

    def _legend(self, top: float, *, left_out: int) -> None:
        """Draw the legend of the marks in use, in as many rows as are needed."""
        width = self.size[0] - 2 * _MARGIN - (_MEASURES if self.content.map.georeference else 0.0)
        x, y = _MARGIN, top
        for draw, text in self._legend_items():
            wide = 20 + text_width(text, _TEXT) + 16
            if x > _MARGIN and x + wide - 16 > _MARGIN + width:
                x, y = _MARGIN, y + 15
            draw((x + 8, y - 3))
            self.drawing.text((x + 20, y), text, style=TextStyle(_TEXT))
            x += wide
        notes = []
        if self.content.map.georeference is None:
            notes.append(self.words.no_scale)
        if left_out:
            notes.append(self.words.labels_left_out.format(n=left_out))
        for note in notes:
            y += 13
            self.drawing.text((_MARGIN, y), note, style=TextStyle(_SMALL, colour=QUIET))

    def _legend_items(self) -> Iterator[tuple[Callable[[Point], None], str]]:
        map_, drawing = self.content.map, self.drawing
        if map_.experiences:
            yield lambda at: marks.draw_photo(drawing, at, radius=2.8, angle_deg=None), self.words.photo
        if self.options.headings and any(e.heading_deg is not None for e in map_.experiences):
            yield lambda at: marks.draw_photo(drawing, at, radius=2.8, angle_deg=60.0), self.words.looks
        if self.options.control_points and any(p.position for p in map_.control_points):
            yield lambda at: marks.draw_control_point(drawing, at), self.words.control_point
        if self.options.notes and any(note.position for note in map_.notes):
            yield lambda at: marks.draw_note(drawing, at, number=1), self.words.note
        if self.content.answers:
            yield self._probabilities, self.words.answer
            if any(a.radius_px is not None for a in self.content.answers):
                ring = probability_colour(0.5)
                yield lambda at: drawing.ring(at, 4.5, colour=ring, width=0.8), self.words.radius

    def _probabilities(self, at: Point) -> None:
        """Draw three discs from unlikely to likely."""
        for n, probability in enumerate((0.1, 0.5, 0.9)):
            self.drawing.disc((at[0] - 5 + 5 * n, at[1]), 3.4, colour=probability_colour(probability))

    def _measures(self, view: SheetView, top: float) -> None:
        """Draw scale and north at the right, if they are known."""
        georeference = self.content.map.georeference
        scale = None if georeference is None else marks.scale_of(georeference, view, longest=_BAR)
        if georeference is None or scale is None:
            return
        right = self.size[0] - _MARGIN
        middle = MapPixel((view.part.left + view.part.right) / 2, (view.part.top + view.part.bottom) / 2)
        marks.draw_north(self.drawing, (right - 14, top + 11), angle_deg=self._norths([middle])[0])
        ratio = f"1 : {_rounded(scale.ratio)}"
        text = ratio if scale.even else self.words.about.format(scale=ratio)
        marks.draw_scale(self.drawing, scale, at=(right - 50 - scale.length, top + 7), text=text)

    def _attribution(self, y: float) -> None:
        if self.options.attribution:
            text = self.words.image.format(attribution=self.options.attribution)
            width = self.size[0] - 2 * _MARGIN
            self.drawing.text(
                (_MARGIN, y), shorten(text, _SMALL, width=width), style=TextStyle(_SMALL, colour=QUIET)
            )


def _rounded(ratio: float) -> str:
    """Write a ratio with three significant digits, and spaces between thousands."""
    digits = max(0, math.floor(math.log10(max(ratio, 1))) - 2)
    return f"{round(ratio / 10**digits) * 10**digits:,}".replace(",", "\u202f")


def _wrapped(text: str, *, width: float) -> list[str]:
    """Break a title into at most two lines, and truncate it."""
    lines: list[str] = []
    rest = text.split()
    while rest and len(lines) < _TITLE_LINES - 1:
        fits = 1
        while fits < len(rest) and text_width(" ".join(rest[: fits + 1]), _TITLE, bold=True) <= width:
            fits += 1
        lines.append(" ".join(rest[:fits]))
        rest = rest[fits:]
    lines += [" ".join(rest)] if rest else []
    return [shorten(line, _TITLE, width=width, bold=True) for line in lines]


def _lines(text: str, *, width: float) -> list[str]:
    lines = []
    for paragraph in text.splitlines():
        line = ""
        for word in paragraph.split():
            longer = f"{line} {word}".strip()
            if line and text_width(longer, _TEXT) > width:
                lines.append(line)
                longer = word
            line = longer
        lines += [shorten(line, _TEXT, width=width)] if line else []
    return lines


def _cut(content: SheetContent, part: Box, *, most: int) -> NDArray[np.uint8]:
    """Cut a part out of the image, with at most `most` pixels along its longer side."""
    height, width = content.satellite.shape[:2]
    sx, sy = width / content.map.satellite.width, height / content.map.satellite.height
    rows = slice(int(part.top * sy), max(int(part.top * sy) + 1, round(part.bottom * sy)))
    columns = slice(int(part.left * sx), max(int(part.left * sx) + 1, round(part.right * sx)))
    cut = content.satellite[rows, columns]
    scale = min(1.0, most / max(cut.shape[:2]))
    if scale == 1.0:
        return np.ascontiguousarray(cut)
    size = [max(1, round(side * scale)) for side in (cut.shape[1], cut.shape[0])]
    return np.asarray(cv2.resize(cut, size, interpolation=cv2.INTER_AREA), np.uint8)


def _fitted(label: _Label) -> str:
    """Truncate the beginning of a long label: names of photos differ at their ends."""
    text, width = label.text, text_width(label.text, _LABEL, bold=label.bold)
    while width > _LABEL_WIDTH:
        text = f"…{text.lstrip('…')[1:]}"
        width = text_width(text, _LABEL, bold=label.bold)
    return text


def _square(at: Point, reach: float) -> Box:
    return Box(at[0] - reach, at[1] - reach, at[0] + reach, at[1] + reach)
