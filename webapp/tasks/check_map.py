"""Says what is wrong with a map and how to fix it, all of it in one go."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from webapp.core.mapmodel.checks import FolderFacts, PhotoFacts, check_folder, check_lines
from webapp.core.mapmodel.findings import Finding
from webapp.errors import MapError, PhotoError
from webapp.files.cfg import read_bytes
from webapp.files.cfgscan import Scan, scan
from webapp.files.imageprobe import check_decodes, image_size
from webapp.files.listing import Spelling, list_photos, normal_name
from webapp.files.mapfolder import photo_path
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.check_beside import check_beside


@dataclass(frozen=True, slots=True)
class Report:
    """What the check of a map found.

    Attributes
    ----------
    cfg_path : Path
    photos : int
        Lines of photos that could be read.
    findings : tuple of Finding
        Those of the `.cfg` first, in the order of the lines, then those of the files beside it.
    """

    cfg_path: Path
    photos: int
    findings: tuple[Finding, ...]

    @property
    def errors(self) -> int:
        """Number of findings that make the map unusable."""
        return sum(finding.severity == "error" for finding in self.findings)

    @property
    def warnings(self) -> int:
        """Number of findings that leave the map usable."""
        return len(self.findings) - self.errors


def run(cfg_path: Path, *, settings: Settings, progress: Progress) -> Report:
    """Check a map file, the files beside it and the photos it names.

    Parameters
    ----------
    cfg_path : Path
    settings : Settings
        The limits of photos count.
    progress : Progress
        One step a photo.

    Returns
    -------
    Report

    Raises
    ------
    MapError
        There is no such file, or it cannot be read at all.
    Cancelled
        The user stopped it.
    """
    pieces = scan(read_bytes(cfg_path))
    beside = check_beside(cfg_path, pieces)
    findings = [*pieces.faults, *check_lines(pieces.image, pieces.photos), *beside.findings]
    facts = _folder_facts(cfg_path, pieces, settings=settings, progress=progress)
    findings += check_folder(pieces.image, pieces.photos, facts)
    findings.sort(key=lambda finding: (finding.file, finding.line, finding.column))
    return Report(cfg_path, len(pieces.photos), tuple(findings))


def _folder_facts(cfg_path: Path, pieces: Scan, *, settings: Settings, progress: Progress) -> FolderFacts:
    present = list_photos(cfg_path.parent)
    named = dict.fromkeys(line.photo for line in pieces.photos if line.photo is not None)
    image = pieces.image.image if pieces.image else None
    orphans = _orphans(cfg_path, present, pieces)
    listed, unused = Spelling(present), Spelling(orphans)

    def looked_up(name: str) -> PhotoFacts:
        found = _file_facts(cfg_path, name)
        actual = listed.same(normal_name(name))
        if found.state == "missing" and actual is None:
            actual = unused.similar(name)
        return replace(found, actual=actual)

    photos: dict[str, PhotoFacts] = {}
    progress.size(len(named))
    for name in named:
        progress.check()
        found = looked_up(name)
        photos[name] = _decoded(cfg_path, name, found, settings=settings) if found.state == "ok" else found
        progress.advance()
    satellite, size = PhotoFacts("ok"), None
    if image is not None:
        satellite = looked_up(image)
        if satellite.state == "ok":
            satellite, size = _sized(cfg_path, image, satellite)
    return FolderFacts(satellite, size, photos, orphans)


def _file_facts(cfg_path: Path, name: str) -> PhotoFacts:
    try:
        path = photo_path(cfg_path, name)
    except MapError as error:
        return PhotoFacts("outside", error.message)
    return PhotoFacts("ok" if path.is_file() else "missing")


def _decoded(cfg_path: Path, name: str, found: PhotoFacts, *, settings: Settings) -> PhotoFacts:
    try:
        check_decodes(photo_path(cfg_path, name), limits=settings.photo)
    except PhotoError as error:
        return replace(found, state="unreadable", reason=error.message)
    return found


def _sized(cfg_path: Path, name: str, found: PhotoFacts) -> tuple[PhotoFacts, tuple[int, int] | None]:
    try:
        return found, image_size(photo_path(cfg_path, name))
    except PhotoError as error:
        return replace(found, state="unreadable", reason=error.message), None


def _orphans(cfg_path: Path, present: Sequence[str], pieces: Scan) -> list[str]:
    """List the photos that no map in the folder names, not even on a line that could not be read."""
    others = [
        scan(read_bytes(p)) for p in sorted(cfg_path.parent.glob("*.cfg")) if p.is_file() and p != cfg_path
    ]
    named: set[str] = set()
    for each in (pieces, *others):
        named |= {normal_name(line.photo) for line in each.photos if line.photo is not None}
        if each.image and each.image.image is not None:
            named.add(normal_name(each.image.image))
    unread = "\n".join(text for each in (pieces, *others) for text in each.unread)
    return [name for name in present if name not in named and name not in unread]
