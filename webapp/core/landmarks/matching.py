"""Which photos are compared for a reconstruction, and the matches of two of them."""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from webapp.core.retrieval.engines.ivf import InvertedFile, encode, train

_RATIO = 0.8
"""Distance of a match over that of the second nearest descriptor (Lowe 2004)."""

_AHEAD = 6
"""Photos that follow one, by time or name, are compared with it."""

_NEAREST = 6
"""Placed photos are compared with so many of those placed nearest to them."""

_VOTED, _VOTING, _NEIGHBOURS = 10, 400, 10
"""Photos that the strongest descriptors of one vote for: how many, how many vote, for how many neighbours."""

Pairs = NDArray[np.int64]
"""(k, 2), the lower number first, each pair once, in rising order."""


def choose_pairs(descriptors: Sequence[NDArray[np.uint8]], *, at: NDArray[np.complex128]) -> Pairs:
    """Choose the pairs to compare.

    Parameters
    ----------
    descriptors : sequence of (n, d) uint8
        Of each photo, the strongest first; the photos in the order in which they were taken.
    at : (p,) complex128
        Where they are, map pixels; NaN where unknown.
    """
    count = len(descriptors)
    if count < 2:
        return np.zeros((0, 2), np.int64)
    some = np.array([len(one) > 0 for one in descriptors], np.bool_)
    ahead = [(i, i + step) for step in range(1, _AHEAD + 1) for i in range(count - step)]
    chosen = np.array([*ahead, *_nearest(at), *_voted(descriptors)], np.int64).reshape(-1, 2)
    chosen = chosen[some[chosen].all(1)]
    return np.unique(np.sort(chosen, axis=1), axis=0)


def _nearest(at: NDArray[np.complex128]) -> list[tuple[int, int]]:
    placed = np.flatnonzero(np.isfinite(at))
    found = []
    for row in placed:
        apart = np.abs(at[placed] - at[row])
        found += [
            (int(row), int(other)) for other in placed[np.argsort(apart, kind="stable")[: _NEAREST + 1]]
        ]
    return [(one, other) for one, other in found if one != other]


def _voted(descriptors: Sequence[NDArray[np.uint8]]) -> list[tuple[int, int]]:
    """List the photos that each one's descriptors vote for: by the distance that a neighbour is nearer by."""
    voting = [np.ascontiguousarray(one[:_VOTING]) for one in descriptors]
    owner = np.repeat(np.arange(len(voting)), [len(one) for one in voting])
    rows = np.concatenate(voting)
    if len(rows) <= _NEIGHBOURS:
        return []
    index = train(rows, len(rows), kind="float")
    encode(index, rows)
    search, found = InvertedFile([index]), []
    for number, own in enumerate(voting):
        near = search.search(own, _NEIGHBOURS)
        reach = np.where(np.isfinite(near.distance), near.distance, 0.0)
        weight = np.maximum(reach.max(1, keepdims=True, initial=0.0) - near.distance, 0.0)
        photo = owner[near.row]
        elsewhere = (near.row >= 0) & (photo != number)
        votes = np.bincount(photo[elsewhere], weights=weight[elsewhere], minlength=len(voting))
        best = np.argsort(-votes, kind="stable")[:_VOTED]
        found += [(number, int(other)) for other in best if votes[other] > 0.0]
    return found


def match_mutually(first: NDArray[np.uint8], second: NDArray[np.uint8]) -> NDArray[np.uint32]:
    """Match descriptors that are each other's nearest, and clearly nearer than the second.

    Parameters
    ----------
    first, second : (n, d), (m, d) uint8

    Returns
    -------
    (k, 2) uint32
        Rows of both.
    """
    if len(first) < 2 or len(second) < 2:
        return np.zeros((0, 2), np.uint32)
    ours, theirs = first.astype(np.float32), second.astype(np.float32)
    own, length = (ours**2).sum(1), (theirs**2).sum(1)
    # Half the squared distances, without the part that all in a row share.
    apart = 0.5 * length - ours @ theirs.T
    rows = np.arange(len(ours))
    nearest = apart.argmin(1)
    best = apart[rows, nearest] * 2.0 + own
    apart[rows, nearest] = np.inf
    clear = best < _RATIO**2 * (apart.min(1) * 2.0 + own)
    row, column = rows[clear], nearest[clear]
    back = (0.5 * own - theirs[column] @ ours.T).argmin(1)
    mutual = back == row
    return np.stack([row[mutual], column[mutual]], 1).astype(np.uint32)
