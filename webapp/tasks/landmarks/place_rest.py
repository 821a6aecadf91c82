"""Suggests places for unplaced photos, by a reconstruction with placed ones."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from webapp.core.geo.types import MapPixel, inside
from webapp.core.landmarks.georegister import Georegistration, georegister
from webapp.core.landmarks.placing import AlignedSubmodel, KnownPositions, NotAligned, propose_next
from webapp.core.landmarks.radii import RADIUS_OVER_SIGMA
from webapp.core.landmarks.submodels import Submodel
from webapp.core.mapmodel.model import Experience, Map, UnplacedPhoto
from webapp.errors import PhotoError, UsageError
from webapp.files.landmarks.colmap import pycolmap
from webapp.files.maps.folder import photo_path, read_map
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.landmarks.adjust import adjust_submodels
from webapp.tasks.landmarks.colours import colour_cloud
from webapp.tasks.landmarks.control_points import found_points
from webapp.tasks.landmarks.known import known_positions
from webapp.tasks.landmarks.reconstruct import Reconstruction, reconstruct
from webapp.tasks.tags.answer import answer_by_tags
from webapp.tasks.tags.photos import with_tag_clicks

_PROPOSED = 6
_NAMED = 3
"""Number of photos proposed to be placed next, and of nearest placed photos given with a suggestion."""


_WIDEST = 0.5
"""Radius over the shorter side of the image above which nothing is suggested."""


_SURE = 0.9
"""Least probability of a place by tags that is suggested."""


@dataclass(frozen=True, slots=True)
class SuggestedPlace:
    """Where a photo was probably taken."""

    id: int
    photo: str
    position: MapPixel
    radius_px: float  # 68 % radius
    heading_deg: float | None  # Degrees clockwise from north; None if the map does not define north
    placed_by: tuple[int, ...]  # Ids of the nearest of the photos that it was placed by
    # Whether a third known position shows how far off the places are; the radius is a guess without it
    is_checked: bool = True


@dataclass(frozen=True, slots=True)
class LeftPhoto:
    """A photo that stays unplaced, and why; `join` are ids of photos that would help if they were placed."""

    id: int
    photo: str
    reason: str
    join: tuple[int, ...] = ()


@dataclass(frozen=True, slots=True)
class CheckedPhoto:
    id: int
    photo: str
    # Distance from its position by the other placed photos; None if they are too few.
    residual_px: float | None
    contradicts: bool  # It was left out as an outlier: the others agree on another position
    predicted: MapPixel | None = None  # Its position by the others
    residual_m: float | None = None  # The residual in metres, on a map with a georeference
    # Direction from its own position to the predicted one, degrees clockwise from north
    bearing_deg: float | None = None


@dataclass(frozen=True, slots=True)
class CorrectedPlace:
    """Corrected position of a photo that was placed by GPS, by all photos together."""

    id: int
    photo: str
    position: MapPixel
    # Its GPS position: the correction is void if the photo was moved since, or is on another image.
    before: MapPixel
    moved_px: float  # Distance from there
    moved_m: float  # The same in metres
    radius_px: float  # 68 % radius, which is less than that of the GPS
    heading_deg: float | None  # Degrees clockwise from north; None if the photo has one, or north is unknown


@dataclass(frozen=True, slots=True)
class RestReport:
    """Suggested places of the unplaced photos."""

    suggested: tuple[SuggestedPlace, ...]
    left: tuple[LeftPhoto, ...]
    checked: tuple[CheckedPhoto, ...]
    place_next: tuple[int, ...]  # Ids of the photos that would help most if they were placed by hand next
    # Photos that were placed by GPS, and whose positions are now known better.
    corrected: tuple[CorrectedPlace, ...] = ()


def suggest_rest(cfg: Path, *, settings: Settings, progress: Progress, check: bool = False) -> RestReport:
    """Suggest places for the photos in the tray of a map; nothing is changed.

    Args:
        check: The purpose is to check the placed photos: the tray may be empty. It also may if photos are
            placed by GPS.

    Raises:
        MapError: The map cannot be read.
        UsageError: No photo is left to be placed or corrected.
        MissingPart: The extra `sfm` is not installed.
    """
    pycolmap()  # fail early if the extra is missing
    the_map = read_map(cfg)
    if not the_map.unplaced and not check and not any(e.by_gps for e in the_map.experiences):
        raise UsageError("the map has no photo without a place", where=str(cfg))
    found = reconstruct(cfg, the_map, settings=settings, progress=progress)
    joined, _ = adjust_submodels(found, the_map, progress=progress)
    colour_cloud(cfg, joined, limits=settings.photo, progress=progress)
    return _with_tags(suggest_from(joined, the_map), joined, cfg, the_map=the_map, settings=settings)


def _with_tags(
    report: RestReport, found: Reconstruction, cfg: Path, *, the_map: Map, settings: Settings
) -> RestReport:
    """Suggest places by the tags in photos that are not joined with others, or less exactly."""
    by_content = {content: found.photos[number] for content, number in found.number_of.items()}
    points = with_tag_clicks(the_map, by_content, folder=found.shared)
    show = {click.photo for point in points if point.tag is not None for click in point.clicks}
    by_id = {photo.id: photo for photo in the_map.unplaced if photo.id in show}
    tried = (_by_tags(photo, cfg, the_map, settings=settings) for photo in by_id.values())
    there = {one.id: one for one in report.suggested}
    for one in tried:
        if one is not None and (one.id not in there or one.radius_px < there[one.id].radius_px):
            there[one.id] = one
    left = tuple(one for one in report.left if one.id not in there)
    return replace(report, suggested=tuple(there[id] for id in sorted(there)), left=left)


def _by_tags(photo: UnplacedPhoto, cfg: Path, the_map: Map, *, settings: Settings) -> SuggestedPlace | None:
    """Return where the tags in a photo put it; None if that is ambiguous, or outside the image."""
    path, fov_deg = photo_path(cfg, photo.photo), photo.fov_deg
    try:
        answer = answer_by_tags(path, the_map, settings=settings, fov_deg=fov_deg).answer
    except PhotoError:
        return None
    image, best = the_map.satellite, None if answer is None else answer.hypotheses[0]
    if best is None or best.probability < _SURE or best.heading_deg is None or best.radius_px is None:
        return None
    if not inside(best.position, width=image.width, height=image.height):
        return None
    if best.radius_px > _WIDEST * min(image.width, image.height):
        return None
    return SuggestedPlace(photo.id, photo.photo, best.position, best.radius_px, best.heading_deg, ())


def suggest_from(found: Reconstruction, the_map: Map) -> RestReport:
    known = known_positions(found.photos, the_map)
    aligned = [result.aligned for result in georegister_found(found, the_map)]
    proposed = propose_next(found.submodels, aligned, known=known, most=_PROPOSED)
    suggested: list[SuggestedPlace] = []
    left: list[LeftPhoto] = []
    for submodel, result in zip(found.submodels, aligned, strict=True):
        for one in _of_submodel(submodel, result, found=found, the_map=the_map, known=known):
            (suggested if isinstance(one, SuggestedPlace) else left).append(one)  # type: ignore[arg-type]
    left += _unjoined(found)
    checked = [
        one
        for submodel, result in zip(found.submodels, aligned, strict=True)
        if isinstance(result, AlignedSubmodel)
        for one in _checked(submodel, result, photos=found.photos, the_map=the_map)
    ]
    return RestReport(
        tuple(sorted(suggested, key=lambda one: one.id)),
        tuple(sorted(left, key=lambda one: one.id)),
        tuple(sorted(checked, key=lambda one: one.id)),
        tuple(found.photos[number].id for number in proposed),
        tuple(sorted(_corrected(found, aligned, known=known, the_map=the_map), key=lambda one: one.id)),
    )


def georegister_found(found: Reconstruction, the_map: Map) -> list[Georegistration]:
    """Georegister the submodels of a reconstruction by the map's placed photos and control points."""
    known, points = known_positions(found.photos, the_map), found_points(found, the_map)
    return [georegister(submodel, known, points=points) for submodel in found.submodels]


