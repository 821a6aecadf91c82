"""Places from verified photos: joined by geometry first, then what is left by votes."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from webapp.core.features.relative import RelativePose
from webapp.core.geo.types import MapPixel
from webapp.core.hypotheses.model import NoPose
from webapp.core.localize.indexed import IndexedMap
from webapp.core.localize.resection import MIN_BEARINGS, Bearings, Fix, resect
from webapp.core.localize.shortlist import Shortlisted

_PLACES = 6

INLIER_SCALE = 35.0
"""Inliers beyond chance that make two of three poses right."""

_CHANCE_INLIERS = 6.0
"""Inliers that any pair of photos has."""

_CHANCE_SHARE, _SURE_SHARE = 0.15, 0.5
"""Share of the matches that agree on some pose by chance, and from which on it is no chance."""

_WILD_PARALLAX = math.radians(20.0)
"""A pose with more parallax is rather a wrong one: its turn does not bring the rays together."""


_LEAST_WEIGHT = 0.02
_SUPPORT_WEIGHT = 0.5
"""Merit of a place with all votes, in photos that are fully trusted."""

_SUPPORT_REACH = 2.0
"""How far votes reach, in place radii."""

_APART = 2.0
"""Places nearer to each other, in place radii, could both be right: the better one stands for both."""

_AGREES = 0.25
"""A photo speaks for a place from this agreement on."""


@dataclass(frozen=True, slots=True, eq=False)
class Verified:
    """A shortlisted photo with its geometry.

    Attributes
    ----------
    matched : Shortlisted
    pose : RelativePose or NoPose
    """

    matched: Shortlisted
    pose: RelativePose | NoPose

    @property
    def inliers(self) -> int:
        """Matches that agree on one relative pose."""
        return int(self.pose.inlier.sum()) if isinstance(self.pose, RelativePose) else 0

    @property
    def weight(self) -> float:
        """Trust in the geometry, 0 to 1."""
        if not isinstance(self.pose, RelativePose):
            return 0.0
        enough = 1.0 - math.exp(-max(0.0, self.inliers - _CHANCE_INLIERS) / INLIER_SCALE)
        share = self.inliers / len(self.pose.inlier)
        common = min(1.0, max(0.0, (share - _CHANCE_SHARE) / (_SURE_SHARE - _CHANCE_SHARE)))
        return enough * common / (1.0 + (self.pose.parallax / _WILD_PARALLAX) ** 4)


@dataclass(frozen=True, slots=True, eq=False)
class Place:
    """A place that came out, before its probability.

    Attributes
    ----------
    kind : {"position", "photo"}
    position : MapPixel
    heading : float or None
        Radians.
    spread_px : float
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
    spread_px: float
    photos: list[Verified]
    score: float
    support: float

    @property
    def votes(self) -> float:
        """Sum of the votes of its photos."""
        return sum(v.matched.votes for v in self.photos)

    @property
    def merit(self) -> float:
        """What places are ranked by: geometry, and where there is little of it, votes."""
        return self.score + _SUPPORT_WEIGHT * self.support


def join(indexed: IndexedMap, checked: list[Verified]) -> list[Place]:
    """Join the photos of the shortlist into places.

    Parameters
    ----------
    indexed : IndexedMap
    checked : list of Verified

    Returns
    -------
    list of Place
        The best first, any two at least twice the place radius apart; at most six.
    """
    usable = sorted((v for v in checked if v.weight >= _LEAST_WEIGHT), key=lambda v: -v.inliers)
    places: list[Place] = []
    for fix in resect(
        _bearings(indexed, usable),
        indexed.position,
        place_radius_px=indexed.place_radius_px,
        most=_PLACES,
    ):
        near = [v for v, agrees in zip(usable, fix.agreement, strict=True) if agrees >= _AGREES]
        at = np.array([[fix.x, fix.y]])
        if near and not _taken(places, MapPixel(fix.x, fix.y), indexed):
            places.append(_place(indexed, near, fix, support=float(_support(indexed, checked, at)[0])))
    where = indexed.position[[v.matched.photo for v in checked]]
    support = _support(indexed, checked, where)
    for n in np.argsort(-support, kind="stable"):
        if len(places) < _PLACES and not _taken(places, MapPixel(*map(float, where[n])), indexed):
            places.append(_photo_place(indexed, [checked[n]], score=0.0, support=float(support[n])))
    return sorted(places, key=lambda p: -p.merit)


def _support(
    indexed: IndexedMap, checked: list[Verified], position: NDArray[np.float64]
) -> NDArray[np.float64]:
    """Share of the votes around (m, 2) positions: photos of one place vote together; (m,)."""
    if not checked:
        return np.zeros(len(position))
    voters = indexed.position[[v.matched.photo for v in checked]]
    votes = np.array([v.matched.votes for v in checked])
    squared = ((position[:, None] - voters[None]) ** 2).sum(-1)
    near = np.exp(-squared / (2.0 * (_SUPPORT_REACH * indexed.place_radius_px) ** 2))
    share: NDArray[np.float64] = near @ votes / votes.sum()
    return share


def _bearings(indexed: IndexedMap, usable: list[Verified]) -> Bearings:
    poses = [v.pose for v in usable if isinstance(v.pose, RelativePose)]
    return Bearings(
        position=indexed.position[[v.matched.photo for v in usable]],
        bearing=np.array([p.bearing for p in poses]),
        parallax=np.array([p.parallax for p in poses]),
        weight=np.array([v.weight for v in usable]),
    )


def _taken(places: list[Place], position: MapPixel, indexed: IndexedMap) -> bool:
    return any(math.dist(p.position, position) <= _APART * indexed.place_radius_px for p in places)


def _place(indexed: IndexedMap, photos: list[Verified], fix: Fix, *, support: float) -> Place:
    """Take the fix as it is, or with too few photos for one, the best photo's place."""
    if len(photos) < MIN_BEARINGS:
        return _photo_place(indexed, photos, score=fix.score, support=support)
    position = MapPixel(fix.x, fix.y)
    return Place("position", position, fix.heading, fix.spread_px, photos, fix.score, support)


def _photo_place(indexed: IndexedMap, photos: list[Verified], *, score: float, support: float) -> Place:
    position = MapPixel(*map(float, indexed.position[photos[0].matched.photo]))
    return Place("photo", position, None, indexed.place_radius_px / 2.0, photos, score, support)
