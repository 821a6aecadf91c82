"""The map: a satellite image and photos with positions on it."""

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
    """The image whose pixels positions refer to.

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
    """Origin and licence of a photo from a service.

    Attributes
    ----------
    service : str
        Display name of the service.
    id : str
        Of the photo there; for a view cut out of a panorama, followed by `#` and its turn.
    licence : str
        Its short name, such as `CC BY-SA 4.0`.
    author : str or None
        Author to credit.
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
        """Credit line of the photo."""
        who = self.service if self.author is None else f"{self.author}, {self.service}"
        return f"© {who} ({self.licence})"


@dataclass(frozen=True, slots=True)
class Experience:
    """A photo and the position where it was taken.

    Attributes
    ----------
    id : int
        Unique in the map, and never reused for another photo; 0 is valid.
    photo : str
        Relative to the map's folder, with forward slashes.
    heading_deg : float or None
        Viewing direction, degrees clockwise from north.
    fov_deg : float or None
        Horizontal field of view of the upright photo.
    gps_accuracy_m : float or None
        68 % radius of its GPS position.
    taken_at : str or None
        ISO 8601.
    name : str or None
        Of the original file; None if `photo` ends with it.
    blurred : tuple of BlurBox
        Parts that are blurred wherever the photo is shown.
    source : PhotoSource or None
        For a photo from a service.
    panorama : Panorama or None
        For a photo that shows the whole sphere.
    view : LevelView or None
        For a view by which `level_views` has replaced a panorama.
    by_gps : bool
        Whether its position is that of its GPS, with that accuracy; else a person has placed it.
    radius_px : float or None
        68 % radius of a position that was suggested and accepted; None for one that was placed by hand or by
        GPS.
    note : str or None
        Text that people have written about it.
    floor : int
        Id of its floor.
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
    """A photo in the tray: of the map, but without a position. Fields as those of `Experience`."""

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
    """Alternative positions of the same photos, by id; for example clusters instead of exact positions."""

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
        In addition to the positions of the experiences themselves.
    next_id : int
        The id for the next photo; larger than every id ever used.
    revision : int
        Number of edits.
    unplaced : tuple of UnplacedPhoto
        Photos in the tray, by id.
    floors : tuple of Floor
        By id; empty if the map has only one image.
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
        """Find a floor by its id; None if the map does not have it."""
        return next((floor for floor in self.floors if floor.id == id), None)
