"""The map in the report of a mission: tracks, drawings and objects on the image of its map, north up."""

from __future__ import annotations

import io
import math
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

import cv2
import numpy as np
from numpy.typing import NDArray
from PIL import Image

from webapp.missions.core.trajectory.outgoing import ExportDrawing, ExportTrack
from webapp.missions.tasks.export import icon
from webapp.missions.tasks.report import MissionReport
from webapp.render.canvas import Point
from webapp.render.colours import INK, RGB
from webapp.render.mercator import MercatorPicture
from webapp.render.sheet.drawing import (
    Box,
    LabelWanted,
    PngDrawing,
    TextStyle,
    place_labels,
    shorten,
    text_width,
)

WIDTH, LEAST_HEIGHT, MOST_HEIGHT = 510.0, 230.0, 480.0
"""Size, points: the width is that of an A4 page between its margins."""

_DPI = 220
_MARGIN = 24.0
_LEAST_M = 20.0
"""Shown around a mission that went nowhere."""

_EARTH_M = 6_378_137.0
_PX_POINTS = 0.75
"""Points of a pixel of line width."""

_ICON = 13.0
_LABEL = 7.5
_LABEL_WIDTH = 130.0
_MOST_LABELS = 150
_WHITE: RGB = (255, 255, 255)
_EMPTY: RGB = (243, 245, 246)

_Line = NDArray[np.float64]
"""(n, 2) float64: degrees north, degrees east."""


def draw_map(report: MissionReport, ground: MercatorPicture | None) -> bytes | None:
    """Draw the map as JPEG; None if the mission has no position."""
    lines = [(track, _positions(track)) for track in report.mission.tracks if not track.look.hidden]
    objects = np.array([one.latlon for one in report.objects], np.float64).reshape(-1, 2)
    shapes = [(drawing, np.array(drawing.points, np.float64)) for drawing in report.mission.drawings]
    every = [at for _, at in lines] + [at for _, at in shapes] + [objects]
    latlon = np.concatenate([at for at in every if len(at)] or [np.zeros((0, 2))])
    if not len(latlon):
        return None
    view = _View.around(latlon)
    drawing = PngDrawing((WIDTH, view.height), dpi=_DPI)
    _lay(drawing, ground, view=view)
    for shape, at in shapes:
        _draw_shape(drawing, shape, view.shown(at))
    for track, at in lines:
        _draw_track(drawing, track, view.shown(at))
    marks = [(x, y) for x, y in view.shown(objects).tolist()]
    named = [(shape.name, *_middle(shape, view.shown(at)), 4.0) for shape, at in shapes]
    named += [(track.label, *view.shown(at[-1:])[0].tolist(), 5.0) for track, at in lines if track.label]
    named += [(one.id, x, y, _ICON / 2) for one, (x, y) in zip(report.objects, marks, strict=True)]
    _draw_labels(drawing, named[:_MOST_LABELS], marks=marks, view=view)
    _draw_scale(drawing, view)
    image = Image.open(io.BytesIO(drawing.finish()))
    _put_icons(image, [one.kind for one in report.objects], marks)
    data = io.BytesIO()
    image.save(data, "JPEG", quality=85, dpi=(_DPI, _DPI))
    return data.getvalue()


def _positions(track: ExportTrack) -> _Line:
    return np.concatenate([part.latlon for part in track.poses()])


