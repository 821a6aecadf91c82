"""Imports a zip of a `.cfg` and its folder, also with unplaced photos, as a map of the library."""

from __future__ import annotations

import shutil
from collections.abc import Collection, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

from webapp.core.mapmodel.findings import Code, Finding, quoted
from webapp.core.mapmodel.model import Map, Placement
from webapp.errors import Conflict, InputError, MapError, NotFound, PhotoError
from webapp.files.atomic import storage_error, write_bytes
from webapp.files.exchange.map_zip import UnpackedMap, unpack
from webapp.files.json_fields import most_values_in
from webapp.files.listing import folded, list_photos
from webapp.files.maps.cfg import read_bytes, read_cfg
from webapp.files.maps.cfg_scan import scan
from webapp.files.maps.folder import json_path, placement_path, read_map, read_map_json
from webapp.files.maps.map_json import check_placement_name, format_map_json
from webapp.files.photos.sidecars import sidecars_in
from webapp.progress import Progress
from webapp.settings import PhotoLimits, Settings
from webapp.store.database import Writes
from webapp.store.library import Library
from webapp.store.maps import maps
from webapp.store.schema import MapRecord, Photo
from webapp.tasks.exchange.export_files import UNPLACED
from webapp.tasks.maps import adopt_map, check_map
from webapp.tasks.maps.adopt_map import FolderContents
from webapp.tasks.maps.check_map import orphan_photos
from webapp.tasks.relative_paths import relative_finding, show_relative_to
from webapp.tasks.satellite.upright import make_floors_upright, make_plan_upright


def choose_map(unpacked: UnpackedMap) -> Path:
    """Find the map file, and rename it and its JSON to `map.cfg` and `map.json`.

    A `.cfg` that the JSON of another one lists as a placement is not a map; of several maps, `map.cfg` is
    chosen.

    Raises:
        InputError: There is none, or there are several.
    """
    paths = [unpacked.folder / name for name in unpacked.cfgs]
    if not paths:
        raise InputError("the zip has no map: there is no .cfg in it", hint="zip the folder with its map.cfg")
    known = {other for path in paths for other in _known_placements(path)}
    maps = [path for path in paths if path not in known] or paths
    named = [path for path in maps if path.name.lower() == "map.cfg"]
    if len(maps) > 1 and len(named) != 1:
        raise InputError(
            f"the zip has several maps: {_listed(maps, unpacked.folder)}",
            hint="zip one map at a time, or give the main one the name map.cfg",
        )
    chosen = named[0] if named else maps[0]
    elsewhere = [path for path in maps if path.parent != chosen.parent]
    if elsewhere:
        raise InputError(
            f"the zip has further maps in other folders: {_listed(elsewhere, unpacked.folder)}",
            hint="zip one map at a time",
        )
    cfg = chosen.with_name("map.cfg")
    if chosen != cfg:
        if json_path(chosen).exists():
            json_path(chosen).replace(json_path(cfg))
        chosen.replace(cfg)
    return cfg


def add_placements(cfg: Path) -> None:
    """Add the other `.cfg` files next to a valid map to its `map.json`, as placements."""
    there = {cfg, *_known_placements(cfg)}
    others = [path for path in sorted(cfg.parent.glob("*.cfg")) if path not in there]
    if not others:
        return
    map_ = read_map(cfg)
    photos = {e.id: e.photo for e in map_.experiences}
    strangers = [path for path in others if not _is_placement(path, map_, photos=photos)]
    if strangers:
        raise InputError(
            f"these are not placements of {cfg.name}: they have another image or other photos: "
            f"{_listed(strangers, cfg.parent)}",
            hint="a placement has the first line, ids and photos of the map; zip other maps separately",
        )
    new = [Placement(p.stem, {e.id: e.position for e in read_cfg(p).map.experiences}) for p in others]
    write_bytes(json_path(cfg), format_map_json(replace(map_, placements=(*map_.placements, *new))))


def _known_placements(path: Path) -> list[Path]:
    """List the files that the JSON of a `.cfg` names as placements; the linter reports a damaged JSON."""
    try:
        return [placement_path(path, name) for name in read_map_json(path).placements]
    except MapError:
        return []


