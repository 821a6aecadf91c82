"""Adds a complete photo file to a map: checks and stores it, places it by GPS and makes its previews."""

from __future__ import annotations

import unicodedata
from collections.abc import Callable
from contextlib import AbstractContextManager
from dataclasses import dataclass, replace
from pathlib import Path

from webapp.core.geo.types import LatLon
from webapp.core.mapmodel.model import PhotoSource
from webapp.core.mapmodel.panorama import Panorama
from webapp.errors import NotFound
from webapp.files import contents
from webapp.files.decode import contrast_note, stored_suffix
from webapp.files.maps.facts import panorama_fields, source_fields
from webapp.files.part_file import sha256_of, show_file_as
from webapp.files.photos.exif import ABSENT, Gps
from webapp.files.photos.panorama import PanoramaTags, find_panorama
from webapp.files.photos.photo import (
    PhotoFacts,
    make_previews,
    previews_folder,
    read_facts,
    remarks,
    write_previews,
)
from webapp.files.photos.sidecars import Sidecar, beside_photo, with_sidecars
from webapp.files.satellite.raster import is_georeferenced_tiff
from webapp.settings import Settings
from webapp.store.library import Library
from webapp.store.maps import maps
from webapp.store.maps.changing import MapChange
from webapp.store.schema import MapRecord, Photo
from webapp.tasks.maps.photo_files import forget_intake, free_path, keep
from webapp.tasks.maps.place_photos import FileState, SurveyedFile, place
from webapp.tasks.maps.placing import image_of

_OF_DRAWINGS = {"PNG", "TIFF", "GIF", "BMP"}
_MAX_NAME = 300
_NOT_STATED = "no position is known where it is from"
_PLAN_NOTE = "it looks like a plan or satellite image: as the map's image, add it on the page Image"


@dataclass(frozen=True, slots=True)
class ServiceMetadata:
    """Metadata of a photo from its service, which take precedence over EXIF; None if unknown."""

    source: PhotoSource
    position: LatLon
    heading_deg: float | None = None  # Degrees clockwise from north
    fov_deg: float | None = None
    accuracy_m: float | None = None  # 68 % radius of the position
    taken_at: str | None = None  # ISO 8601


@dataclass(frozen=True, slots=True)
class StatedMetadata:
    """What another program states about a photo of the user."""

    # Whether its position and time take precedence over those of EXIF, or only fill gaps.
    overrides: bool
    position: LatLon | None = None
    accuracy_m: float | None = None  # 68 % radius of the position
    taken_at: str | None = None  # ISO 8601
    heading_deg: float | None = None  # Degrees clockwise from north
    camera: str | None = None  # Maker and model
    note: str | None = None  # What people have written on it
    remarks: tuple[str, ...] = ()  # Sentences about its file


@dataclass(frozen=True, slots=True)
class IncomingPhoto:
    """A file on its way into a map."""

    # Complete file on the same file system as the library (its uploads folder); it is moved or deleted.
    file: Path
    name: str  # Name of the original file; any text
    id: int | None = None  # Id reserved for it in the map; None for the next one
    known: ServiceMetadata | None = None  # Metadata of a photo from a service
    stated: StatedMetadata | None = None  # Metadata of a photo from another program
    beside: tuple[Sidecar, ...] = ()  # Files that may belong to it: others are ignored


Changing = Callable[[int], AbstractContextManager[MapChange]]
"""Begins a change of a map: `Library.changing`, or that of a job with its lease."""


@dataclass(frozen=True, slots=True)
class AddedPhoto:
    id: int  # Id of the photo in the map
    name: str  # Name under which it is stored
    duplicate: bool  # The map already had a photo with the same content: nothing was changed
    placed: bool  # It has a position on the satellite image
    gps_problem: str | None  # Why it was not placed by its GPS, for display
    job: int | None  # Id of the job that adds it to the index
    notes: tuple[str, ...] = ()  # Sentences about its file: where its position is from, what was left out
    is_plan: bool = False  # It looks like a plan or satellite image


