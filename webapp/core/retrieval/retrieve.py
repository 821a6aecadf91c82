"""First stage of a query: find the map photos that may show the same scene.

The shortlist is chosen by votes of matching descriptors. Photos that are similar to the query by global
descriptors are added to it: the two rankings are fused by reciprocal ranks (Cormack et al. 2009). Most of the
shortlist is still chosen by votes, so that a model that is useless on a map does little harm.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from webapp.core.features.lightglue import PairMatcher
from webapp.core.features.types import Features
from webapp.core.retrieval.indexed import Candidates, IndexedMap, candidates
from webapp.threads import in_threads


@dataclass(frozen=True, slots=True, eq=False)
class ShortlistedPhoto:
    """A map photo and its matches."""

    photo: int  # Its number in the map
    votes: float  # Sum of the weights of its matches
    # `query_row`, `photo_row`: (m,) int64. Keypoints of the query, each at most once, and of the photo.
    query_row: NDArray[np.int64]
    photo_row: NDArray[np.int64]
    # `query_xy`, `photo_xy`: (m, 2) float32. Their pixels in the upright photos.
    query_xy: NDArray[np.float32]
    photo_xy: NDArray[np.float32]


_ROTATION_BINS = 36

_AROUND_TURN_DEG, _SHOWN_BY = 30.0, 0.25
"""A rotation is clear if neighbours within this angle of it have at least this share of the total weight;
by chance it is about 0.2."""


def filter_by_rotation(indexed: IndexedMap, query: Features, *, found: Candidates) -> Candidates:
    """Keep the neighbours whose rotation relative to the query's keypoint is the dominant one.

    Right matches share the rotation between the two photos, near zero if both are upright; that of wrong
    ones is random. This weak geometric consistency (Jégou et al. 2008) costs almost nothing and removes most
    of the wrong matches before votes are counted.

    Args:
        found: (n, k)

    Returns:
        Of the same shape, with photos and rows of dropped neighbours set to -1; distances are kept.
    """
    turn, weight = _turns(indexed, query, found=found)
    if not weight.any():
        return found
    wide = 360.0 / _ROTATION_BINS
    bins = np.floor(np.remainder(turn, 360.0) / wide).astype(int) % _ROTATION_BINS
    votes = np.bincount(bins.ravel(), weights=weight.ravel(), minlength=_ROTATION_BINS)
    most = int((votes + np.roll(votes, 1) + np.roll(votes, -1)).argmax())
    off = np.abs(np.remainder(turn - (most + 0.5) * wide + 180.0, 360.0) - 180.0)
    keep = off <= indexed.tuning.retrieval.rotation_tolerance_deg
    return Candidates(found.distance, np.where(keep, found.row, -1), np.where(keep, found.photo, -1))


def mean_turn_deg(indexed: IndexedMap, query: Features, *, found: Candidates) -> float:
    """Compute the clockwise rotation that aligns the query with the map's photos.

    Args:
        query: If keypoints have no orientation, all angles are 0, and so is the rotation.

    Returns:
        Degrees, -180 to 180: the weighted mean; 0 without neighbours.
    """
    turn, weight = _turns(indexed, query, found=found)
    return float(np.degrees(np.angle((weight * np.exp(1j * np.radians(turn))).sum())))


def quarter_turns(indexed: IndexedMap, query: Features, *, nearest: Candidates, turn_deg: float) -> int:
    """Count the clockwise quarter turns that bring the query upright, if the keypoints' rotation is clear.

    Args:
        nearest: (n, k), before `filter_by_rotation`.

    Returns:
        0 to 3; 0 if it is not clear.
    """
    turn, weight = _turns(indexed, query, found=nearest)
    around = np.abs(np.remainder(turn - turn_deg + 180.0, 360.0) - 180.0) <= _AROUND_TURN_DEG
    if weight[around].sum() < _SHOWN_BY * weight.sum():
        return 0
    return round(turn_deg / 90.0) % 4


def _turns(
    indexed: IndexedMap, query: Features, *, found: Candidates
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return the rotation of each neighbour relative to the query, degrees, and its weight; (n, k) both."""
    turn = indexed.keypoint_angle(found.row) - query.angle[:, None]
    return turn, np.where(found.photo >= 0, np.maximum(_yardstick(found) - found.distance, 0.0), 0.0)


