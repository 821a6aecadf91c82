"""The marks on a printed map, and its scale and direction of north."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from webapp.core.geo.georeference import Georeference
from webapp.core.geo.types import MapPixel
from webapp.render.canvas import Point
from webapp.render.colours import INK, RGB, probability_colour
from webapp.render.sheet.drawing import Box, Drawing, TextStyle
from webapp.render.sheet.options import SheetAnswer

PHOTO: RGB = (22, 104, 220)
CONTROL_POINT: RGB = (255, 212, 0)
NOTE: RGB = (176, 26, 112)
_RIM: RGB = (255, 255, 255)

LEAST_DOT_PT, MOST_DOT_PT = 1.1, 3.4
ANSWER_PT = 5.0
CROSS_PT = 4.0
NOTE_PT = 5.0
_POINTER = 3.2
"""Length of the pointer in a photo's viewing direction, in radii of its dot."""

_STEP_DEG = 1e-5
"""Step northward, about a metre, for computing the direction of north."""

_UNEVEN = 1.05
"""A scale that varies more across the image is printed as approximate."""

_POINTS_PER_METRE = 72 / 0.0254


@dataclass(frozen=True, slots=True)
class SheetView:
    """The part of the image that is printed, and where it is on the paper."""

    part: Box  # Map pixels
    frame: Box  # Points

    @property
    def scale(self) -> float:
        """Points per map pixel."""
        return (self.frame.right - self.frame.left) / (self.part.right - self.part.left)

    def shown(self, position: MapPixel) -> Point:
        """Return a map position on the paper."""
        x = self.frame.left + (position.x - self.part.left) * self.scale
        return x, self.frame.top + (position.y - self.part.top) * self.scale

    def shows(self, position: MapPixel) -> bool:
        """Return whether a position is in the part."""
        return (
            self.part.left <= position.x <= self.part.right
            and self.part.top <= position.y <= self.part.bottom
        )


@dataclass(frozen=True, slots=True)
class Scale:
    metres: float  # A round distance
    length: float  # Length of that distance on the paper, points
    ratio: float  # Denominator of the scale, as in 1 : 1000
    even: bool  # Whether it is nearly the same all over the map


def scale_of(georeference: Georeference, view: SheetView, *, longest: float) -> Scale | None:
    """Compute the scale in the middle of a view; None if the image has none there.

    Args:
        longest: Maximum length of the round distance on the paper, points.
    """
    left, top, right, bottom = view.part
    corners = [MapPixel(x, y) for x in (left, right) for y in (top, bottom)]
    middle = georeference.metres_per_pixel(MapPixel((left + right) / 2, (top + bottom) / 2))
    if not (math.isfinite(middle) and middle > 0):
        return None
    all_over = [georeference.metres_per_pixel(corner) for corner in corners]
    even = all(middle / _UNEVEN <= there <= middle * _UNEVEN for there in all_over)
    points_per_metre = view.scale / middle
    power = 10.0 ** math.floor(math.log10(longest / points_per_metre))
    metres = max(step * power for step in (1, 2, 5) if step * power * points_per_metre <= longest)
    return Scale(metres, metres * points_per_metre, _POINTS_PER_METRE / points_per_metre, even)


def norths(georeference: Georeference | None, positions: Sequence[MapPixel]) -> NDArray[np.float64]:
    """Return the direction of north at map positions, degrees clockwise from image-up; 0 if unknown."""
    if georeference is None or not positions:
        return np.zeros(len(positions))
    pixels = np.asarray(positions, np.float64)
    northward = georeference.latlon_from_pixel(pixels) + np.array([_STEP_DEG, 0.0])
    towards = georeference.pixel_from_latlon(northward) - pixels
    return np.nan_to_num(np.degrees(np.arctan2(towards[:, 0], -towards[:, 1])))


