"""A mission as the exporters of all file formats read it.

A mission can have millions of poses and many objects, so neither is ever in memory as a whole: they are
yielded in parts, anew by each call.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from webapp.core.geo.types import LatLon
from webapp.missions.core.drawings import Kind
from webapp.missions.core.looks import DRAWING_COLOURS, SOURCE_COLOURS, USUAL, WIDTH_PX, TrackLook
from webapp.missions.core.trajectory.records import Poses


@dataclass(frozen=True, slots=True)
class ExportTrack:
    """A track."""

    id: int
    source: str  # `gps`, `odometry`, `visual`, `fused` or `manual`
    name: str  # Distinguishes several tracks of one source; may be empty
    count: int  # Number of exported poses
    distance_m: float  # Distance along all poses of the source
    bounds: tuple[float, float, float, float] | None  # South, west, north, east, degrees; None without poses
    # Yields the poses in their order, in parts of at most a few thousand.
    poses: Callable[[], Iterable[Poses]]
    timed: bool = True  # False if the times only order the poses: they are not exported
    removed: int = 0  # Number of poses that were removed to save space
    # Largest distance of those from the motion interpolated without them, metres; None if only both ends are
    # left.
    thinned_m: float | None = None
    look: TrackLook = USUAL
    # Earliest and latest time, seconds since 1970, UTC; None without times.
    first_time_s: float | None = None
    last_time_s: float | None = None

    @property
    def remark(self) -> str:
        """Description of what has been removed; empty if nothing was."""
        if not self.removed:
            return ""
        if self.thinned_m is None:
            return f"{self.removed} poses between its ends were removed"
        return f"thinned: {self.removed} poses were removed, which changes it by {self.thinned_m:g} m at most"

    @property
    def title(self) -> str:
        """Title to show."""
        return self.look.title or (f"{self.source}: {self.name}" if self.name else self.source)

    @property
    def label(self) -> str:
        """What people or else the sender call it; may be empty."""
        return self.look.title or self.name

    @property
    def colour(self) -> str:
        """Line colour, `#rrggbb`."""
        return self.look.colour or SOURCE_COLOURS.get(self.source, SOURCE_COLOURS["manual"])

    @property
    def width_px(self) -> float:
        """Line width."""
        return self.look.width_px or WIDTH_PX


@dataclass(frozen=True, slots=True)
class ExportObject:
    """A detected object at its last position; an associated object at the mean of its detections."""

    id: str
    kind: str  # Its class
    latlon: LatLon
    # `first_time_s`, `last_time_s`: Seconds since 1970, UTC.
    first_time_s: float
    last_time_s: float
    height_m: float | None
    confidence: float | None
    sightings: int
    photo: str | None  # SHA-256 of a photo of the mission
    # Of the position: variance east, variance north, covariance of the two.
    covariance_m2: tuple[float, float, float] | None = None
    size_m: tuple[float, float, float] | None = None  # Length, width, height
    state: str = "found"  # `found`, `confirmed`, `cleared` or `dismissed`
    state_by: str | None = None  # Who set the state; None if it is unset, or names are not exported
    state_time_s: float | None = None  # When it was set, seconds since 1970, UTC


@dataclass(frozen=True, slots=True)
class ExportDrawing:
    """A search area, a line or a marker that somebody drew."""

    id: int
    kind: Kind
    name: str
    points: tuple[LatLon, ...]  # An area is closed without repeating its first point
    created_time_s: float  # Seconds since 1970, UTC
    radius_m: float | None = None  # None except of areas
    searched_time_s: float | None = None  # When the area was marked as searched, seconds since 1970, UTC
    # What people wrote and who they are: empty or None where names are not exported.
    note: str = ""
    assigned: str = ""
    searched_by: str | None = None
    created_by: str | None = None

    @property
    def searched(self) -> bool | None:
        """Whether an area was searched; None for other kinds."""
        return self.searched_time_s is not None if self.kind == "area" else None

    @property
    def colour(self) -> str:
        """Line colour, `#rrggbb`, as on the web pages."""
        if self.kind != "area":
            return DRAWING_COLOURS["line"]
        state = "searched" if self.searched else "assigned" if self.assigned else "open"
        return DRAWING_COLOURS[state]


@dataclass(frozen=True, slots=True)
class MissionExport:
    """A mission to export."""

    name: str
    tracks: tuple[ExportTrack, ...]  # Those that have poses
    kinds: tuple[str, ...]  # The classes of its objects; of very many, a part
    objects: Callable[[], Iterable[ExportObject]]  # Yields the objects, in the order of their ids
    drawings: tuple[ExportDrawing, ...] = ()  # In order of creation
