"""The map: a satellite image and photos with positions on it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import KW_ONLY, dataclass, fields
from typing import Any

from webapp.core.boxes import BlurBox
from webapp.core.geo.floors import BASE_FLOOR, Floor
from webapp.core.geo.georeference import Georeference
from webapp.core.geo.types import LatLon, MapPixel
from webapp.core.mapmodel.control_points import GroundControlPoint
from webapp.core.mapmodel.facts import Edited, Fact, FixedForm, NumberForm, TextForm, fact
from webapp.core.mapmodel.notes import NOTE_TEXT, MapNote
from webapp.core.mapmodel.panorama import LevelView, Panorama


@dataclass(frozen=True, slots=True)
class SatelliteImage:
    """The image whose pixels positions refer to."""

    path: str
    """Relative to the map's folder, with forward slashes."""
    width: int
    height: int


@dataclass(frozen=True, slots=True)
class PhotoSource:
    """Origin and licence of a photo from a service."""

    service: str
    id: str
    """Of the photo there; for a view cut out of a panorama, followed by `#` and its turn."""
    licence: str
    """Its short name, such as `CC BY-SA 4.0`."""
    author: str | None = None
    url: str | None = None
    """Page or record of the photo."""

    @property
    def credit(self) -> str:
        who = self.service if self.author is None else f"{self.author}, {self.service}"
        return f"© {who} ({self.licence})"


@dataclass(frozen=True, slots=True)
class MapPhoto:
    """A photo of a map, and its facts; `docs/design.md` says what else a further fact needs."""

    id: int
    """Unique in the map, and never reused for another photo; 0 is valid."""
    photo: str
    """Relative to the map's folder, with forward slashes."""
    _: KW_ONLY
    heading_deg: float | None = fact(
        FixedForm.HEADING,
        description="Clockwise from north.",
        visitors="always",
        edited=Edited("turn", "Clockwise from north."),
    )
    """Viewing direction; that of a panorama is that of its middle."""
    fov_deg: float | None = fact(
        NumberForm("above 0 and at most 360", lambda v: 0 < v <= 360),
        description="Horizontal field of view of the upright photo.",
        visitors="originals",
    )
    gps_accuracy_m: float | None = fact(NumberForm("0 or more", lambda v: v >= 0))
    """68 % radius of its GPS position."""
    taken_at: str | None = fact(
        FixedForm.TIME,
        visitors="originals",
        edited=Edited("retime", "Local time, where the camera's clock was wrong.", "2026-05-31T14:05:00"),
    )
    name: str | None = fact(TextForm(), description="Name of the original file.", visitors="originals")
    """None if `photo` ends with it; records always have it."""
    blurred: tuple[BlurBox, ...] = fact(
        FixedForm.BOXES, default=(), description="What is blurred in pictures of it."
    )
    """Parts that are blurred wherever the photo is shown."""
    source: PhotoSource | None = fact(
        FixedForm.SOURCE, description="Of a photo from a street-level service.", visitors="always"
    )
    panorama: Panorama | None = fact(
        FixedForm.SPHERE,
        description="Of a panorama: `heading_deg` is where its middle looks, `fov_deg` is 360.",
        visitors="always",
        edited=Edited("panorama", "It shows the whole sphere, and is twice as wide as high; null: not."),
    )
    note: str | None = fact(
        NOTE_TEXT,
        label="Note",
        description="What people have written on it.",
        visitors="notes",
        edited=Edited("note", "What people write on it; null or empty: nothing."),
    )
    view: LevelView | None = None
    """For a view by which `level_views` has replaced a panorama."""


FACTS: Mapping[str, Fact] = {
    part.name: part.metadata["fact"] for part in fields(MapPhoto) if "fact" in part.metadata
}
"""By name, in the order of files."""

EDITED: Mapping[str, Edited] = {name: fact.edited for name, fact in FACTS.items() if fact.edited}
"""The facts that people edit."""

WRITTEN: Mapping[str, TextForm] = {
    name: form for name in EDITED if isinstance(form := FACTS[name].form, TextForm)
}
"""The texts among them."""


def facts_of(photo: MapPhoto) -> dict[str, Any]:
    """Return the facts of a photo by name, to give them to another one."""
    return {name: getattr(photo, name) for name in FACTS}


@dataclass(frozen=True, slots=True)
class UnplacedPhoto(MapPhoto):
    """A photo in the tray: of the map, but without a position."""

    _: KW_ONLY
    gps: LatLon | None = None
    """Position that its GPS, its sidecar file or a table states; None if unknown."""


@dataclass(frozen=True, slots=True)
class Experience(MapPhoto):
    """A photo and the position where it was taken."""

    position: MapPixel
    _: KW_ONLY
    by_gps: bool = False
    """Whether its position is that of its GPS, with that accuracy; else a person has placed it."""
    radius_px: float | None = None
    """68 % radius of a position that was suggested and accepted; None for one placed by hand or by GPS."""
    floor: int = BASE_FLOOR


@dataclass(frozen=True, slots=True)
class Placement:
    """Alternative positions of the same photos, by id; for example clusters instead of exact positions."""

    name: str
    positions: Mapping[int, MapPixel]


@dataclass(frozen=True, slots=True, kw_only=True)
class MapLists:
    """What a map has in lists, besides photos and placements; see `webapp.files.maps.lists`."""

    control_points: tuple[GroundControlPoint, ...] = ()
    """By name."""
    notes: tuple[MapNote, ...] = ()
    """By id."""
    floors: tuple[Floor, ...] = ()
    """By id; empty if the map has only one image."""


@dataclass(frozen=True, slots=True)
class Map(MapLists):
    """A satellite image and its experiences; immutable."""

    satellite: SatelliteImage
    experiences: tuple[Experience, ...]
    """In the order of the file."""
    georeference: Georeference | None = None
    placements: tuple[Placement, ...] = ()
    """In addition to the positions of the experiences themselves."""
    next_id: int = 0
    """The id for the next photo; larger than every id ever used."""
    revision: int = 0
    """Number of edits."""
    title: str | None = None
    description: str | None = None
    """A sentence on what it is, for visitors."""
    unplaced: tuple[UnplacedPhoto, ...] = ()
    """Photos in the tray, by id."""

    def floor_named(self, id: int) -> Floor | None:
        """Find a floor by its id; None if the map does not have it."""
        return next((floor for floor in self.floors if floor.id == id), None)
