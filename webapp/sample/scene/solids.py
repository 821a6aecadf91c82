"""Buildings with their facades, trunks and furniture, as textured quadrilaterals."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from webapp.sample.scene.masonry import (
    PIXELS_PER_METRE,
    Colour,
    Style,
    darker,
    fill_box,
    roof_surface,
    surface,
)
from webapp.sample.scene.noise import fractal, jitter
from webapp.sample.scene.plan import Footprint
from webapp.sample.scene.raster import Quad, Texture

_UP = np.array([0.0, 0.0, 1.0])
EAVES_M, RISE = 0.45, 0.62
"""Overhang of a roof over the walls, and its slope (rise over run)."""


def lift(point: NDArray[np.float64], height: float) -> NDArray[np.float64]:
    """Return a (2,) point of the ground at a height."""
    return np.array([point[0], point[1], height])


def wall_height(house: Footprint) -> float:
    """Return the height of the eaves, metres."""
    return house.floors * FLOOR_M + 0.35


def ridge_height(house: Footprint) -> float:
    """Return the height of the ridge, metres."""
    return wall_height(house) + RISE * house.depth / 2


def house_quads(rng: np.random.Generator, house: Footprint, *, style: Style) -> list[Quad]:
    """Build a house: four walls, two gables, the roof and a chimney."""
    height = wall_height(house)
    corners = house.corners()
    quads = []
    for number, (left, right) in enumerate(zip(corners, np.roll(corners, -1, axis=0), strict=True)):
        along = lift(right - left, 0.0)
        size = (float(np.linalg.norm(along)), height)
        picture = front(rng, size, style=style, entrance=number == 0)
        # corners are counter-clockwise from above: seen from outside, a wall goes from left to right
        quads.append(Quad(lift(left, 0.0), along, _UP * height, Texture.of(picture)))
        if number in (1, 3):
            gable = _gable(rng, size[0], style)
            rise = RISE * size[0] / 2
            quads.append(Quad(lift(left, height), along, _UP * rise, Texture.of(gable)))
    return [*quads, *_roof(rng, house, style), *_chimney(rng, house, style)]


def _gable(rng: np.random.Generator, width: float, style: Style) -> NDArray[np.uint8]:
    shape = (round(RISE * width / 2 * PIXELS_PER_METRE), round(width * PIXELS_PER_METRE))
    wall = surface(rng, shape, material=style.material, colour=style.wall)
    if RISE * width / 2 > style.window_m[1] + 1.2:
        window(rng, wall, foot=(shape[1] // 2, shape[0] + PIXELS_PER_METRE // 2), style=style)
    share = np.abs(np.arange(shape[1]) / shape[1] - 0.5) * 2
    inside = np.arange(shape[0])[:, None] / shape[0] >= share[None, :]
    return np.dstack([wall, np.where(inside, 255, 0).astype(np.uint8)])


def _roof(rng: np.random.Generator, house: Footprint, style: Style) -> list[Quad]:
    """Build two slopes that meet over the middle, with eaves on all sides."""
    reach = house.depth / 2 + EAVES_M
    length = house.width + 2 * EAVES_M
    slope_px = round(reach * np.hypot(1, RISE) * PIXELS_PER_METRE)
    top = ridge_height(house) + 0.05
    quads = []
    for sign in (1.0, -1.0):
        along = lift(house.side * sign * length, 0.0)
        foot = house.centre + house.facing * sign * reach - house.side * sign * length / 2
        up = lift(-house.facing * sign * reach, RISE * reach)
        picture = roof_surface(rng, (slope_px, round(length * PIXELS_PER_METRE)), colour=style.roof)
        quads.append(Quad(lift(foot, top - RISE * reach), along, up, Texture.of(picture), two_sided=True))
    return quads


def _chimney(rng: np.random.Generator, house: Footprint, style: Style) -> list[Quad]:
    at = house.centre + house.side * float(rng.uniform(-0.35, 0.35)) * house.width
    low = ridge_height(house) - 0.9
    bricks = Texture.of(surface(rng, (90, 40), material="brick", colour=(132, 84, 70)))
    return box_quads(lift(at, low), house.side, size=(0.8, 0.8, 1.9), texture=bricks)


def box_quads(
    foot: NDArray[np.float64],
    side: NDArray[np.float64],
    *,
    size: tuple[float, float, float],
    texture: Texture,
) -> list[Quad]:
    """Build a box.

    Args:
        foot: (3,) float64. Centre of its base.
        side: (2,) float64. Unit vector along its width.
        size: Width, depth, height, metres.
        texture: On all sides and on top.
    """
    across = lift(side * size[0] / 2, 0.0)
    out = lift(np.array([side[1], -side[0]]) * size[1] / 2, 0.0)
    up = _UP * size[2]
    corners = [foot - across + out, foot + across + out, foot + across - out, foot - across - out]
    walls = [Quad(corners[i], corners[(i + 1) % 4] - corners[i], up, texture) for i in range(4)]
    return [*walls, Quad(corners[0] + up, across * 2, -out * 2, texture)]


_Box = tuple[float, float, float, float]


def window(rng: np.random.Generator, wall: NDArray[np.uint8], *, foot: tuple[int, int], style: Style) -> None:
    """Paint a window over the point `foot` of the floor's lower edge; the wall is changed in place."""
    width, height = (side * PIXELS_PER_METRE for side in style.window_m)
    left = foot[0] - width / 2
    bottom = foot[1] - 0.95 * PIXELS_PER_METRE
    box = (left, bottom - height, left + width, bottom)
    if style.shutters:
        for side in (box[0] - width * 0.42, box[2] + width * 0.06):
            _shutter(wall, (side, box[1], side + width * 0.36, bottom), style.door)
    frame = style.frame_px
    fill_box(wall, (box[0] - frame, box[1] - frame, box[2] + frame, box[3] + 2), colour=style.trim)
    _lintel(wall, box, style)
    fill_box(wall, (box[0] - frame - 3, box[3], box[2] + frame + 3, box[3] + 6), colour=style.trim)
    fill_box(
        wall, (box[0] - frame - 3, box[3] + 6, box[2] + frame + 3, box[3] + 9), colour=darker(style.trim, 0.5)
    )
    _glass(rng, wall, box)
    _bars(wall, box, style)
    if rng.random() < style.flower_boxes:
        _flower_box(rng, wall, box)