def _yardstick(found: Candidates) -> NDArray[np.float32]:
    """Return the distance of each query descriptor's last neighbour, whose vote has weight 0; (n, 1)."""
    known = np.where(np.isfinite(found.distance), found.distance, -np.inf)
    yardstick: NDArray[np.float32] = known.max(axis=1, keepdims=True)
    return yardstick


def weighted_votes(found: Candidates, photos: int) -> NDArray[np.float64]:
    """Let every query descriptor vote for the photos of its neighbours.

    A vote's weight is how much nearer the neighbour is than the last one of the list, so that indistinctive
    descriptors have little weight.

    Args:
        found: (n, k)
    """
    weight = np.maximum(_yardstick(found) - found.distance, 0.0)
    voted = found.photo >= 0
    return np.bincount(found.photo[voted], weights=weight[voted], minlength=photos).astype(np.float64)


def shortlist(
    indexed: IndexedMap, query: Features, *, found: Candidates, votes: NDArray[np.float64], most: int
) -> list[ShortlistedPhoto]:
    """Select the photos with most votes and collect their matches.

    Args:
        votes: (p,) float64

    Returns:
        Most votes first; only photos with at least one match.
    """
    order = np.argsort(-votes, kind="stable")[:most]
    order = order[votes[order] > 0.0]
    wanted = np.flatnonzero(np.isin(found.photo, order).ravel())
    photo, row = found.photo.ravel()[wanted], found.row.ravel()[wanted]
    query_row = wanted // found.photo.shape[1]
    photo_xy = indexed.keypoint_xy(row)
    listed = []
    for p in order:
        mine = np.flatnonzero(photo == p)
        # Neighbours are sorted by distance, so that the first of a keypoint is its best in this photo.
        rows, first = np.unique(query_row[mine], return_index=True)
        matches = mine[first]
        theirs = indexed.row_in_photo(row[matches])
        listed.append(
            ShortlistedPhoto(int(p), float(votes[p]), rows, theirs, query.xy[rows], photo_xy[matches])
        )
    return listed


def rematch_with_network(
    indexed: IndexedMap, query: Features, *, listed: list[ShortlistedPhoto], matcher: PairMatcher
) -> list[ShortlistedPhoto]:
    """Match the photos of a shortlist with the query by a network; their votes do not change."""
    found = []
    for one in listed:
        photo = indexed.features(one.photo)
        if photo is None:
            raise IndexError(f"photo {one.photo} has no features")
        rows, theirs = matcher.match(query, photo).T
        matched = replace(one, query_row=rows, photo_row=theirs)
        found.append(replace(matched, query_xy=query.xy[rows], photo_xy=photo.xy[theirs]))
    return found


_RANK_OFFSET = 60
"""Added to ranks in the denominator, the authors' value: the larger, the less the first ranks differ."""

_RATIO = 0.9
"""Ratio test: a match is dropped if the next descriptor of the photo is nearly as near (Lowe 2004)."""


def standard_scores(
    indexed: IndexedMap, query: Features, *, hide: Collection[int]
) -> NDArray[np.float64] | None:
    """Compare a query with the map's photos by their global descriptors.

    Returns:
        (p,) float64 or None: As from `GlobalDescriptors.standard_scores`; None if map or query have no global
            descriptors.
    """
    if indexed.global_descriptors is None or query.vector is None:
        return None
    visible = ~np.isin(indexed.ids, np.fromiter(hide, np.int64, len(hide)))
    return indexed.global_descriptors.standard_scores(query.vector, visible=visible)


