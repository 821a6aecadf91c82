"""Looks at every file of a folder: which are photos, and where they were taken."""

from __future__ import annotations

import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path

from webapp.core.geo.types import LatLon, MapPixel
from webapp.errors import PhotoError
from webapp.files.maps.positions import Positions
from webapp.files.photos.exif_gps import Gps, Heading
from webapp.files.photos.photo import PhotoFacts, read_facts
from webapp.files.satellite.image_probe import PHOTO_SUFFIXES, check_decodes
from webapp.progress import Progress
from webapp.settings import PhotoLimits


class FileState(StrEnum):
    """What became of a file."""

    PLACED = "placed"
    NO_POSITION = "no position"
    OUTSIDE = "outside the image"
    UNREADABLE = "unreadable"
    NOT_A_PHOTO = "not a photo"


@dataclass(frozen=True, slots=True)
class Surveyed:
    """A file and what is known of it.

    Attributes
    ----------
    name : str
        Relative to the folder, forward slashes.
    facts : PhotoFacts or None
        None when it is no readable photo.
    state : FileState or None
        Why it cannot be placed; None when it has a position.
    reason : str or None
        The same as a sentence.
    """

    name: str
    facts: PhotoFacts | None = None
    position: LatLon | MapPixel | None = None
    state: FileState | None = None
    reason: str | None = None

    @property
    def gps(self) -> Gps | None:
        """The EXIF position, where the photo's place is that one."""
        gps = self.facts.gps if self.facts else None
        return gps if isinstance(gps, Gps) and self.position == (gps.lat, gps.lon) else None


def survey(
    folder: Path,
    names: Sequence[str],
    *,
    positions: Positions | None,
    limits: PhotoLimits,
    progress: Progress,
) -> list[Surveyed]:
    """Read each file; a bad one is a result, not an exception.

    Parameters
    ----------
    names : sequence of str
        Relative to it.
    positions : Positions or None
        Positions by file name, instead of those in EXIF.

    Returns
    -------
    list of Surveyed
        One for each name, in order.
    """
    progress.size(len(names))
    found = []
    for name in names:
        progress.check()
        if _leads_out(folder / name, folder):
            reason = "it is a link that leads out of the folder; replace it by a copy"
            found.append(Surveyed(name, state=FileState.UNREADABLE, reason=reason))
        else:
            found.append(_look(folder / name, name, positions=positions, limits=limits))
        progress.advance()
    return found


def _leads_out(path: Path, folder: Path) -> bool:
    return path.is_symlink() and not Path(os.path.realpath(path)).is_relative_to(folder.resolve())


def _look(path: Path, name: str, *, positions: Positions | None, limits: PhotoLimits) -> Surveyed:
    try:
        facts = read_facts(path, limits=limits)
        check_decodes(path, limits=limits)
    except PhotoError as error:
        photo_like = path.suffix.lower() in PHOTO_SUFFIXES
        return Surveyed(
            name, state=FileState.UNREADABLE if photo_like else FileState.NOT_A_PHOTO, reason=error.message
        )
    if positions is None:
        if not isinstance(facts.gps, Gps):
            return Surveyed(name, facts, state=FileState.NO_POSITION, reason=facts.gps.reason)
        return Surveyed(name, facts, LatLon(facts.gps.lat, facts.gps.lon))
    position = positions.find(name)
    if position is None:
        return Surveyed(
            name, facts, state=FileState.NO_POSITION, reason="the list of positions does not name it"
        )
    heading = positions.heading_of(name)
    if heading is not None:
        facts = replace(facts, heading=Heading(heading, "T"))
    return Surveyed(name, facts, position)
