"""Registers an existing map folder of the library in the database; no file is copied or changed."""

from __future__ import annotations

import hashlib
import re
import secrets
import shutil
import time
from collections.abc import Collection, Iterable, Iterator
from contextlib import suppress
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path

from sqlalchemy import select
from sqlalchemy.orm import Session

from webapp.core.mapmodel.model import Experience, Map, UnplacedPhoto
from webapp.core.mapmodel.notes import MOST_NOTES
from webapp.errors import Conflict, MapError, PhotoError, UsageError
from webapp.files.decode import check_decodes
from webapp.files.listing import normal_name
from webapp.files.maps.folder import MapFolder, json_path, read_map
from webapp.files.maps.lists import LISTS
from webapp.files.maps.map_json import georeference_fields
from webapp.files.photos.exif import Gps
from webapp.files.photos.photo import POSITION_FROM, PhotoFacts, read_facts, read_file, remarks
from webapp.files.photos.sidecars import Sidecars, read_sidecars, sidecars_in, with_sidecars
from webapp.progress import Progress
from webapp.settings import PhotoLimits, Settings
from webapp.store.library import Library
from webapp.store.maps import maps
from webapp.store.maps.changing import INDEX_JOB
from webapp.store.operate import jobs
from webapp.store.operate.job_views import PYRAMID_JOB
from webapp.store.schema import MapRecord, Member, Photo, PlacedElsewhere
from webapp.tasks.maps.export import file_sha256
from webapp.tasks.maps.library_map import fact_columns
from webapp.tasks.satellite.apply import DISPLAY_SIDE_PX
from webapp.tasks.satellite.upright import turned_note

_LARGEST_NEXT_ID = 2_000_000_000
_SLUG = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,79}")


@dataclass(frozen=True, slots=True)
class FolderContents:
    """Contents of a map folder, ready to be registered; records are not yet assigned to a map."""

    map: Map
    cfg_sha256: str | None
    """Of the `map.cfg` that was read."""
    photos: tuple[Photo, ...]
    problems: tuple[str, ...]
    """A message for each missing or unreadable photo, whose record has no size and no EXIF."""
    tray: tuple[Photo, ...] = ()
    """Photos without a position."""


def adopt_map(
    library: Library,
    slug: str,
    *,
    account_id: int,
    settings: Settings | None = None,
    progress: Progress | None = None,
) -> int:
    """Register the folder of a map that is in the library but not in the database.

    Ids, revision and files are unchanged. Missing or unreadable photos keep their positions; the linter
    reports them.

    Args:
        slug: Name of the folder, which has a `map.cfg`.
        settings: Only the limits of photos are used.

    Raises:
        MapError: The folder cannot be read as a map.
        UsageError: The folder's name cannot be used in a URL, or the title in `map.json` is not valid.
        Conflict: The database has such a map already.
    """
    if not _SLUG.fullmatch(slug) or slug in maps.RESERVED:
        raise UsageError(
            f"{slug!r} is not a valid name for a map of the library",
            hint="rename the folder: letters, digits, -",
        )
    settings = settings or Settings()
    contents = read(library.cfg(slug), limits=settings.photo, progress=progress or Progress())
    _check_upright(library.cfg(slug), contents.map, settings)
    for problem in contents.problems:
        (progress or Progress()).note(problem)
    title = contents.map.title or slug.replace("-", " ").capitalize()
    with library.database.write() as session:
        if session.scalars(select(MapRecord.id).where(MapRecord.slug == slug)).first() is not None:
            raise Conflict(f"the library already has a map {slug}", where=slug)
        record = MapRecord(slug=slug, name=maps.checked_name(title), description=contents.map.description)
        session.add(record)
        session.flush()
        session.add(Member(map_id=record.id, account_id=account_id, role="owner"))
        fill(session, record, contents)
        return record.id


def _check_upright(cfg: Path, map_: Map, settings: Settings) -> None:
    """Refuse images that EXIF turns: they would have to be changed, as viewers differ in showing them."""
    floors = (floor.image.path for floor in map_.floors if floor.image)
    for name in (map_.satellite.path, *floors):
        with suppress(MapError):  # missing: the linter reports it
            path = MapFolder(cfg).path(name)
            note = turned_note(path, settings)
            if note is not None:
                raise UsageError(
                    f"the image {name} is turned by its EXIF orientation",
                    where=str(cfg),
                    hint="import a zip of the folder, which makes it upright, or turn it and save it again",
                )


def read(
    cfg: Path, *, limits: PhotoLimits, progress: Progress, decoded: Collection[str] = ()
) -> FolderContents:
    """Read a map folder and all its photos, each file once.

    Args:
        decoded: Normalised names of photos that are known to be complete.
    """
    sha256 = file_sha256(cfg)  # before reading: a change in between is detected as an outside edit
    map_ = read_map(cfg)
    _check_placements(map_, cfg)
    _check_notes(map_, cfg)
    check_room_for_ids(map_, cfg)
    progress.size(len(map_.experiences))
    files = PhotoFiles(cfg, limits, decoded=decoded)
    photos, problems = [], []
    taken: set[str] = set()
    for e in map_.experiences:
        progress.check()
        row, problem = files.row(e)
        if row.sha256 in taken:
            row.sha256 = distinct_hash(row.sha256, e.id)
        taken.add(row.sha256)
        photos.append(row)
        problems += [problem] if problem else []
        progress.advance()
    return FolderContents(map_, sha256, tuple(photos), tuple(problems))