def _is_placement(path: Path, map_: Map, *, photos: Mapping[int, str]) -> bool:
    other = read_cfg(path).map
    try:
        check_placement_name(path.stem)
    except MapError:
        return False
    same = all(photos.get(e.id) == e.photo for e in other.experiences)
    return same and other.satellite == map_.satellite and path.suffix == ".cfg"


def _listed(paths: Collection[Path], folder: Path) -> str:
    names = [PurePosixPath(path.relative_to(folder)).as_posix() for path in paths]
    return ", ".join(quoted(name) for name in names[:10]) + (" ..." if len(names) > 10 else "")


_VALUES_PER_PHOTO = 40
"""Limit of the values in JSON, for each file that a zip may have; a photo with all fields has 30."""

_TOLERATED = frozenset({Code.MISSING_PHOTO, Code.UNREADABLE_PHOTO})
"""Errors of single photos: they are reported, and the map is imported nevertheless."""


@dataclass(frozen=True, slots=True)
class ImportedMap:
    map_id: int
    slug: str
    findings: tuple[Finding, ...]  # Findings of the linter
    # Files of the zip that do not belong to a map, and unplaced photos that were not imported, with the
    # reason.
    left_out: tuple[str, ...]


class MapRefused(MapError):
    """The linter found errors with which the map cannot be imported.

    Attributes:
        findings: All findings, warnings included.
    """

    def __init__(self, message: str, *, findings: tuple[Finding, ...], hint: str | None = None) -> None:
        super().__init__(message, hint=hint)
        self.findings = findings


def import_map(
    library: Library,
    archive: Path,
    *,
    account_id: int,
    name: str,
    settings: Settings,
    progress: Progress | None = None,
) -> ImportedMap:
    """Import a map, all or nothing.

    Args:
        archive: The zip; it is not changed.
        settings: The limits of imports and photos.
        progress: One step per file in each of three phases: unpacking, checking, reading.

    Raises:
        InputError: It is not a zip, is not safe, or holds no map or several.
        MapRefused: The map has errors; with the findings of the linter.
    """
    name = maps.checked_name(name)
    with _unpacked(library, archive, settings=settings, progress=progress or Progress()) as found:
        map_id, slug = _register(library, found, name=name, account_id=account_id)
        return ImportedMap(map_id, slug, found.findings, found.left_out)


def run_into(
    library: Library,
    archive: Path,
    *,
    map_id: int,
    settings: Settings,
    progress: Progress | None = None,
    writes: Writes | None = None,
) -> ImportedMap:
    """Import a zip into an existing empty map; idempotent.

    Parameters and errors are those of `import_map`, and:

    Args:
        writes: Opens the write session; a job passes its own, which checks its lease.

    Raises:
        Conflict: The map is no longer empty.
        NotFound: The map does not exist, or is in the bin.
    """
    with _unpacked(library, archive, settings=settings, progress=progress or Progress()) as found:
        with (writes or library.database.write)() as session:
            record = session.get(MapRecord, map_id)
            if record is None or record.binned_at is not None:
                raise NotFound("the map was deleted, or is in the bin")
            if record.exported_sha256 != found.contents.cfg_sha256 or not record.photos:
                if record.photos or record.satellite_path is not None:
                    raise Conflict("the map is no longer empty", hint="import the zip as a new map")
                adopt_map.fill(session, record, found.contents)
                session.flush()
                _move_into(found.cfg.parent, library.map_folder(record.slug))
            slug = record.slug
        return ImportedMap(map_id, slug, found.findings, found.left_out)


@dataclass(frozen=True, slots=True)
class _Found:
    cfg: Path
    contents: adopt_map.FolderContents
    findings: tuple[Finding, ...]
    left_out: tuple[str, ...]