@dataclass(frozen=True, slots=True)
class _View:
    """Transformation from positions to points of the sheet, by the Mercator projection of a sphere."""

    west: float  # Radians
    north: float  # Mercator's y
    scale: float  # Points per radian
    height: float

    @classmethod
    def around(cls, latlon: _Line) -> _View:
        """Fit the view to all positions, with a margin."""
        at = _mercator(latlon)
        low, high = at.min(axis=0), at.max(axis=0)
        middle_lat = math.atan(math.sinh(float(low[1] + high[1]) / 2))
        spread = np.maximum(high - low, _LEAST_M / _EARTH_M / math.cos(middle_lat))
        scale = float(min((np.array([WIDTH, MOST_HEIGHT]) - 2 * _MARGIN) / spread))
        height = max(LEAST_HEIGHT, float(spread[1]) * scale + 2 * _MARGIN)
        middle = (low + high) / 2
        west, north = float(middle[0]) - WIDTH / 2 / scale, float(middle[1]) + height / 2 / scale
        return cls(west, north, scale, height)

    def shown(self, latlon: _Line) -> _Line:
        """Convert positions to points (n, 2) of the sheet."""
        at = _mercator(latlon)
        return np.column_stack([(at[:, 0] - self.west) * self.scale, (self.north - at[:, 1]) * self.scale])

    @property
    def points_per_metre(self) -> float:
        """Scale in the middle of the sheet."""
        lat = math.atan(math.sinh(self.north - self.height / 2 / self.scale))
        return self.scale / (_EARTH_M * math.cos(lat))


def _mercator(latlon: _Line) -> _Line:
    lat, lon = np.radians(latlon).reshape(-1, 2).T
    return np.column_stack([lon, np.arcsinh(np.tan(np.clip(lat, -1.5, 1.5)))])


def _lay(drawing: PngDrawing, ground: MercatorPicture | None, *, view: _View) -> None:
    """Draw the image of the map below everything, faint at its transparent parts."""
    size = (round(WIDTH * _DPI / 72), round(view.height * _DPI / 72))
    pixels = np.full((size[1], size[0], 3), _EMPTY, np.uint8)
    if ground is not None:
        corners = np.array([[ground.north, ground.west], [ground.south, ground.east]])
        (left, top), (right, bottom) = (view.shown(corners) * _DPI / 72).tolist()
        rows, columns = ground.pixels.shape[:2]
        across, down = (right - left) / columns, (bottom - top) / rows
        matrix = np.array([[across, 0, left + across / 2 - 0.5], [0, down, top + down / 2 - 0.5]])
        source, matrix = _shrunk(ground.pixels, matrix)
        laid = cv2.warpAffine(source, matrix, size, flags=cv2.INTER_LINEAR)
        opacity = laid[:, :, 3:].astype(np.float32) / 255
        pixels = np.rint(laid[:, :, 2::-1] * opacity + pixels * (1 - opacity)).astype(np.uint8)
    drawing.image(pixels, Box(0, 0, WIDTH, view.height))


def _shrunk(
    pixels: NDArray[np.uint8], matrix: NDArray[np.float64]
) -> tuple[NDArray[np.uint8], NDArray[np.float64]]:
    """Scale a picture down before it is drawn smaller, so that it does not flicker."""
    factor = float(matrix[0, 0])
    if factor >= 0.75:
        return pixels, matrix
    rows, columns = (max(1, round(side * factor)) for side in pixels.shape[:2])
    smaller = cv2.resize(pixels, (columns, rows), interpolation=cv2.INTER_AREA)
    across, down = pixels.shape[1] / columns, pixels.shape[0] / rows
    out = matrix.copy()
    out[:, 2] += matrix[:, 0] * (across - 1) / 2 + matrix[:, 1] * (down - 1) / 2
    out[0, 0], out[1, 1] = matrix[0, 0] * across, matrix[1, 1] * down
    return np.asarray(smaller, np.uint8), out


def _draw_shape(drawing: PngDrawing, shape: ExportDrawing, points: _Line) -> None:
    colour = rgb(shape.colour)
    if shape.kind == "marker":
        x, y = points[0].tolist()
        drawing.disc((x, y), 4.2, colour=_WHITE)
        drawing.disc((x, y), 3.2, colour=colour)
        return
    closed = np.concatenate([points, points[:1]]) if shape.kind == "area" else points
    _draw_line(drawing, closed, colour=_WHITE, width=3.0)
    _draw_line(drawing, closed, colour=colour, width=1.8)