def _of_submodel(
    submodel: Submodel,
    aligned: AlignedSubmodel | NotAligned,
    *,
    found: Reconstruction,
    the_map: Map,
    known: KnownPositions,
) -> Iterator[SuggestedPlace | LeftPhoto]:
    photos = [found.photos[number] for number in submodel.photo.tolist()]
    free = [row for row, photo in enumerate(photos) if isinstance(photo, UnplacedPhoto)]
    if isinstance(aligned, NotAligned):
        help_ = tuple(found.photos[n].id for n in propose_next([submodel], [aligned], known=known, most=2))
        reason = f"it is joined with {len(submodel) - 1} other photos, but {aligned.reason}"
        yield from (LeftPhoto(photos[row].id, photos[row].photo, reason, help_) for row in free)
        return
    used = np.flatnonzero(np.isfinite(known.at[submodel.photo]) & ~aligned.contradicting)
    is_checked = bool(np.isfinite(aligned.residual_px[used]).any())
    for row in free:
        photo, at = photos[row], MapPixel(float(aligned.at[row].real), float(aligned.at[row].imag))
        image = the_map.satellite
        if not inside(at, width=image.width, height=image.height):
            reason = f"it would be outside the image, at x {at.x:.0f}, y {at.y:.0f}"
            yield LeftPhoto(photo.id, photo.photo, reason)
            continue
        radius = float(aligned.radius_px[row])
        if radius > _WIDEST * min(image.width, image.height):
            reason = f"it may be anywhere within {radius:.0f} pixels: place it, or a photo near it, by hand"
            yield LeftPhoto(photo.id, photo.photo, reason, (photo.id,))
            continue
        nearest = used[np.argsort(np.abs(aligned.at[used] - aligned.at[row]), kind="stable")[:_NAMED]]
        yield SuggestedPlace(
            photo.id,
            photo.photo,
            at,
            radius,
            _heading(float(aligned.angle_deg[row]), at, the_map),
            tuple(photos[other].id for other in nearest.tolist()),
            is_checked,
        )