def fill(session: Session, record: MapRecord, contents: FolderContents) -> None:
    """Fill a record with the contents of its folder; the files count as exported by the library.

    Args:
        record: In the database, without photos.
    """
    map_ = contents.map
    record.satellite_revision = record.exported_revision = map_.revision
    record.revision = map_.revision + bool(contents.tray)  # the tray is not in the files yet
    record.exported_sha256 = contents.cfg_sha256
    record.next_id = max([map_.next_id, *(row.id + 1 for row in contents.tray)])
    record.satellite_path = map_.satellite.path
    record.satellite_width, record.satellite_height = map_.satellite.width, map_.satellite.height
    record.georeference = georeference_fields(map_.georeference)
    for name, form in LISTS.items():
        setattr(record, name, form.fields(getattr(map_, name)) or None)
    photos = (*contents.photos, *contents.tray)
    _keep_gps(contents.photos, map_)
    for row in photos:
        row.map_id, row.revision = record.id, record.revision
    session.add_all(photos)
    session.add_all(_placed(record.id, map_))
    session.flush()
    queue_derived(session, record)


def _keep_gps(rows: Iterable[Photo], map_: Map) -> None:
    """Record the GPS position of photos that were placed by it, if their files have none."""
    by_gps = {e.id: e.position for e in map_.experiences if e.by_gps}
    for row in rows:
        if row.id in by_gps and row.gps_lat is None and map_.georeference is not None:
            row.gps_lat, row.gps_lon = map_.georeference.latlon_of(by_gps[row.id])


def queue_derived(session: Session, record: MapRecord) -> None:
    """Queue the jobs for an imported map: its index, and the tiles of a large image."""
    if maps.counts(session, record)[0]:  # `record.photos` may have been read when it was empty
        jobs.enqueue(session, INDEX_JOB, map_id=record.id)
    if max(record.satellite_width or 0, record.satellite_height or 0) > DISPLAY_SIDE_PX:
        jobs.enqueue(session, PYRAMID_JOB, map_id=record.id, key=record.satellite_path or "")


def distinct_hash(sha256: str, id: int) -> str:
    """Return a different hash for the second of two lines with the same photo, as hashes must be unique.

    The first line keeps the true hash, by which the photo is recognised when it is uploaded again.
    """
    return hashlib.sha256(f"{sha256}/{id}".encode()).hexdigest()


def tray_row(
    path: Path, *, known: UnplacedPhoto | None = None, beside: Iterable[Path] = (), limits: PhotoLimits
) -> Photo:
    """Make the record of a photo without a position, not yet assigned to a map, without id and path.

    Its facts in `map.json`, `known`, take precedence over those of its file and of files `beside` it.
    """
    row = Photo(**fact_columns(known or UnplacedPhoto(0, path.name)))
    _read_photo(path, beside=beside, limits=limits).complete(row)
    if known is not None and known.gps is not None and known.gps != (row.gps_lat, row.gps_lon):
        (row.gps_lat, row.gps_lon), row.gps_problem = known.gps, None
        row.gps_accuracy_m = known.gps_accuracy_m
        said = (note for note in row.file_notes or () if not note.startswith(POSITION_FROM))
        row.file_notes = [f"{POSITION_FROM}map.json", *said]
    return row


@dataclass(frozen=True, slots=True)
class _PhotoFile:
    sha256: str
    size_bytes: int
    facts: PhotoFacts

    def complete(self, row: Photo) -> None:
        """Complete a record; its own values take precedence over EXIF."""
        facts = self.facts
        row.sha256, row.size_bytes = self.sha256, self.size_bytes
        row.width, row.height = facts.width, facts.height
        row.taken_at = row.taken_at or facts.taken_at
        row.camera = facts.camera
        row.file_notes = list(remarks(facts)) or None
        row.fov_deg = facts.fov_deg if row.fov_deg is None else row.fov_deg
        if isinstance(facts.gps, Gps):
            row.gps_lat, row.gps_lon = facts.gps.lat, facts.gps.lon
            row.gps_accuracy_m = facts.gps.accuracy_m if row.gps_accuracy_m is None else row.gps_accuracy_m
        else:
            row.gps_problem = facts.gps.reason


def _read_photo(
    path: Path, *, limits: PhotoLimits, beside: Iterable[Path] = (), is_decoded: bool = False
) -> _PhotoFile:
    """Read the file of a photo and its sidecars; raises `PhotoError`."""
    if not is_decoded:
        check_decodes(path, limits=limits)
    data = read_file(path, limits=limits)
    facts = with_sidecars(read_facts(data, limits=limits), read_sidecars(beside))
    return _PhotoFile(hashlib.sha256(data).hexdigest(), len(data), facts)


