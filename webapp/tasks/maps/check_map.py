"""Checks a map: lists all its problems, and how to fix them."""

from __future__ import annotations

import math
import re
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from webapp.core.geo.georeference import Georeference
from webapp.core.geo.types import LatLon, whole_pixel
from webapp.core.hypotheses.places import MapPlaces, describe_places
from webapp.core.mapmodel.checks import FileFacts, FolderFacts, PhotoLine, check_folder, check_lines, free_id
from webapp.core.mapmodel.findings import Code, Finding, quoted
from webapp.errors import MapError, PhotoError
from webapp.files.contents import is_there
from webapp.files.decode import check_decodes, image_size
from webapp.files.listing import Spelling, list_photos, normal_name
from webapp.files.maps.cfg import read_bytes
from webapp.files.maps.cfg_scan import Scan, scan
from webapp.files.maps.folder import MapFolder, json_path, photo_path, placement_path, read_map_json
from webapp.files.maps.map_json import MapJson
from webapp.files.photos.exif import Gps
from webapp.files.photos.photo import read_facts
from webapp.progress import Progress
from webapp.settings import PhotoLimits, Settings

_QUERIES = "queries"
_SEPARATORS = re.compile(r"[;,\t]")
"""Column separators in use, valid or not."""


@dataclass(frozen=True, slots=True)
class SideFiles:
    """Findings about the files next to a `.cfg`; georeference and further file names from `map.json`."""

    findings: list[Finding] = field(default_factory=list)
    georeference: Georeference | None = None
    named: frozenset[str] = frozenset()
    """Photos in the tray and images of floors."""


def check_side_files(cfg_path: Path, pieces: Scan) -> SideFiles:
    """Check `map.json` and the placements it names against the lines of the `.cfg`.

    Returns:
        Empty if there is no `map.json`.
    """
    file = json_path(cfg_path).name
    try:
        known = read_map_json(cfg_path)
    except MapError as error:
        fix = error.hint or "restore the file, or delete it: the .cfg alone is a map"
        message = f"{error.where}: {error.message}" if error.where else error.message
        return SideFiles([Finding(Code.MAP_JSON_DAMAGED, 1, 1, message, fix, file)])
    lines = {line.id: line for line in pieces.photos if line.id is not None}
    findings = [*_stale(known, lines, file=file), *_positions(known, lines, file=file)]
    if json_path(cfg_path).exists() and known.next_id < free_id(pieces.photos):
        message = f"next_id is {known.next_id}, but the map has the id {free_id(pieces.photos) - 1}"
        fix = f"write next_id {free_id(pieces.photos)}"
        findings.append(Finding(Code.NEXT_ID_TOO_SMALL, 1, 1, message, fix, file))
    photos = {line.id: line.photo for line in pieces.photos if line.id is not None}
    for name in known.placements:
        findings += _placement(cfg_path, name, pieces=pieces, photos=photos)
    plans = [floor.image.path for floor in known.floors if floor.image]
    for name in plans:
        findings += _floor_image(cfg_path, name, file=file)
    named = frozenset(map(normal_name, (*(record.photo for record in known.unplaced.values()), *plans)))
    return SideFiles(findings, known.georeference, named)


def _floor_image(cfg_path: Path, name: str, *, file: str) -> Iterator[Finding]:
    """Find a missing image of a floor, or one whose link leads out of the folder."""
    try:
        there = photo_path(cfg_path, name).is_file()
    except MapError:
        there = False
    if not there:
        fix = f"put {quoted(name)} into the folder, or delete the image of the floor in {file}"
        yield Finding(Code.MISSING_FLOOR, 1, 1, f"there is no image {quoted(name)} of a floor", fix, file)


def _stale(known: MapJson, lines: dict[int, PhotoLine], *, file: str) -> Iterator[Finding]:
    """Find records in `map.json` whose id is missing from the `.cfg`, or has another photo there."""
    for id, record in known.experiences.items():
        line = lines.get(id)
        if line is None:
            message = f"the id {id} ({quoted(record.photo)}) is not in the .cfg: its record is ignored"
            yield Finding(Code.MAP_JSON_STALE, 1, 1, message, f"delete the record of id {id}", file)
        elif line.photo is not None and line.photo != record.photo:
            message = f"the id {id} is {quoted(line.photo)} in the .cfg, but {quoted(record.photo)} in {file}"
            fix = f"write the same photo in both; until then the record in {file} is ignored"
            yield Finding(Code.MAP_JSON_STALE, line.line, line.columns[1], message, fix)


