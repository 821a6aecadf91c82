"""Control points of a map in its reconstruction, and the residuals of the known positions."""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from webapp.core.geo.local import LocalFrame
from webapp.core.geo.types import MapPixel
from webapp.core.geometry.equirectangular import ray_of_panorama
from webapp.core.landmarks.absolute_pose import Lens, ray_of_pixel
from webapp.core.landmarks.cloud import LandmarkCloud
from webapp.core.landmarks.control_points import KnownPoint
from webapp.core.landmarks.georegister import Georegistration, georegister
from webapp.core.landmarks.placing import AlignedSubmodel, NotAligned
from webapp.core.landmarks.submodels import Submodel, view_rotation
from webapp.core.mapmodel.control_points import GroundControlPoint, PhotoClick
from webapp.core.mapmodel.model import Experience, Map
from webapp.core.mapmodel.panorama import experience_of
from webapp.core.mapmodel.views import content_of, level_views
from webapp.errors import IndexDamaged
from webapp.files.landmarks.cloud import CLOUD_FILE, read_cloud
from webapp.files.landmarks.colmap import SUBMODELS_FILE, read_submodels
from webapp.files.localize.features import read_segment
from webapp.files.localize.index_store import IndexFolder
from webapp.files.maps.folder import photo_hash
from webapp.tasks.landmarks.known import AnyPhoto, all_photos, known_positions
from webapp.tasks.landmarks.reconstruct import Reconstruction
from webapp.tasks.localize.index_location import landmarks_folder
from webapp.tasks.tags.photos import with_tag_clicks

_DEFAULT_PX, _LEAST_PX = 1.0, 0.01
"""Standard deviation of a point on the map: default, and lower limit."""


_MANY = 1_000_000
"""More than any number of clicks."""


@dataclass(frozen=True, slots=True)
class Residual:
    """How well a placed photo or a control point fits the others."""

    photo: int | None  # Id of the photo; None for a control point
    name: str  # Of the photo's file, or of the control point
    at: MapPixel | None  # Its known position
    predicted: MapPixel | None = None  # Its position by the others; None if they are too few
    contradicts: bool = False  # It was left out as an outlier: the others agree on another position
    wrong: tuple[str, ...] = ()  # Photos whose clicks of a control point disagree with the others
    problem: str | None = None  # Why a control point takes no part
    is_check: bool = False  # It is a check point
    photos: int = 0  # Number of joined photos with clicks of a control point that agree
    # Standard deviation along each axis of a control point's known position and clicks together.
    sigma_px: float | None = None
    height_off_px: float | None = None  # Of a check point: predicted minus known height

    @property
    def shift_px(self) -> tuple[float, float] | None:
        """From the known to the predicted position: right and down."""
        if self.at is None or self.predicted is None:
            return None
        return self.predicted.x - self.at.x, self.predicted.y - self.at.y

    @property
    def residual_px(self) -> float | None:
        """Distance between the two positions."""
        return None if self.shift_px is None else math.hypot(*self.shift_px)

    def shift_m(self, the_map: Map) -> tuple[float, float] | None:
        """Return the shift in metres east and north, on a map with a georeference."""
        georeference = the_map.georeference
        if self.at is None or self.predicted is None or georeference is None:
            return None
        frame = LocalFrame(georeference.latlon_of(self.at))
        (east, north), (there_east, there_north) = georeference.enu_from_pixel(
            [self.at, self.predicted], frame
        ).tolist()
        shift = there_east - east, there_north - north
        return shift if all(map(math.isfinite, shift)) else None

    def residual_m(self, the_map: Map) -> float | None:
        """Return `residual_px` in metres, on a map with a georeference."""
        shift = self.shift_m(the_map)
        return None if shift is None else math.hypot(*shift)

    def in_metres(self, px: float | None, the_map: Map) -> float | None:
        """Convert a length at the known position, on a map with a georeference."""
        if px is None or self.at is None or the_map.georeference is None:
            return None
        return px * the_map.georeference.metres_per_pixel(self.at)