def check_room_for_ids(map_: Map, cfg: Path) -> None:
    """Refuse a map whose next photo ids would be too large for a `.cfg`. Raises MapError."""
    if map_.next_id > _LARGEST_NEXT_ID:
        raise MapError(
            f"the id {map_.next_id - 1} is so large that few further photos could be added",
            where=str(cfg),
            hint=f"number the photos from 0, and set next_id in map.json; at most {_LARGEST_NEXT_ID}",
        )


def _check_placements(map_: Map, cfg: Path) -> None:
    """Refuse placements whose file names are equal, or that of the map, ignoring case."""
    names = [cfg.stem.casefold(), *(placement.name.casefold() for placement in map_.placements)]
    if len(set(names)) < len(names):
        raise MapError("two placements have one file name", where=str(cfg), hint="rename one of them")


def _check_notes(map_: Map, cfg: Path) -> None:
    """Refuse more notes than a map of the library may have: each edit of one writes all."""
    if len(map_.notes) > MOST_NOTES:
        raise MapError(
            f"the map has {len(map_.notes)} notes, more than {MOST_NOTES}",
            where=str(cfg),
            hint="remove some of them from map.json",
        )


def _placed(map_id: int, map_: Map) -> Iterator[PlacedElsewhere]:
    for placement in map_.placements:
        for id, at in placement.positions.items():
            yield PlacedElsewhere(map_id=map_id, placement=placement.name, photo_id=id, x_px=at.x, y_px=at.y)


class PhotoFiles:
    """Reads the photos of a map's folder, each file once, no matter how many lines of the map name it.

    Args:
        cfg: The map.
        decoded: Normalised names of photos that are known to be complete.
    """

    def __init__(self, cfg: Path, limits: PhotoLimits, *, decoded: Collection[str] = ()) -> None:
        self._cfg, self._files, self._limits, self._decoded = cfg, MapFolder(cfg), limits, decoded
        self._read: dict[str, _PhotoFile | str] = {}

    def row(self, e: Experience) -> tuple[Photo, str | None]:
        """Make a new record of an experience's photo; values of the map take precedence over EXIF.

        Returns:
            row: Not yet assigned to a map; with size 0 if the photo cannot be read.
            problem: Why it cannot be read.
        """
        row = Photo(
            id=e.id,
            path=e.photo,
            sha256=hashlib.sha256(f"no photo {e.id}".encode()).hexdigest(),
            size_bytes=0,
            width=0,
            height=0,
            x_px=e.position.x,
            y_px=e.position.y,
            radius_px=e.radius_px,
            floor=e.floor,
            **fact_columns(e),
        )
        file = self._file(e.photo)
        if isinstance(file, str):
            row.gps_problem = f"{e.photo}: {file}"
            return row, row.gps_problem
        file.complete(row)
        return row, None

    @cached_property
    def _sidecars(self) -> Sidecars:
        return sidecars_in(self._cfg.parent, but=json_path(self._cfg))

    def _file(self, photo: str) -> _PhotoFile | str:
        """Read a photo, or return why it cannot be read."""
        name = normal_name(photo)
        if name not in self._read:
            try:
                beside = [self._cfg.parent / other for other in self._sidecars.of(name)]
                self._read[name] = _read_photo(
                    self._files.path(photo),
                    beside=beside,
                    limits=self._limits,
                    is_decoded=name in self._decoded,
                )
            except (MapError, PhotoError) as error:
                self._read[name] = error.message
        return self._read[name]


def add_removed(session: Session, record: MapRecord, rows: Iterable[Photo]) -> None:
    """Add records of photos marked as removed, so that the edit that restores them can be undone.

    Args:
        rows: Marked as removed, with ids from `next_id` on, not yet assigned to a map.
    """
    for row in rows:
        row.map_id, row.revision = record.id, record.revision
        record.next_id = max(record.next_id, row.id + 1)
        session.add(row)
    session.flush()


_STALE_S = 7 * 86_400
"""Age from which on staging folders are deleted as abandoned."""


def make_staging(library: Library) -> Path:
    """Make an empty staging folder; old ones left by killed processes are deleted."""
    there = staging_parent(library)
    for old in there.iterdir():
        with suppress(FileNotFoundError):  # another import has just finished
            if time.time() - old.stat().st_mtime > _STALE_S:
                shutil.rmtree(old, ignore_errors=True) if old.is_dir() else old.unlink(missing_ok=True)
    folder = there / secrets.token_hex(8)
    folder.mkdir()
    return folder


def staging_parent(library: Library) -> Path:
    """Return the parent of the staging folders, on the file system of the maps; created if missing."""
    folder = library.inner / "imports"
    folder.mkdir(parents=True, exist_ok=True)
    return folder
