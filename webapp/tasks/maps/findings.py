"""Findings of the linter about a map of the library, and their fixes, as edits that can be undone."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Literal, get_args

from sqlalchemy.orm import Session

from webapp.core.geo.types import LatLon, MapPixel, whole_pixel
from webapp.core.mapmodel.findings import Code, Finding
from webapp.core.mapmodel.model import Experience, Map
from webapp.core.mapmodel.paths import name_problem
from webapp.errors import Conflict, UsageError
from webapp.files.contents import hash_of
from webapp.files.decode import image_size
from webapp.files.listing import list_photos, normal_name
from webapp.files.maps.cfg_scan import scan
from webapp.files.maps.folder import photo_path
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.store.library import Library
from webapp.store.maps import edits, maps
from webapp.store.schema import MapRecord, Photo
from webapp.tasks.maps import check_map, export, outside_edit
from webapp.tasks.maps.adopt_map import PhotoFiles, add_removed
from webapp.tasks.maps.library_map import as_map, georeference
from webapp.tasks.relative_paths import relative_finding, show_relative_to
from webapp.tasks.satellite.apply import TRAY
from webapp.tasks.satellite.files import images_of

FixName = Literal["to-tray", "remove", "swap", "adopt", "image-size", "outside-take", "outside-discard"]

FIXES: dict[Code, FixName] = {
    Code.POSITION_OUTSIDE_IMAGE: "to-tray",
    Code.SWAPPED_XY: "swap",
    Code.MISSING_PHOTO: "remove",
    Code.UNREADABLE_PHOTO: "remove",
    Code.PATH_LEAVES_FOLDER: "remove",
    Code.DUPLICATE_PHOTO: "remove",
    Code.IMAGE_SIZE_DIFFERS: "image-size",
    Code.ORPHAN_PHOTO: "adopt",
}
"""Findings that can be fixed by a button."""

FIX_NAMES: tuple[FixName, ...] = get_args(FixName)

OUTSIDE = "outside-edit"
_TOGETHER = 5
"""More findings than this of one kind are grouped into one."""

KIND = "fix"
"""Kind of the edit."""

Changes = dict[str, Mapping[str, Any] | None]


@dataclass(frozen=True, slots=True)
class Problem:
    code: str  # Code of the linter; `outside-edit` for a map file that was edited outside the library
    severity: Literal["error", "warning"]  #
    message: str
    hint: str | None  # What to do, if there is no automatic fix
    ids: tuple[int, ...]  # Affected photos
    fixes: tuple[FixName, ...]


def list_findings(
    library: Library, map_id: int, *, settings: Settings, progress: Progress | None = None
) -> list[Problem]:
    """Check a map of the library, as stored in its records. Raises StorageError, Cancelled.

    Returns:
        Errors first.
    """
    outside = outside_edit.show(library, map_id, settings=settings)
    if outside is None:
        export.export_map(library, map_id)
    with library.database.read() as session:
        record = session.get_one(MapRecord, map_id)
        cfg, map_ = library.cfg(record.slug), as_map(session, record)
    problems = [] if outside is None else [_outside(outside)]
    if map_ is not None:
        report = check_map.check_map(
            cfg, settings=settings, progress=progress or Progress(), content=_lines(map_)
        )
        with library.database.read() as session:
            record = session.get_one(MapRecord, map_id)
            ours = [relative_finding(f, cfg.parent) for f in report.findings if _counts(f)]
            problems += _as_problems(ours, map_, gps_swapped=swapped(record, maps.photos(session, record)))
            problems += _extra(orphans(session, record, cfg))
    return sorted(problems, key=lambda problem: problem.severity != "error")


def orphans(session: Session, record: MapRecord, cfg: Path) -> list[str]:
    """List photos in a map's folder that have no record and are not copies of ones that do.

    Returns:
        Paths relative to the folder.
    """
    rows = maps.photos(session, record)
    known = {normal_name(row.path) for row in rows} | images_of(session, record)
    hashes = {row.sha256 for row in rows}
    found = check_map.orphan_photos(cfg, scan(b""), present=list_photos(cfg.parent))
    return [name for name in found if name not in known and hash_of(cfg.parent / name) not in hashes]


def swapped(record: MapRecord, rows: Iterable[Photo]) -> list[int]:
    """List the photos that agree with their GPS much better if x and y are swapped, as the linter decides."""
    where = georeference(record)
    found = []
    for row in rows:
        if None in (where, row.x_px, row.y_px, row.gps_lat, row.gps_lon) or row.removed:
            continue
        assert where is not None and row.x_px is not None and row.y_px is not None
        assert row.gps_lat is not None and row.gps_lon is not None
        gps = where.pixel_of(LatLon(row.gps_lat, row.gps_lon))
        if not all(abs(value) < 1e9 for value in gps):  # NaN too
            continue
        gx, gy = whole_pixel(gps)
        far = max(abs(row.x_px - gx), abs(row.y_px - gy))
        if 4 * max(abs(row.y_px - gx), abs(row.x_px - gy)) < far:
            found.append(row.id)
    return found


def _lines(map_: Map) -> bytes:
    """Write the records as a map file, even an invalid one, for the linter to check."""
    image = map_.satellite
    lines = [(image.path, image.width, image.height)]
    lines += [(e.id, e.photo, *whole_pixel(e.position)) for e in map_.experiences]  # type: ignore[misc]
    return "".join(";".join(map(str, line)) + "\n" for line in lines).encode("utf-8", "replace")


def _counts(finding: Finding) -> bool:
    """Return False for findings about side files (written from the records) and photos without a record."""
    return not finding.file and finding.code is not Code.ORPHAN_PHOTO


def _as_problems(findings: Sequence[Finding], map_: Map, *, gps_swapped: Sequence[int]) -> list[Problem]:
    """Group the findings by kind, with photo ids instead of line numbers."""
    by_code: dict[Code, list[Finding]] = defaultdict(list)
    for finding in findings:
        by_code[finding.code].append(finding)
    problems = []
    for code, same in by_code.items():
        groups = [same] if len(same) > _TOGETHER else [[finding] for finding in same]
        for group in groups:
            ids = tuple(gps_swapped) if code is Code.SWAPPED_XY and gps_swapped else _ids(map_, group)
            problems.append(_problem(group, ids))
    return problems


def _extra(names: Sequence[str]) -> list[Problem]:
    """List the photos in the folder that have no record."""
    if not names:
        return []
    shown = ", ".join(names[:3]) + (" ..." if len(names) > 3 else "")
    message = f"photos in the folder that are not in the map: {shown} ({len(names)})"
    return [Problem(Code.ORPHAN_PHOTO, "warning", message, None, (), ("adopt",))]


def _problem(group: Sequence[Finding], ids: tuple[int, ...]) -> Problem:
    first = group[0]
    more = f" (and {len(group) - 1} more like it)" if len(group) > 1 else ""
    fix = FIXES.get(first.code)
    return Problem(
        code=first.code,
        severity=first.severity,
        message=first.message + more,
        hint=first.fix if fix is None else None,
        ids=ids,
        fixes=() if fix is None else (fix,),
    )


def _ids(map_: Map, group: Sequence[Finding]) -> tuple[int, ...]:
    """Return the photos of findings by their line numbers; the first photo is on line 2."""
    lines = [finding.line - 2 for finding in group]
    return tuple(map_.experiences[line].id for line in lines if 0 <= line < len(map_.experiences))


def _outside(shown: dict[str, Any]) -> Problem:
    what_counts = ("added", "moved", "turned", "removed", "control_points")
    counts = ", ".join(f"{len(shown[what])} {what.replace('_', ' ')}" for what in what_counts if shown[what])
    message = "map.cfg was changed outside of this program"
    message += f": {shown['problem']}" if shown["problem"] else f" ({counts or 'no relevant change'})"
    fixes: tuple[FixName, ...] = (
        ("outside-discard",) if shown["problem"] else ("outside-take", "outside-discard")
    )
    ids = tuple(photo["id"] for what in ("moved", "turned", "removed", "kept") for photo in shown[what])
    return Problem(OUTSIDE, "error", message, None, ids, fixes)


def fix_findings(
    library: Library, map_id: int, *, fix: str, ids: Sequence[int], account_id: int, settings: Settings
) -> int | None:
    """Apply a fix to the photos of a finding.

    Args:
        fix: One of `findings.FIX_NAMES`.
        ids: Photos; ignored by fixes of the map as a whole.

    Returns:
        Revision of the edit; None if the records did not change.

    Raises:
        UsageError: The fix does not exist or is not applicable.
        NotFound: The map has no such photo.
        Conflict: There is nothing left to fix.
    """
    if fix not in FIX_NAMES:
        raise UsageError(f"unknown fix {fix!r}", where="code", hint=f"use one of {', '.join(FIX_NAMES)}")
    if fix in ("outside-take", "outside-discard"):
        take = fix == "outside-take"
        return _resolve_outside(library, map_id, take=take, account_id=account_id, settings=settings)
    orphaned = _orphaned_photos(library, map_id, settings=settings) if fix == "adopt" else []
    with library.changing(map_id) as change:
        session, record = change.session, change.record
        cfg = library.cfg(record.slug)
        with show_relative_to(cfg.parent):
            if fix == "adopt":
                changes = _adopt(session, record, orphaned)
            elif fix == "image-size":
                changes = _true_size(session, record, cfg)
            else:
                photos = maps.present_photos(session, record, ids)
                changes = {f"photo/{id}": _of_photo(record, photos[id], fix=fix) for id in photos}
        edit = edits.apply(session, record, changes=changes, kind=KIND, account_id=account_id)
        if edit is None:
            raise Conflict("there is nothing left to fix", hint="check the map again")
    return edit.revision


def _resolve_outside(
    library: Library, map_id: int, *, take: bool, account_id: int, settings: Settings
) -> int | None:
    shown = outside_edit.show(library, map_id, settings=settings)
    if shown is None:
        raise Conflict("the map file has not been changed from outside", hint="check the map again")
    sha256 = shown["sha256"]
    if take:
        return outside_edit.take(
            library, map_id, account_id=account_id, settings=settings, sha256=sha256
        ).revision
    outside_edit.discard(library, map_id, sha256=sha256)
    return None


def _of_photo(record: MapRecord, photo: Photo, *, fix: str) -> Mapping[str, Any]:
    match fix:
        case "to-tray":
            return TRAY
        case "remove":
            return {"removed": True}
        case _:
            return _swap(record, photo)


def _swap(record: MapRecord, photo: Photo) -> Mapping[str, Any]:
    x, y = photo.y_px, photo.x_px
    if x is None or y is None or x > (record.satellite_width or 0) or y > (record.satellite_height or 0):
        raise UsageError(f"{photo.name} cannot be swapped: it would lie outside the image", where="ids")
    return {"x_px": x, "y_px": y}


def _true_size(session: Session, record: MapRecord, cfg: Path) -> Changes:
    """Set the true size of the image; photos that are then outside return to the tray."""
    if record.satellite_path is None:
        raise UsageError("the map has no satellite image", hint="upload one")
    width, height = image_size(photo_path(cfg, record.satellite_path))
    changes: Changes = {"map": {"satellite_width": width, "satellite_height": height}}
    for photo in maps.photos(session, record):
        if photo.x_px is not None and photo.y_px is not None and (photo.x_px > width or photo.y_px > height):
            changes[f"photo/{photo.id}"] = TRAY
    return changes


def _orphaned_photos(library: Library, map_id: int, *, settings: Settings) -> list[Photo]:
    """Read the photos of the folder that have no record; unreadable ones are ignored."""
    with library.database.read() as session:
        record = session.get_one(MapRecord, map_id)
        cfg = library.cfg(record.slug)
        with show_relative_to(cfg.parent):
            names = [name for name in orphans(session, record, cfg) if not name_problem(name)]
    files = PhotoFiles(cfg, settings.photo)
    read = (files.row(Experience(0, name, MapPixel(0.0, 0.0))) for name in names)
    return [row for row, problem in read if problem is None]


def _adopt(session: Session, record: MapRecord, orphaned: Sequence[Photo]) -> Changes:
    """Add photos to the tray, without duplicates and those added to the map in the meantime."""
    rows = maps.photos(session, record)
    known = {row.path for row in rows} | {row.sha256 for row in rows}
    new: list[Photo] = []
    for row in orphaned:
        if row.path not in known and row.sha256 not in known:
            known.add(row.sha256)
            row.id = record.next_id + len(new)
            row.x_px = row.y_px = None
            row.removed = True
            new.append(row)
    add_removed(session, record, new)
    return {f"photo/{row.id}": {"removed": False} for row in new}
