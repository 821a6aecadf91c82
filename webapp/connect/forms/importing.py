"""Takes over an export of submissions: its photos are added to a map in the same way as an upload.

A photo that the map has already is recognised by its content: a later export of the same form adds only what
is new, and so does a run after one that was killed.
"""

from __future__ import annotations

import shutil
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from pathlib import Path, PurePosixPath
from typing import Any, NamedTuple

from webapp.connect.forms.submissions import SubmittedPhoto, read_submissions
from webapp.core.geo.types import LatLon
from webapp.errors import InputError, NotFound, PhotoError, TableError
from webapp.files.decode import PHOTO_SUFFIXES
from webapp.files.exchange.map_zip import unpack
from webapp.files.maps.geopackage import MAGIC
from webapp.files.maps.positions import read_positions
from webapp.jobs.context import Context
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.store.library import Library
from webapp.tasks.exchange.import_map import archive_path
from webapp.tasks.maps.add_photo import Changing, IncomingPhoto, StatedMetadata, add_photo
from webapp.tasks.maps.adopt_map import make_staging

TABLES = frozenset({".csv", ".gpkg"})
_ZIP = (b"PK\x03\x04", b"PK\x05\x06")
_NAMED = 100
"""Photos that a result names."""


@dataclass(frozen=True, slots=True)
class FormPhoto:
    """A photo of an export."""

    file: Path
    name: str  # Relative to the export
    stated: StatedMetadata


@dataclass(slots=True)
class FormExport:
    """What an export has."""

    photos: list[FormPhoto] = field(default_factory=list)
    missing: list[str] = field(default_factory=list)  # Named in a table, but not in the export
    unnamed: list[str] = field(default_factory=list)  # In the export, but named in no table


class FormFile(NamedTuple):
    """A file of an export: a zip, a table or a GeoPackage."""

    path: Path
    name: str  # As the user knows it


class GivenExport(NamedTuple):
    """The files of an export, and how they are read."""

    files: Sequence[FormFile]
    all_answers: bool = False  # Notes have all answers, not only the comments


@dataclass(slots=True)
class FormReport:
    """The result of taking over an export."""

    added: int = 0
    placed: int = 0
    duplicates: int = 0
    missing: list[str] = field(default_factory=list)
    unnamed: list[str] = field(default_factory=list)
    failed: list[dict[str, str]] = field(default_factory=list)

    def to_json(self) -> dict[str, Any]:
        return {
            "added": self.added,
            "placed": self.placed,
            "duplicates": self.duplicates,
            "missing": self.missing[:_NAMED],
            "unnamed": self.unnamed[:_NAMED],
            "failed": self.failed[:_NAMED],
        }


def import_uploaded(context: Context) -> Mapping[str, Any]:
    """Take over an uploaded export.

    The argument `files` lists tokens and names of its files, which are deleted afterwards.
    """
    files = [
        FormFile(archive_path(context.library, one["token"]), one["name"])
        for one in context.arguments["files"]
    ]
    if not all(file.path.is_file() for file in files):
        raise NotFound("the uploaded export no longer exists", hint="upload it again")
    report = import_export(
        context.library,
        context.map().id,
        given=GivenExport(files, bool(context.arguments["all_answers"])),
        settings=context.settings,
        progress=context.progress,
        changing=context.changing,
    )
    for file in files:
        file.path.unlink(missing_ok=True)
    return report.to_json()


def import_export(
    library: Library,
    map_id: int,
    *,
    given: GivenExport,
    settings: Settings,
    progress: Progress,
    changing: Changing | None = None,
) -> FormReport:
    """Add the photos of an export to a map; those that cannot be used are reported.

    Raises:
        InputError: A file is damaged or too large, or no table names a photo of the export.
        NotFound: The map is gone.
    """
    with staged(library) as folder:
        export = read_export(given, folder=folder, settings=settings, progress=progress)
        report = FormReport(missing=export.missing, unnamed=export.unnamed)
        progress.size(len(export.photos))
        progress.note("adding photos")
        for photo in export.photos:
            progress.check()
            incoming = IncomingPhoto(photo.file, PurePosixPath(photo.name).name, stated=photo.stated)
            try:
                added = add_photo(library, map_id, photo=incoming, settings=settings, changing=changing)
            except PhotoError as error:
                report.failed.append({"name": photo.name, "reason": error.message})
            else:
                report.duplicates += added.duplicate
                report.added += not added.duplicate
                report.placed += added.placed and not added.duplicate
            progress.advance()
        return report


