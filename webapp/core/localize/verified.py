"""Methods `verified` and `thorough`: votes of all photos, geometry for a shortlist, position by all matches.

1. Retrieve: the k nearest map descriptors of every query descriptor vote for their photos. If photos have
   global descriptors, the most similar photos are added to those with most votes.
2. Verify: the shortlisted photos are verified by the relative pose of the two cameras; in `thorough` a
   network matches them with the query first.
3. Position: all matches with photos of known orientation determine position and heading; if they have known
   depths, a single photo is enough. Without orientations, bearings to three or more photos are used. Separate
   solutions are separate hypotheses. If the position is not determined, the hypothesis is the position of the
   best photo; on a map of areas it is an area.
4. Probability: a calibrated softmax over the places found and "not on this map".
"""

from __future__ import annotations

import math
import time
from collections.abc import Callable, Collection, Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from numpy.typing import NDArray

from webapp.core.features.types import Features
from webapp.core.geometry.estimate import NoPose
from webapp.core.geometry.extrinsics import KeypointDepths, empty_depths
from webapp.core.geometry.relative_pose import Camera, RelativePose, relative_pose
from webapp.core.hypotheses.calibration import DEFAULT, Calibration, probabilities, weigh
from webapp.core.hypotheses.model import Answer, Evidence, Hypothesis
from webapp.core.localize.evidence import Spots, evidence_vectors
from webapp.core.localize.places import PlaceCandidate, VerifiedPhoto, estimate_places, locate, voters_of
from webapp.core.localize.vote import match_statistics
from webapp.core.reconstruction.depths import DepthsExcluding
from webapp.core.retrieval.indexed import IndexedMap, candidates
from webapp.core.retrieval.retrieve import (
    ShortlistedPhoto,
    filter_by_rotation,
    mean_turn_deg,
    quarter_turns,
    rematch_with_network,
    retrieve,
    shortlist,
    weighted_votes,
)
from webapp.threads import in_threads

_EVIDENCE_PHOTOS = 5


@dataclass(frozen=True, slots=True, eq=False)
class PlaceSearch:
    """Result of the search without probabilities, as calibration needs it."""

    places: list[PlaceCandidate]  # The best first
    evidence: NDArray[np.float64]  # (h, EVIDENCE) float64. Evidence of each place; see `evidence_vectors`.
    answer: Answer  # Statistics and seconds, and the reason if there is no place


def with_probabilities(
    indexed: IndexedMap, found: PlaceSearch, *, calibration: Calibration, top: int
) -> Answer:
    if not found.places:
        return found.answer
    probability, off_map = probabilities(found.evidence, calibration)
    order = np.argsort(-probability, kind="stable")
    hypotheses = tuple(
        _hypothesis(indexed, found.places[i], rank=rank, probability=probability[i], calibration=calibration)
        for rank, i in enumerate(order[:top], 1)
    )
    first, *further = (found.places[i].photos for i in order[:top])
    chosen = [*first[:_EVIDENCE_PHOTOS], *(photos[0] for photos in further)]
    shown = {photo.matched.photo: photo for photo in chosen}  # a photo may speak for several places
    return Answer(
        hypotheses=hypotheses,
        off_map_probability=off_map,
        other_probability=float(probability[order[top:]].sum()),
        no_pose=None,
        statistics=found.answer.statistics,
        evidence=tuple(_evidence(indexed, photo) for photo in shown.values()),
        seconds=found.answer.seconds,
        quarter_turns=found.answer.quarter_turns,
    )


def find_places(
    indexed: IndexedMap,
    query: Features,
    *,
    fov_deg: float,
    hide: Collection[int] = (),
    include: Collection[int] = (),
    depths: KeypointDepths | DepthsExcluding | None = None,
) -> PlaceSearch:
    """Find the places where a photo may have been taken, by its features.

    Args:
        indexed: Its `fov_deg` must be known for every photo.
        fov_deg: Horizontal field of view of the upright query.
        hide: Experience ids to leave out.
        include: Experience ids, the best of which are verified, too, if none of them is in the shortlist.
        depths: Depths without observations from hidden photos. By default those of the map, and none if
            photos are hidden.
    """
    fovs = (fov_deg,)
    return find_places_by_fov(indexed, query, fov_deg=fovs, hide=hide, include=include, depths=depths)[0]