@dataclass(frozen=True, slots=True, eq=False)
class PhotoLenses:
    folder: Path  # Folder of the photos' features
    cloud: LandmarkCloud
    content_of: Mapping[int, str]  # Content hashes by the photos' numbers in the submodels

    def lens(self, number: int) -> Lens | None:
        """Return the lens of a photo; None if it is not in the reconstruction or its features are missing."""
        content = self.content_of.get(number)
        if content is None or content not in self.cloud.contents:
            return None
        row = self.cloud.contents.index(content)
        if not self.cloud.focal_px[row] > 0.0:
            return None
        try:
            described = read_segment(IndexFolder(self.folder).spool_path(content)).entry(0)
        except (OSError, IndexDamaged):
            return None
        size = described.features.photo_size
        return Lens(*size, float(self.cloud.focal_px[row]), float(self.cloud.distortion[row]))


def georegister_all(
    submodels: Sequence[Submodel],
    photos: Sequence[AnyPhoto | None],
    *,
    the_map: Map,
    lenses: PhotoLenses,
) -> list[Georegistration]:
    """Georegister submodels by the map's placed photos and control points.

    Args:
        photos: Photos, or the views of panoramas, by their numbers in the submodels.
    """
    known = known_positions(photos, the_map)
    points = known_points(photos, the_map, lenses=lenses)
    return [georegister(submodel, known, points=points) for submodel in submodels]


def found_points(found: Reconstruction, the_map: Map) -> tuple[KnownPoint, ...]:
    """Collect the control points on the map, with the rays of their clicks in a reconstruction."""
    stored = read_cloud(found.folder / CLOUD_FILE) if the_map.control_points else None
    if stored is None:
        return ()
    content_of = {number: content for content, number in found.number_of.items()}
    return known_points(found.photos, the_map, lenses=PhotoLenses(found.shared, stored.cloud, content_of))


def known_points(
    photos: Sequence[AnyPhoto | None], the_map: Map, *, lenses: PhotoLenses
) -> tuple[KnownPoint, ...]:
    """Collect the control points on the map, with the rays of their clicks and of their tags in photos."""
    pictures: dict[int, list[int]] = {}
    for number, photo in enumerate(photos):
        if photo is not None:
            pictures.setdefault(experience_of(photo.id), []).append(number)
    by_content = {
        content: photo
        for number, content in lenses.content_of.items()
        if number < len(photos) and (photo := photos[number]) is not None
    }
    found = []
    for point in with_tag_clicks(the_map, by_content, folder=lenses.folder):
        if point.position is None:
            continue
        rays = [
            (number, photo.photo, ray)
            for click in point.clicks
            for number in pictures.get(click.photo, ())
            if (photo := photos[number]) is not None
            and (ray := _ray(click, photo, number=number, lenses=lenses)) is not None
        ]
        numbers = np.array([number for number, _, _ in rays], np.int64)
        ray = np.array([ray for _, _, ray in rays], np.float64).reshape(-1, 3)
        sigma, height = _sigma_and_height(point, point.position, the_map)
        shown_by = tuple(name for _, name, _ in rays)
        found.append(
            KnownPoint(
                point.name,
                complex(*point.position),
                sigma,
                height,
                numbers,
                shown_by,
                ray,
                point.is_check,
            )
        )
    return tuple(found)


def _sigma_and_height(point: GroundControlPoint, at: MapPixel, the_map: Map) -> tuple[float, float]:
    """Return standard deviation and height of a point, map pixels; an unknown height is NaN."""
    scale = math.nan if the_map.georeference is None else the_map.georeference.metres_per_pixel(at)
    if not scale > 0.0:
        return _DEFAULT_PX, math.nan
    sigma = _DEFAULT_PX if point.accuracy_m is None else max(point.accuracy_m / scale, _LEAST_PX)
    return sigma, math.nan if point.height_m is None else point.height_m / scale