@contextmanager
def staged(library: Library) -> Iterator[Path]:
    """Make a temporary folder on the disk of the library."""
    folder = make_staging(library)
    try:
        yield folder
    finally:
        shutil.rmtree(folder, ignore_errors=True)


def read_export(given: GivenExport, *, folder: Path, settings: Settings, progress: Progress) -> FormExport:
    """Unpack and read an export.

    Args:
        folder: Empty; for its files.

    Raises:
        InputError: A file is damaged or too large, or no table names a photo of the export.
    """
    for number, file in enumerate(given.files):
        _unpack(file, folder / str(number), settings=settings, progress=progress)
    there = sorted(path for path in folder.rglob("*") if path.is_file())
    tables = [path for path in there if path.suffix.lower() == ".csv"]
    packages = [path for path in there if path.suffix.lower() == ".gpkg"]
    if not tables and not packages:
        raise InputError(
            "the export has no table",
            hint="choose a zip with a table (CSV or GeoPackage) and its photos",
        )
    named = read_submissions(tables, folder=folder, all_answers=given.all_answers)
    for package in packages:
        named += _of_package(package, where=package.relative_to(folder).as_posix())
    return _matched(named, _Files(folder, there))


def _unpack(file: FormFile, folder: Path, *, settings: Settings, progress: Progress) -> None:
    """Unpack a zip; a table is linked into the folder."""
    folder.mkdir()
    with file.path.open("rb") as opened:
        head = opened.read(len(MAGIC))
    if head.startswith(_ZIP):
        progress.note("unpacking")
        reserve_mb = settings.upload.reserve_mb
        unpack(
            file.path,
            folder,
            limits=settings.imports,
            reserve_mb=reserve_mb,
            progress=progress,
            tables=TABLES,
        )
    else:
        shutil.copyfile(file.path, folder / ("table.gpkg" if head == MAGIC else "table.csv"))


def _of_package(path: Path, *, where: str) -> list[SubmittedPhoto]:
    """Read the points of a GeoPackage that name photos; none if it has no such layer."""
    try:
        listed = read_positions(path)
    except TableError as error:
        if error.message == "no point in it has a name":
            return []
        raise
    found = []
    for name, position in listed.by_name.items():
        at = position if isinstance(position, LatLon) else None
        heading, note = listed.heading_of(name), listed.note_of(name)
        found.append(SubmittedPhoto(name, None, where, position=at, heading_deg=heading, note=note))
    return found


class _Files:
    """The photos of an export by their names."""

    def __init__(self, folder: Path, there: Sequence[Path]) -> None:
        self.names = {
            path.relative_to(folder).as_posix(): path
            for path in there
            if path.suffix.lower() in PHOTO_SUFFIXES
        }
        self._by_last: dict[str, list[str]] = {}
        for name in self.names:
            self._by_last.setdefault(PurePosixPath(name).name.casefold(), []).append(name)

    def find(self, photo: SubmittedPhoto) -> str | None:
        """Find the file of a photo; of several with its name, the one in the folder of its submission."""
        wanted = PurePosixPath(photo.name)
        same = self._by_last.get(wanted.name.casefold(), [])
        if len(same) > 1 and photo.submission:
            same = [name for name in same if photo.submission in PurePosixPath(name).parts]
        if len(same) > 1:
            same = [name for name in same if name.endswith(f"/{wanted.as_posix()}")]
        return same[0] if len(same) == 1 else None


def _matched(named: Sequence[SubmittedPhoto], files: _Files) -> FormExport:
    export = FormExport()
    taken: set[str] = set()
    for photo in named:
        name = files.find(photo)
        if name is None:
            export.missing.append(f"{photo.name} ({photo.where})")
        elif name not in taken:
            taken.add(name)
            stated = StatedMetadata(
                False,
                photo.position,
                photo.accuracy_m,
                taken_at=photo.taken_at,
                heading_deg=photo.heading_deg,
                note=photo.note,
            )
            export.photos.append(FormPhoto(files.names[name], name.partition("/")[2], stated))
    export.unnamed = [name.partition("/")[2] for name in files.names if name not in taken]
    if not export.photos:
        raise InputError(
            "no table of the export names a photo that is in it",
            hint="export the photos, too; for KoboToolbox give the CSV and the zip with the media",
        )
    return export