def door(rng: np.random.Generator, wall: NDArray[np.uint8], *, foot: tuple[int, int], style: Style) -> None:
    """Paint a door with its step at `foot`; the wall is changed in place."""
    width, height = 1.35 * PIXELS_PER_METRE, 2.25 * PIXELS_PER_METRE
    left, bottom = foot[0] - width / 2, foot[1]
    fill_box(wall, (left - 8, bottom - height - 10, left + width + 8, bottom), colour=style.trim)
    fill_box(wall, (left, bottom - height, left + width, bottom), colour=style.door)
    for column in range(2):
        for row in range(3):
            x, y = left + 5 + column * width / 2, bottom - height + 7 + row * height / 3
            panel = (x, y, x + width / 2 - 10, y + height / 3 - 12)
            fill_box(wall, panel, colour=darker(style.door, 0.68))
            fill_box(wall, (panel[0] + 2, panel[1] + 3, panel[2], panel[3]), colour=darker(style.door, 0.86))
    fill_box(
        wall,
        (left + width / 2 - 1, bottom - height, left + width / 2 + 1, bottom),
        colour=darker(style.door, 0.4),
    )
    knob = (round(left + width / 2 + 6), round(bottom - height * 0.45))
    cv2.circle(wall, knob, 3, (214, 190, 110), -1)
    number = str(int(rng.integers(1, 99)))
    fill_box(wall, (left + width + 14, bottom - 86, left + width + 40, bottom - 68), colour=(24, 52, 110))
    at = (round(left + width + 17), round(bottom - 71))
    cv2.putText(wall, number, at, _FONT, 0.5, (240, 240, 240), 1, cv2.LINE_AA)
    fill_box(wall, (left - 14, bottom - 7, left + width + 14, bottom), colour=(150, 146, 140))


