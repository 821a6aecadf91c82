"""Choice of the photo pairs to match for a reconstruction, and matching of a pair."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np
from numpy.typing import NDArray

from webapp.core.retrieval.engines.ivf import InvertedFile, encode, train

_RATIO = 0.8
"""Distance of a match over that of the second nearest descriptor (Lowe 2004)."""

_AHEAD = 6
"""Each photo is matched with so many that follow it, by time or name."""

_NEAREST = 6
"""Each placed photo is matched with so many of the nearest placed photos."""

_VOTED, _VOTING, _NEIGHBOURS = 10, 400, 10
"""Voting for the photos to match with one: number of photos, of its strongest descriptors that vote, and of
neighbours of each."""

Pairs = NDArray[np.int64]
"""(k, 2), the lower number first, each pair once, in ascending order."""


@dataclass(frozen=True, slots=True, eq=False)
class Views:
    """Which photo, and which view of a panorama, each of p pictures is."""

    photo: NDArray[np.int64]  # (p,) int64. Ascending, without gaps.
    # (p,) int64. Turn of a view from the middle of its panorama; -1 for a photo that is not a panorama.
    turn_deg: NDArray[np.int64]

    @classmethod
    def none(cls, count: int) -> Views:
        """Return the views of pictures that are one photo each."""
        return cls(np.arange(count), np.full(count, -1))

    def between(
        self, one: int, other: int, *, descriptors: Sequence[NDArray[np.uint8]]
    ) -> Iterator[tuple[int, int]]:
        """Yield the pairs of pictures of two photos; of two panoramas only views that differ by one turn."""
        firsts, seconds = (np.flatnonzero(self.photo == number).tolist() for number in (one, other))
        if self.turn_deg[firsts[0]] < 0 or self.turn_deg[seconds[0]] < 0:
            yield from product(firsts, seconds)
            return
        by = (self.turn_deg[seconds] - self.turn_deg[firsts][:, None]) % 360
        turn = _turn_between([descriptors[n] for n in firsts], [descriptors[n] for n in seconds], by=by)
        for row, column in np.argwhere(by == turn).tolist():
            yield firsts[row], seconds[column]


_QUICK_VOTING = 200
"""Of a photo's strongest descriptors, those that vote where a choice has to be quick."""


def rank_pairs(descriptors: Sequence[NDArray[np.uint8]], *, views: Views) -> list[list[tuple[int, int]]]:
    """Rank the pairs that may show the same: the first of each photo, then the second, and so on.

    Args:
        descriptors: As for `choose_pairs`.

    Returns:
        Pairs by their rank, the lower number first, each pair once. Without pairs of views of one panorama.
    """
    ranks: list[list[tuple[int, int]]] = [[] for _ in range(_VOTED)]
    some = [number for number, one in enumerate(descriptors) if len(one)]
    if len(some) < 2:
        return []
    photos = int(views.photo[-1]) + 1
    for step in range(1, _AHEAD + 1):
        ranks[step - 1] += [
            pair
            for one in range(photos - step)
            for pair in views.between(one, one + step, descriptors=descriptors)
        ]
    number_of: dict[int, int] = {}
    for one, other in _voted(descriptors, views.photo, voting=_QUICK_VOTING):
        number_of[one] = number_of.get(one, -1) + 1
        ranks[number_of[one]].append((min(one, other), max(one, other)))
    there, known = set[tuple[int, int]](), set(some)
    for rank in ranks:
        new = [pair for pair in dict.fromkeys(rank) if pair not in there and known.issuperset(pair)]
        rank[:] = new
        there.update(new)
    return ranks


def choose_pairs(
    descriptors: Sequence[NDArray[np.uint8]], *, at: NDArray[np.complex128], views: Views | None = None
) -> Pairs:
    """Choose the pairs to match; never two views of one panorama, whose relative rotation is known.

    Args:
        descriptors: sequence of (n, d) uint8. Of each photo, the strongest first; the photos in the order in
            which they were taken.
        at: (p,) complex128. Positions, map pixels; NaN where unknown.
        views: By default each picture is a photo of its own.
    """
    count = len(descriptors)
    if count < 2:
        return np.zeros((0, 2), np.int64)
    of = views or Views.none(count)
    some = np.array([len(one) > 0 for one in descriptors], np.bool_)
    photos = int(of.photo[-1]) + 1
    ahead = [(i, i + step) for step in range(1, _AHEAD + 1) for i in range(photos - step)]
    near = _nearest(at[np.unique(of.photo, return_index=True)[1]])
    in_order = [
        pair
        for one, other in dict.fromkeys([*ahead, *near])
        for pair in of.between(one, other, descriptors=descriptors)
    ]
    chosen = np.array([*in_order, *_voted(descriptors, of.photo)], np.int64).reshape(-1, 2)
    chosen = chosen[some[chosen].all(1)]
    return np.unique(np.sort(chosen, axis=1), axis=0)


