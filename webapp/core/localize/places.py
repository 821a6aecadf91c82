"""Place candidates from verified photos: by geometry first, then by votes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from webapp.core.geo.types import MapPixel
from webapp.core.geometry.estimate import NoPose
from webapp.core.geometry.extrinsics import MIN_TRUST
from webapp.core.geometry.relative_pose import RelativePose
from webapp.core.localize.pose_refinement import PoseEstimate, estimate_poses
from webapp.core.localize.pose_residuals import VerifiedView
from webapp.core.localize.resection import MIN_BEARINGS, Bearings, Fix, resect
from webapp.core.retrieval.indexed import IndexedMap
from webapp.core.retrieval.shortlist import ShortlistedPhoto
from webapp.core.tuning import PlacesTuning


@dataclass(frozen=True, slots=True, eq=False)
class VerifiedPhoto:
    """A shortlisted photo after geometric verification.

    Attributes
    ----------
    query_ray, photo_ray : (m, 3) float64
        Of its matches, camera frames, depth 1.
    inverse_depth, sigma : (m,) float64
        Inverse depths of the matched points in the photo's frame, per map pixel, and their standard
        deviations; NaN where unknown.
    ray_sigma : (float, float)
        Standard deviations of the query's and the photo's rays at depth 1.
    """

    matched: ShortlistedPhoto
    pose: RelativePose | NoPose
    query_ray: NDArray[np.float64]
    photo_ray: NDArray[np.float64]
    inverse_depth: NDArray[np.float64]
    sigma: NDArray[np.float64]
    ray_sigma: tuple[float, float]

    @property
    def inliers(self) -> int:
        """Matches that agree on one relative pose."""
        return self.pose.inliers if isinstance(self.pose, RelativePose) else 0

    @property
    def weight(self) -> float:
        """Trust in the geometry, 0 to 1."""
        return self.pose.trust if isinstance(self.pose, RelativePose) else 0.0


@dataclass(frozen=True, slots=True, eq=False)
class PlaceCandidate:
    """A candidate place, before its probability.

    Attributes
    ----------
    kind : {"position", "photo"}
    heading : float or None
        Radians.
    sigma_px : float
        Uncertainty by the estimate itself, before calibration.
    photos : list of VerifiedPhoto
        That support it, the best first.
    score : float
        Sum of the trust in the photos that agree on it.
    support : float
        Share of the shortlist's votes that photos around it have, 0 to 1.
    merit : float
        What candidates are ranked by: the score, and where it is low, the votes.
    """

    kind: Literal["position", "photo"]
    position: MapPixel
    heading: float | None
    sigma_px: float
    photos: list[VerifiedPhoto]
    score: float
    support: float
    merit: float


def estimate_places(indexed: IndexedMap, checked: list[VerifiedPhoto]) -> list[PlaceCandidate]:
    """Cluster the photos of the shortlist into candidate places.

    Returns
    -------
    list of PlaceCandidate
        The best first, any two at least twice the place radius apart; at most six, or one of two photos.
    """
    places: list[PlaceCandidate] = []
    others = [v for v in checked if not _has_extrinsics(indexed, v)]
    for place in (*_from_poses(indexed, checked), *_from_bearings(indexed, checked, others=others)):
        if not _is_occupied(places, place.position, indexed):
            places.append(place)
    where = indexed.position[[v.matched.photo for v in checked]]
    support = support_at(indexed, checked, position=where)
    for n in np.argsort(-support, kind="stable"):
        if not _is_occupied(places, MapPixel(*map(float, where[n])), indexed):
            places.append(_photo_place(indexed, [checked[n]], score=0.0, support=float(support[n])))
    return sorted(places, key=lambda p: -p.merit)[: max(indexed.tuning.places.most, len(checked) // 2)]


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
        support = float(support_at(indexed, checked, position=np.array([[pose.x, pose.y]]))[0])
        if _sigma_from_matches(pose, tuning) > tuning.max_sigma * radius:
            places.append(_photo_place(indexed, photos, score=pose.score, support=support))
            continue
        sigma_px = _sigma_px(pose, radius, tuning=tuning)
        places.append(_computed_place(indexed, pose, photos, sigma_px=sigma_px, support=support))
    return places


def _computed_place(
    indexed: IndexedMap,
    found: PoseEstimate | Fix,
    photos: list[VerifiedPhoto],
    *,
    sigma_px: float,
    support: float,
) -> PlaceCandidate:
    return PlaceCandidate(
        "position",
        MapPixel(found.x, found.y),
        found.heading,
        sigma_px,
        photos,
        found.score,
        support,
        merit=found.score + indexed.tuning.places.support_weight * support,
    )


def _sigma_px(pose: PoseEstimate, radius: float, *, tuning: PlacesTuning) -> float:
    """Combine the uncertainty of a position by its matches with that by its score, map pixels."""
    by_score = radius * tuning.score_sigma / (tuning.score_offset + pose.score)
    return math.hypot(_sigma_from_matches(pose, tuning), by_score, tuning.floor_sigma * radius)


def _sigma_from_matches(pose: PoseEstimate, tuning: PlacesTuning) -> float:
    """Compute the uncertainty of a position by its matches alone, map pixels."""
    return tuning.correlation * math.sqrt(float(np.trace(pose.covariance_px2)))


def _has_extrinsics(indexed: IndexedMap, verified: VerifiedPhoto) -> bool:
    known = indexed.extrinsics
    return known is not None and bool(known.trust[verified.matched.photo] >= MIN_TRUST)


def _from_bearings(
    indexed: IndexedMap, checked: list[VerifiedPhoto], *, others: list[VerifiedPhoto]
) -> list[PlaceCandidate]:
    """Estimate places from the bearings of `others`, whose extrinsics are not known; the best score first."""
    tuning = indexed.tuning.places
    usable = sorted((v for v in others if v.weight >= tuning.min_weight), key=lambda v: -v.inliers)
    places = []
    for fix in resect(
        _bearings(indexed, usable),
        indexed.position,
        place_radius_px=indexed.place_radius_px,
        most=tuning.most,
    ):
        near = [v for v, a in zip(usable, fix.agreement, strict=True) if a >= tuning.min_agreement]
        at = np.array([[fix.x, fix.y]])
        if near:
            support = float(support_at(indexed, checked, position=at)[0])
            places.append(_place_from_fix(indexed, near, fix, support=support))
    return places


def support_at(
    indexed: IndexedMap, checked: list[VerifiedPhoto], *, position: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Compute the share of the votes around positions: photos of one place vote together.

    Parameters
    ----------
    checked : list of VerifiedPhoto
        Whose votes count.
    position : (m, 2) float64
        Map pixels.

    Returns
    -------
    (m,) float64
        0 to 1.
    """
    votes = np.array([v.matched.votes for v in checked])
    if not votes.any():
        return np.zeros(len(position))
    voters = indexed.position[[v.matched.photo for v in checked]]
    squared = ((position[:, None] - voters[None]) ** 2).sum(-1)
    near = np.exp(-squared / (2.0 * (indexed.tuning.places.support_reach * indexed.place_radius_px) ** 2))
    share: NDArray[np.float64] = near @ votes / votes.sum()
    return share