@contextmanager
def _unpacked(library: Library, archive: Path, *, settings: Settings, progress: Progress) -> Iterator[_Found]:
    """Unpack, check and read a zip in a temporary folder."""
    place = adopt_map.make_staging(library)
    try:
        progress.note("unpacking")
        folder = place / "map"
        folder.mkdir()
        limits, reserve_mb = settings.imports, settings.upload.reserve_mb
        unpacked = unpack(archive, folder, limits=limits, reserve_mb=reserve_mb, progress=progress)
        _check_lines(unpacked, most=settings.imports.max_files)
        cfg = choose_map(unpacked)
        make_plan_upright(cfg, scratch=place, settings=settings)
        make_floors_upright(cfg, scratch=place, settings=settings)
        with show_relative_to(cfg.parent):
            tray = set_tray_aside(cfg, place / "tray")
            progress.note("checking")
            findings, decoded = _checked(cfg, settings=settings, progress=progress)
            add_placements(cfg)
            progress.note("reading photos")
            contents = adopt_map.read(cfg, limits=settings.photo, progress=progress, decoded=decoded)
            contents, not_taken = take_tray_back(
                contents, tray, cfg=cfg, limits=settings.photo, progress=progress
            )
        yield _Found(cfg, contents, findings, (*unpacked.left_out, *not_taken))
    finally:
        shutil.rmtree(place, ignore_errors=True)


def _check_lines(unpacked: UnpackedMap, *, most: int) -> None:
    """Refuse maps with more lines than the zip may have files, each of which costs a look-up on the disk, and
    JSON with far more values than such a map has, which takes memory."""
    values = sum(most_values_in(read_bytes(path)) for path in unpacked.folder.rglob("*.json"))
    if values > most * _VALUES_PER_PHOTO:
        raise InputError(
            f"the map has more than {most * _VALUES_PER_PHOTO} values in map.json",
            hint="remove what is not needed, or raise the limit of files",
        )
    lines = sum(read_bytes(unpacked.folder / name).count(b"\n") for name in unpacked.cfgs)
    if lines > most:
        raise InputError(
            f"the map has {lines} lines, more than the limit of {most}",
            hint="leave out photos that are missing",
        )


def _register(library: Library, found: _Found, *, name: str, account_id: int) -> tuple[int, str]:
    """Create the record and move the folder into the library; on failure, keep neither."""
    folder: Path | None = None
    kept = False
    try:
        with library.database.write() as session:
            folders = [path.name for path in library.folder.iterdir()]
            record = maps.create(session, name, account_id=account_id, folders=folders)
            adopt_map.fill(session, record, found.contents)
            session.flush()
            folder = library.map_folder(record.slug)
            found.cfg.parent.rename(folder)
        kept = True
    finally:
        if folder is not None and not kept:
            shutil.rmtree(folder, ignore_errors=True)
    return record.id, record.slug


def _move_into(source: Path, folder: Path) -> None:
    """Move files into the folder of an empty map, replacing leftovers of a killed import."""
    folder.mkdir(exist_ok=True)
    for child in source.iterdir():
        target = folder / child.name
        if target.is_dir():
            shutil.rmtree(target)
        child.rename(target)


def _checked(
    cfg: Path, *, settings: Settings, progress: Progress
) -> tuple[tuple[Finding, ...], frozenset[str]]:
    """Return the findings, and the names of the photos that could be decoded."""
    report = check_map.check_map(cfg, settings=settings, progress=progress)
    findings = tuple(relative_finding(f, cfg.parent) for f in report.findings)
    errors = [f for f in findings if f.severity == "error" and f.code not in _TOLERATED]
    if errors:
        first = errors[0]
        more = f", and {len(errors) - 1} more errors" if len(errors) > 1 else ""
        raise MapRefused(
            f"{first.file or cfg.name}:{first.line}:{first.column}: {first.message}{more}",
            findings=findings,
            hint=first.fix,
        )
    return findings, report.decoded


def archive_path(library: Library, token: str) -> Path:
    """Return the path of an uploaded zip that awaits its import; create its folder if missing.

    Args:
        token: Hexadecimal digits.
    """
    return adopt_map.staging_parent(library) / f"{int(token, 16):032x}.zip"


@dataclass(frozen=True, slots=True)
class Tray:
    """Unplaced photos that are set aside during an import."""

    folder: Path  # Temporary folder outside the map, whose linter would report them as orphans
    names: tuple[str, ...]  # Their paths in that folder, which are also those to use in the map's folder