def dot_radius(at: NDArray[np.float64]) -> float:
    """Return the radius of dots at (n, 2) positions on the paper, points; smaller if they are dense."""
    distinct = np.unique(np.round(at, 1), axis=0)
    if len(distinct) < 2:
        return MOST_DOT_PT
    some = distinct[:: -(-len(distinct) // 400)]
    nearest = [np.partition(np.hypot(*(distinct - one).T), 1)[1] for one in some]
    return float(np.clip(0.4 * np.median(nearest), LEAST_DOT_PT, MOST_DOT_PT))


def draw_photo(drawing: Drawing, at: Point, *, radius: float, angle_deg: float | None) -> None:
    """Draw a dot with a pointer in the viewing direction: `angle_deg` is clockwise from up on the paper."""
    rim = max(0.4, 0.25 * radius)
    if angle_deg is not None:
        angle = math.radians(angle_deg)
        ahead = np.array([math.sin(angle), -math.cos(angle)])
        across = np.array([-ahead[1], ahead[0]])
        for wider, colour in ((rim, _RIM), (0.0, PHOTO)):
            tip = np.array(at) + (_POINTER * radius + 1.6 * wider) * ahead
            sides = (np.array(at) + sign * (0.95 * radius + wider) * across for sign in (1, -1))
            corners = [(float(x), float(y)) for x, y in (tip, *sides)]
            drawing.polygon(corners, colour=colour)
    drawing.disc(at, radius + rim, colour=_RIM)
    drawing.disc(at, radius, colour=PHOTO)


def draw_control_point(drawing: Drawing, at: Point) -> None:
    """Draw a diagonal cross."""
    for width, colour in ((3.0, INK), (1.4, CONTROL_POINT)):
        for dx, dy in ((1, 1), (1, -1)):
            ends = [(at[0] + side * dx * CROSS_PT, at[1] + side * dy * CROSS_PT) for side in (1, -1)]
            drawing.line(*ends, colour=colour, width=width)


def draw_note(drawing: Drawing, at: Point, *, number: int) -> None:
    for side, colour in ((NOTE_PT + 1, _RIM), (NOTE_PT, NOTE)):
        corners = [(at[0] + dx * side, at[1] + dy * side) for dx, dy in ((-1, -1), (1, -1), (1, 1), (-1, 1))]
        drawing.polygon(corners, colour=colour)
    style = TextStyle(7, colour=_RIM, bold=True, anchor="middle")
    drawing.text((at[0], at[1] + 2.5), str(number), style=style)


def draw_answer_area(drawing: Drawing, answer: SheetAnswer, *, view: SheetView) -> None:
    if answer.radius_px is not None:
        at, colour, radius = (
            view.shown(answer.position),
            probability_colour(answer.probability),
            answer.radius_px,
        )
        drawing.disc(at, radius * view.scale, colour=colour, opacity=0.2)
        drawing.ring(at, radius * view.scale, colour=colour, width=0.8)


def draw_answer(drawing: Drawing, answer: SheetAnswer, *, view: SheetView, angle_deg: float | None) -> None:
    """Draw the place of an answer, in the colour of its probability."""
    at, colour = view.shown(answer.position), probability_colour(answer.probability)
    if angle_deg is not None:
        angle = math.radians(angle_deg)
        tip = (at[0] + 2.4 * ANSWER_PT * math.sin(angle), at[1] - 2.4 * ANSWER_PT * math.cos(angle))
        for width, ink in ((3.6, _RIM), (2.0, colour)):
            drawing.line(at, tip, colour=ink, width=width)
    for more, ink in ((1.4, _RIM), (0.7, INK), (0.0, colour)):
        drawing.disc(at, ANSWER_PT + more, colour=ink)


def draw_scale(drawing: Drawing, scale: Scale, *, at: Point, text: str) -> None:
    """Draw a bar of two halves; `at` is its left end."""
    (x, y), half = at, scale.length / 2
    for n in range(2):
        left, right = x + n * half, x + (n + 1) * half
        corners = [(left, y - 4), (right, y - 4), (right, y), (left, y)]
        drawing.polygon(corners, colour=INK)
        if n:
            inner = [(left, y - 3.2), (right - 0.8, y - 3.2), (right - 0.8, y - 0.8), (left, y - 0.8)]
            drawing.polygon(inner, colour=_RIM)
    style = TextStyle(8, anchor="middle")
    for share in (0.0, 0.5, 1.0):
        unit = " m" if share == 1 else ""
        drawing.text((x + share * scale.length, y - 7), f"{share * scale.metres:g}{unit}", style=style)
    drawing.text((x, y + 10), text, style=TextStyle(8))


def draw_north(drawing: Drawing, centre: Point, *, angle_deg: float) -> None:
    """Draw an arrow to the north, 30 points long; the angle is clockwise from up."""
    angle = math.radians(angle_deg)
    ahead = np.array([math.sin(angle), -math.cos(angle)])
    across = np.array([-ahead[1], ahead[0]])
    middle = np.array(centre)

    def corner(forward: float, sideward: float) -> Point:
        x, y = (middle + forward * ahead + sideward * across).tolist()
        return x, y

    drawing.polygon([corner(15, 0), corner(-11, 7), corner(-6, 0)], colour=INK)
    drawing.polygon([corner(15, 0), corner(-11, -7), corner(-6, 0)], colour=INK)
    drawing.polygon([corner(11.5, 0.9), corner(-9, 5.6), corner(-5.2, 0.9)], colour=_RIM)
    x, y = corner(21, 0)
    drawing.text((x, y + 3.6), "N", style=TextStyle(10, bold=True, anchor="middle"))