def find_places_by_fov(
    indexed: IndexedMap,
    query: Features,
    *,
    fov_deg: Sequence[float],
    hide: Collection[int] = (),
    include: Collection[int] = (),
    depths: KeypointDepths | DepthsExcluding | None = None,
) -> list[PlaceSearch]:
    """Find the places once for each field of view, with the same matches; otherwise as `find_places`.

    The seconds of the first search include those of the retrieval.
    """
    started = time.perf_counter()
    retrieved = retrieve(indexed, query, hide=hide)
    nearest, found = retrieved.nearest, retrieved.found
    listed, further = retrieved.listed, retrieved.further
    include = frozenset(include).difference(hide)
    if include and not np.isin(indexed.ids[[s.photo for s in listed]], [*include]).any():
        # put them first, so that a network that matches only the first few matches these
        listed = [*_shortlist_among(indexed, query, votes=retrieved.votes, include=include), *listed]
        further = [f for f in further if f.photo not in {s.photo for s in listed}]
    seconds = {"retrieve": time.perf_counter() - started}
    turn_deg = mean_turn_deg(indexed, query, found=found)
    if depths is None:
        depths = empty_depths() if hide or indexed.extrinsics is None else indexed.extrinsics.depths
    first = nearest.distance[:, 0][nearest.photo[:, 0] >= 0]
    left = int((found.photo[:, 0] >= 0).sum())
    nowhere = Answer(
        hypotheses=(),
        off_map_probability=1.0,
        other_probability=0.0,
        no_pose=NoPose("no keypoints" if not len(query) else "no match with any photo of the map"),
        statistics=match_statistics(len(query), first, left=left),
        quarter_turns=quarter_turns(indexed, query, nearest=nearest, turn_deg=turn_deg),
    )
    unverified = [VerifiedPhoto.by_votes(f) for f in further]
    verify = partial(_verify, indexed, upright=_roll_correction(turn_deg), depths=depths)
    searches: list[PlaceSearch] = []
    checked: list[VerifiedPhoto] = []  # with the first field of view
    for degrees in fov_deg:
        before = time.perf_counter()
        with_camera = partial(verify, camera=Camera(*query.photo_size, degrees))
        if not searches:
            checked = seen = _verify_all(indexed, query, listed=listed, verify=with_camera)
        else:
            seen = _verify_again(indexed, checked, verify=with_camera)
        seconds = {**seconds, "verify": time.perf_counter() - before}
        search = _places_of(indexed, seen, unverified=unverified, alike=retrieved.alike, nowhere=nowhere)
        position = time.perf_counter() - before - seconds["verify"]
        answer = replace(search.answer, seconds={**seconds, "position": position})
        searches.append(replace(search, answer=answer))
        seconds = {"retrieve": 0.0}
    return searches


def _verify_again(
    indexed: IndexedMap,
    checked: list[VerifiedPhoto],
    *,
    verify: Callable[[ShortlistedPhoto], VerifiedPhoto],
) -> list[VerifiedPhoto]:
    """Verify photos with another camera of the query, if they are trusted at all with the first one."""
    again = [n for n, v in enumerate(checked) if v.weight >= indexed.tuning.places.min_weight]
    renewed = dict(zip(again, in_threads(verify, [checked[n].matched for n in again]), strict=True))
    return [renewed.get(n, v) for n, v in enumerate(checked)]


def _places_of(
    indexed: IndexedMap,
    checked: list[VerifiedPhoto],
    *,
    unverified: list[VerifiedPhoto],
    alike: NDArray[np.float64] | None,
    nowhere: Answer,
) -> PlaceSearch:
    """Estimate the places of verified photos, those with most evidence first."""
    places = estimate_places(indexed, checked, further=unverified, alike=alike)
    evidence = _evidence_vectors(indexed, places, checked=[*checked, *unverified], alike=alike)
    order = np.argsort(-weigh(evidence, DEFAULT), kind="stable")
    answer = replace(nowhere, no_pose=None) if places else nowhere
    return PlaceSearch([places[n] for n in order], evidence[order], answer)


def _shortlist_among(
    indexed: IndexedMap,
    query: Features,
    *,
    votes: NDArray[np.float64],
    include: Collection[int],
) -> list[ShortlistedPhoto]:
    """List the best photos of `include`, matched as if there were no others.

    Their votes are those on the whole map, so that they remain comparable with all other photos.
    """
    others = indexed.ids[~np.isin(indexed.ids, [*include])]
    neighbours = indexed.tuning.retrieval.neighbours
    nearest = candidates(indexed, query.descriptors, k=neighbours + 1, hide=others.tolist())
    found = filter_by_rotation(indexed, query, found=nearest)
    among = weighted_votes(found, len(indexed.ids))
    further = shortlist(indexed, query, found=found, votes=among, most=indexed.tuning.retrieval.shortlist)
    return [replace(s, votes=float(votes[s.photo])) for s in further]


