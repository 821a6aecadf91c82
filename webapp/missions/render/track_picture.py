"""Draws raw tracks, the fused one with its uncertainty, and rejected fixes as a picture, north up."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from webapp.core.geo.local import LocalFrame, centre_of
from webapp.core.geo.types import LatLon
from webapp.missions.core.trajectory.records import SOURCES, Poses, Source
from webapp.missions.store import tracks
from webapp.missions.tasks import fuse
from webapp.render.canvas import Canvas, Point, text_width
from webapp.render.colours import INK, PAPER, QUIET, RGB
from webapp.store.library import Library

COLOURS: dict[Source, RGB] = {
    "gps": (0, 114, 178),
    "odometry": (230, 159, 0),
    "visual": (204, 121, 167),
    "fused": (0, 120, 84),
    "manual": (86, 180, 233),
}
"""Distinguishable for colour-blind people: Okabe and Ito, "Color universal design" (2008)."""

NAMES: dict[Source, str] = {
    "gps": "GPS",
    "odometry": "odometry",
    "visual": "visual fixes",
    "fused": "corrected, with 95 % ellipses",
    "manual": "by hand",
}
GATED: RGB = (200, 30, 60)

SIDE_PX = 1000
BAND_PX = 44
_MARGIN_PX = 40
_MOST_POINTS = 4000
_ELLIPSES = 40
_95 = math.sqrt(-2.0 * math.log(0.05))
"""Radius of the ellipse that holds 95 % of a normal distribution in the plane, standard deviations."""


@dataclass(frozen=True, slots=True, eq=False)
class Shown:
    tracks: Sequence[tuple[Source, Poses]]  # Drawn in this order; fixes as dots, paths as lines
    gated: Sequence[tuple[LatLon, LatLon]] = ()  # Rejected fixes, and their expected positions
    pieces: Sequence[float] = field(default=())  # Times at which fused tracks begin and restart


def of_mission(library: Library, mission_id: int) -> Image.Image:
    """Draw a mission whose tracks were fused.

    Raises:
        NotFound: The tracks were not fused.
    """
    report = fuse.read_report(library, mission_id)
    with library.database.read() as session:
        found = [t for t in tracks.list_tracks(session, mission_id) if t.poses]
        wanted = [t for t in found if t.source != "odometry" or t.id == report["odometry"]]
        order: list[Source] = ["odometry", "gps", "manual", "visual", "fused"]
        shown = [
            (source, tracks.at(session, track, _some(track.poses)))
            for source in order
            for track in wanted
            if track.source == source
        ]
    gated = [
        (LatLon(one["lat"], one["lon"]), LatLon(one["expected"]["lat"], one["expected"]["lon"]))
        for one in report["gated"]
    ]
    return draw_tracks(Shown(shown, gated, report["pieces"]))


def draw_tracks(shown: Shown) -> Image.Image:
    """Draw tracks.

    Args:
        shown: Has at least one pose.

    Returns:
        RGB. Scaled to the larger extent of the tracks; a legend and a scale bar are below.
    """
    places = [poses.latlon for _, poses in shown.tracks] + [np.array(pair) for pair in shown.gated]
    frame = LocalFrame(centre_of(np.vstack(places)))
    view = _View.around(frame.enu_from_latlon(np.vstack(places)))
    canvas = Canvas(np.full((view.height + BAND_PX, view.width, 3), PAPER, dtype=np.uint8))
    for source, poses in shown.tracks:
        points = view.shown(frame.enu_from_latlon(poses.latlon))
        if source == "fused":
            _ellipses(canvas, points, poses, view=view)
        if source in ("fused", "odometry"):
            _path(canvas, points, COLOURS[source], breaks=_breaks(source, poses, shown.pieces))
        else:
            for x, y in points.tolist():
                canvas.disc((x, y), 2.5, colour=COLOURS[source])
    for one in shown.gated:
        (at, expected) = view.shown(frame.enu_from_latlon(list(one))).tolist()
        _cross(canvas, (at[0], at[1]), (expected[0], expected[1]))
    _legend(canvas, view, shown)
    return canvas.image()


@dataclass(frozen=True, slots=True)
class _View:
    """Transformation from metres east and north to pixels."""

    west: float
    north: float
    scale: float
    width: int
    height: int

    @classmethod
    def around(cls, enu: NDArray[np.float64]) -> _View:
        """Fit the view to all points, with a margin."""
        west, south = enu.min(axis=0).tolist()
        east, north = enu.max(axis=0).tolist()
        spread = max(east - west, north - south, 5.0)
        scale = (SIDE_PX - 2 * _MARGIN_PX) / spread
        width = max(640, math.ceil((east - west) * scale) + 2 * _MARGIN_PX)
        height = math.ceil((north - south) * scale) + 2 * _MARGIN_PX
        middle = (west + east) / 2
        return cls(middle - width / 2 / scale, north + _MARGIN_PX / scale, scale, width, height)

    def shown(self, enu: NDArray[np.float64]) -> NDArray[np.float64]:
        """Convert metres east and north (n, 2) to pixels (n, 2)."""
        return np.column_stack([(enu[:, 0] - self.west) * self.scale, (self.north - enu[:, 1]) * self.scale])


def _some(count: int) -> list[int]:
    return sorted(set(np.linspace(0, count - 1, min(count, _MOST_POINTS)).astype(int).tolist()))


def _breaks(source: Source, poses: Poses, pieces: Sequence[float]) -> set[int]:
    """Return the indices of poses that are not connected with the previous one."""
    if source != "fused":
        return set()
    return set(np.searchsorted(poses.times_s, np.array(pieces[1:])).tolist())


def _path(canvas: Canvas, points: NDArray[np.float64], colour: RGB, *, breaks: set[int]) -> None:
    places: list[list[float]] = points.tolist()
    for i in range(1, len(places)):
        if i not in breaks:
            (x0, y0), (x1, y1) = places[i - 1], places[i]
            canvas.line((x0, y0), (x1, y1), colour=colour, width=2)


def _ellipses(canvas: Canvas, points: NDArray[np.float64], poses: Poses, *, view: _View) -> None:
    """Draw the 95 % ellipses of the position at some poses."""
    turn = np.linspace(0, 2 * np.pi, 33)
    circle = np.column_stack([np.cos(turn), np.sin(turn)])
    with canvas.faint(0.55):
        for i in np.unique(np.linspace(0, len(poses) - 1, _ELLIPSES).astype(int)).tolist():
            east, north, both = poses.covariance_m2[i].tolist()
            values, vectors = np.linalg.eigh([[east, both], [both, north]])
            metres = circle * (_95 * np.sqrt(np.maximum(values, 0.0))) @ vectors.T
            rim = points[i] + metres * (view.scale, -view.scale)
            _path(canvas, rim, COLOURS["fused"], breaks=set())


def _cross(canvas: Canvas, at: Point, expected: Point) -> None:
    canvas.line(at, expected, colour=GATED, width=1)
    for dx, dy in ((6, 6), (6, -6)):
        canvas.line((at[0] - dx, at[1] - dy), (at[0] + dx, at[1] + dy), colour=GATED, width=2)


def _legend(canvas: Canvas, view: _View, shown: Shown) -> None:
    x, y = 16.0, view.height + BAND_PX / 2
    there = {source for source, _ in shown.tracks}
    entries = [(COLOURS[source], NAMES[source]) for source in SOURCES if source in there]
    if shown.gated:
        entries.append((GATED, f"left out ({len(shown.gated)})"))
    for colour, name in entries:
        canvas.disc((x + 5, y), 5, colour=colour)
        canvas.text((x + 16, y + 5), name, size=14, colour=INK)
        x += 34 + text_width(name, 14)
    power = 10.0 ** math.floor(math.log10(120 / view.scale))
    metres = max(step * power for step in (1, 2, 5) if step * power * view.scale <= 120)
    right = view.width - 16.0
    left = right - metres * view.scale
    canvas.line((left, y + 8), (right, y + 8), colour=INK, width=2)
    canvas.text(((left + right) / 2, y + 2), f"{metres:g} m", size=12, colour=QUIET, anchor="ms")
