"""Place candidates from verified photos: by geometry first, then by votes."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from webapp.core.geo.floors import BASE_FLOOR
from webapp.core.geo.types import MapPixel
from webapp.core.geometry.estimate import NoPose
from webapp.core.geometry.extrinsics import MIN_TRUST
from webapp.core.geometry.relative_pose import RelativePose
from webapp.core.hypotheses.calibration import Calibration
from webapp.core.hypotheses.model import CameraPose
from webapp.core.localize.evidence import Voters, photo_spots, similarity_around, support
from webapp.core.localize.pose_refinement import PoseEstimate, VerifiedView, estimate_poses
from webapp.core.localize.resection import MIN_BEARINGS, Bearings, Resection, resect
from webapp.core.retrieval.indexed import IndexedMap
from webapp.core.retrieval.retrieve import ShortlistedPhoto
from webapp.core.tuning import PlacesTuning

_SCHEMATIC_SIGMA = 0.5
"""Standard deviation of a query's distance from its best photo on a schematic map, place radii."""


@dataclass(frozen=True, slots=True, eq=False)
class VerifiedPhoto:
    """A shortlisted photo after geometric verification."""

    matched: ShortlistedPhoto
    pose: RelativePose | NoPose
    # `query_ray`, `photo_ray`: (m, 3) float64. Rays of its matches in the camera frames, at depth 1.
    query_ray: NDArray[np.float64]
    photo_ray: NDArray[np.float64]
    # `inverse_depth`, `sigma`: (m,) float64. Inverse depths of the matched points in the photo's frame, per
    # map pixel, and their standard deviations; NaN where unknown.
    inverse_depth: NDArray[np.float64]
    sigma: NDArray[np.float64]
    ray_sigma: tuple[float, float]  # Standard deviations of the query's and the photo's rays at depth 1

    @classmethod
    def by_votes(cls, listed: ShortlistedPhoto) -> VerifiedPhoto:
        no_rays, unknown = np.zeros((0, 3)), np.zeros(0)
        return cls(listed, NoPose("not verified"), no_rays, no_rays, unknown, unknown, (0.0, 0.0))

    @property
    def inliers(self) -> int:
        """Number of matches that agree on one relative pose."""
        return self.pose.inliers if isinstance(self.pose, RelativePose) else 0

    @property
    def weight(self) -> float:
        """Trust in the geometry, 0 to 1."""
        return self.pose.trust if isinstance(self.pose, RelativePose) else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class PlaceCandidate:
    kind: Literal["position", "photo", "area"]  #
    position: MapPixel
    heading: float | None  # Radians
    sigma_px: float  # Uncertainty of the estimate itself, before calibration
    photos: list[VerifiedPhoto]  # Photos that support it, the best first
    score: float  # Sum of the trust in the photos that agree on it
    anchor: MapPixel  # Position of the best-matching of these photos
    area: int = -1  # Number of the area; -1 for a place in none
    camera: CameraPose | None = None  # Height and orientation of the camera, if solved from landmarks
    floor: int = BASE_FLOOR  # Id of its floor


@dataclass(frozen=True, slots=True)
class LocatedPlace:
    """Position of a place, from its geometry and its photos together."""

    kind: Literal["position", "photo", "area"]
    position: MapPixel
    sigma_px: float
    heading: float | None


def locate(place: PlaceCandidate, *, calibration: Calibration, place_radius_px: float) -> LocatedPlace:
    """Combine a computed position with that of the best-matching photo, by inverse variance.

    Along the line of sight a camera's motion is poorly determined, so that a computed position can be far off
    in this direction and yet look certain. The photo's weight is fitted on the map; on a schematic map the
    photo alone is used.
    """
    if place.kind != "position":
        return LocatedPlace(place.kind, place.position, place.sigma_px, None)
    if calibration.schematic:
        return LocatedPlace("photo", place.anchor, _SCHEMATIC_SIGMA * place_radius_px, None)
    computed = place.sigma_px**-2
    photo = (calibration.photo_sigma * place_radius_px) ** -2 if place.anchor != place.position else 0.0
    x, y = (
        (computed * p + photo * a) / (computed + photo)
        for p, a in zip(place.position, place.anchor, strict=True)
    )
    sigma_px = calibration.radius_scale * (computed + photo) ** -0.5
    return LocatedPlace("position", MapPixel(x, y), sigma_px, place.heading)