def _bearings(indexed: IndexedMap, usable: list[VerifiedPhoto]) -> Bearings:
    poses = [v.pose for v in usable if isinstance(v.pose, RelativePose)]
    return Bearings(
        position=indexed.position[[v.matched.photo for v in usable]],
        bearing=np.array([p.bearing for p in poses]),
        parallax=np.array([p.parallax for p in poses]),
        weight=np.array([v.weight for v in usable]),
    )


def _is_occupied(places: list[PlaceCandidate], position: MapPixel, indexed: IndexedMap) -> bool:
    apart = indexed.tuning.places.apart * indexed.place_radius_px
    return any(math.dist(p.position, position) <= apart for p in places)


def _place_from_fix(
    indexed: IndexedMap, photos: list[VerifiedPhoto], fix: Fix, *, support: float
) -> PlaceCandidate:
    """Take the fix as it is, or with too few photos for one, the best photo's place."""
    if len(photos) < MIN_BEARINGS:
        return _photo_place(indexed, photos, score=fix.score, support=support)
    return _computed_place(indexed, fix, photos, sigma_px=fix.sigma_px, support=support)


def _photo_place(
    indexed: IndexedMap, photos: list[VerifiedPhoto], *, score: float, support: float
) -> PlaceCandidate:
    position = MapPixel(*map(float, indexed.position[photos[0].matched.photo]))
    tuning = indexed.tuning.places
    merit = score + tuning.support_weight * support
    sigma_px = tuning.photo_sigma * indexed.place_radius_px
    return PlaceCandidate("photo", position, None, sigma_px, photos, score, support, merit)
