"""The satellite image with the map's photos and the hypotheses on it, and a detail of the best place."""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from webapp.core.geo.types import MapPixel
from webapp.core.hypotheses.model import Answer, Hypothesis
from webapp.core.hypotheses.verdict import verdict_of
from webapp.core.mapmodel.model import Map
from webapp.render.canvas import Canvas, Point, text_width
from webapp.render.colours import EXPERIENCE, INK, PAPER, QUIET, RGB, TRUTH, probability_colour, text_on

MAX_SCALE = 8.0
ZOOM = 3.0
"""Magnification of a detail compared with the whole."""


@dataclass(frozen=True, slots=True)
class MapView:
    """A part of the satellite image, scaled."""

    # `left`, `top`, `right`, `bottom`: Map pixels.
    left: int
    top: int
    right: int
    bottom: int
    scale: float  # Picture pixels per map pixel

    @property
    def size(self) -> tuple[int, int]:
        """Width and height in the picture."""
        width, height = (self.right - self.left) * self.scale, (self.bottom - self.top) * self.scale
        return max(1, round(width)), max(1, round(height))

    def shown(self, position: MapPixel) -> Point:
        """Return a map position in the view, from the centre of its top-left pixel."""
        return (position.x - self.left) * self.scale - 0.5, (position.y - self.top) * self.scale - 0.5

    def fitted(self, size: tuple[int, int]) -> MapView:
        """Scale the same part to be as large as fits into `size`."""
        width, height = self.right - self.left, self.bottom - self.top
        scale = min(size[0] / width, size[1] / height, MAX_SCALE)
        return MapView(self.left, self.top, self.right, self.bottom, scale)


def overview(themap: Map, positions: list[MapPixel]) -> MapView:
    """Return a view of all experiences and all `positions` with a margin, at scale 1."""
    width, height = themap.satellite.width, themap.satellite.height
    seen = np.array([*(e.position for e in themap.experiences), *positions], dtype=np.float64).reshape(-1, 2)
    if not len(seen):
        return MapView(0, 0, width, height, 1.0)
    # A map with few photos still shows their surroundings: at least a quarter of the image.
    low, high = seen.min(axis=0), seen.max(axis=0)
    spread = np.maximum(high - low, max(width, height) / 4) * 1.14
    return _around((low + high) / 2, spread, (width, height), scale=1.0)


def detail(themap: Map, whole: MapView, *, centre: MapPixel, size: tuple[int, int]) -> MapView:
    """Return an enlarged view of the surroundings of a position, at most of this size."""
    scale = min(ZOOM * whole.scale, MAX_SCALE)
    spread = np.array(size, dtype=np.float64) / scale
    image = themap.satellite.width, themap.satellite.height
    return _around(np.array(centre), spread, image, scale=scale)


def _around(
    centre: NDArray[np.float64], spread: NDArray[np.float64], image: tuple[int, int], *, scale: float
) -> MapView:
    """Return the view of a box of this spread; beyond the image's border it is shifted, or smaller."""
    limit = np.array(image, dtype=np.float64)
    spread = np.minimum(np.maximum(np.floor(spread), 1), limit)
    left, top = np.floor(np.clip(centre - spread / 2, 0, limit - spread))
    return MapView(int(left), int(top), int(left + spread[0]), int(top + spread[1]), scale)


