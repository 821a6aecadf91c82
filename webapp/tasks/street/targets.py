"""The maps to which street-level photos are added: one of the library, or one of any other folder."""

from __future__ import annotations

import hashlib
from collections.abc import Collection
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Protocol

from webapp.core.geo.types import MapPixel
from webapp.core.mapmodel.model import Experience, UnplacedPhoto
from webapp.core.mapmodel.panorama import Panorama
from webapp.errors import UsageError
from webapp.files.decode import check_decodes
from webapp.files.listing import DERIVED
from webapp.files.maps.folder import MapFolder, read_map, write_map
from webapp.files.part_file import discard, move_in
from webapp.files.photos.panorama import find_panorama
from webapp.files.photos.photo import read_facts
from webapp.settings import Settings
from webapp.store.library import Library
from webapp.store.maps import maps
from webapp.store.schema import MapRecord
from webapp.tasks.maps.add_photo import Changing, IncomingPhoto, ServiceMetadata, add_photo, suffix_of
from webapp.tasks.maps.photo_files import PHOTOS
from webapp.tasks.maps.place_photos import MapImage
from webapp.tasks.maps.placing import needed_image

_NEEDED = "give its image a georeference first: street-level photos come by latitude and longitude"


@dataclass(frozen=True, slots=True)
class ArrivedPhoto:
    """A downloaded photo, or a view that was cut out of one."""

    file: Path  # One of the target's scratch files; it is moved or deleted
    name: str
    known: ServiceMetadata
    pixel: MapPixel


class StreetTarget(Protocol):
    """A map to which photos are added."""

    def scratch(self, name: str) -> Path:
        """Return the path of a temporary file on the map's disk; the same after a restart."""

    def image(self) -> MapImage:
        """Return the image of the map, with a georeference; UsageError without one."""

    def known(self, service: str) -> Collection[str]:
        """Return the ids of the photos of a service that the map has."""

    def take(self, photo: ArrivedPhoto) -> bool:
        """Add a photo; return False if the map has the same file already. PhotoError if it is not a photo."""


class LibraryTarget:
    """A map of the library.

    Args:
        changing: Opens a change of the map; a job passes its own, which checks its lease.
    """

    def __init__(
        self, library: Library, map_id: int, *, settings: Settings, changing: Changing | None = None
    ) -> None:
        self._library, self._map_id, self._settings = library, map_id, settings
        self._changing = changing or library.changing

    def scratch(self, name: str) -> Path:
        """Return a path in the uploads folder, from which old files are deleted."""
        return self._library.uploads / f"street-{self._map_id}-{name}"

    def image(self) -> MapImage:
        """Return the image of the map, with a georeference; UsageError without one."""
        with self._library.database.read() as session:
            return needed_image(session.get_one(MapRecord, self._map_id), with_georeference=True)

    def known(self, service: str) -> Collection[str]:
        """Return the ids of the photos of a service that the map has."""
        with self._library.database.read() as session:
            record = session.get_one(MapRecord, self._map_id)
            # Removed photos included: they are not added again.
            sources = [photo.source for photo in maps.photos(session, record)]
        return {source["id"] for source in sources if source and source["service"] == service}

    def take(self, photo: ArrivedPhoto) -> bool:
        """Add a photo in the same way as an upload."""
        intake = add_photo(
            self._library,
            self._map_id,
            photo=IncomingPhoto(photo.file, photo.name, known=photo.known),
            settings=self._settings,
            changing=self._changing,
        )
        return not intake.duplicate


class FolderTarget:
    """A map outside a library; its files are authoritative."""

    def __init__(self, cfg: Path, *, settings: Settings) -> None:
        self._cfg, self._settings = cfg, settings

    def scratch(self, name: str) -> Path:
        """Return a path next to the index, where no photos are looked for."""
        return self._cfg.parent / DERIVED / "street" / name

    def image(self) -> MapImage:
        """Return the image of the map, with a georeference; UsageError without one."""
        the_map = read_map(self._cfg)
        size = the_map.satellite
        if the_map.georeference is None:
            raise UsageError("the map has no georeference", where=str(self._cfg), hint=_NEEDED)
        return MapImage(size.width, size.height, the_map.georeference)

    def known(self, service: str) -> Collection[str]:
        """Return the ids of the photos of a service that the map has."""
        sources = [photo.source for photo in self._photos()]
        return {source.id for source in sources if source is not None and source.service == service}

    def take(self, photo: ArrivedPhoto) -> bool:
        """Move a photo into the map's folder, and add it to the map file."""
        facts = read_facts(photo.file, limits=self._settings.photo)
        check_decodes(photo.file, limits=self._settings.photo)
        content = photo.file.read_bytes()
        digest = hashlib.sha256(content).digest()
        if digest in self._digests.get(len(content), ()):
            discard(photo.file)
            return False
        around = find_panorama(content, facts, limits=self._settings.photo)
        name = f"{PHOTOS}/{Path(photo.name).stem}.{suffix_of(facts)}"
        move_in(photo.file, self._cfg.parent / name)
        known = photo.known
        # Read again: somebody may edit the file while photos are added.
        the_map = read_map(self._cfg)
        added = Experience(
            id=the_map.next_id,
            photo=name,
            position=photo.pixel,
            heading_deg=facts.heading_deg if known.heading_deg is None else known.heading_deg,
            fov_deg=known.fov_deg or (facts.fov_deg if around is None else 360.0),
            gps_accuracy_m=known.accuracy_m,
            taken_at=known.taken_at or facts.taken_at,
            source=known.source,
            panorama=None if around is None else Panorama(),
            by_gps=True,
        )
        changed = replace(
            the_map,
            experiences=(*the_map.experiences, added),
            next_id=added.id + 1,
            revision=the_map.revision + 1,
        )
        write_map(self._cfg, changed)
        self._digests.setdefault(len(content), set()).add(digest)
        return True

    def _photos(self) -> tuple[Experience | UnplacedPhoto, ...]:
        the_map = read_map(self._cfg)
        return (*the_map.experiences, *the_map.unplaced)

    @cached_property
    def _digests(self) -> dict[int, set[bytes]]:
        """Hashes of the map's photos by their sizes."""
        found: dict[int, set[bytes]] = {}
        files = MapFolder(self._cfg)
        for photo in self._photos():
            path = files.path(photo.photo)
            if path.is_file():
                content = path.read_bytes()
                found.setdefault(len(content), set()).add(hashlib.sha256(content).digest())
        return found
