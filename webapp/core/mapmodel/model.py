"""The map: a satellite image and photos with their places on it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field

from webapp.core.blur import BlurBox
from webapp.core.geo.floors import BASE_FLOOR, Floor
from webapp.core.geo.georeference import Georeference
from webapp.core.geo.types import MapPixel
from webapp.core.mapmodel.control_points import GroundControlPoint
from webapp.core.mapmodel.notes import MapNote
from webapp.core.mapmodel.panorama import LevelView, Panorama


@dataclass(frozen=True, slots=True)
class SatelliteImage:
    """The picture that positions are given on.

    Attributes
    ----------
    path : str
        Relative to the map's folder, with forward slashes.
    width, height : int
        Pixels.
    """

    path: str
    width: int
    height: int


@dataclass(frozen=True, slots=True)
class PhotoSource:
    """Where a photo comes from that somebody else has taken, and on what terms.

    Attributes
    ----------
    service : str
        That gives it: its name for people.
    id : str
        Of the photo there; a view cut out of a panorama has its turn behind `#`.
    licence : str
        Its short name, such as `CC BY-SA 4.0`.
    author : str or None
        Who is to be named.
    url : str or None
        Page or record of the photo.
    """

    service: str
    id: str
    licence: str
    author: str | None = None
    url: str | None = None

    @property
    def credit(self) -> str:
        """The line that goes with the photo."""
        who = self.service if self.author is None else f"{self.author}, {self.service}"
        return f"© {who} ({self.licence})"


@dataclass(frozen=True, slots=True)
class Experience:
    """A photo and where it was taken.

    Attributes
    ----------
    id : int
        Unique in the map, never used again for another photo; 0 is legal.
    photo : str
        Relative to the map's folder, with forward slashes.
    heading_deg : float or None
        Where the camera looked, degrees clockwise from north.
    fov_deg : float or None
        Horizontal field of view of the upright photo.
    gps_accuracy_m : float or None
        68 % radius of the position its GPS gave.
    taken_at : str or None
        ISO 8601.
    name : str or None
        Of the original file; None where `photo` ends with it.
    blurred : tuple of BlurBox
        What every picture of the photo hides.
    source : PhotoSource or None
        Of a photo that is from a service.
    panorama : Panorama or None
        Of a photo that shows the whole sphere.
    view : LevelView or None
        Of a panorama, where `level_views` has put it in the panorama's place.
    by_gps : bool
        Its position is what its GPS gave, and as exact; else somebody has placed it.
    radius_px : float or None
        68 % radius of a position that was suggested and accepted; None where somebody has placed it exactly,
        or its GPS has.
    note : str or None
        What people have written on it.
    floor : int
        Id of the floor that it is on.
    """

    id: int
    photo: str
    position: MapPixel
    heading_deg: float | None = None
    fov_deg: float | None = None
    gps_accuracy_m: float | None = None
    taken_at: str | None = None
    name: str | None = None
    blurred: tuple[BlurBox, ...] = ()
    source: PhotoSource | None = None
    panorama: Panorama | None = None
    view: LevelView | None = None
    by_gps: bool = False
    radius_px: float | None = None
    note: str | None = None
    floor: int = BASE_FLOOR


@dataclass(frozen=True, slots=True)
class UnplacedPhoto:
    """A photo in the tray: of the map, but not on it. Fields as those of `Experience`."""

    id: int
    photo: str
    heading_deg: float | None = None
    fov_deg: float | None = None
    gps_accuracy_m: float | None = None
    taken_at: str | None = None
    name: str | None = None
    blurred: tuple[BlurBox, ...] = ()
    source: PhotoSource | None = None
    panorama: Panorama | None = None
    view: LevelView | None = None
    note: str | None = None


@dataclass(frozen=True, slots=True)
class Placement:
    """Other positions for the same photos, by id (clusters besides exact positions, say)."""

    name: str
    positions: Mapping[int, MapPixel]


@dataclass(frozen=True, slots=True)
class Map:
    """A satellite image and its experiences; immutable.

    Attributes
    ----------
    experiences : tuple of Experience
        In the order of the file.
    placements : tuple of Placement
        Besides the main one, which the experiences carry themselves.
    next_id : int
        The id for the next photo; larger than every id ever used.
    revision : int
        Counts the edits.
    unplaced : tuple of UnplacedPhoto
        Photos in the tray, by id.
    floors : tuple of Floor
        By id; none where the map has one image alone.
    """

    satellite: SatelliteImage
    experiences: tuple[Experience, ...]
    georeference: Georeference | None = None
    placements: tuple[Placement, ...] = field(default=())
    next_id: int = 0
    revision: int = 0
    title: str | None = None
    unplaced: tuple[UnplacedPhoto, ...] = ()
    control_points: tuple[GroundControlPoint, ...] = ()
    notes: tuple[MapNote, ...] = ()
    floors: tuple[Floor, ...] = ()

    def floor_named(self, id: int) -> Floor | None:
        """Find a floor by its id; None where the map has none."""
        return next((floor for floor in self.floors if floor.id == id), None)
