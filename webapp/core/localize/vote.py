"""Method `vote`: an exact implementation of the pose estimator of 2013.

Every query descriptor votes for the photo of its nearest map descriptor; matches farther than the mean
distance are dropped; the photos with most remaining votes are the answer, each with its share of them.
"""

from __future__ import annotations

from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from webapp.core.features.types import Features
from webapp.core.geo.types import MapPixel
from webapp.core.geometry.estimate import NoPose
from webapp.core.hypotheses.model import Answer, Evidence, Hypothesis, MatchStatistics
from webapp.core.mapmodel.panorama import experiences_of
from webapp.core.retrieval.indexed import Candidates, IndexedMap, candidates


def localize(indexed: IndexedMap, query: Features, *, top: int, hide: Collection[int] = ()) -> Answer:
    """Localize a photo by its features.

    Returns:
        One hypothesis per experience; without radius and off-map probability, which the method does not
            estimate. Without any match `no_pose` has the reason.
    """
    found = candidates(indexed, query.descriptors, k=1, hide=hide)
    distance, photo = found.distance[:, 0], found.photo[:, 0]
    matched = photo >= 0
    # in double precision: rounded down, the mean of equal distances would be less than each of them
    kept = matched & (distance <= distance[matched].mean(dtype=np.float64)) if matched.any() else matched
    statistics = match_statistics(len(query), distance[matched], left=int(kept.sum()))
    if not kept.any():
        return Answer((), None, 0.0, NoPose(_why_none(len(query))), statistics)
    of_photo = np.bincount(photo[kept], minlength=len(indexed.ids))
    votes, best = _of_experiences(indexed, of_photo)
    order = best[np.argsort(-votes[best], kind="stable")]
    order = order[: min(top, int((votes[best] > 0).sum()))]
    total = int(votes.sum())
    hypotheses = tuple(
        Hypothesis(
            rank=rank,
            kind="photo",
            position=MapPixel(*map(float, indexed.position[p])),
            probability=float(votes[p] / total),
            radius_px=None,
            heading_deg=None,
            experiences=(int(indexed.ids[p]),),
            inliers=None,
            matches=int(votes[p]),
            floor=int(indexed.floor[p]),
        )
        for rank, p in enumerate(order, 1)
    )
    other = float(1.0 - votes[order].sum() / total)
    evidence = tuple(_evidence(indexed, query, found=found, kept=kept, photo=int(p)) for p in order[:1])
    return Answer(hypotheses, None, max(0.0, other), None, statistics, evidence)


def _of_experiences(
    indexed: IndexedMap, votes: NDArray[np.int64]
) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Add up the votes of the views of each panorama.

    Returns:
        votes: (p,) int64. Votes of each photo's experience.
        best: (e,) int64. Photo of each experience with most votes, in the map's order.
    """
    ids, mine = np.unique(experiences_of(indexed.ids), return_inverse=True)
    together = np.bincount(mine, weights=votes, minlength=len(ids)).astype(np.int64)
    falling = np.lexsort((-votes, mine))
    best = falling[np.unique(mine[falling], return_index=True)[1]]
    return together[mine], np.sort(best).astype(np.int64)


def match_statistics(keypoints: int, distance: NDArray[np.float32], *, left: int) -> MatchStatistics:
    """Compute statistics of (m,) match distances, `left` of which remain after pruning."""
    if not len(distance):
        return MatchStatistics(keypoints, 0, 0, None, None, None, None)
    exact = distance.astype(np.float64)
    return MatchStatistics(
        keypoints=keypoints,
        matches=len(exact),
        matches_pruned=left,
        distance_min=float(exact.min()),
        distance_max=float(exact.max()),
        distance_mean=float(exact.mean()),
        distance_total=float(exact.sum()),
    )


def _why_none(keypoints: int) -> str:
    if not keypoints:
        return "no keypoints: the photo has no texture to recognise"
    return "no match: the map has no descriptors"


def _evidence(
    indexed: IndexedMap, query: Features, *, found: Candidates, kept: NDArray[np.bool_], photo: int
) -> Evidence:
    mine = np.flatnonzero(kept & (found.photo[:, 0] == photo))
    return Evidence(
        experience=int(indexed.ids[photo]),
        query_xy=query.xy[mine],
        photo_xy=indexed.keypoint_xy(found.row[mine, 0]),
        inlier=np.zeros(len(mine), bool),
    )