_MIN_ROLL_DEG = 5.0
"""A query rolled by less than this cannot be distinguished from a level one by its keypoints."""


def _roll_correction(askew_deg: float) -> NDArray[np.float64]:
    """Compute the rotation about the line of sight that levels the frame of a rolled query."""
    turn = math.radians(askew_deg) if abs(askew_deg) > _MIN_ROLL_DEG else 0.0
    cos, sin = math.cos(turn), math.sin(turn)
    return np.array([[cos, -sin, 0.0], [sin, cos, 0.0], [0.0, 0.0, 1.0]])


def _verify_all(
    indexed: IndexedMap,
    query: Features,
    *,
    listed: list[ShortlistedPhoto],
    verify: Callable[[ShortlistedPhoto], VerifiedPhoto],
) -> list[VerifiedPhoto]:
    """Verify a shortlist, with matches from a network if there is one.

    The network is slow: in a second look it matches the first photos only, and the others if none of these
    certainly shows the same scene as the query.
    """
    matcher = indexed.pair_matcher
    if matcher is None:
        return in_threads(verify, listed)
    few = len(listed) if indexed.rematched is None else indexed.rematched
    checked = in_threads(verify, rematch_with_network(indexed, query, listed=listed[:few], matcher=matcher))
    further = listed[few:]
    if max((v.inliers for v in checked), default=0) < indexed.tuning.retrieval.certain_inliers:
        further = rematch_with_network(indexed, query, listed=further, matcher=matcher)
    return [*checked, *in_threads(verify, further)]


def _verify(
    indexed: IndexedMap,
    matched: ShortlistedPhoto,
    *,
    camera: Camera,
    upright: NDArray[np.float64],
    depths: KeypointDepths | DepthsExcluding,
) -> VerifiedPhoto:
    theirs = indexed.camera(matched.photo)
    sigma_px, side_px = indexed.tuning.pose.keypoint_sigma_px, indexed.extract_side_px
    pose = relative_pose(matched.query_xy, matched.photo_xy, query=camera, photo=theirs)
    if isinstance(pose, RelativePose):
        pose = pose.rotated(upright)
    inverse_depth, sigma = depths.lookup(matched.photo, matched.photo_row)
    return VerifiedPhoto(
        matched,
        pose,
        query_ray=camera.rays(matched.query_xy.astype(np.float64)) @ upright.T,
        photo_ray=theirs.rays(matched.photo_xy.astype(np.float64)),
        inverse_depth=inverse_depth,
        sigma=sigma,
        ray_sigma=(
            camera.ray_sigma(sigma_px, extract_side_px=side_px),
            theirs.ray_sigma(sigma_px, extract_side_px=side_px),
        ),
    )


def _evidence_vectors(
    indexed: IndexedMap,
    places: list[PlaceCandidate],
    *,
    checked: list[VerifiedPhoto],
    alike: NDArray[np.float64] | None,
) -> NDArray[np.float64]:
    at = Spots(
        np.array([p.position for p in places], np.float64).reshape(-1, 2),
        np.array([p.area for p in places], np.int64),
        np.array([p.floor for p in places], np.int64),
    )
    return evidence_vectors(indexed, voters_of(checked), at=at, score=[p.score for p in places], alike=alike)


def _hypothesis(
    indexed: IndexedMap, place: PlaceCandidate, *, rank: int, probability: float, calibration: Calibration
) -> Hypothesis:
    located = locate(place, calibration=calibration, place_radius_px=indexed.place_radius_px)
    best = place.photos[0]
    return Hypothesis(
        rank=rank,
        kind=located.kind,
        position=located.position,
        probability=float(probability),
        radius_px=None if located.kind == "area" else min(located.sigma_px, indexed.place_radius_px),
        heading_deg=None if located.heading is None else math.degrees(located.heading),
        experiences=tuple(int(indexed.ids[v.matched.photo]) for v in place.photos),
        inliers=best.inliers,
        matches=len(best.matched.query_row),
        camera=place.camera,
        floor=place.floor,
    )


def _evidence(indexed: IndexedMap, photo: VerifiedPhoto) -> Evidence:
    matched, pose = photo.matched, photo.pose
    return Evidence(
        experience=int(indexed.ids[matched.photo]),
        query_xy=matched.query_xy,
        photo_xy=matched.photo_xy,
        inlier=pose.inlier if isinstance(pose, RelativePose) else np.zeros(len(matched.query_row), bool),
    )