def _lintel(wall: NDArray[np.uint8], box: _Box, style: Style) -> None:
    left, top, right, _ = (round(side) for side in box)
    top -= style.frame_px
    if style.lintel == "beam":
        fill_box(wall, (left - 9, top - 6, right + 9, top), colour=darker(style.trim, 0.85))
    elif style.lintel == "gable":
        gable = np.array([[left - 10, top], [right + 10, top], [(left + right) // 2, top - 18]], np.int32)
        cv2.fillPoly(wall, [gable], darker(style.trim, 0.9), cv2.LINE_AA)
    elif style.lintel == "arch":
        axes = ((right - left) // 2 + style.frame_px, 13)
        cv2.ellipse(wall, ((left + right) // 2, top), axes, 0, 180, 360, style.trim, -1, cv2.LINE_AA)
        cv2.ellipse(
            wall, ((left + right) // 2, top), (axes[0] - 6, 7), 0, 180, 360, style.door, -1, cv2.LINE_AA
        )


def _glass(rng: np.random.Generator, wall: NDArray[np.uint8], box: _Box) -> None:
    left, top, right, bottom = (round(side) for side in box)
    height, width = bottom - top, right - left
    if top < 0 or left < 0 or right > wall.shape[1]:
        return
    fall = np.linspace(1.25, 0.7, height, dtype=np.float32)[:, None, None]
    glass = np.array(jitter(rng, (62, 76, 88), amount=8), np.float32) * fall
    # reflections of sky and trees
    line = height * (rng.uniform(0.2, 0.7) + 0.16 * fractal(rng, (2, width), cell_px=20, octaves=3)[0])
    sky = np.arange(height)[:, None] < line[None, :]
    clouds = 1 + 0.4 * fractal(rng, (height, width), cell_px=24, octaves=3)
    glass = np.where(
        sky[..., None], np.array(jitter(rng, (132, 156, 176), amount=12), np.float32) * fall, glass
    )
    glass = np.ascontiguousarray(glass * clouds[..., None], np.float32)
    _behind(rng, glass, fall)
    wall[top:bottom, left:right] = np.clip(glass, 0, 255).astype(np.uint8)


def _behind(rng: np.random.Generator, glass: NDArray[np.float32], fall: NDArray[np.float32]) -> None:
    """Paint curtains, a blind, a plant, or nothing behind the glass."""
    height, width = glass.shape[:2]
    kind = rng.random()
    if kind < 0.35:  # curtains to both sides
        share = int(width * rng.uniform(0.15, 0.4))
        cloth = np.array(jitter(rng, (196, 188, 176), amount=22), np.float32)
        folds = 1 + 0.12 * np.sin(np.arange(width) * rng.uniform(0.5, 1.1))[None, :, None]
        drawn = np.broadcast_to(cloth * folds * fall, glass.shape)
        glass[:, :share], glass[:, -share:] = drawn[:, :share], drawn[:, -share:]
    elif kind < 0.6:  # a blind, partly down
        depth = int(height * rng.uniform(0.15, 0.75))
        slats = 0.85 + 0.15 * (np.arange(depth) % 5 > 0)[:, None, None]
        glass[:depth] = np.array(jitter(rng, (205, 200, 186), amount=12), np.float32) * slats
    elif kind < 0.8:  # a pot plant on the sill
        centre = (int(width * rng.uniform(0.25, 0.75)), int(height * 0.72))
        for _ in range(14):
            spot = np.array(centre) + rng.normal(0, width * 0.1, 2)
            cv2.circle(glass, (int(spot[0]), int(spot[1])), 3, jitter(rng, (66, 110, 52), amount=18), -1)
        cv2.rectangle(glass, (centre[0] - 5, centre[1] + 4), (centre[0] + 6, height), (150, 84, 56), -1)


def _bars(wall: NDArray[np.uint8], box: _Box, style: Style) -> None:
    left, top, right, bottom = box
    across, down = style.panes
    for step in range(1, across):
        x = left + (right - left) * step / across
        fill_box(wall, (x - 1.5, top, x + 1.5, bottom), colour=style.trim)
    for step in range(1, down):
        y = top + (bottom - top) * step / down
        fill_box(wall, (left, y - 1.5, right, y + 1.5), colour=style.trim)


def _flower_box(rng: np.random.Generator, wall: NDArray[np.uint8], box: _Box) -> None:
    left, right, top = box[0] - 4, box[2] + 4, box[3] - 2
    fill_box(wall, (left, top, right, top + 11), colour=(104, 72, 50))
    bloom = jitter(rng, (190, 90, 110), amount=55)
    for _ in range(38):
        spot = (int(rng.uniform(left, right)), int(top + rng.normal(-3, 4)))
        colour = bloom if rng.random() < 0.45 else jitter(rng, (70, 116, 54), amount=14)
        cv2.circle(wall, spot, int(rng.integers(1, 4)), colour, -1, cv2.LINE_AA)


def _shutter(wall: NDArray[np.uint8], box: _Box, colour: Colour) -> None:
    fill_box(wall, box, colour=colour)
    for y in np.arange(box[1] + 3, box[3] - 2, 5):
        fill_box(wall, (box[0] + 2, y, box[2] - 2, y + 2), colour=darker(colour, 0.7))


_FONT = cv2.FONT_HERSHEY_DUPLEX


def sign(wall: NDArray[np.uint8], *, middle: tuple[int, int], style: Style) -> None:
    """Hang the building's name over its door."""
    scale = 1.05
    (width, height), _ = cv2.getTextSize(style.name, _FONT, scale, 2)
    left = int(np.clip(middle[0] - width // 2, 14, max(14, wall.shape[1] - width - 14)))
    top = middle[1] - height // 2
    board = (left - 12, top - 9, left + width + 12, top + height + 11)
    fill_box(wall, board, colour=darker(style.door, 0.55))
    cv2.rectangle(wall, (board[0], board[1]), (board[2], board[3]), (232, 222, 190), 2, cv2.LINE_AA)
    cv2.putText(wall, style.name, (left, top + height), _FONT, scale, (246, 238, 214), 2, cv2.LINE_AA)


def poster(rng: np.random.Generator, wall: NDArray[np.uint8], *, middle: int) -> None:
    """Hang a notice at eye height: shapes and a few lines of letters."""
    height, width = wall.shape[:2]
    wide, high = int(rng.integers(26, 44)), int(rng.integers(36, 60))
    left = int(np.clip(middle - wide // 2, 0, width - wide))
    top = height - round(rng.uniform(1.1, 1.6) * PIXELS_PER_METRE) - high // 2
    paper = np.full((high, wide, 3), rng.integers(150, 250, 3), np.uint8)
    for _ in range(4):
        colour = jitter(rng, (128, 110, 100), amount=70)
        spot = (int(rng.integers(wide)), int(rng.integers(high // 2)))
        cv2.circle(paper, spot, int(rng.integers(3, 11)), colour, -1, cv2.LINE_AA)
    for y in range(high // 2 + 6, high - 3, 6):
        word = "".join(chr(65 + letter) for letter in rng.integers(0, 26, 6))
        cv2.putText(paper, word, (3, y), cv2.FONT_HERSHEY_PLAIN, 0.5, (30, 30, 36), 1)
    wall[top : top + high, left : left + wide] = paper


def mural(rng: np.random.Generator, wall: NDArray[np.uint8]) -> None:
    """Paint a framed landscape of plain shapes over most of the ground floor."""
    height, width = wall.shape[:2]
    wide = min(width - 2 * PIXELS_PER_METRE, round(rng.uniform(3.5, 6.0) * PIXELS_PER_METRE))
    high = round(2.1 * PIXELS_PER_METRE)
    left = int(rng.integers(PIXELS_PER_METRE // 2, max(PIXELS_PER_METRE // 2 + 1, width - wide)))
    top = height - high - round(0.4 * PIXELS_PER_METRE)
    picture = np.full((high, wide, 3), jitter(rng, (150, 190, 205), amount=40), np.uint8)
    spot = (int(rng.integers(wide)), int(rng.integers(high // 2)))
    cv2.circle(
        picture, spot, int(rng.integers(12, 30)), jitter(rng, (235, 190, 80), amount=30), -1, cv2.LINE_AA
    )
    x = np.arange(wide)
    for layer in range(4):
        hills = high * (0.3 + 0.17 * layer) + fractal(rng, (2, wide), cell_px=90, octaves=2)[0] * 22
        outline = np.column_stack([x, hills])
        polygon = np.concatenate([outline, [[wide, high], [0, high]]]).astype(np.int32)
        cv2.fillPoly(picture, [polygon], jitter(rng, (120, 115, 105), amount=50), cv2.LINE_AA)
    for _ in range(14):
        centre = (int(rng.integers(wide)), int(rng.integers(high)))
        axes = (int(rng.integers(3, 16)), int(rng.integers(3, 10)))
        colour = jitter(rng, (150, 130, 120), amount=60)
        cv2.ellipse(picture, centre, axes, float(rng.uniform(0, 180)), 0, 360, colour, -1, cv2.LINE_AA)
    cv2.rectangle(picture, (0, 0), (wide - 1, high - 1), (236, 230, 214), 5)
    wall[top : top + high, left : left + wide] = picture


def ivy(rng: np.random.Generator, wall: NDArray[np.uint8]) -> None:
    """Let ivy grow from the foot of the wall."""
    height, width = wall.shape[:2]
    reach = fractal(rng, (2, width), cell_px=160, octaves=3)[0] * 1.7 * PIXELS_PER_METRE
    from_foot = (height - np.arange(height))[:, None]
    leaves = fractal(rng, (height, width), cell_px=9, octaves=3)
    grown = (from_foot + 12 * leaves < reach[None, :]) & (leaves > -0.5)
    tone = np.clip(0.8 + 0.45 * leaves[grown], 0.3, 1.6)
    wall[grown] = np.clip(tone[:, None] * np.array([66.0, 104.0, 48.0]), 0, 255).astype(np.uint8)


def drainpipe(rng: np.random.Generator, wall: NDArray[np.uint8]) -> None:
    """Fix a pipe to one side of the wall."""
    x = 12 if rng.random() < 0.5 else wall.shape[1] - 16
    fill_box(wall, (x, 0, x + 5, wall.shape[0]), colour=(98, 98, 96))
    fill_box(wall, (x + 5, 0, x + 7, wall.shape[0]), colour=(52, 50, 48))


FLOOR_M = 3.3


def front(
    rng: np.random.Generator, size_m: tuple[float, float], *, style: Style, entrance: bool
) -> NDArray[np.uint8]:
    """Paint one front of a building.

    Args:
        size_m: Width and height.
        entrance: With a door and the sign; other fronts get other distinctive features.

    Returns:
        (h, w, 3) uint8: `PIXELS_PER_METRE` pixels per metre.
    """
    width, height = (round(side * PIXELS_PER_METRE) for side in size_m)
    wall = surface(rng, (height, width), material=style.material, colour=style.wall)
    columns = max(1, int((size_m[0] - 0.8) // style.spacing_m))
    painted = not entrance and rng.random() < 0.45
    door_column = int(rng.integers(1, max(2, columns - 1))) if entrance else -1
    for floor in range(max(1, int(size_m[1] // FLOOR_M))):
        ground = height - round(floor * FLOOR_M * PIXELS_PER_METRE)
        if floor:
            fill_box(wall, (0, ground - 7, width, ground + 2), colour=style.trim)
            fill_box(wall, (0, ground + 2, width, ground + 5), colour=darker(style.trim, 0.6))
        for column in range(columns):
            middle = round((column + 0.5) * width / columns)
            if floor == 0 and column == door_column:
                door(rng, wall, foot=(middle, height), style=style)
            elif rng.random() < 0.93 and not (painted and floor == 0):
                window(rng, wall, foot=(middle, ground), style=style)
    if entrance:
        middle = round((door_column + 0.5) * width / columns)
        sign(wall, middle=(middle, height - round(2.75 * PIXELS_PER_METRE)), style=style)
    elif painted:
        mural(rng, wall)
    else:
        ivy(rng, wall)
    for gap in () if painted else rng.permutation(columns - 1)[: int(rng.integers(1, 4))]:
        poster(rng, wall, middle=round((int(gap) + 1) * width / columns))
    drainpipe(rng, wall)
    return wall
