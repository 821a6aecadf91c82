"""Surveys the photos of a folder, and places them on the image by their positions; one result per file."""

from __future__ import annotations

import math
import os
from collections.abc import Sequence
from dataclasses import dataclass, replace
from enum import StrEnum
from pathlib import Path

from webapp.core.geo.georeference import Georeference
from webapp.core.geo.local import LocalFrame
from webapp.core.geo.types import LatLon, MapPixel, inside
from webapp.core.mapmodel.model import Experience, Map
from webapp.core.mapmodel.panorama import Panorama
from webapp.core.mapmodel.paths import name_problem
from webapp.core.texts import significant
from webapp.errors import PhotoError
from webapp.files.decode import PHOTO_SUFFIXES, check_decodes, contrast_note
from webapp.files.maps.positions import Positions
from webapp.files.photos.exif import Gps, Heading
from webapp.files.photos.panorama import find_panorama
from webapp.files.photos.photo import PhotoFacts, read_facts
from webapp.files.photos.sidecars import Sidecars, read_sidecars, with_sidecars
from webapp.progress import Progress
from webapp.settings import PhotoLimits


class FileState(StrEnum):
    PLACED = "placed"
    NO_POSITION = "no position"
    OUTSIDE = "outside the image"
    UNREADABLE = "unreadable"
    NOT_A_PHOTO = "not a photo"


@dataclass(frozen=True, slots=True)
class SurveyedFile:
    name: str  # Relative to the folder, with forward slashes
    facts: PhotoFacts | None = None  # None if it is not a readable photo
    position: LatLon | MapPixel | None = None
    state: FileState | None = None  # Why it cannot be placed; None if it has a position
    reason: str | None = None  # The same as a message
    panorama: Panorama | None = None
    position_from: str | None = None  # `list`, or the source of its GPS position
    note: str | None = None  # What a list says of it

    @property
    def gps(self) -> Gps | None:
        """Its GPS position, if it is the photo's position."""
        gps = self.facts.gps if self.facts else None
        return gps if isinstance(gps, Gps) and self.position == (gps.lat, gps.lon) else None


def survey(
    folder: Path,
    names: Sequence[str],
    *,
    positions: Positions | None,
    limits: PhotoLimits,
    progress: Progress,
    assume_panoramas: bool = False,
) -> list[SurveyedFile]:
    """Read each file, and those beside photos; a bad one is a result, not an exception.

    Args:
        names: Paths relative to the folder.
        positions: Positions by file name, instead of those in and beside the photos.
        assume_panoramas: Treat all photos twice as wide as high as panoramas, even without panorama metadata.

    Returns:
        One for each name, in order.
    """
    progress.size(len(names))
    found = []
    sidecars = Sidecars(names)
    for name in names:
        progress.check()
        if sidecars.photo_of(name) is not None:
            reason = f"it was read for {sidecars.photo_of(name)}"
            found.append(SurveyedFile(name, state=FileState.NOT_A_PHOTO, reason=reason))
        elif _leads_out(folder / name, folder):
            reason = "it is a link that points outside the folder; replace it with a copy"
            found.append(SurveyedFile(name, state=FileState.UNREADABLE, reason=reason))
        else:
            beside = [folder / other for other in sidecars.of(name)]
            reader = _Reader(positions, limits, assume_panoramas)
            found.append(reader.read(folder / name, name, beside=beside))
        progress.advance()
    return found


def _leads_out(path: Path, folder: Path) -> bool:
    return path.is_symlink() and not Path(os.path.realpath(path)).is_relative_to(folder.resolve())


@dataclass(frozen=True, slots=True)
class _Reader:
    positions: Positions | None
    limits: PhotoLimits
    assume: bool  # Whether all photos twice as wide as high are panoramas

    def read(self, path: Path, name: str, *, beside: Sequence[Path]) -> SurveyedFile:
        try:
            facts = read_facts(path, limits=self.limits)
            check_decodes(path, limits=self.limits)
            around = find_panorama(path, facts, limits=self.limits, assume=self.assume)
            contrast = contrast_note(path, limits=self.limits)
        except PhotoError as error:
            photo_like = path.suffix.lower() in PHOTO_SUFFIXES
            state = FileState.UNREADABLE if photo_like else FileState.NOT_A_PHOTO
            return SurveyedFile(name, state=state, reason=error.message)
        if contrast is not None:
            facts = replace(facts, notes=(*facts.notes, contrast))
        facts = with_sidecars(facts, read_sidecars(beside))
        if around is not None and around.heading_deg is not None:
            facts = replace(facts, heading=Heading(around.heading_deg, "T"))
        return self._placed(name, facts, panorama=None if around is None else Panorama(tilt=around.tilt))

    def _placed(self, name: str, facts: PhotoFacts, *, panorama: Panorama | None) -> SurveyedFile:
        if self.positions is None:
            if not isinstance(facts.gps, Gps):
                return SurveyedFile(name, facts, state=FileState.NO_POSITION, reason=facts.gps.reason)
            position = LatLon(facts.gps.lat, facts.gps.lon)
            return SurveyedFile(name, facts, position, panorama=panorama, position_from=facts.gps.source)
        listed = self.positions.find(name)
        if listed is None:
            reason = "it is not in the list of positions"
            return SurveyedFile(name, facts, state=FileState.NO_POSITION, reason=reason)
        heading = self.positions.heading_of(name)
        if heading is not None:
            facts = replace(facts, heading=Heading(heading, "T"))
        return SurveyedFile(
            name,
            facts,
            listed,
            panorama=panorama,
            position_from="list",
            note=self.positions.note_of(name),
        )


