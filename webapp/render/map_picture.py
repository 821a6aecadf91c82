"""The satellite image with the map's photos and the hypotheses on it, and a detail of the best place."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from webapp.core.geo.types import MapPixel
from webapp.core.hypotheses.model import Answer, Hypothesis
from webapp.core.mapmodel.model import Map
from webapp.render.canvas import Canvas, Point
from webapp.render.colours import EXPERIENCE, INK, PAPER, RGB, TRUTH, probability_colour, text_on
from webapp.render.map_legend import BAND_PX, draw_legend
from webapp.render.map_view import View, detail, ground, overview, scale_bar

WIDTH_PX = 1600
HEIGHT_PX = 1100
DETAIL_PX = 480
"""Width of a detail beside the map, height of one below it."""

GAP_PX = 8
LEAST_WIDTH_PX = 1040
"""The legend needs so much, however narrow the map is."""

DOT_PX = 3.5
DISC_PX = 13.0
_HALO: RGB = (255, 255, 255)


def draw_map(
    satellite: NDArray[np.uint8], themap: Map, *, answer: Answer, truth: MapPixel | None = None
) -> Image.Image:
    """Draw the hypotheses of an answer on the map.

    Parameters
    ----------
    satellite : (height, width, 3) uint8
        Blue, green, red.
    themap : Map
    answer : Answer
    truth : MapPixel, optional
        Marked, when it is known.

    Returns
    -------
    PIL.Image.Image
        RGB. At the top left the part of the map with all experiences; beside it, or below a wide one, the
        surroundings of the best hypothesis enlarged; at the bottom a legend.
    """
    whole, close = _views(themap, answer, truth)
    panels = [_panel(satellite, themap, view, answer=answer, truth=truth) for view in (whole, close) if view]
    if close is not None:
        _outline(panels[0], whole, close)
    at = _places(panels, beside=not _is_wide(whole))
    width = max(LEAST_WIDTH_PX, *(x + p.size[0] for (x, _), p in zip(at, panels, strict=True)))
    height = max(y + p.size[1] for (_, y), p in zip(at, panels, strict=True))
    canvas = Canvas(np.full((height + BAND_PX, width, 3), PAPER, dtype=np.uint8))
    for place, panel in zip(at, panels, strict=True):
        canvas.paste(panel.pixels, at=place)
    draw_legend(canvas, answer, top=height, scale_bar=scale_bar(themap, whole), truth=truth is not None)
    return canvas.image()


def _is_wide(whole: View) -> bool:
    return whole.right - whole.left > 2 * (whole.bottom - whole.top)


def _views(themap: Map, answer: Answer, truth: MapPixel | None) -> tuple[View, View | None]:
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


def _places(panels: list[Canvas], *, beside: bool) -> list[tuple[int, int]]:
    width, height = panels[0].size
    second = (width + GAP_PX, 0) if beside else (0, height + GAP_PX)
    return [(0, 0), second][: len(panels)]


def _panel(
    satellite: NDArray[np.uint8], themap: Map, view: View, *, answer: Answer, truth: MapPixel | None
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


def _uncertainty(panel: Canvas, hypothesis: Hypothesis, view: View) -> None:
    if hypothesis.radius_px is None:
        return
    centre, radius = view.shown(hypothesis.position), hypothesis.radius_px * view.scale
    colour = probability_colour(hypothesis.probability)
    with panel.faint(0.22):
        panel.disc(centre, radius, colour=colour)
    panel.ring(centre, radius, colour=_HALO, width=4)
    panel.ring(centre, radius, colour=colour, width=2)


def _hypothesis(panel: Canvas, hypothesis: Hypothesis, view: View, *, north_deg: float) -> None:
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
    """Direction of north in the image, degrees clockwise from up; up without a georeference."""
    return 0.0 if themap.georeference is None else themap.georeference.north_deg(hypothesis.position)


def _target(panel: Canvas, centre: Point) -> None:
    """Mark the truth by four strokes around a dot: a disc on the same place leaves their ends visible."""
    for colour, width, grow in ((_HALO, 7, 1.0), (TRUTH, 3, 0.0)):
        panel.disc(centre, 3 + grow, colour=colour)
        for dx, dy in ((1, 1), (1, -1), (-1, 1), (-1, -1)):
            start, end = ((centre[0] + dx * reach, centre[1] + dy * reach) for reach in (7.0, 16.0))
            panel.line(start, end, colour=colour, width=width)


def _outline(panel: Canvas, whole: View, close: View) -> None:
    """Show on the whole map where the detail is."""
    left, top = whole.shown(MapPixel(close.left, close.top))
    right, bottom = whole.shown(MapPixel(close.right, close.bottom))
    corners = [(left, top), (right, top), (right, bottom), (left, bottom)]
    for colour, width in ((_HALO, 4), (INK, 2)):
        for start, end in zip(corners, [*corners[1:], corners[0]], strict=True):
            panel.line(start, end, colour=colour, width=width)