def add_photo(
    library: Library,
    map_id: int,
    *,
    photo: IncomingPhoto,
    settings: Settings,
    by_gps: bool = True,
    changing: Changing | None = None,
) -> AddedPhoto:
    """Add a photo to a map.

    The operation is atomic and durable: after a kill, the map either has the photo or not; at most, a file
    without a record remains until it is uploaded again or swept.

    Args:
        by_gps: Place it by its GPS, if the photo has a position and the map a georeference.
        changing: Used instead of `library.changing`.

    Raises:
        PhotoError: It is not a photo of a known format, is damaged or truncated, or exceeds the limits. The
            file is unchanged.
        NotFound: The map is gone.
        DiskFull, StorageError: The disk or the object storage failed.
    """
    name, source = tidy_name(photo.name), photo.file
    with show_file_as(name, source):
        facts = _read(photo, name=name, settings=settings)
        around = find_panorama(source, facts, limits=settings.photo)
        previews = make_previews(source, limits=settings.photo)
        is_map = _is_of_no_camera(facts) and is_georeferenced_tiff(source, limits=settings.satellite)
    sha256 = sha256_of(source)
    stored = contents.store(source)  # before the transaction, which blocks other writers
    with (changing or library.changing)(map_id) as change:
        session, record = change.session, change.record
        if record.binned_at is not None:
            raise NotFound("the map was deleted, or is in the bin")
        folder = library.map_folder(record.slug)
        row = _row(facts, name=name, sha256=sha256, size_bytes=source.stat().st_size)
        is_plan = photo.known is None and photo.stated is None and (is_map or _may_be_image(facts, record))
        if is_plan:
            row.file_notes = [*(row.file_notes or ()), _PLAN_NOTE]
        if around is not None:
            mark_panorama(row, around)
        if photo.known is not None:
            _say(row, photo.known)
        if photo.stated is not None:
            _state(row, photo.stated)
        if photo.id is not None:
            row.id = photo.id
        row.path = free_path(session, record, folder=folder, row=row, suffix=suffix_of(facts))
        problem = _place(row, record, facts) if by_gps else None
        before = record.revision
        kept = maps.add_photo(session, record, row=row)
        keep(source, folder=folder, row=kept, stored=stored)
        duplicate, placed = record.revision == before, kept.x_px is not None
        if kept is row:
            # before the commit: if the previews cannot be written, the whole photo is rejected
            write_previews(previews_folder(folder), str(kept.id), previews=previews)
    forget_intake(folder, kept)
    return AddedPhoto(
        kept.id,
        name,
        duplicate,
        placed,
        problem or kept.gps_problem,
        change.job,
        tuple(kept.file_notes or ()),
        is_plan,
    )


def _read(photo: IncomingPhoto, *, name: str, settings: Settings) -> PhotoFacts:
    facts = read_facts(photo.file, limits=settings.photo)
    contrast = contrast_note(photo.file, limits=settings.photo)
    if contrast is not None:
        facts = replace(facts, notes=(*facts.notes, contrast))
    return with_sidecars(facts, beside_photo(name, photo.beside))


def _is_of_no_camera(facts: PhotoFacts) -> bool:
    return facts.camera is None and facts.taken_at is None and facts.fov is None and not facts.gps


def _may_be_image(facts: PhotoFacts, record: MapRecord) -> bool:
    """Return whether a picture that no camera took may be the map's image.

    It has the size of the present one, or there is none yet and its format is one of drawings.
    """
    if record.satellite_path is None:
        return _is_of_no_camera(facts) and facts.format in _OF_DRAWINGS
    size = record.satellite_width, record.satellite_height
    return _is_of_no_camera(facts) and size == (facts.width, facts.height)


def suffix_of(facts: PhotoFacts) -> str:
    """Return the suffix of a photo's file, by its format."""
    return stored_suffix(facts.format)