@dataclass(frozen=True, slots=True)
class FileResult:
    name: str  # Relative to the folder
    state: FileState
    reason: str | None = None  # Why it was not placed
    experience: Experience | None = None  # The experience in the map, if it was placed
    latlon: LatLon | None = None  # Geographic position, if known
    notes: tuple[str, ...] = ()  # Remarks on irregularities
    position_from: str | None = None  # What its position is from: see `SurveyedFile`


@dataclass(frozen=True, slots=True)
class MapImage:
    """The satellite image or blank plan."""

    # `width`, `height`: Pixels.
    width: int
    height: int
    georeference: Georeference | None  # None if unknown; positions are in pixels then
    residuals_m: tuple[float, ...] = ()  # Residuals of its control points, metres
    warnings: tuple[str, ...] = ()  # Warnings about its georeference


def unplaced(s: SurveyedFile) -> FileResult:
    """Return the result for a file that cannot be placed according to the survey."""
    assert s.state is not None
    return FileResult(s.name, s.state, s.reason, notes=s.facts.notes if s.facts else ())


def place(s: SurveyedFile, image: MapImage, *, photo: str) -> FileResult:
    """Place one photo.

    Args:
        image: Must have a georeference, unless the position is in pixels.
        photo: Its name in the map.

    Returns:
        A placed photo has id 0 until `with_ids` assigns one.
    """
    if s.state is not None or s.facts is None or s.position is None:
        return unplaced(s)
    problem = name_problem(photo)
    if problem:
        return FileResult(s.name, FileState.UNREADABLE, f"{problem.message}; rename it", notes=s.facts.notes)
    georeference = image.georeference
    if isinstance(s.position, MapPixel):
        pixel = s.position
        latlon = georeference.latlon_of(pixel) if georeference else None
    else:
        assert georeference is not None
        pixel, latlon = georeference.pixel_of(s.position), s.position
    if not inside(pixel, width=image.width, height=image.height):
        reason = how_far(pixel, image)
        return FileResult(s.name, FileState.OUTSIDE, reason, latlon=latlon, notes=s.facts.notes)
    heading, notes = s.facts.heading, s.facts.notes
    if heading is not None and heading.reference != "T":
        notes = (*notes, "its heading is from magnetic or unknown north; the declination is not corrected")
    experience = Experience(
        id=0,
        photo=photo,
        position=pixel,
        heading_deg=heading.deg if heading else None,
        fov_deg=s.facts.fov_deg if s.panorama is None else 360.0,
        gps_accuracy_m=s.gps.accuracy_m if s.gps else None,
        taken_at=s.facts.taken_at,
        panorama=s.panorama,
        by_gps=s.gps is not None,
        note=s.note,
    )
    return FileResult(
        s.name,
        FileState.PLACED,
        experience=experience,
        latlon=latlon,
        notes=notes,
        position_from=s.position_from,
    )


def with_ids(placed: Sequence[FileResult], before: Map | None) -> tuple[list[FileResult], int]:
    """Assign ids to the photos; photos of the replaced map keep theirs, and no id is reused."""
    known = {e.photo: e.id for e in before.experiences} if before else {}
    next_id = before.next_id if before else 0
    files = []
    for file in placed:
        if file.experience is not None:
            id = known.pop(file.experience.photo, None)
            if id is None:
                id, next_id = next_id, next_id + 1
            file = replace(file, experience=replace(file.experience, id=id))
        files.append(file)
    return files, next_id


def how_far(pixel: MapPixel, image: MapImage) -> str:
    """Describe how far beyond which edge of the image a position is."""
    if not math.isfinite(pixel.x):
        return "its position is beyond the horizon of the image"
    edge = MapPixel(min(max(pixel.x, 0.0), image.width), min(max(pixel.y, 0.0), image.height))
    metric = ""
    if image.georeference is not None:
        frame = LocalFrame(image.georeference.latlon_of(edge))
        metres = math.hypot(*frame.enu_of(image.georeference.latlon_of(pixel)))
        metric = f" ({significant(metres)} m)" if metres < 1000.0 else f" ({metres / 1000.0:.0f} km)"
    sides = [
        name
        for name, beyond in (
            ("left", pixel.x < 0),
            ("right", pixel.x > image.width),
            ("top", pixel.y < 0),
            ("bottom", pixel.y > image.height),
        )
        if beyond
    ]
    return f"{math.dist(pixel, edge):.0f} px{metric} beyond the {' and '.join(sides)} edge"