def set_tray_aside(cfg: Path, folder: Path) -> Tray:
    """Move the photos in `unplaced/` that no `.cfg` of the map names. Raises StorageError.

    Args:
        folder: A new folder on the same disk, not below the map's.
    """
    orphans = orphan_photos(cfg, scan(read_bytes(cfg)), present=list_photos(cfg.parent))
    names = tuple(name.removeprefix(f"{UNPLACED}/") for name in orphans if name.startswith(f"{UNPLACED}/"))
    there = cfg.parent / UNPLACED
    beside = sidecars_in(there) if there.is_dir() else None
    for name in names:
        for file in (name, *(() if beside is None else beside.of(name))):
            if not (folder / file).exists():  # two photos may share one
                _move(there / file, folder / file, name=file)
    _drop_empty(cfg.parent / UNPLACED)
    return Tray(folder, names)


def take_tray_back(
    contents: FolderContents, tray: Tray, *, cfg: Path, limits: PhotoLimits, progress: Progress
) -> tuple[FolderContents, tuple[str, ...]]:
    """Move photos into the folder of their map and add their records to its contents.

    Photos that the map has already are left out. Those listed in `map.json` keep their ids, and with them the
    order of the map's photos. Raises StorageError, Cancelled.

    Returns:
        left_out: Files by their names in the zip, each with the reason.
    """
    rows: list[Photo] = []
    left_out: list[str] = []
    known = {row.sha256 for row in contents.photos}
    names = _Names(cfg.parent)
    listed = {photo.photo: photo for photo in contents.map.unplaced}
    free = contents.map.next_id
    beside = sidecars_in(tray.folder) if tray.names else None
    for name in tray.names:
        progress.check()
        listing = listed.get(name)
        try:
            others = [tray.folder / other for other in (beside.of(name) if beside else ())]
            row = adopt_map.tray_row(tray.folder / name, known=listing, beside=others, limits=limits)
        except PhotoError as error:
            left_out.append(f"{UNPLACED}/{name}: {error.message}")
            continue
        if row.sha256 in known:
            left_out.append(f"{UNPLACED}/{name}: the map has this photo already")
            continue
        known.add(row.sha256)
        row.id, row.path = free if listing is None else listing.id, names.take(name)
        free += listing is None
        _move(tray.folder / name, cfg.parent / row.path, name=name)
        rows.append(row)
    return replace(contents, tray=tuple(rows)), tuple(left_out)


class _Names:
    """The names of a folder's files, compared as on a case-insensitive file system."""

    def __init__(self, folder: Path) -> None:
        self._files: set[str] = set()
        self._folders: set[str] = set()
        for path in folder.rglob("*"):
            if path.is_file():
                self._add(path.relative_to(folder).as_posix())

    def take(self, name: str) -> str:
        """Reserve the name of a new file, with the prefix `unplaced/` if the name is taken."""
        while self._is_barred(name):
            name = f"{UNPLACED}/{name}"
        self._add(name)
        return name

    def _add(self, name: str) -> None:
        self._files.add(folded(name))
        self._folders.update(_above(name))

    def _is_barred(self, name: str) -> bool:
        above_or_below = folded(name) in self._folders or not self._files.isdisjoint(_above(name))
        return above_or_below or folded(name) in self._files


def _above(name: str) -> list[str]:
    return [folded(str(parent)) for parent in PurePosixPath(name).parents]


def _drop_empty(folder: Path) -> None:
    """Delete the empty folders in a folder, then the folder itself if it is empty."""
    below = [path for path in folder.rglob("*") if path.is_dir()]
    for path in sorted([folder, *below], reverse=True):
        if path.is_dir() and not any(path.iterdir()):
            path.rmdir()


def _move(source: Path, target: Path, *, name: str) -> None:
    try:
        target.parent.mkdir(parents=True, exist_ok=True)
        source.rename(target)
    except OSError as error:
        raise storage_error(error, where=f"{UNPLACED}/{name}") from error