def _draw_track(drawing: PngDrawing, track: ExportTrack, points: _Line) -> None:
    """Draw fixes as dots, paths as lines with a dot at the end."""
    colour, width = rgb(track.colour), track.width_px * _PX_POINTS
    if track.source in ("visual", "manual"):
        for x, y in points.tolist():
            drawing.disc((x, y), width / 2 + 0.8, colour=_WHITE)
            drawing.disc((x, y), width / 2, colour=colour)
        return
    _draw_line(drawing, points, colour=_WHITE, width=width + 1.4)
    _draw_line(drawing, points, colour=colour, width=width)
    x, y = points[-1].tolist()
    drawing.disc((x, y), width / 2 + 2.6, colour=_WHITE)
    drawing.disc((x, y), width / 2 + 1.6, colour=colour)


def _draw_line(drawing: PngDrawing, points: _Line, *, colour: RGB, width: float) -> None:
    places: list[list[float]] = points.tolist()
    for (x0, y0), (x1, y1) in pairwise(places):
        drawing.line((x0, y0), (x1, y1), colour=colour, width=width)


def _draw_labels(
    drawing: PngDrawing,
    named: Sequence[tuple[str, float, float, float]],
    *,
    marks: Sequence[Point],
    view: _View,
) -> None:
    """Write texts as far as they fit, each with the centre and the radius of its mark."""
    texts = [shorten(text, _LABEL, width=_LABEL_WIDTH) for text, *_ in named]
    wanted = [
        LabelWanted(x, y, reach, text_width(text, _LABEL), _LABEL)
        for text, (_, x, y, reach) in zip(texts, named, strict=True)
    ]
    taken = [Box(x - _ICON / 2, y - _ICON / 2, x + _ICON / 2, y + _ICON / 2) for x, y in marks]
    boxes = place_labels(wanted, taken=taken, frame=Box(2, 2, WIDTH - 2, view.height - 2))
    for text, box in zip(texts, boxes, strict=True):
        if box is not None:
            drawing.text((box.left, box.bottom - 0.2 * _LABEL), text, style=TextStyle(_LABEL, halo=1.0))


def _middle(shape: ExportDrawing, points: _Line) -> Point:
    """Return where the name of a drawing is written: in an area, else at its first point."""
    x, y = (points.mean(axis=0) if shape.kind == "area" else points[0]).tolist()
    return x, y


def _draw_scale(drawing: PngDrawing, view: _View) -> None:
    longest = 110.0 / view.points_per_metre
    power = 10.0 ** math.floor(math.log10(longest))
    metres = max(step * power for step in (1, 2, 5) if step * power <= longest)
    text = f"{metres / 1000:g} km" if metres >= 1000 else f"{metres:g} m"
    right, y = WIDTH - 12.0, view.height - 10.0
    left = right - metres * view.points_per_metre
    drawing.line((left, y), (right, y), colour=_WHITE, width=4.0)
    drawing.line((left, y), (right, y), colour=INK, width=1.6)
    style = TextStyle(8.0, halo=1.2, anchor="middle")
    drawing.text(((left + right) / 2, y - 4), text, style=style)


def _put_icons(image: Image.Image, kinds: Sequence[str], marks: Sequence[Point]) -> None:
    side = round(_ICON * _DPI / 72)
    icons = {
        kind: Image.open(io.BytesIO(icon(kind))).resize((side, side), Image.Resampling.LANCZOS)
        for kind in set(kinds)
    }
    for kind, (x, y) in zip(kinds, marks, strict=True):
        at = (round(x * _DPI / 72 - side / 2), round(y * _DPI / 72 - side / 2))
        image.paste(icons[kind], at, icons[kind])


def rgb(colour: str) -> RGB:
    """Convert `#rrggbb`."""
    red, green, blue = bytes.fromhex(colour.removeprefix("#"))
    return red, green, blue