def _turn_between(
    first: Sequence[NDArray[np.uint8]], second: Sequence[NDArray[np.uint8]], *, by: NDArray[np.int64]
) -> int:
    """Find the turn between the views of two panoramas at which most of their strongest descriptors match.

    Their middles may look anywhere: a map has panoramas without headings, and headings are wrong indoors.

    Args:
        by: (n, m) int64. Turn from each of the first views to each of the second ones, degrees.

    Returns:
        int: One of `by`; 0 or the smallest one if nothing matches.
    """
    (row, column), (rows, columns) = zip(*(_strongest(views) for views in (first, second)), strict=True)
    matches = match_mutually(rows, columns)
    votes = np.bincount(by[row[matches[:, 0]], column[matches[:, 1]]], minlength=360)
    turns = np.unique(by)
    return int(turns[votes[turns].argmax()])


def _strongest(views: Sequence[NDArray[np.uint8]]) -> tuple[NDArray[np.int64], NDArray[np.uint8]]:
    """Return the strongest descriptors of views, and the view of each."""
    some = [one[:_VOTING] for one in views]
    return np.repeat(np.arange(len(some)), [len(one) for one in some]), np.concatenate(some)


def _nearest(at: NDArray[np.complex128]) -> list[tuple[int, int]]:
    placed = np.flatnonzero(np.isfinite(at))
    found = []
    for row in placed:
        apart = np.abs(at[placed] - at[row])
        found += [
            (int(row), int(other)) for other in placed[np.argsort(apart, kind="stable")[: _NEAREST + 1]]
        ]
    return [(one, other) for one, other in found if one != other]


def _voted(
    descriptors: Sequence[NDArray[np.uint8]], of_photo: NDArray[np.int64], *, voting: int = _VOTING
) -> list[tuple[int, int]]:
    """List the pairs that descriptors vote for, those of each photo together, the best first.

    A vote weighs how much nearer it is than the last one.

    Args:
        voting: Number of the strongest descriptors of each photo that vote.
    """
    strongest = [np.ascontiguousarray(one[:voting]) for one in descriptors]
    owner = np.repeat(np.arange(len(strongest)), [len(one) for one in strongest])
    rows = np.concatenate(strongest)
    if len(rows) <= _NEIGHBOURS:
        return []
    index = train(rows, len(rows), kind="float")
    encode(index, rows)
    search, found = InvertedFile([index]), []
    for number, own in enumerate(strongest):
        near = search.search(own, _NEIGHBOURS)
        reach = np.where(np.isfinite(near.distance), near.distance, 0.0)
        weight = np.maximum(reach.max(1, keepdims=True, initial=0.0) - near.distance, 0.0)
        photo = owner[near.row]
        elsewhere = (near.row >= 0) & (of_photo[photo] != of_photo[number])
        votes = np.bincount(photo[elsewhere], weights=weight[elsewhere], minlength=len(strongest))
        best = np.argsort(-votes, kind="stable")[:_VOTED]
        found += [(number, int(other)) for other in best if votes[other] > 0.0]
    return found


def match_mutually(first: NDArray[np.uint8], second: NDArray[np.uint8]) -> NDArray[np.uint32]:
    """Match mutual nearest neighbours that pass the ratio test.

    Args:
        first, second: (n, d), (m, d) uint8

    Returns:
        (k, 2) uint32: Rows of `first` and of `second`.
    """
    if len(first) < 2 or len(second) < 2:
        return np.zeros((0, 2), np.uint32)
    ours, theirs = first.astype(np.float32), second.astype(np.float32)
    own, length = (ours**2).sum(1), (theirs**2).sum(1)
    # half the squared distances, without the term that is constant in a row
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
