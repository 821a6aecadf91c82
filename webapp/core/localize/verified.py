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
from webapp.core.hypotheses.calibration import Calibration, probabilities
from webapp.core.hypotheses.model import Answer, Evidence, Hypothesis, NoPose
from webapp.core.localize.indexed import IndexedMap, candidates
from webapp.core.localize.resection import MIN_BEARINGS, Bearings, Fix, resect
from webapp.core.localize.shortlist import Shortlisted, shortlist, weighted_votes
from webapp.core.localize.vote import match_statistics

NEIGHBOURS = 10
_SHORTLIST = 15
_PLACES = 8
_EVIDENCE_PHOTOS = 5

_CHANCE_INLIERS = 6.0
_SURE_INLIERS = 40.0
"""Inliers of a random pair of photos, and from which on a pair is beyond doubt."""


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
        return min(1.0, max(0.0, (self.inliers - _CHANCE_INLIERS) / (_SURE_INLIERS - _CHANCE_INLIERS)))


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
    evidence : (EVIDENCE,) float64
        Log of the best photo's inliers, log of all photos' inliers, share of the votes.
    """

    kind: Literal["position", "photo"]
    position: MapPixel
    heading: float | None
    spread_px: float
    photos: list[Verified]
    evidence: NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Found:
    """Everything but the probabilities: what calibration works with."""

    places: list[Place]
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
    evidence = np.array([p.evidence for p in found.places])
    probability, off_map = probabilities(evidence, calibration)
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
        Its answer has statistics and seconds; and the reason, where there is no place.
    """
    clock = [time.perf_counter()]
    found = candidates(indexed, query.descriptors, k=NEIGHBOURS + 1, hide=hide)
    votes = weighted_votes(found, len(indexed.ids))
    listed = shortlist(indexed, query, found, votes=votes, most=_SHORTLIST)
    clock.append(time.perf_counter())
    camera = Camera(*query.photo_size, fov_deg)
    checked = [Verified(m, _pose(indexed, m, camera)) for m in listed]
    clock.append(time.perf_counter())
    places = _places(indexed, checked)
    clock.append(time.perf_counter())
    nearest = found.distance[:, 0][found.photo[:, 0] >= 0]
    supported = len(np.unique(np.concatenate([v.matched.query_row for v in checked]))) if checked else 0
    reason = "no keypoints" if not len(query) else "no match with any photo of the map"
    stages = ("retrieve", "verify", "position")
    return Found(
        places,
        Answer(
            hypotheses=(),
            off_map_probability=1.0,
            other_probability=0.0,
            no_pose=None if places else NoPose(reason),
            statistics=match_statistics(len(query), nearest, pruned=supported),
            seconds={s: b - a for s, a, b in zip(stages, clock, clock[1:], strict=False)},
        ),
    )


def _pose(indexed: IndexedMap, matched: Shortlisted, camera: Camera) -> RelativePose | NoPose:
    features = indexed.features(matched.photo)
    if features is None:
        return NoPose("the photo has no features")
    theirs = Camera(*features.photo_size, float(indexed.fov_deg[matched.photo]))
    return relative_pose(matched.query_xy, matched.photo_xy, query=camera, photo=theirs)


def _places(indexed: IndexedMap, checked: list[Verified]) -> list[Place]:
    """Join the photos into places: by geometry first, then what is left by votes."""
    total_votes = sum(v.matched.votes for v in checked)
    usable = sorted((v for v in checked if v.weight > 0.0), key=lambda v: -v.inliers)
    fixes = resect(_bearings(indexed, usable), indexed.place_radius_px, most=_PLACES)
    places: list[Place] = []
    for fix in fixes:
        near = [v for v in usable if _speaks_for(indexed, v, fix)]
        if near and not _taken(places, MapPixel(fix.x, fix.y), indexed):
            places.append(_place(indexed, near, fix=fix, total_votes=total_votes))
    rest = sorted(checked, key=lambda v: -v.matched.votes)
    for one in rest:
        position = MapPixel(*map(float, indexed.position[one.matched.photo]))
        if len(places) < _PLACES and not _taken(places, position, indexed):
            near = [v for v in rest if _distance(indexed, v, position) <= indexed.place_radius_px]
            places.append(_place(indexed, near, fix=None, total_votes=total_votes))
    return places


def _bearings(indexed: IndexedMap, usable: list[Verified]) -> Bearings:
    poses = [v.pose for v in usable if isinstance(v.pose, RelativePose)]
    return Bearings(
        position=indexed.position[[v.matched.photo for v in usable]],
        bearing=np.array([p.bearing for p in poses]),
        parallax=np.array([p.parallax for p in poses]),
        weight=np.array([v.weight for v in usable]),
    )


_SPEAKS_WITHIN = 3.0
"""A photo speaks for a place up to this distance, in place radii."""


def _speaks_for(indexed: IndexedMap, photo: Verified, fix: Fix) -> bool:
    return _distance(indexed, photo, MapPixel(fix.x, fix.y)) <= _SPEAKS_WITHIN * indexed.place_radius_px


def _distance(indexed: IndexedMap, photo: Verified, position: MapPixel) -> float:
    return float(math.dist(indexed.position[photo.matched.photo], position))


def _taken(places: list[Place], position: MapPixel, indexed: IndexedMap) -> bool:
    return any(math.dist(p.position, position) <= indexed.place_radius_px for p in places)


def _place(indexed: IndexedMap, photos: list[Verified], *, fix: Fix | None, total_votes: float) -> Place:
    """Sum up the evidence; without a fix, or with too few photos for one, it is the best photo's place."""
    best = photos[0]
    evidence = np.array(
        [
            math.log1p(max(v.inliers for v in photos)),
            math.log1p(sum(max(0.0, v.inliers - _CHANCE_INLIERS) for v in photos)),
            sum(v.matched.votes for v in photos) / total_votes,
        ]
    )
    if fix is not None and len(photos) >= MIN_BEARINGS:
        return Place("position", MapPixel(fix.x, fix.y), fix.heading, fix.spread_px, photos, evidence)
    position = MapPixel(*map(float, indexed.position[best.matched.photo]))
    return Place("photo", position, None, indexed.place_radius_px / 2.0, photos, evidence)


def _hypothesis(
    indexed: IndexedMap, place: Place, *, rank: int, probability: float, calibration: Calibration
) -> Hypothesis:
    radius = max(place.spread_px * calibration.radius_scale, calibration.radius_floor_px)
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
