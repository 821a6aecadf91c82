"""Pairs of map photos that see the same scene, with their relative poses."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from webapp.core.features.lightglue import PairMatcher
from webapp.core.geometry.relative_pose import Camera, RelativePose, relative_pose
from webapp.core.retrieval.indexed import Candidates, IndexedMap, candidates
from webapp.core.retrieval.retrieve import (
    ShortlistedPhoto,
    filter_by_rotation,
    rematch_with_network,
    shortlist,
    weighted_votes,
)

_SAME_SPOT_PX = 1.0
"""Photos nearer to each other are at one spot, and give no information about each other's headings."""


@dataclass(frozen=True, slots=True, eq=False)
class PhotoPairs:
    """k pairs of photos, with m matches in all."""

    # `first`, `second`: (k,) int64. Numbers of the photos.
    first: NDArray[np.int64]
    second: NDArray[np.int64]
    rotation: NDArray[np.float64]  # (k, 3, 3) float64. Second camera from first camera.
    # (k, 3) float64. Position of the first camera in the second's frame, scaled to unit length.
    translation: NDArray[np.float64]
    trust: NDArray[np.float64]  # (k,) float64. Trust in the relative pose, 0 to 1.
    parallax: NDArray[np.float64]  # (k,) float64. Median angle between the two rays of a match, radians.
    start: NDArray[np.int64]  # (k + 1,) int64. Matches of pair i are `start[i]` to `start[i + 1]`.
    # `row_first`, `row_second`: (m,) int32. Keypoint numbers of the inliers in the photos.
    row_first: NDArray[np.int32]
    row_second: NDArray[np.int32]
    # `ray_first`, `ray_second`: (m, 2) float32. x and y of their rays at depth 1.
    ray_first: NDArray[np.float32]
    ray_second: NDArray[np.float32]

    def __len__(self) -> int:
        return len(self.first)

    def subset(
        self, which: NDArray[np.int64], *, first: NDArray[np.int64], second: NDArray[np.int64]
    ) -> PhotoPairs:
        """Select pairs by their numbers, and renumber their photos."""
        lengths = np.diff(self.start)[which]
        inside = np.arange(lengths.sum()) - np.repeat(np.cumsum(lengths) - lengths, lengths)
        rows = np.repeat(self.start[which], lengths) + inside
        return PhotoPairs(
            first=first,
            second=second,
            rotation=self.rotation[which],
            translation=self.translation[which],
            trust=self.trust[which],
            parallax=self.parallax[which],
            start=np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64),
            row_first=self.row_first[rows],
            row_second=self.row_second[rows],
            ray_first=self.ray_first[rows],
            ray_second=self.ray_second[rows],
        )

    def thinned(self, most: int) -> PhotoPairs:
        """Limit the matches of each pair to a number, evenly spread over its inliers."""
        lengths = np.diff(self.start)
        kept = np.minimum(lengths, most)
        start = np.concatenate([[0], np.cumsum(kept)]).astype(np.int64)
        number = np.arange(start[-1]) - np.repeat(start[:-1], kept)
        rows = np.repeat(self.start[:-1], kept) + number * np.repeat(lengths, kept) // np.repeat(kept, kept)
        return replace(
            self,
            start=start,
            row_first=self.row_first[rows],
            row_second=self.row_second[rows],
            ray_first=self.ray_first[rows],
            ray_second=self.ray_second[rows],
        )


def homogeneous(ray: NDArray[np.float32]) -> NDArray[np.float64]:
    """Append the third coordinate 1 to (m, 2) rays at depth 1; (m, 3)."""
    return np.column_stack([ray, np.ones(len(ray))]).astype(np.float64)


def concatenate(parts: Sequence[PhotoPairs]) -> PhotoPairs:
    if not parts:
        return _empty()
    starts = np.cumsum([0, *(p.start[-1] for p in parts)])
    return PhotoPairs(
        first=np.concatenate([p.first for p in parts]),
        second=np.concatenate([p.second for p in parts]),
        rotation=np.concatenate([p.rotation for p in parts]),
        translation=np.concatenate([p.translation for p in parts]),
        trust=np.concatenate([p.trust for p in parts]),
        parallax=np.concatenate([p.parallax for p in parts]),
        start=np.concatenate([[0], *(p.start[1:] + s for p, s in zip(parts, starts[:-1], strict=True))]),
        row_first=np.concatenate([p.row_first for p in parts]),
        row_second=np.concatenate([p.row_second for p in parts]),
        ray_first=np.concatenate([p.ray_first for p in parts]),
        ray_second=np.concatenate([p.ray_second for p in parts]),
    )