def _positions(known: MapJson, lines: dict[int, PhotoLine], *, file: str) -> Iterator[Finding]:
    """Find sub-pixel positions that do not round to the ones in the `.cfg`."""
    for id, record in known.experiences.items():
        line = lines.get(id)
        if line is None or line.photo != record.photo or record.position is None:
            continue
        at, exact = (line.line, line.columns[2]), record.position
        x, y = whole_pixel(exact)
        if None in (line.x, line.y) or (line.x, line.y) == (x, y):
            continue
        if (line.y, line.x) == (x, y):
            message = f"x and y seem to be swapped: {file} has ({exact.x:g}, {exact.y:g})"
            yield Finding(Code.SWAPPED_XY, *at, message, f"write {line.text(x=x, y=y)}")
        else:
            message = (
                f"{file} has ({exact.x:g}, {exact.y:g}), which differs; the position in this line is used"
            )
            fix = f"write {line.text(x=x, y=y)}, or delete x_px and y_px of id {id} in {file}"
            yield Finding(Code.MAP_JSON_POSITION, *at, message, fix)


def _placement(cfg_path: Path, name: str, *, pieces: Scan, photos: Mapping[int, str | None]) -> list[Finding]:
    """Check the `.cfg` of a placement, by itself and against that of the map, with its photos by id."""
    path = placement_path(cfg_path, name)
    try:
        placed = scan(read_bytes(path))
    except MapError as error:
        fix = f"put {path.name} back, or delete the placement {name!r} in {json_path(cfg_path).name}"
        return [Finding(Code.PLACEMENT_DAMAGED, 1, 1, error.message, fix, path.name)]
    found = [*placed.faults, *check_lines(placed.image, placed.photos)]
    found = [replace(finding, file=path.name) for finding in found]
    if placed.image and pieces.image and _image(placed) != _image(pieces):
        message = f"the first line is not that of {cfg_path.name}"
        fix = "write {};{};{}".format(*_image(pieces))
        found.append(Finding(Code.PLACEMENT_DAMAGED, 1, 1, message, fix, path.name))
    for line in placed.photos:
        if line.id is not None and line.id not in photos:
            message = f"the id {line.id} is not in {cfg_path.name}: the line is ignored"
            found.append(Finding(Code.PLACEMENT_STALE, line.line, 1, message, "delete the line", path.name))
        elif (
            line.id is not None
            and None not in (line.photo, photos[line.id])
            and line.photo != photos[line.id]
        ):
            message = (
                f"the id {line.id} has another photo in {cfg_path.name}: {quoted(photos[line.id] or '')}"
            )
            fix = f"write {line.id};{photos[line.id]};{line.x};{line.y}"
            found.append(Finding(Code.PLACEMENT_DAMAGED, line.line, line.columns[1], message, fix, path.name))
    return found


def _image(pieces: Scan) -> tuple[object, ...]:
    image = pieces.image
    return (image.image, image.width, image.height) if image else ()


@dataclass(frozen=True, slots=True)
class CheckReport:
    cfg_path: Path
    photos: int  # Number of readable photo lines
    # Those of the `.cfg` first, in the order of the lines, then those of the files next to it.
    findings: tuple[Finding, ...]
    # Kind of map and place radius by the positions alone; None if no photo has a position, or the image size
    # is unknown.
    places: MapPlaces | None = None
    decoded: frozenset[str] = frozenset()  # Normalised names of the photos that could be decoded

    @property
    def errors(self) -> int:
        """Number of findings that make the map unusable."""
        return sum(finding.severity == "error" for finding in self.findings)

    @property
    def warnings(self) -> int:
        """Number of findings that leave the map usable."""
        return len(self.findings) - self.errors


def check_map(
    cfg_path: Path, *, settings: Settings, progress: Progress, content: bytes | None = None
) -> CheckReport:
    """Check a map file, the files next to it and the photos that it names.

    Args:
        settings: Only the limits of photos are used.
        content: Used instead of the content of the map file.

    Raises:
        MapError: The file does not exist or cannot be read.
        Cancelled: The user stopped it.
    """
    pieces = scan(read_bytes(cfg_path) if content is None else content)
    side_files = check_side_files(cfg_path, pieces)
    findings = [*pieces.faults, *check_lines(pieces.image, pieces.photos), *side_files.findings]
    judge = _FileChecker(MapFolder(cfg_path), settings.photo, side_files.georeference)
    facts = _folder_facts(cfg_path, judge, pieces=pieces, named=side_files.named, progress=progress)
    findings += check_folder(pieces.image, pieces.photos, facts=facts)
    findings.sort(key=lambda finding: (finding.file, finding.line, finding.column))
    decoded = frozenset(normal_name(name) for name, found in facts.photos.items() if found.state == "ok")
    return CheckReport(cfg_path, len(pieces.photos), tuple(findings), _places(pieces), decoded)


