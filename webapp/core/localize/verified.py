"""Method `verified`: votes of the whole map, geometry for a shortlist, position from bearings.

1. Retrieve: the k nearest map descriptors of every query descriptor vote for their photos.
2. Verify: the photos with most votes are checked by the relative pose of the two cameras.
3. Position: bearings to the verified photos fix position and heading; separate solutions are separate
   hypotheses. With fewer than three photos that agree, the best photo's own place is all that is known.
4. Probability: a calibrated softmax over the places found and "not on this map".
"""

from __future__ import annotations

import math
import time
from collections.abc import Collection
from dataclasses import dataclass
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from webapp.core.features.relative import Camera, RelativePose, relative_pose
from webapp.core.features.types import Features
from webapp.core.geo.types import MapPixel
from webapp.core.hypotheses.calibration import EVIDENCE, Calibration, probabilities
from webapp.core.hypotheses.model import Answer, Evidence, Hypothesis, NoPose
from webapp.core.localize.indexed import IndexedMap, candidates
from webapp.core.localize.resection import MIN_BEARINGS, Bearings, Fix, resect
from webapp.core.localize.shortlist import Shortlisted, consistent, shortlist, weighted_votes
from webapp.core.localize.vote import match_statistics
from webapp.threads import in_threads

NEIGHBOURS = 10
_SHORTLIST = 10
_PLACES = 6
_EVIDENCE_PHOTOS = 5

_CHANCE_INLIERS = 6.0
"""Inliers that any pair of photos has."""

_INLIER_SCALE = 35.0
"""Inliers beyond chance that make two of three poses right."""

_CHANCE_SHARE, _SURE_SHARE = 0.15, 0.5
"""Share of the matches that agree on some pose by chance, and from which on it is no chance."""