def _corrected(
    found: Reconstruction,
    aligned: Sequence[AlignedSubmodel | NotAligned],
    *,
    known: KnownPositions,
    the_map: Map,
) -> Iterator[CorrectedPlace]:
    """Yield corrections of photos with GPS from adjusted submodels, whose world is that of the map."""
    georeference, image = the_map.georeference, the_map.satellite
    for submodel, result in zip(found.submodels, aligned, strict=True):
        if submodel.covariance is None or isinstance(result, NotAligned) or georeference is None:
            continue
        for row, number in enumerate(submodel.photo.tolist()):
            photo, at = found.photos[number], MapPixel(*submodel.centre[row, :2].tolist())
            if not isinstance(photo, Experience) or not photo.by_gps or result.contradicting[row]:
                continue
            radius = float(result.radius_px[row])
            if radius >= RADIUS_OVER_SIGMA * known.sigma_px[number]:
                continue
            if not inside(at, width=image.width, height=image.height):
                continue
            heading = _heading(float(result.angle_deg[row]), at, the_map)
            moved = math.dist(at, photo.position)
            metres = moved * georeference.metres_per_pixel(photo.position)
            new = heading if photo.heading_deg is None else None
            yield CorrectedPlace(photo.id, photo.photo, at, photo.position, moved, metres, radius, new)


def _heading(angle_deg: float, at: MapPixel, the_map: Map) -> float | None:
    """Convert an angle from image-up to a heading; up is north on a map without a georeference."""
    north = 0.0 if the_map.georeference is None else the_map.georeference.north_deg(at)
    return None if math.isnan(north) else (angle_deg - north) % 360.0


def _unjoined(found: Reconstruction) -> Iterator[LeftPhoto]:
    joined = {number for submodel in found.submodels for number in submodel.photo.tolist()}
    for number, photo in enumerate(found.photos):
        if number in joined or isinstance(photo, Experience):
            continue
        problem = found.problems.get(number)
        reason = "too few photos overlap enough" if problem is None else problem
        yield LeftPhoto(photo.id, photo.photo, reason)


def _checked(
    submodel: Submodel,
    aligned: AlignedSubmodel,
    *,
    photos: Sequence[Experience | UnplacedPhoto],
    the_map: Map,
) -> Iterator[CheckedPhoto]:
    georeference = the_map.georeference
    for row, number in enumerate(submodel.photo.tolist()):
        photo, residual = photos[number], float(aligned.residual_px[row])
        if not isinstance(photo, Experience):
            continue
        if math.isnan(residual):
            yield CheckedPhoto(photo.id, photo.photo, None, False)
            continue
        metres = None
        if georeference is not None:
            metres = residual * georeference.metres_per_pixel(photo.position)
        there = complex(aligned.predicted[row])
        off = there - complex(*photo.position)
        bearing = _heading(math.degrees(math.atan2(off.real, -off.imag)), photo.position, the_map)
        yield CheckedPhoto(
            photo.id,
            photo.photo,
            residual,
            bool(aligned.contradicting[row]),
            MapPixel(there.real, there.imag),
            metres,
            bearing,
        )