def _places(pieces: Scan) -> MapPlaces | None:
    image = pieces.image
    positions = [(line.x, line.y) for line in pieces.photos if None not in (line.x, line.y)]
    if image is None or image.width is None or image.height is None or not positions:
        return None
    return describe_places(np.array(positions, np.float64), trust=None, size=(image.width, image.height))


@dataclass(frozen=True, slots=True)
class _FileChecker:
    files: MapFolder
    limits: PhotoLimits
    georeference: Georeference | None

    def find(self, name: str) -> FileFacts:
        try:
            path = self.files.place(name)
        except MapError as error:
            return FileFacts("outside", error.message)
        return FileFacts("ok" if is_there(path) else "missing")

    def photo(self, name: str) -> FileFacts:
        """Return whether an existing photo can be decoded, and the pixel of its GPS position."""
        path = self.files.path(name)
        try:
            check_decodes(path, limits=self.limits)
            gps = read_facts(path, limits=self.limits).gps if self.georeference else None
        except PhotoError as error:
            return FileFacts("unreadable", error.message)
        if self.georeference is None or not isinstance(gps, Gps):
            return FileFacts("ok")
        pixel = self.georeference.pixel_of(LatLon(gps.lat, gps.lon))
        return FileFacts("ok", gps=pixel if math.isfinite(pixel.x) and math.isfinite(pixel.y) else None)

    def image(self, name: str) -> tuple[FileFacts, tuple[int, int] | None]:
        """Return whether an existing image can be read, and its size in pixels."""
        try:
            return FileFacts("ok"), image_size(self.files.path(name))
        except PhotoError as error:
            return FileFacts("unreadable", error.message), None


def _folder_facts(
    cfg_path: Path, judge: _FileChecker, *, pieces: Scan, named: frozenset[str], progress: Progress
) -> FolderFacts:
    present = list_photos(cfg_path.parent)
    orphans = [name for name in orphan_photos(cfg_path, pieces, present=present) if name not in named]
    listed, unused = Spelling(present), Spelling(orphans)

    def spelled(name: str, found: FileFacts) -> FileFacts:
        actual = listed.same(normal_name(name))
        if found.state == "missing" and actual is None:
            actual = unused.similar(name)
        return replace(found, actual=actual)

    photos: dict[str, FileFacts] = {}
    looked: dict[str, FileFacts] = {}  # by normalised name: one file can be named in several ways
    wanted = dict.fromkeys(line.photo for line in pieces.photos if line.photo is not None)
    progress.size(len(wanted))
    for name in wanted:
        progress.check()
        found = judge.find(name)
        if found.state == "ok":
            same = normal_name(name)
            found = looked[same] = looked.get(same) or judge.photo(name)
        photos[name] = spelled(name, found)
        progress.advance()
    satellite, size = FileFacts("ok"), None
    image = pieces.image.image if pieces.image else None
    if image is not None:
        satellite = judge.find(image)
        if satellite.state == "ok":
            satellite, size = judge.image(image)
        satellite = spelled(image, satellite)
    return FolderFacts(satellite, size, photos, orphans)


def orphan_photos(cfg_path: Path, pieces: Scan, *, present: Sequence[str]) -> list[str]:
    """List the photos that no map in the folder names, not even on an unreadable line.

    Photos in `queries/` are example queries and are left out.

    Args:
        pieces: Scan of the map file.
        present: Photos below the folder.
    """
    others = [
        scan(read_bytes(p)) for p in sorted(cfg_path.parent.glob("*.cfg")) if p.is_file() and p != cfg_path
    ]
    named: set[str] = set()
    for each in (pieces, *others):
        named |= {normal_name(line.photo) for line in each.photos if line.photo is not None}
        if each.image and each.image.image is not None:
            named.add(normal_name(each.image.image))
        for text in each.unread:
            named |= {normal_name(cell.strip()) for cell in _SEPARATORS.split(text)}
    return [name for name in present if name not in named and not name.startswith(f"{_QUERIES}/")]
