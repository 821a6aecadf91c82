"""A mission on its way out: what every file that is made of it is made of.

A mission can have millions of poses and many objects, so neither is ever there as a whole: they come in
parts, afresh each time that they are asked for.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass

from webapp.core.geo.types import LatLon
from webapp.core.trajectory.records import Poses

SOURCE_COLOURS = {
    "gps": "#0072b2",
    "odometry": "#e69f00",
    "visual": "#cc79a7",
    "fused": "#009e73",
    "manual": "#56b4e9",
}
"""Of lines, by where their poses come from: as on the pages."""


@dataclass(frozen=True, slots=True)
class ExportTrack:
    """A track.

    Attributes
    ----------
    source : str
        `gps`, `odometry`, `visual`, `fused` or `manual`.
    name : str
        Distinguishes several tracks of one source; may be empty.
    count : int
        Poses that come.
    distance_m : float
        Along all poses that the source had.
    bounds : tuple of float, or None
        South, west, north, east, degrees; None without poses.
    poses : function
        Gives the poses from the first to the last, in parts of at most a few thousand.
    timed : bool
        False where the times of the poses only keep their order: they do not go out.
    removed : int
        Poses that were removed to save room.
    thinned_m : float or None
        How far from the motion through the others those are, at most, metres; None: only both ends are left.
    """

    id: int
    source: str
    name: str
    count: int
    distance_m: float
    bounds: tuple[float, float, float, float] | None
    poses: Callable[[], Iterable[Poses]]
    timed: bool = True
    removed: int = 0
    thinned_m: float | None = None

    @property
    def remark(self) -> str:
        """What has been removed, for people; empty where nothing was."""
        if not self.removed:
            return ""
        if self.thinned_m is None:
            return f"{self.removed} poses between its ends were removed"
        return f"thinned: {self.removed} poses were removed, which changes it by {self.thinned_m:g} m at most"

    @property
    def title(self) -> str:
        """For people."""
        return f"{self.source}: {self.name}" if self.name else self.source

    @property
    def colour(self) -> str:
        """Of its line, `#rrggbb`."""
        return SOURCE_COLOURS.get(self.source, SOURCE_COLOURS["manual"])


@dataclass(frozen=True, slots=True)
class ExportObject:
    """Something that was seen, where it was seen last; an associated object in the mean of its detections.

    Attributes
    ----------
    kind : str
        Its class.
    first_time_s, last_time_s : float
        Seconds since 1970, UTC.
    photo : str or None
        SHA-256 of a photo of the mission.
    covariance_m2 : tuple of float, or None
        Of the position: variance east, variance north, covariance of the two.
    size_m : tuple of float, or None
        Length, width, height.
    state : str
        How far people are with it.
    state_by : str or None
        Who has set the state; None where nobody has, or it does not go out.
    state_time_s : float or None
        When, seconds since 1970, UTC.
    """

    id: str
    kind: str
    latlon: LatLon
    first_time_s: float
    last_time_s: float
    height_m: float | None
    confidence: float | None
    sightings: int
    photo: str | None
    covariance_m2: tuple[float, float, float] | None = None
    size_m: tuple[float, float, float] | None = None
    state: str = "found"
    state_by: str | None = None
    state_time_s: float | None = None


@dataclass(frozen=True, slots=True)
class MissionOut:
    """A mission.

    Attributes
    ----------
    tracks : tuple of ExportTrack
        Those that have poses.
    kinds : tuple of str
        The classes of its objects; of very many, some.
    objects : function
        Gives the objects, in the order of their ids.
    """

    name: str
    tracks: tuple[ExportTrack, ...]
    kinds: tuple[str, ...]
    objects: Callable[[], Iterable[ExportObject]]