def ground(satellite: NDArray[np.uint8], themap: Map, *, view: MapView) -> NDArray[np.uint8]:
    """Cut a view out of the satellite image, with muted colours.

    Args:
        satellite: (height, width, 3) uint8. Blue, green, red. It may have another size than the map states:
            positions follow the stated one.

    Returns:
        (height, width, 3) uint8: Red, green, blue.
    """
    height, width = satellite.shape[:2]
    sx, sy = width / themap.satellite.width, height / themap.satellite.height
    columns = slice(int(view.left * sx), max(int(view.left * sx) + 1, round(view.right * sx)))
    rows = slice(int(view.top * sy), max(int(view.top * sy) + 1, round(view.bottom * sy)))
    way = cv2.INTER_AREA if view.scale < 1 else cv2.INTER_CUBIC
    part = cv2.resize(satellite[rows, columns], view.size, interpolation=way)
    grey = cv2.cvtColor(cv2.cvtColor(part, cv2.COLOR_BGR2GRAY), cv2.COLOR_GRAY2RGB)
    colour = cv2.cvtColor(part, cv2.COLOR_BGR2RGB)
    return np.asarray(cv2.addWeighted(colour, 0.6, grey, 0.4, 0), dtype=np.uint8)


def scale_bar(themap: Map, view: MapView) -> tuple[float, str]:
    """Return length in the picture and label of a round distance, at most 120 pixels long."""
    middle = MapPixel((view.left + view.right) / 2, (view.top + view.bottom) / 2)
    unit_px, unit = view.scale, "map pixels"
    if themap.georeference is not None:
        metres = themap.georeference.metres_per_pixel(middle)
        if math.isfinite(metres) and metres > 0:
            unit_px, unit = view.scale / metres, "m"
    power = 10.0 ** math.floor(math.log10(120 / unit_px))
    amount = max(step * power for step in (1, 2, 5) if step * power * unit_px <= 120)
    return amount * unit_px, f"{amount:g} {unit}"


BAND_PX = 104
_NAMED = 5
"""Number of places whose probability is written out; the colours show the others."""

_TEXT, _SMALL, _MARGIN, _BAR_PX = 20, 16, 16, 260


def draw_legend(
    canvas: Canvas, answer: Answer, *, top: int, scale_bar: tuple[float, str], truth: bool
) -> None:
    """Draw the legend.

    Args:
        top: Top of the legend's band.
        scale_bar: Length in pixels and label.
        truth: Whether the picture marks the true position.
    """
    canvas.text((_MARGIN, top + 34), headline(answer), size=_TEXT)
    y = top + 70
    x = _probability_bar(canvas, y)
    x = _mark(canvas, (x, y), "photo of the map")
    if any(h.radius_px is not None for h in answer.hypotheses):
        x = _mark(canvas, (x, y), "68 % radius")
    if truth:
        x = _mark(canvas, (x, y), "true position")
    length, label = scale_bar
    right = canvas.size[0] - _MARGIN
    canvas.line((right - length, y), (right, y), colour=INK, width=2)
    for end in (right - length, right):
        canvas.line((end, y - 5), (end, y + 5), colour=INK, width=2)
    canvas.text((right, y + 22), label, size=_SMALL, colour=QUIET, anchor="rs")


def headline(answer: Answer) -> str:
    """Summarise the answer in a line: places, or why there are none, and the remaining probabilities."""
    parts = []
    if answer.hypotheses:
        named = (f"{h.rank}: {_percent(h.probability)}" for h in answer.hypotheses[:_NAMED])
        parts.append("Place " + ",  ".join(named))
        if answer.abstained:
            likely = verdict_of(answer) == "off_map"
            parts.insert(0, f"{'Probably' if likely else 'Perhaps'} not on this map")
    elif answer.no_pose is not None:
        parts.append(f"No place found: {answer.no_pose.reason}")
    if answer.other_probability > 0:
        parts.append(f"places not shown: {_percent(answer.other_probability)}")
    if answer.off_map_probability is not None:
        parts.append(f"not on this map: {_percent(answer.off_map_probability)}")
    return "  ·  ".join(parts)


def _percent(probability: float) -> str:
    percent = 100 * probability
    if 0 < percent < 1:
        return "under 1 %"
    return "over 99 %" if 99 < percent < 100 else f"{percent:.0f} %"