_WILD_PARALLAX = math.radians(20.0)
"""A pose with more parallax is rather a wrong one: its turn does not bring the rays together."""


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
        enough = 1.0 - math.exp(-max(0.0, self.inliers - _CHANCE_INLIERS) / _INLIER_SCALE)
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
    """

    kind: Literal["position", "photo"]
    position: MapPixel
    heading: float | None
    spread_px: float
    photos: list[Verified]
    score: float

    @property
    def votes(self) -> float:
        """Sum of the votes of its photos."""
        return sum(v.matched.votes for v in self.photos)


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """Everything but the probabilities: what calibration works with.

    Attributes
    ----------
    places : list of Place
        The best first.
    evidence : (h, EVIDENCE) float64
        Of each place: log of the inliers that agree on the best place, share of the votes that the best
        place has, and log of the place's score over the best one's.
    answer : Answer
        Statistics and seconds, and the reason where there is no place.
    """

    places: list[Place]
    evidence: NDArray[np.float64]
    answer: Answer


def localize(
    indexed: IndexedMap,
    query: Features,
    *,
    fov_deg: float,
    calibration: Calibration,
    top: int,
    hide: Collection[int] = (),
) -> Answer:
    """Localize a photo by its features.

    Parameters
    ----------
    indexed : IndexedMap
        Its `fov_deg` must be known for every photo.
    query : Features
    fov_deg : float
        Horizontal field of view of the upright query.
    calibration : Calibration
    top : int
        At most so many hypotheses.
    hide : collection of int
        Experience ids to leave out.

    Returns
    -------
    Answer
    """
    found = find_places(indexed, query, fov_deg=fov_deg, hide=hide)
    if not found.places:
        return found.answer
    probability, off_map = probabilities(found.evidence, calibration)
    order = np.argsort(-probability, kind="stable")
    hypotheses = tuple(
        _hypothesis(indexed, found.places[i], rank=rank, probability=probability[i], calibration=calibration)
        for rank, i in enumerate(order[:top], 1)
    )
    return Answer(
        hypotheses=hypotheses,
        off_map_probability=off_map,
        other_probability=float(probability[order[top:]].sum()),
        no_pose=None,
        statistics=found.answer.statistics,
        evidence=tuple(_evidence(indexed, v) for v in found.places[order[0]].photos[:_EVIDENCE_PHOTOS]),
        seconds=found.answer.seconds,
    )


def find_places(indexed: IndexedMap, query: Features, *, fov_deg: float, hide: Collection[int] = ()) -> Found:
    """Do all of `localize` but the probabilities.

    Returns
    -------
    Found
    """
    clock = [time.perf_counter()]
    nearest = candidates(indexed, query.descriptors, k=NEIGHBOURS + 1, hide=hide)
    found = consistent(indexed, query, found=nearest)
    votes = weighted_votes(found, len(indexed.ids))
    listed = shortlist(indexed, query, found=found, votes=votes, most=_SHORTLIST)
    clock.append(time.perf_counter())
    camera = Camera(*query.photo_size, fov_deg)
    checked = in_threads(lambda m: Verified(m, _pose(indexed, m, camera)), listed)
    clock.append(time.perf_counter())
    places = _places(indexed, checked)
    clock.append(time.perf_counter())
    first = nearest.distance[:, 0][nearest.photo[:, 0] >= 0]
    left = int((found.photo[:, 0] >= 0).sum())
    reason = "no keypoints" if not len(query) else "no match with any photo of the map"
    stages = ("retrieve", "verify", "position")
    return Found(
        places,
        _weigh(places, checked),
        Answer(
            hypotheses=(),
            off_map_probability=1.0,
            other_probability=0.0,
            no_pose=None if places else NoPose(reason),
            statistics=match_statistics(len(query), first, pruned=left),
            seconds={s: b - a for s, a, b in zip(stages, clock, clock[1:], strict=False)},
        ),
    )


def _pose(indexed: IndexedMap, matched: Shortlisted, camera: Camera) -> RelativePose | NoPose:
    theirs = Camera(*indexed.photo_size(matched.photo), float(indexed.fov_deg[matched.photo]))
    return relative_pose(matched.query_xy, matched.photo_xy, query=camera, photo=theirs)


def _places(indexed: IndexedMap, checked: list[Verified]) -> list[Place]:
    """Join the photos into places: by geometry first, then what is left by votes."""
    usable = sorted((v for v in checked if v.weight >= _LEAST_WEIGHT), key=lambda v: -v.inliers)
    places: list[Place] = []
    for fix in resect(
        _bearings(indexed, usable),
        indexed.position,
        place_radius_px=indexed.place_radius_px,
        most=_PLACES,
    ):
        near = [v for v, agrees in zip(usable, fix.agreement, strict=True) if agrees >= _AGREES]
        if near and not _taken(places, MapPixel(fix.x, fix.y), indexed):
            places.append(_place(indexed, near, fix))
    for one in sorted(checked, key=lambda v: -v.matched.votes):
        position = MapPixel(*map(float, indexed.position[one.matched.photo]))
        if len(places) < _PLACES and not _taken(places, position, indexed):
            places.append(_photo_place(indexed, [one], score=0.0))
    return places


def _weigh(places: list[Place], checked: list[Verified]) -> NDArray[np.float64]:
    """Describe each place for its probability; see `Found`."""
    if not places:
        return np.zeros((0, EVIDENCE))
    best = places[0]
    share = best.votes / sum(v.matched.votes for v in checked)
    common = (math.log1p(_INLIER_SCALE * best.score), share)
    return np.array([(*common, math.log((p.score + _NO_SCORE) / (best.score + _NO_SCORE))) for p in places])


def _bearings(indexed: IndexedMap, usable: list[Verified]) -> Bearings:
    poses = [v.pose for v in usable if isinstance(v.pose, RelativePose)]
    return Bearings(
        position=indexed.position[[v.matched.photo for v in usable]],
        bearing=np.array([p.bearing for p in poses]),
        parallax=np.array([p.parallax for p in poses]),
        weight=np.array([v.weight for v in usable]),
    )


_LEAST_WEIGHT = 0.02
_NO_SCORE = 0.02
"""Stands for the score of a place that only has votes."""

_APART = 2.0
"""Places nearer to each other, in place radii, could both be right: the better one stands for both."""

_AGREES = 0.25
"""A photo speaks for a place from this agreement on."""


def _taken(places: list[Place], position: MapPixel, indexed: IndexedMap) -> bool:
    return any(math.dist(p.position, position) <= _APART * indexed.place_radius_px for p in places)


def _place(indexed: IndexedMap, photos: list[Verified], fix: Fix) -> Place:
    """Take the fix as it is, or with too few photos for one, the best photo's place."""
    if len(photos) < MIN_BEARINGS:
        return _photo_place(indexed, photos, score=fix.score)
    position = MapPixel(fix.x, fix.y)
    return Place("position", position, fix.heading, fix.spread_px, photos, fix.score)


def _photo_place(indexed: IndexedMap, photos: list[Verified], *, score: float) -> Place:
    position = MapPixel(*map(float, indexed.position[photos[0].matched.photo]))
    return Place("photo", position, None, indexed.place_radius_px / 2.0, photos, score)


def _hypothesis(
    indexed: IndexedMap, place: Place, *, rank: int, probability: float, calibration: Calibration
) -> Hypothesis:
    radius = place.spread_px * (calibration.radius_scale if place.kind == "position" else 1.0)
    best = place.photos[0]
    return Hypothesis(
        rank=rank,
        kind=place.kind,
        position=place.position,
        probability=float(probability),
        radius_px=min(radius, indexed.place_radius_px),
        heading_deg=None if place.heading is None else math.degrees(place.heading),
        experiences=tuple(int(indexed.ids[v.matched.photo]) for v in place.photos),
        inliers=best.inliers,
        matches=len(best.matched.query_row),
    )


def _evidence(indexed: IndexedMap, photo: Verified) -> Evidence:
    matched, pose = photo.matched, photo.pose
    return Evidence(
        experience=int(indexed.ids[matched.photo]),
        query_xy=matched.query_xy,
        photo_xy=matched.photo_xy,
        inlier=pose.inlier if isinstance(pose, RelativePose) else np.zeros(len(matched.query_row), bool),
    )