def with_similar(
    indexed: IndexedMap,
    query: Features,
    *,
    voting: Sequence[ShortlistedPhoto],
    votes: NDArray[np.float64],
    alike: NDArray[np.float64],
) -> tuple[list[ShortlistedPhoto], list[ShortlistedPhoto]]:
    """Choose the photos to verify by votes and by similarity.

    Args:
        voting: Most votes first.
        votes: (p,) float64
        alike: (p,) float64. As from `standard_scores`.

    Returns:
        listed: The shortlist, by fused ranks. Photos that were not chosen by votes are matched directly.
        further: The rest of `voting`.
    """
    tuning = indexed.tuning.retrieval
    similar = np.argsort(-alike, kind="stable")[: tuning.voters]
    by_similarity = similar[np.isfinite(alike[similar])].tolist()
    by_votes = [s.photo for s in voting]
    fused = fused_ranking(by_votes, by_similarity)
    few = min(tuning.similar, tuning.shortlist // 2)
    kept = by_votes[: tuning.shortlist - few]
    wanted = dict.fromkeys([*kept, *by_similarity[:few], *fused])
    chosen = {*[*wanted][: tuning.shortlist]}
    known = {s.photo: s for s in voting if s.photo in kept}
    order = [photo for photo in fused if photo in chosen]
    listed = in_threads(lambda p: known.get(p) or _match(indexed, query, photo=p, votes=votes), order)
    return listed, [s for s in voting if s.photo not in chosen]


def fused_ranking(*rankings: Sequence[int]) -> list[int]:
    """Fuse rankings by the sums of reciprocal ranks; ties are in the order of the first ranking."""
    merit: dict[int, float] = {}
    for ranking in rankings:
        for rank, item in enumerate(ranking, 1):
            merit[item] = merit.get(item, 0.0) + 1.0 / (_RANK_OFFSET + rank)
    return sorted(merit, key=lambda item: -merit[item])


def _match(
    indexed: IndexedMap, query: Features, *, photo: int, votes: NDArray[np.float64]
) -> ShortlistedPhoto:
    """Match a photo with the query by mutual nearest neighbours that pass the ratio test."""
    theirs = indexed.features(photo)
    if theirs is None:
        raise IndexError(f"photo {photo} has no features")
    rows = photo_rows = np.zeros(0, np.int64)
    if len(query) and len(theirs) > 1:
        distance = _distances(query.descriptors, np.asarray(theirs.descriptors), binary=indexed.binary)
        nearest = distance.argmin(axis=1)
        mutual = distance.argmin(axis=0)[nearest] == np.arange(len(query))
        least = np.partition(distance, 1, axis=1)
        rows = np.flatnonzero(mutual & (least[:, 0] < _RATIO * least[:, 1]))
        photo_rows = nearest[rows]
    return ShortlistedPhoto(
        photo, float(votes[photo]), rows, photo_rows, query.xy[rows], theirs.xy[photo_rows]
    )


def _distances(query: NDArray[np.uint8], photo: NDArray[np.uint8], *, binary: bool) -> NDArray[np.float32]:
    """Compute Euclidean distances (n, m) of (n, d) and (m, d) descriptors; binary ones bit by bit."""
    if binary:
        query, photo = np.unpackbits(query, axis=1), np.unpackbits(photo, axis=1)
    ours, theirs = query.astype(np.float32), photo.astype(np.float32)
    squared = (ours**2).sum(axis=1)[:, None] + (theirs**2).sum(axis=1) - 2.0 * (ours @ theirs.T)
    distance: NDArray[np.float32] = np.sqrt(np.maximum(squared, np.float32(0.0)))
    return distance


@dataclass(frozen=True, slots=True, eq=False)
class Retrieved:
    """The photos of a map that match a query."""

    nearest: Candidates  # (n, k): the nearest map descriptors of each query descriptor
    found: Candidates  # Those of them with the dominant rotation
    votes: NDArray[np.float64]  # (p,) float64. Of all photos.
    # `listed`, `further`: The shortlist, and further photos with votes, which are not verified.
    listed: list[ShortlistedPhoto]
    further: list[ShortlistedPhoto]
    # (p,) float64 or None. Standard scores by global descriptors; None without these.
    alike: NDArray[np.float64] | None


def retrieve(indexed: IndexedMap, query: Features, *, hide: Collection[int] = ()) -> Retrieved:
    """List the photos with most votes, and those most similar by global descriptors, if there are any."""
    tuning = indexed.tuning.retrieval
    nearest = candidates(indexed, query.descriptors, k=tuning.neighbours + 1, hide=hide)
    found = filter_by_rotation(indexed, query, found=nearest)
    votes = weighted_votes(found, len(indexed.ids))
    voting = shortlist(indexed, query, found=found, votes=votes, most=max(tuning.voters, tuning.shortlist))
    listed, further = voting[: tuning.shortlist], voting[tuning.shortlist :]
    alike = standard_scores(indexed, query, hide=hide)
    if alike is not None:
        listed, further = with_similar(indexed, query, voting=voting, votes=votes, alike=alike)
    return Retrieved(nearest, found, votes, listed, further, alike)