def _ray(
    click: PhotoClick, photo: AnyPhoto, *, number: int, lenses: PhotoLenses
) -> NDArray[np.float64] | None:
    """Return the ray of a click in the frame of the photo's camera; None if its lens is unknown."""
    if photo.view is not None:
        ray = ray_of_panorama(click.x, click.y, photo.view.tilt)
        return np.asarray(view_rotation(photo.view.turn_deg) @ ray)
    if photo.panorama is not None:
        return ray_of_panorama(click.x, click.y, photo.panorama.tilt)
    lens = lenses.lens(number)
    if lens is None:
        return None
    return ray_of_pixel(np.array([click.x * lens.width - 0.5, click.y * lens.height - 0.5]), lens=lens)


def residuals_of(
    submodels: Sequence[Submodel],
    results: Sequence[Georegistration],
    *,
    photos: Sequence[AnyPhoto | None],
    the_map: Map,
) -> list[Residual]:
    """List the residuals of placed photos and control points, the largest first."""
    found = [
        one
        for submodel, result in zip(submodels, results, strict=True)
        if isinstance(result.aligned, AlignedSubmodel)
        for one in _of_photos(submodel, result.aligned, photos=photos)
    ]
    found += [_of_point(point, results) for point in the_map.control_points]
    return sorted(found, key=lambda one: (-(one.residual_px or 0.0), one.name))


def _of_photos(
    submodel: Submodel, aligned: AlignedSubmodel, *, photos: Sequence[AnyPhoto | None]
) -> Iterator[Residual]:
    for row, number in enumerate(submodel.photo.tolist()):
        photo, there = photos[number], complex(aligned.predicted[row])
        if isinstance(photo, Experience) and not math.isnan(there.real):
            others = MapPixel(there.real, there.imag)
            wrong = bool(aligned.contradicting[row])
            yield Residual(experience_of(photo.id), photo.photo, photo.position, others, wrong)


def _of_point(point: GroundControlPoint, results: Iterable[Georegistration]) -> Residual:
    """Return the residual of a control point in the first submodel that has it, or why none has it."""
    if point.position is None:
        problem = "it is not on the map yet"
        return Residual(None, point.name, None, problem=problem, is_check=point.is_check)
    clicks, problem = -1, "no photo is joined with others"
    wrong: tuple[str, ...] = ()
    for result in results:
        for fit in result.points:
            if fit.name == point.name and isinstance(result.aligned, NotAligned):
                clicks, problem, wrong = _MANY, result.aligned.reason, fit.wrong
            elif fit.name == point.name:
                there = fit.predicted
                others = None if math.isnan(there.real) else MapPixel(there.real, there.imag)
                return Residual(
                    None,
                    point.name,
                    point.position,
                    others,
                    fit.contradicts,
                    fit.wrong,
                    is_check=point.is_check,
                    photos=fit.photos,
                    sigma_px=_finite(fit.sigma_px),
                    height_off_px=_finite(fit.height_off_px),
                )
        for one in result.problems:
            if one.point.name == point.name and one.clicks > clicks:
                clicks, problem = one.clicks, f"it {one.reason}" if one.clicks < 2 else one.reason
    return Residual(
        None,
        point.name,
        point.position,
        wrong=wrong,
        problem=problem,
        is_check=point.is_check,
        photos=clicks if 0 < clicks < _MANY else 0,
    )


def _finite(value: float) -> float | None:
    return value if math.isfinite(value) else None


def stored_residuals(cfg: Path, the_map: Map) -> list[Residual] | None:
    """List the residuals of known positions in the stored landmarks of a map; None if it has none.

    Raises MapError.
    """
    folder = landmarks_folder(cfg)
    stored, submodels = read_cloud(folder / CLOUD_FILE), read_submodels(folder / SUBMODELS_FILE)
    if stored is None or submodels is None or stored.key != submodels.cloud_key:
        return None
    photos = {content_of(one, photo_hash(cfg, one.photo)): one for one in level_views(all_photos(the_map))}
    of_cloud = [photos.get(content) for content in submodels.contents]
    lenses = PhotoLenses(folder, stored.cloud, dict(enumerate(submodels.contents)))
    results = georegister_all(submodels.submodels, of_cloud, the_map=the_map, lenses=lenses)
    return residuals_of(submodels.submodels, results, photos=of_cloud, the_map=the_map)
