"""Counts the street-level photos of an area before any is downloaded, for a map (its target)."""

from __future__ import annotations

import hashlib
import threading
from collections import Counter
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Literal, NamedTuple, Protocol

import numpy as np

from webapp.core.geo.tilegrid import GeoBox
from webapp.core.geo.types import MapPixel, inside
from webapp.core.mapmodel.model import Experience, UnplacedPhoto
from webapp.core.mapmodel.panorama import Panorama
from webapp.errors import Cancelled, GeoreferenceError, InputError, NotFound, UsageError
from webapp.files.decode import check_decodes
from webapp.files.listing import DERIVED
from webapp.files.maps.folder import MapFolder, read_map, write_map
from webapp.files.part_file import discard, move_in
from webapp.files.photos.panorama import find_panorama
from webapp.files.photos.photo import read_facts
from webapp.net.polite import PoliteClient
from webapp.net.street import Mapillary, Panoramax, StreetPhoto, StreetService, list_photos
from webapp.progress import Progress
from webapp.settings import Settings, StreetSettings
from webapp.store.library import Library
from webapp.store.maps import maps
from webapp.store.schema import MapRecord
from webapp.tasks.maps.add_photo import Changing, IncomingPhoto, ServiceMetadata, add_photo, suffix_of
from webapp.tasks.maps.panoramas import CutOptions, view_turns
from webapp.tasks.maps.photo_files import PHOTOS
from webapp.tasks.maps.place_photos import MapImage
from webapp.tasks.maps.placing import needed_image

SourceKey = Literal["panoramax", "mapillary"]
SOURCES: tuple[SourceKey, ...] = ("panoramax", "mapillary")

PanoramaWish = Literal["cut", "skip", "keep"]
PANORAMA_WISHES: tuple[PanoramaWish, ...] = ("cut", "skip", "keep")
"""Cut panoramas into six level views, skip them, or keep them unchanged."""

_CHOOSE = "choose one that is on it"
_SAMPLES = 17
"""Sampled positions along a side of an area, for its bounding box in degrees."""

CUT = CutOptions(assume=True)
"""Options for cutting panoramas, which the service has marked as such."""


class PixelBox(NamedTuple):
    """A rectangle of a map's image, pixels."""

    left: float
    top: float
    right: float
    bottom: float

    def on(self, image: MapImage) -> PixelBox:
        left, right = max(self.left, 0.0), min(self.right, float(image.width))
        return PixelBox(left, max(self.top, 0.0), right, min(self.bottom, float(image.height)))

    def holds(self, pixel: MapPixel) -> bool:
        return self.left <= pixel.x <= self.right and self.top <= pixel.y <= self.bottom


@dataclass(frozen=True, slots=True)
class StreetRequest:
    source: SourceKey  # "panoramax" or "mapillary"
    area: GeoBox | PixelBox | None = None  # None for the whole image of the map
    panoramas: PanoramaWish = "cut"


@dataclass(frozen=True, slots=True)
class PlacedStreetPhoto:
    """A photo of a service, and its position on the map."""

    photo: StreetPhoto
    pixel: MapPixel


@dataclass(frozen=True, slots=True)
class StreetSurvey:
    service: str
    wanted: tuple[PlacedStreetPhoto, ...]  # Photos that the map does not have yet
    found: int  # Number of all photos that the service has of the area
    known: int = 0  # Number of photos that the map has already
    outside: int = 0  # Number of photos that are not on the map's image
    skipped: int = 0  # Number of panoramas, if these are not wanted
    unusable: int = 0  # Number of photos for which the service gives no file, position or licence

    @property
    def size_bytes(self) -> int:
        return sum(one.photo.size_bytes for one in self.wanted)

    @property
    def panoramas(self) -> int:
        """Number of panoramas among the photos that the map does not have."""
        return sum(one.photo.is_panorama for one in self.wanted)

    @property
    def licences(self) -> Mapping[str, int]:
        """Number of photos that the map does not have, by licence."""
        return dict(sorted(Counter(one.photo.licence for one in self.wanted).items()))

    @property
    def authors(self) -> int:
        """Number of different authors (people and companies) of these photos."""
        return len({one.photo.author for one in self.wanted if one.photo.author})


def services(settings: StreetSettings) -> dict[SourceKey, StreetService]:
    found: dict[SourceKey, StreetService] = {}
    if settings.panoramax is not None:
        found["panoramax"] = Panoramax(settings.panoramax)
    if settings.mapillary_token is not None:
        found["mapillary"] = Mapillary(settings.mapillary, token=settings.mapillary_token)
    return found


def open_service(source: SourceKey, settings: StreetSettings) -> tuple[StreetService, PoliteClient]:
    """Return a service and its client; no request is sent yet."""
    service = services(settings).get(source)
    if service is None:
        needed = "street.panoramax" if source == "panoramax" else "street.mapillary_token"
        raise NotFound(f"the service {source} is not set up here", hint=f"set {needed}, see docs/street.md")
    return service, PoliteClient(service.name, service.base, headers=service.headers, settings=settings)