def _probability_bar(canvas: Canvas, y: int) -> float:
    for i in range(_BAR_PX):
        canvas.box((_MARGIN + i, y - 6), (1, 12), colour=probability_colour(i / (_BAR_PX - 1)))
    for x, words, anchor in (
        (_MARGIN, "0", "ls"),
        (_MARGIN + _BAR_PX / 2, "probability of a place", "ms"),
        (_MARGIN + _BAR_PX, "1", "rs"),
    ):
        canvas.text((x, y + 22), words, size=_SMALL, colour=QUIET, anchor=anchor)
    return _MARGIN + _BAR_PX + 36


def _mark(canvas: Canvas, at: tuple[float, int], words: str) -> float:
    """Draw one mark with its meaning; return where the next one begins."""
    x, y = at
    middle = (x + 8, y)
    if words == "photo of the map":
        canvas.disc(middle, 5, colour=INK)
        canvas.disc(middle, 4, colour=EXPERIENCE)
    elif words == "true position":
        canvas.disc(middle, 2, colour=TRUTH)
        for dx, dy in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
            canvas.line((x + 8 + 5 * dx, y + 5 * dy), (x + 8 + 10 * dx, y + 10 * dy), colour=TRUTH, width=2)
    else:
        canvas.ring(middle, 8, colour=QUIET, width=2)
    canvas.text((x + 26, y), words, size=_SMALL, colour=INK, anchor="lm")
    return x + 26 + text_width(words, _SMALL) + 30


WIDTH_PX = 1600
HEIGHT_PX = 1100
DETAIL_PX = 480
"""Width of a detail right of the map, height of one below it."""

GAP_PX = 8
LEAST_WIDTH_PX = 1040
"""Width that the legend needs."""

DOT_PX = 3.5
DISC_PX = 13.0
_HALO: RGB = (255, 255, 255)


def draw_map(
    satellite: NDArray[np.uint8], themap: Map, *, answer: Answer, truth: MapPixel | None = None
) -> Image.Image:
    """Draw the hypotheses of an answer on the map.

    Args:
        satellite: (height, width, 3) uint8. Blue, green, red.
        truth: Marked if it is known.

    Returns:
        RGB. At the top left the part of the map with all experiences; right of it, or below a wide one, the
            surroundings of the best hypothesis enlarged; at the bottom a legend.
    """
    whole, close = _views(themap, answer, truth)
    panels = [_panel(satellite, themap, view, answer=answer, truth=truth) for view in (whole, close) if view]
    if close is not None:
        _outline(panels[0], whole, close)
    at = _places(panels, side_by_side=not _is_wide(whole))
    width = max(LEAST_WIDTH_PX, *(x + p.size[0] for (x, _), p in zip(at, panels, strict=True)))
    height = max(y + p.size[1] for (_, y), p in zip(at, panels, strict=True))
    canvas = Canvas(np.full((height + BAND_PX, width, 3), PAPER, dtype=np.uint8))
    for place, panel in zip(at, panels, strict=True):
        canvas.paste(panel.pixels, at=place)
    draw_legend(canvas, answer, top=height, scale_bar=scale_bar(themap, whole), truth=truth is not None)
    return canvas.image()


def _is_wide(whole: MapView) -> bool:
    return whole.right - whole.left > 2 * (whole.bottom - whole.top)


def _views(themap: Map, answer: Answer, truth: MapPixel | None) -> tuple[MapView, MapView | None]:
    marked = [h.position for h in answer.hypotheses] + ([] if truth is None else [truth])
    part = overview(themap, marked)
    if not answer.hypotheses:
        return part.fitted((WIDTH_PX, HEIGHT_PX)), None
    centre = answer.hypotheses[0].position
    if _is_wide(part):
        whole = part.fitted((WIDTH_PX, HEIGHT_PX - DETAIL_PX))
        return whole, detail(themap, whole, centre=centre, size=(whole.size[0], DETAIL_PX))
    whole = part.fitted((WIDTH_PX - DETAIL_PX - GAP_PX, HEIGHT_PX))
    return whole, detail(themap, whole, centre=centre, size=(DETAIL_PX, whole.size[1]))


