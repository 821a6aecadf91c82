"""From positions of photos to places on the image, one verdict a file."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace

from webapp.core.geo.georeference import Georeference
from webapp.core.geo.local import LocalFrame
from webapp.core.geo.types import LatLon, MapPixel
from webapp.core.mapmodel.model import Experience, Map
from webapp.core.mapmodel.paths import name_problem
from webapp.core.mapmodel.positions import inside
from webapp.tasks.maps.survey_photos import FileState, Surveyed


@dataclass(frozen=True, slots=True)
class FileResult:
    """What became of one file of the folder.

    Attributes
    ----------
    name : str
        Relative to the folder.
    reason : str or None
        Why it was not placed.
    experience : Experience or None
        As it stands in the map, when it was placed.
    latlon : LatLon or None
        Where it was taken, when that is known.
    notes : tuple of str
        What was odd about it.
    """

    name: str
    state: FileState
    reason: str | None = None
    experience: Experience | None = None
    latlon: LatLon | None = None
    notes: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class MapImage:
    """The satellite image or blank plan.

    Attributes
    ----------
    width, height : int
        Pixels.
    georeference : Georeference or None
        None where the positions are in pixels and nothing else is known.
    residuals_m : tuple of float
        Of its control points, metres.
    warnings : tuple of str
        About its georeference.
    """

    width: int
    height: int
    georeference: Georeference | None
    residuals_m: tuple[float, ...] = ()
    warnings: tuple[str, ...] = ()


def unplaced(s: Surveyed) -> FileResult:
    """Give the verdict on a file that the survey has given up."""
    assert s.state is not None
    return FileResult(s.name, s.state, s.reason, notes=s.facts.notes if s.facts else ())


def place(s: Surveyed, image: MapImage, *, photo: str) -> FileResult:
    """Place one photo.

    Parameters
    ----------
    image : MapImage
        With a georeference, unless the position is in pixels.
    photo : str
        Its name in the map.

    Returns
    -------
    FileResult
        A placed photo has the id 0 until `with_ids` numbers it.
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
        fov_deg=s.facts.fov_deg,
        gps_accuracy_m=s.gps.accuracy_m if s.gps else None,
        taken_at=s.facts.taken_at,
    )
    return FileResult(s.name, FileState.PLACED, experience=experience, latlon=latlon, notes=notes)


def with_ids(placed: Sequence[FileResult], before: Map | None) -> tuple[list[FileResult], int]:
    """Number the photos; those of the map that is replaced keep their ids, and no id is used again."""
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
    """Say how far beyond which edge of the image a position is."""
    if not math.isfinite(pixel.x):
        return "its position is beyond the horizon of the image"
    edge = MapPixel(min(max(pixel.x, 0.0), image.width), min(max(pixel.y, 0.0), image.height))
    metric = ""
    if image.georeference is not None:
        frame = LocalFrame(image.georeference.latlon_of(edge))
        metres = math.hypot(*frame.enu_of(image.georeference.latlon_of(pixel)))
        metric = f" ({metres:.3g} m)" if metres < 1000.0 else f" ({metres / 1000.0:.0f} km)"
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