def estimate_places(
    indexed: IndexedMap,
    checked: list[VerifiedPhoto],
    *,
    further: Sequence[VerifiedPhoto] = (),
    alike: NDArray[np.float64] | None = None,
) -> list[PlaceCandidate]:
    """Cluster the photos of the shortlist into candidate places.

    Args:
        alike: (p,) float64. Standard scores of the map's photos by their global descriptors.

    Returns:
        Those from geometry first, then others by votes and similarity around them until there are eight
            places, or half as many as checked photos if that is more. Places of one floor are more than a
            minimum distance apart (`tuning.places.apart` place radii).
    """
    places: list[PlaceCandidate] = []
    by_pose, by_bearing = _by_floor(indexed, checked)
    for place in (*by_pose, *by_bearing):
        if not _is_occupied(places, place.position, indexed, floor=place.floor):
            places.append(place)
    most = max(indexed.tuning.places.most, len(checked) // 2)
    voting = [*checked, *further]
    for n in _by_votes(indexed, voting, alike=alike):
        photo = voting[n].matched.photo
        if len(places) >= most:
            break
        if indexed.area[photo] >= 0:
            if all(p.area != indexed.area[photo] for p in places):
                places.append(_area_place(indexed, voting, photo))
        elif not _is_occupied(places, _position(indexed, photo), indexed, floor=int(indexed.floor[photo])):
            places.append(_photo_place(indexed, [voting[n]], score=0.0))
    return places


def _by_floor(
    indexed: IndexedMap, checked: list[VerifiedPhoto]
) -> tuple[list[PlaceCandidate], list[PlaceCandidate]]:
    """Estimate places from poses and from bearings, separately for each floor; the best score first."""
    by_pose: list[PlaceCandidate] = []
    by_bearing: list[PlaceCandidate] = []
    floors = [int(indexed.floor[v.matched.photo]) for v in checked]
    for floor in dict.fromkeys(floors):
        there = [v for v, own in zip(checked, floors, strict=True) if own == floor]
        others = [v for v in there if not _has_extrinsics(indexed, v)]
        by_pose += (replace(place, floor=floor) for place in _from_poses(indexed, there))
        by_bearing += (replace(place, floor=floor) for place in _from_bearings(indexed, others=others))
    if len(set(floors)) > 1:
        by_pose.sort(key=lambda place: -place.score)
        by_bearing.sort(key=lambda place: -place.score)
    return by_pose, by_bearing


def voters_of(checked: list[VerifiedPhoto]) -> Voters:
    """Collect the votes and the trust of verified photos, most votes first."""
    votes = np.array([v.matched.votes for v in checked])
    order = np.argsort(-votes, kind="stable")
    photo = np.array([v.matched.photo for v in checked], np.int64)
    return Voters(photo[order], votes[order], np.array([v.weight for v in checked])[order])


def _by_votes(
    indexed: IndexedMap, checked: list[VerifiedPhoto], *, alike: NDArray[np.float64] | None
) -> list[int]:
    """Order photos by the votes close to them plus those in their surroundings, each relative to the best.

    If photos have global descriptors, similarity is added in the same way.
    """
    if not checked:
        return []
    voters = voters_of(checked)
    at = photo_spots(indexed, np.array([v.matched.photo for v in checked], np.int64))
    found = [support(indexed, voters, at=at, reach=r) for r in indexed.tuning.places.support_reaches]
    if alike is not None:
        found.append(similarity_around(indexed, alike, at=at))
    merit = sum(f / max(f.max(), np.finfo(float).tiny) for f in found)
    return [int(n) for n in np.argsort(-np.asarray(merit), kind="stable")]


def _area_place(indexed: IndexedMap, checked: list[VerifiedPhoto], photo: int) -> PlaceCandidate:
    """Create the place of a photo's area, with the photos that support it."""
    area = int(indexed.area[photo])
    there = [v for v in checked if indexed.area[v.matched.photo] == area]
    position = _position(indexed, photo)
    order = sorted(there, key=lambda v: (-v.weight, -v.matched.votes))
    floor = int(indexed.floor[photo])
    return PlaceCandidate("area", position, None, 0.0, order, 0.0, position, area, floor=floor)


def _position(indexed: IndexedMap, photo: int) -> MapPixel:
    return MapPixel(*map(float, indexed.position[photo]))


def _from_poses(indexed: IndexedMap, checked: list[VerifiedPhoto]) -> list[PlaceCandidate]:
    """Estimate places from all matches with photos of known extrinsics; the best score first."""
    if indexed.extrinsics is None:
        return []
    usable = [v for v in checked if isinstance(v.pose, RelativePose)]
    views = [
        VerifiedView(v.matched.photo, v.pose, v.query_ray, v.photo_ray, v.inverse_depth, v.sigma, v.ray_sigma)
        for v in usable
        if isinstance(v.pose, RelativePose)
    ]
    radius, tuning = indexed.place_radius_px, indexed.tuning.places
    places = []
    for pose in estimate_poses(
        views,
        indexed.position,
        extrinsics=indexed.extrinsics,
        place_radius_px=radius,
        tuning=indexed.tuning.pose,
    ):
        near = [(a, v) for a, v in zip(pose.agreement, usable, strict=True) if a >= tuning.min_agreement]
        photos = [v for _, v in sorted(near, key=lambda pair: -pair[0])]
        if not photos:
            continue
        if _sigma_from_matches(pose, tuning) > tuning.max_sigma * radius:
            places.append(_photo_place(indexed, photos, score=pose.score))
            continue
        sigma_px = _sigma_px(pose, radius, tuning=tuning)
        places.append(_computed_place(indexed, pose, photos, sigma_px=sigma_px))
    return places


def _computed_place(
    indexed: IndexedMap, found: PoseEstimate | Resection, photos: list[VerifiedPhoto], *, sigma_px: float
) -> PlaceCandidate:
    at = MapPixel(found.x, found.y)
    reach = indexed.tuning.places.anchor_reach * indexed.place_radius_px
    near = [v for v in photos if math.dist(_position(indexed, v.matched.photo), at) <= reach]
    best = max(near, key=lambda v: v.inliers, default=None)
    anchor = at if best is None else _position(indexed, best.matched.photo)
    return PlaceCandidate("position", at, found.heading, sigma_px, photos, found.score, anchor)


def _sigma_px(pose: PoseEstimate, radius: float, *, tuning: PlacesTuning) -> float:
    """Combine the uncertainty of a position from its matches with that from its score, map pixels."""
    by_score = radius * tuning.score_sigma / (tuning.score_offset + pose.score)
    return math.hypot(_sigma_from_matches(pose, tuning), by_score, tuning.floor_sigma * radius)


def _sigma_from_matches(pose: PoseEstimate, tuning: PlacesTuning) -> float:
    """Compute the uncertainty of a position from its matches alone, map pixels."""
    return tuning.correlation * math.sqrt(float(np.trace(pose.covariance_px2)))


def _has_extrinsics(indexed: IndexedMap, verified: VerifiedPhoto) -> bool:
    known = indexed.extrinsics
    return known is not None and bool(known.trust[verified.matched.photo] >= MIN_TRUST)


def _from_bearings(indexed: IndexedMap, *, others: list[VerifiedPhoto]) -> list[PlaceCandidate]:
    """Estimate places from the bearings to `others`, whose extrinsics are unknown; the best score first."""
    tuning = indexed.tuning.places
    usable = [v for v in others if v.weight >= tuning.min_weight and indexed.area[v.matched.photo] < 0]
    usable.sort(key=lambda v: -v.inliers)
    places = []
    for solution in resect(
        _bearings(indexed, usable),
        indexed.position,
        place_radius_px=indexed.place_radius_px,
        most=tuning.most,
    ):
        near = [v for v, a in zip(usable, solution.agreement, strict=True) if a >= tuning.min_agreement]
        if near:
            places.append(_place_from_resection(indexed, near, solution))
    return places


def _bearings(indexed: IndexedMap, usable: list[VerifiedPhoto]) -> Bearings:
    poses = [v.pose for v in usable if isinstance(v.pose, RelativePose)]
    return Bearings(
        position=indexed.position[[v.matched.photo for v in usable]],
        bearing=np.array([p.bearing for p in poses]),
        parallax=np.array([p.parallax for p in poses]),
        weight=np.array([v.weight for v in usable]),
    )


def _is_occupied(
    places: list[PlaceCandidate], position: MapPixel, indexed: IndexedMap, *, floor: int
) -> bool:
    apart = indexed.tuning.places.apart * indexed.place_radius_px
    return any(p.floor == floor and math.dist(p.position, position) <= apart for p in places)


def _place_from_resection(
    indexed: IndexedMap, photos: list[VerifiedPhoto], found: Resection
) -> PlaceCandidate:
    """Convert the solution to a place, or with too few photos for one, take the best photo's position."""
    if len(photos) < MIN_BEARINGS:
        return _photo_place(indexed, photos, score=found.score)
    return _computed_place(indexed, found, photos, sigma_px=found.sigma_px)


def _photo_place(indexed: IndexedMap, photos: list[VerifiedPhoto], *, score: float) -> PlaceCandidate:
    photo = photos[0].matched.photo
    position, floor = _position(indexed, photo), int(indexed.floor[photo])
    sigma_px = indexed.tuning.places.photo_place_sigma * indexed.place_radius_px
    return PlaceCandidate("photo", position, None, sigma_px, photos, score, position, floor=floor)