def _places(panels: list[Canvas], *, side_by_side: bool) -> list[tuple[int, int]]:
    width, height = panels[0].size
    second = (width + GAP_PX, 0) if side_by_side else (0, height + GAP_PX)
    return [(0, 0), second][: len(panels)]


def _panel(
    satellite: NDArray[np.uint8], themap: Map, view: MapView, *, answer: Answer, truth: MapPixel | None
) -> Canvas:
    panel = Canvas(ground(satellite, themap, view=view))
    for experience in themap.experiences:
        at = view.shown(experience.position)
        panel.disc(at, DOT_PX + 1, colour=INK)
        panel.disc(at, DOT_PX, colour=EXPERIENCE)
    for hypothesis in reversed(answer.hypotheses):
        _uncertainty(panel, hypothesis, view)
    if truth is not None:
        _target(panel, view.shown(truth))
    for hypothesis in reversed(answer.hypotheses):
        _hypothesis(panel, hypothesis, view, north_deg=_north(themap, hypothesis))
    return panel


def _uncertainty(panel: Canvas, hypothesis: Hypothesis, view: MapView) -> None:
    if hypothesis.radius_px is None:
        return
    centre, radius = view.shown(hypothesis.position), hypothesis.radius_px * view.scale
    colour = probability_colour(hypothesis.probability)
    with panel.faint(0.22):
        panel.disc(centre, radius, colour=colour)
    panel.ring(centre, radius, colour=_HALO, width=4)
    panel.ring(centre, radius, colour=colour, width=2)


def _hypothesis(panel: Canvas, hypothesis: Hypothesis, view: MapView, *, north_deg: float) -> None:
    centre, colour = view.shown(hypothesis.position), probability_colour(hypothesis.probability)
    if hypothesis.heading_deg is not None and math.isfinite(north_deg):
        angle = math.radians(hypothesis.heading_deg + north_deg)
        direction = math.sin(angle), -math.cos(angle)
        tip = (centre[0] + 2.2 * DISC_PX * direction[0], centre[1] + 2.2 * DISC_PX * direction[1])
        panel.line(centre, tip, colour=_HALO, width=9)
        panel.line(centre, tip, colour=INK, width=7)
        panel.line(centre, tip, colour=colour, width=4)
    panel.disc(centre, DISC_PX + 3, colour=_HALO)
    panel.disc(centre, DISC_PX + 1.5, colour=INK)
    panel.disc(centre, DISC_PX, colour=colour)
    panel.text(centre, str(hypothesis.rank), size=16, colour=text_on(colour), anchor="mm")


def _north(themap: Map, hypothesis: Hypothesis) -> float:
    """Return the direction of north in the image, degrees clockwise from up; 0 without a georeference."""
    north = 0.0 if themap.georeference is None else themap.georeference.north_deg(hypothesis.position)
    return north if math.isfinite(north) else 0.0


def _target(panel: Canvas, centre: Point) -> None:
    """Mark the truth by four strokes around a dot: a disc on the same place leaves their ends visible."""
    for colour, width, grow in ((_HALO, 7, 1.0), (TRUTH, 3, 0.0)):
        panel.disc(centre, 3 + grow, colour=colour)
        for dx, dy in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
            start, end = ((centre[0] + dx * reach, centre[1] + dy * reach) for reach in (7.0, 16.0))
            panel.line(start, end, colour=colour, width=width)


def _outline(panel: Canvas, whole: MapView, close: MapView) -> None:
    left, top = whole.shown(MapPixel(close.left, close.top))
    right, bottom = whole.shown(MapPixel(close.right, close.bottom))
    corners = [(left, top), (right, top), (right, bottom), (left, bottom)]
    for colour, width in ((_HALO, 4), (INK, 2)):
        for start, end in zip(corners, [*corners[1:], corners[0]], strict=True):
            panel.line(start, end, colour=colour, width=width)
