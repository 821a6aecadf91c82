"""Places from verified photos: joined by geometry first, then what is left by votes."""

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

_PLACES = 6

_LEAST_WEIGHT = 0.02
_SUPPORT_WEIGHT = 0.5
"""Merit of a place with all votes, in photos that are fully trusted."""

_SUPPORT_REACH = 2.0
"""How far votes reach, in place radii."""

_APART = 2.0
"""Places nearer to each other, in place radii, could both be right: the better one stands for both."""

_SPREAD, _SPREAD_AT = 0.3, 0.3
"""Uncertainty of a position by its score: the first over the second plus the score, in place radii."""

_MATCHES_ERR_TOGETHER = 6.0
"""Factor on the uncertainty that the matches state, because they do not err independently."""

_SPREAD_LEFT = 0.27
"""Uncertainty of the best position, in place radii: the map's own positions are not better."""

_PHOTO_SPREAD = 0.6
"""Uncertainty of a place that is a photo's own, in place radii: two of three right ones are so near."""

_FIXED = 1.0
"""A position whose matches leave it more uncertain than this, in place radii, is none: one photo whose
depths are not known fixes a line."""

_AGREES = 0.25
"""A photo speaks for a place from this agreement on."""


@dataclass(frozen=True, slots=True, eq=False)
class VerifiedPhoto:
    """A shortlisted photo with its geometry.

    Attributes
    ----------
    matched : Shortlisted
    pose : RelativePose or NoPose
    query_ray, photo_ray : (m, 3) float64
        Of its matches, camera frames, depth 1.
    inverse_depth, sigma : (m,) float64
        Inverse depths of what they show in the photo, per map pixel, and how uncertain; NaN where unknown.
    """

    matched: ShortlistedPhoto
    pose: RelativePose | NoPose
    query_ray: NDArray[np.float64]
    photo_ray: NDArray[np.float64]
    inverse_depth: NDArray[np.float64]
    sigma: NDArray[np.float64]

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
    """A place that came out, before its probability.

    Attributes
    ----------
    kind : {"position", "photo"}
    position : MapPixel
    heading : float or None
        Radians.
    sigma_px : float
        What the estimate itself says of its uncertainty.
    photos : list of Verified
        That speak for it, the best first.
    score : float
        Sum of the trust in the photos that agree on it.
    support : float
        Share of the shortlist's votes that photos around it have, 0 to 1.
    """

    kind: Literal["position", "photo"]
    position: MapPixel
    heading: float | None
    sigma_px: float
    photos: list[VerifiedPhoto]
    score: float
    support: float

    @property
    def merit(self) -> float:
        """What places are ranked by: geometry, and where there is little of it, votes."""
        return self.score + _SUPPORT_WEIGHT * self.support


def estimate_places(indexed: IndexedMap, checked: list[VerifiedPhoto]) -> list[PlaceCandidate]:
    """Join the photos of the shortlist into places.

    Parameters
    ----------
    indexed : IndexedMap
    checked : list of Verified

    Returns
    -------
    list of Place
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
    return sorted(places, key=lambda p: -p.merit)[: max(_PLACES, len(checked) // 2)]


def _from_poses(indexed: IndexedMap, checked: list[VerifiedPhoto]) -> list[PlaceCandidate]:
    """Places from all matches with photos of known orientation; the best score first."""
    if indexed.extrinsics is None:
        return []
    usable = [v for v in checked if isinstance(v.pose, RelativePose)]
    views = [
        VerifiedView(v.matched.photo, v.pose, v.query_ray, v.photo_ray, v.inverse_depth, v.sigma)
        for v in usable
        if isinstance(v.pose, RelativePose)
    ]
    places = []
    for pose in estimate_poses(
        views, indexed.position, extrinsics=indexed.extrinsics, place_radius_px=indexed.place_radius_px
    ):
        near = [(a, v) for a, v in zip(pose.agreement, usable, strict=True) if a >= _AGREES]
        photos = [v for _, v in sorted(near, key=lambda pair: -pair[0])]
        if not photos:
            continue
        support = float(support_at(indexed, checked, position=np.array([[pose.x, pose.y]]))[0])
        if _sigma_from_matches(pose) > _FIXED * indexed.place_radius_px:
            places.append(_photo_place(indexed, photos, score=pose.score, support=support))
            continue
        position, spread = MapPixel(pose.x, pose.y), _sigma_px(pose, indexed.place_radius_px)
        places.append(PlaceCandidate("position", position, pose.heading, spread, photos, pose.score, support))
    return places


def _sigma_px(pose: PoseEstimate, radius: float) -> float:
    """State the uncertainty of a position, map pixels: by its matches, and by how much agrees with it."""
    by_score = radius * _SPREAD / (_SPREAD_AT + pose.score)
    return math.hypot(_sigma_from_matches(pose), by_score, _SPREAD_LEFT * radius)


def _sigma_from_matches(pose: PoseEstimate) -> float:
    """Tell how uncertain the matches alone leave a position, map pixels."""
    return _MATCHES_ERR_TOGETHER * math.sqrt(float(np.trace(pose.covariance_px2)))


def _has_extrinsics(indexed: IndexedMap, verified: VerifiedPhoto) -> bool:
    known = indexed.extrinsics
    return known is not None and bool(known.trust[verified.matched.photo] >= MIN_TRUST)


def _from_bearings(
    indexed: IndexedMap, checked: list[VerifiedPhoto], *, others: list[VerifiedPhoto]
) -> list[PlaceCandidate]:
    """Places from the bearings of `others` alone, whose orientations are not known; the best score first."""
    usable = sorted((v for v in others if v.weight >= _LEAST_WEIGHT), key=lambda v: -v.inliers)
    places = []
    for fix in resect(
        _bearings(indexed, usable),
        indexed.position,
        place_radius_px=indexed.place_radius_px,
        most=_PLACES,
    ):
        near = [v for v, agrees in zip(usable, fix.agreement, strict=True) if agrees >= _AGREES]
        at = np.array([[fix.x, fix.y]])
        if near:
            support = float(support_at(indexed, checked, position=at)[0])
            places.append(_place_from_fix(indexed, near, fix, support=support))
    return places


def support_at(
    indexed: IndexedMap, checked: list[VerifiedPhoto], *, position: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Tell which share of the votes is around positions: photos of one place vote together.

    Parameters
    ----------
    indexed : IndexedMap
    checked : list of Verified
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
    near = np.exp(-squared / (2.0 * (_SUPPORT_REACH * indexed.place_radius_px) ** 2))
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
    return any(math.dist(p.position, position) <= _APART * indexed.place_radius_px for p in places)


def _place_from_fix(
    indexed: IndexedMap, photos: list[VerifiedPhoto], fix: Fix, *, support: float
) -> PlaceCandidate:
    """Take the fix as it is, or with too few photos for one, the best photo's place."""
    if len(photos) < MIN_BEARINGS:
        return _photo_place(indexed, photos, score=fix.score, support=support)
    position = MapPixel(fix.x, fix.y)
    return PlaceCandidate("position", position, fix.heading, fix.sigma_px, photos, fix.score, support)


def _photo_place(
    indexed: IndexedMap, photos: list[VerifiedPhoto], *, score: float, support: float
) -> PlaceCandidate:
    position = MapPixel(*map(float, indexed.position[photos[0].matched.photo]))
    return PlaceCandidate(
        "photo", position, None, _PHOTO_SPREAD * indexed.place_radius_px, photos, score, support
    )