def tidy_name(name: str) -> str:
    """Return a storable file name: valid Unicode without control characters, of limited length."""
    text = name.encode("utf-8", "replace").decode("utf-8")
    text = "".join(c for c in text if unicodedata.category(c) != "Cc").strip()
    return text[-_MAX_NAME:] or "photo"


def why_no_gps(facts: PhotoFacts) -> str | None:
    """Explain why a photo has no GPS position, and what helps; None if it has one."""
    if isinstance(facts.gps, Gps):
        return None
    reason = facts.gps.reason
    if facts.gps != ABSENT:
        return reason
    if facts.maker is None:
        return (
            f"{reason}, nor any other EXIF: messengers, screenshots and some galleries remove it; "
            "take the original file from the device"
        )
    if facts.maker.lower() == "apple":
        return (
            f"{reason}: iOS leaves it out when “Location” is off in the options of the photo picker, "
            "or when the camera may not use the location"
        )
    return (
        f"{reason}: was the location switched on in the camera? Android leaves it out of photos that are "
        "chosen in the gallery of a browser; choose them as files, or copy them by cable"
    )


def _row(facts: PhotoFacts, *, name: str, sha256: str, size_bytes: int) -> Photo:
    gps = facts.gps if isinstance(facts.gps, Gps) else None
    return Photo(
        name=name,
        sha256=sha256,
        size_bytes=size_bytes,
        width=facts.width,
        height=facts.height,
        taken_at=facts.taken_at,
        camera=facts.camera,
        fov_deg=facts.fov_deg,
        gps_lat=gps.lat if gps else None,
        gps_lon=gps.lon if gps else None,
        gps_accuracy_m=gps.accuracy_m if gps else None,
        gps_problem=why_no_gps(facts),
        file_notes=list(remarks(facts)) or None,
        heading_deg=facts.heading_deg,
    )


def mark_panorama(row: Photo, tags: PanoramaTags) -> None:
    row.panorama, row.fov_deg = panorama_fields(Panorama(tilt=tags.tilt)), 360.0
    row.heading_deg = row.heading_deg if tags.heading_deg is None else tags.heading_deg


def _say(row: Photo, known: ServiceMetadata) -> None:
    row.source = source_fields(known.source)
    row.gps_lat, row.gps_lon = known.position
    row.gps_accuracy_m, row.gps_problem = known.accuracy_m, None
    row.heading_deg = row.heading_deg if known.heading_deg is None else known.heading_deg
    row.fov_deg = row.fov_deg if known.fov_deg is None else known.fov_deg
    row.taken_at = known.taken_at or row.taken_at


def _state(row: Photo, stated: StatedMetadata) -> None:
    if stated.position is not None and (stated.overrides or row.gps_lat is None):
        row.gps_lat, row.gps_lon = stated.position
        row.gps_accuracy_m, row.gps_problem = stated.accuracy_m, None
    elif stated.overrides and row.gps_lat is None:
        row.gps_problem = _NOT_STATED
    if stated.taken_at is not None and (stated.overrides or row.taken_at is None):
        row.taken_at = stated.taken_at
    row.heading_deg = row.heading_deg if stated.heading_deg is None else stated.heading_deg
    row.camera = stated.camera or row.camera
    row.note = stated.note
    row.file_notes = [*stated.remarks, *(row.file_notes or ())] or None


def _place(row: Photo, record: MapRecord, facts: PhotoFacts) -> str | None:
    """Place a new photo by its GPS; return the reason if that is not possible, such as outside the image."""
    image = image_of(record)
    if image is None or image.georeference is None or row.gps_lat is None or row.gps_lon is None:
        return None
    verdict = place(SurveyedFile(row.name, facts, LatLon(row.gps_lat, row.gps_lon)), image, photo=row.path)
    if verdict.state is not FileState.PLACED or verdict.experience is None:
        return verdict.reason
    row.x_px, row.y_px = verdict.experience.position
    return None