def best_of_each_pair(pairs: PhotoPairs) -> PhotoPairs:
    """Keep the most trusted of several comparisons of the same two photos."""
    order = np.lexsort((-pairs.trust, pairs.second, pairs.first))
    best = np.ones(len(order), np.bool_)
    best[1:] = (np.diff(pairs.first[order]) != 0) | (np.diff(pairs.second[order]) != 0)
    kept = np.sort(order[best])
    return pairs.subset(kept, first=pairs.first[kept], second=pairs.second[kept])


def strongest_partners(pairs: PhotoPairs, *, photos: int, inliers: int) -> NDArray[np.int64]:
    """Find for each photo the one with which it shares most inliers.

    Args:
        inliers: Minimum number of inliers.

    Returns:
        (photos,) int64: -1 without a partner.
    """
    shared = np.diff(pairs.start)
    order = np.argsort(shared, kind="stable")
    order = order[shared[order] >= inliers]
    partner = np.full(photos, -1, np.int64)
    # Of several assignments to one photo the last one remains, which has most inliers.
    partner[np.stack([pairs.first[order], pairs.second[order]], 1).ravel()] = np.stack(
        [pairs.second[order], pairs.first[order]], 1
    ).ravel()
    return partner


def match_photo(indexed: IndexedMap, photo: int, *, matcher: PairMatcher | None = None) -> PhotoPairs:
    """Find the map photos that see the same scene as a given one from another position.

    Args:
        indexed: Its `fov_deg` must be known for every photo.
        photo: Its number; it is the first photo of every pair.
        matcher: Matches the photos with most votes, instead of nearest-neighbour matching.
    """
    features = indexed.features(photo)
    if features is None or not len(features):
        return _empty()
    nearest = candidates(indexed, features.descriptors, k=indexed.tuning.retrieval.pair_neighbours + 1)
    apart = np.hypot(*(indexed.position - indexed.position[photo]).T) > _SAME_SPOT_PX
    elsewhere = (nearest.photo >= 0) & apart[nearest.photo]
    found = Candidates(
        nearest.distance, np.where(elsewhere, nearest.row, -1), np.where(elsewhere, nearest.photo, -1)
    )
    found = filter_by_rotation(indexed, features, found=found)
    votes = weighted_votes(found, len(indexed.ids))
    ours = indexed.camera(photo)
    most = indexed.tuning.retrieval.pair_shortlist
    listed = shortlist(indexed, features, found=found, votes=votes, most=most)
    if matcher is not None:
        listed = rematch_with_network(indexed, features, listed=listed, matcher=matcher)
    return concatenate(
        [pair for m in listed if (pair := _pair(indexed, photo, matched=m, ours=ours)) is not None]
    )


def _pair(indexed: IndexedMap, photo: int, *, matched: ShortlistedPhoto, ours: Camera) -> PhotoPairs | None:
    theirs = indexed.camera(matched.photo)
    pose = relative_pose(matched.query_xy, matched.photo_xy, query=ours, photo=theirs)
    if not isinstance(pose, RelativePose) or pose.trust <= 0.0:
        return None
    kept = np.flatnonzero(pose.inlier)
    return PhotoPairs(
        first=np.array([photo], np.int64),
        second=np.array([matched.photo], np.int64),
        rotation=pose.rotation[None],
        translation=pose.translation[None],
        trust=np.array([pose.trust]),
        parallax=np.array([pose.parallax]),
        start=np.array([0, len(kept)], np.int64),
        row_first=matched.query_row[kept].astype(np.int32),
        row_second=matched.photo_row[kept].astype(np.int32),
        ray_first=ours.rays(matched.query_xy[kept].astype(np.float64))[:, :2].astype(np.float32),
        ray_second=theirs.rays(matched.photo_xy[kept].astype(np.float64))[:, :2].astype(np.float32),
    )


def _empty() -> PhotoPairs:
    none, flat = np.zeros(0, np.int64), np.zeros(0)
    rows, rays = np.zeros(0, np.int32), np.zeros((0, 2), np.float32)
    return PhotoPairs(
        first=none,
        second=none,
        rotation=np.zeros((0, 3, 3)),
        translation=np.zeros((0, 3)),
        trust=flat,
        parallax=flat,
        start=np.zeros(1, np.int64),
        row_first=rows,
        row_second=rows,
        ray_first=rays,
        ray_second=rays,
    )
