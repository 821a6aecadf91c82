"""Add photos that are similar to the query by global descriptors to the shortlist.

The two rankings are fused by reciprocal ranks (Cormack et al. 2009). Most of the shortlist is still chosen by
votes, so that a model that is useless on a map does little harm.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from webapp.core.features.types import Features
from webapp.core.retrieval.indexed import IndexedMap
from webapp.core.retrieval.shortlist import ShortlistedPhoto
from webapp.threads import in_threads

_RANK_OFFSET = 60
"""Added to ranks in the denominator, the authors' value: the larger, the less the first ranks differ."""

_RATIO = 0.9
"""Ratio test: a match is dropped if the next descriptor of the photo is nearly as near (Lowe 2004)."""


def standard_scores(
    indexed: IndexedMap, query: Features, *, hide: Collection[int]
) -> NDArray[np.float64] | None:
    """Compare a query with the map's photos by their global descriptors.

    Args:
        hide: Experience ids to leave out.

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