def survey_street(
    target: StreetTarget,
    request: StreetRequest,
    *,
    settings: StreetSettings,
    progress: Progress,
    limit_s: float | None = None,
) -> StreetSurvey:
    """List the photos that a service has of an area.

    Raises:
        NotFound: The service is not configured.
        UsageError: The map has no georeference; the area is empty, not on the image, or has too many photos.
        InputError, TooMany: The service does not answer, refuses, sends an invalid answer, or takes longer
            than the limit.
    """
    service, client = open_service(request.source, settings)
    image, known = target.image(), target.known(service.name)
    box = _area(request, image)
    with _stopping(client, progress=progress, limit_s=limit_s):
        listing = list_photos(service, box, client=client, most=settings.max_photos, progress=progress)
    wanted: list[PlacedStreetPhoto] = []
    counts: Counter[str] = Counter()
    assert image.georeference is not None
    for photo in listing.photos:
        pixel = image.georeference.pixel_of(photo.position)
        if isinstance(request.area, PixelBox) and not request.area.holds(pixel):
            counts["elsewhere"] += 1
        elif not inside(pixel, width=image.width, height=image.height):
            counts["outside"] += 1
        elif photo.is_panorama and request.panoramas == "skip":
            counts["skipped"] += 1
        elif photo.id in known or set(part_ids(photo, request.panoramas)).issubset(known):
            counts["known"] += 1
        else:
            wanted.append(PlacedStreetPhoto(photo, pixel))
    found = len(listing.photos) + listing.unusable - counts.pop("elsewhere", 0)
    return StreetSurvey(service.name, tuple(wanted), found, unusable=listing.unusable, **counts)


def check_request(target: StreetTarget, request: StreetRequest, *, settings: StreetSettings) -> None:
    """Check a request without contacting the service; raise the errors of `survey_street`."""
    open_service(request.source, settings)[1].stop()
    _area(request, target.image())


def survey_json(survey: StreetSurvey) -> dict[str, object]:
    """Convert a survey to JSON values, without the photos."""
    return {
        "service": survey.service,
        "found": survey.found,
        "to_download": len(survey.wanted),
        "panoramas": survey.panoramas,
        "size_mb": round(survey.size_bytes / 1e6, 3),
        "licences": dict(survey.licences),
        "authors": survey.authors,
        "known": survey.known,
        "outside": survey.outside,
        "skipped": survey.skipped,
        "unusable": survey.unusable,
    }


def part_ids(photo: StreetPhoto, panoramas: PanoramaWish) -> tuple[str, ...]:
    """Return the ids under which a photo is added to a map: its own, or one for each view of a panorama."""
    if photo.is_panorama and panoramas == "cut":
        return tuple(f"{photo.id}#{turn:03}" for turn in view_turns(CUT))
    return (photo.id,)


@contextmanager
def _stopping(client: PoliteClient, *, progress: Progress, limit_s: float | None) -> Iterator[None]:
    """Stop a client at the end of the block, or after the time limit even if it is waiting."""
    timer = None if limit_s is None else threading.Timer(limit_s, client.stop)
    try:
        if timer is not None:
            timer.start()
        yield
    except Cancelled as error:
        progress.check()  # raises if the user has cancelled
        raise InputError("the service takes too long", where="area", hint="choose a smaller area") from error
    finally:
        if timer is not None:
            timer.cancel()
        client.stop()


def _area(request: StreetRequest, image: MapImage) -> GeoBox:
    """Return the area to request from the service: the part of the wanted area that the image may show.

    Raises:
        UsageError: There is none.
        GeoreferenceError: The image is nowhere on the Earth.
    """
    if isinstance(request.area, PixelBox):
        sides = request.area.on(image)
        if not (sides.left < sides.right and sides.top < sides.bottom):
            raise UsageError("the area is empty, or not on the map's image", where="area", hint=_CHOOSE)
        return _wrapped(_extent(image, sides))
    whole = _extent(image, PixelBox(0.0, 0.0, image.width, image.height))
    if request.area is None:
        return _wrapped(whole)
    box = request.area
    if not (box.north > box.south and box.west != box.east):
        raise UsageError("the area is empty", where="area", hint="north is above south, west not east")
    # unwrap longitudes across the 180th meridian, to be near those of the image
    width = (box.east - box.west) % 360.0
    middle = (whole.west + whole.east) / 2
    west = middle + (box.west + width / 2 - middle + 180.0) % 360.0 - 180.0 - width / 2
    shared = GeoBox(
        north=min(box.north, whole.north),
        south=max(box.south, whole.south),
        west=max(west, whole.west),
        east=min(west + width, whole.east),
    )
    if shared.north <= shared.south or shared.west >= shared.east:
        raise UsageError("the area is not on the map's image", where="area", hint=_CHOOSE)
    return _wrapped(shared)


def _extent(image: MapImage, sides: PixelBox) -> GeoBox:
    """Return the bounding box in degrees of a part of an image; longitudes may be beyond 180 degrees."""
    assert image.georeference is not None
    x, y = np.meshgrid(
        np.linspace(sides.left, sides.right, _SAMPLES), np.linspace(sides.top, sides.bottom, _SAMPLES)
    )
    places = image.georeference.latlon_from_pixel(np.column_stack([x.ravel(), y.ravel()]))
    places = places[np.isfinite(places).all(axis=1)]
    if not len(places):
        raise GeoreferenceError("the area is nowhere on the Earth", hint="check the image's georeference")
    latitudes, longitudes = places.T
    longitudes = longitudes[0] + (longitudes - longitudes[0] + 180.0) % 360.0 - 180.0
    return GeoBox(
        float(latitudes.max()), float(latitudes.min()), float(longitudes.min()), float(longitudes.max())
    )


def _wrapped(box: GeoBox) -> GeoBox:
    west, east = ((side + 180.0) % 360.0 - 180.0 for side in (box.west, box.east))
    return box._replace(west=west, east=east)


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
            panorama=None if around is None else Panorama(tilt=around.tilt),
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
