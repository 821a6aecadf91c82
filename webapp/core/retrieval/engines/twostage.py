"""Search in two stages: signatures select some photos, whose descriptors are then compared exactly.

For maps whose descriptors do not fit into memory: only the signatures are kept there. The descriptors of
selected photos are read when needed.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from webapp.core.retrieval.engines import vlad
from webapp.core.retrieval.engines.types import Neighbours, Segment, no_neighbours
from webapp.core.retrieval.engines.vlad import Codebook
from webapp.threads import in_threads

_NAMED = 48
"""Number of photos selected by signatures."""

_STRONGEST = 500
"""Number of the strongest keypoints by which photos are selected for a full comparison."""

_COMPARED = 24
"""Number of photos that are compared with all their descriptors."""

_NEAREST = 6
"""Nearest neighbours kept over all compared photos: the last one shows the distance of an average one."""

_BLOCK = 128
"""Descriptors of the query compared at once: limits the memory of each thread."""


class TwoStage:
    """Nearest neighbours in the photos that are most similar to the query.

    There is at most one per photo, unless there are fewer photos than neighbours: then photos contribute
    several each, because a neighbour's distance can only be judged relative to another's.

    Args:
        signatures: sequence of (p, b) uint8. Signatures of each segment's photos.
        segments: Their descriptors may be memory-mapped.
    """

    def __init__(
        self, codebook: Codebook, signatures: Sequence[NDArray[np.uint8]], *, segments: Sequence[Segment]
    ) -> None:
        self._codebook = codebook
        self._signatures = signatures
        self._segments = segments
        self._first_entry = np.cumsum([0, *(len(s.content) for s in segments)])
        self._first_row = np.cumsum([0, *(s.first[-1] for s in segments)])

    def search_among(
        self, descriptors: NDArray[np.uint8], k: int, *, visible: NDArray[np.bool_]
    ) -> Neighbours:
        """Find up to k near descriptors for each of (n, d) uint8 descriptors.

        Neighbours that are nearer to another descriptor of the query have row -1. Their distance is kept, as
        a reference for that of others.

        Args:
            descriptors: (n, d) uint8. Those of the strongest keypoints first.
            visible: (e,) bool. Which photos of all segments, in order, are searched.
        """
        if not len(descriptors) or not visible.any():
            return no_neighbours(len(descriptors), k)
        named = vlad.most_similar(
            self._codebook, self._signatures, descriptors=descriptors, visible=visible, most=_NAMED
        )
        if len(named) > _COMPARED:
            quick = self._compare(descriptors[:_STRONGEST], named, strongest=_STRONGEST)
            named = named[np.argsort(-_votes(quick.distance), kind="stable")[:_COMPARED]]
        kept = min(k, _NEAREST)
        found = self._compare(descriptors, named, each=-(-kept // len(named)))
        return _nearest(found, k, kept=kept)

    def _compare(
        self,
        query: NDArray[np.uint8],
        entries: NDArray[np.int64],
        *,
        each: int = 1,
        strongest: int | None = None,
    ) -> Neighbours:
        """Find the `each` nearest descriptors in each photo, or among its `strongest`, as columns."""
        values = query.astype(np.float32)
        squared = (values**2).sum(axis=1)

        def nearest(entry: int) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
            first, theirs = self._descriptors(entry, strongest)
            known = theirs.astype(np.float32)
            length = (known**2).sum(axis=1)
            here = min(each, len(theirs))
            found = no_neighbours(len(values), each)
            nearest_query = np.full(len(theirs), np.inf, np.float32)
            for start in range(0, len(values) if here else 0, _BLOCK):
                part = slice(start, start + _BLOCK)
                block = values[part] @ known.T
                block *= -2.0
                block += length
                block += squared[part, None]
                np.minimum(nearest_query, block.min(axis=0), out=nearest_query)
                rows = _least(block, here)
                found.row[part, :here] = rows
                found.distance[part, :here] = np.take_along_axis(block, rows, 1)
            row, apart = found.row[:, :here], found.distance[:, :here]
            row[...] = np.where(apart <= nearest_query[row], row + first, -1)
            apart[...] = np.sqrt(np.maximum(apart, 0.0))
            return found.distance, found.row

        distances, rows = zip(*in_threads(nearest, entries.tolist()), strict=True)
        return Neighbours(np.column_stack(distances), np.column_stack(rows))

    def _descriptors(self, entry: int, strongest: int | None) -> tuple[int, NDArray[np.uint8]]:
        """Read a photo's descriptors; returns the row of the first, counted over all segments, and them."""
        number = int(np.searchsorted(self._first_entry, entry, side="right")) - 1
        segment, photo = self._segments[number], entry - int(self._first_entry[number])
        first, stop = int(segment.first[photo]), int(segment.first[photo + 1])
        stop = stop if strongest is None else min(stop, first + strongest)
        return first + int(self._first_row[number]), segment.descriptors[first:stop]


def _votes(distance: NDArray[np.float32]) -> NDArray[np.float32]:
    """Sum by how much each photo's (n, m) neighbours are nearer than the median over photos; (m,)."""
    usual = np.median(distance, axis=1, keepdims=True)
    nearer = np.zeros_like(distance)
    np.subtract(usual, distance, where=np.isfinite(usual), out=nearer)
    votes: NDArray[np.float32] = np.maximum(nearer, 0.0).sum(axis=0)
    return votes


def _least(values: NDArray[np.float32], count: int) -> NDArray[np.int64]:
    """Find the columns of the `count` least values of each row, in any order."""
    if count == 1:
        return np.asarray(values.argmin(axis=1, keepdims=True), np.int64)
    return np.argpartition(values, count - 1, axis=1)[:, :count]


def _nearest(found: Neighbours, k: int, *, kept: int) -> Neighbours:
    order = np.argsort(found.distance, axis=1, kind="stable")[:, :kept]
    answer = no_neighbours(len(order), k)
    have = order.shape[1]
    answer.distance[:, :have] = np.take_along_axis(found.distance, order, 1)
    answer.row[:, :have] = np.take_along_axis(found.row, order, 1)
    return answer
