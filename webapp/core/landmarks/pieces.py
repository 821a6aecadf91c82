"""The pieces that photos fall into, judged by pairs alone, before any reconstruction.

Two photos share a piece where a third one shows the same as both: a pair by itself has no common scale.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from typing import NamedTuple

LEAST_INLIERS = 12
"""Least number of inliers for two small photos to show the same: fewer than in a reconstruction, whose photos
are larger. With it the pieces agree best with those of reconstructions."""


class Overlap(NamedTuple):
    """What two photos have in common."""

    one: int  # Number of a photo, less than `other`
    other: int
    matches: int  # Of keypoints, verified or not
    inliers: int  # Of these, those that agree on a relative pose

    @property
    def is_verified(self) -> bool:
        return self.inliers >= LEAST_INLIERS


@dataclass(frozen=True, slots=True)
class PieceGap:
    """Where a piece could be joined to another one: by photos taken between two of them."""

    one: int  # Photo of the piece
    other: int  # Photo of another piece that shows most of the same, or was taken next
    inliers: int  # Verified matches of the two; 0 if they show nothing in common


@dataclass(frozen=True, slots=True)
class PhotoPieces:
    """Photos that can be joined."""

    pieces: tuple[tuple[int, ...], ...]  # Numbers of the photos of each, the largest first
    alone: tuple[int, ...]  # Photos in no piece
    bridges: tuple[int, ...]  # Photos that show the same as one of another piece, but not as two of them
    # One for each piece but the largest, in their order, then for the photos in none.
    gaps: tuple[PieceGap, ...]
    place_first: tuple[int, ...]  # Photos to place by hand first: two of each piece, far from each other


class PieceGraph:
    """Joins photos by verified pairs.

    Args:
        count: Number of photos.
    """

    def __init__(self, count: int) -> None:
        self._seen: list[set[int]] = [set() for _ in range(count)]
        self._root = list(range(count))
        self._weaker: dict[tuple[int, int], Overlap] = {}

    def add(self, overlap: Overlap) -> None:
        one, other = overlap.one, overlap.other
        self._weaker[one, other] = overlap
        if not overlap.is_verified:
            return
        for third in self._seen[one] & self._seen[other]:
            self._join(one, third)
            self._join(other, third)
        self._seen[one].add(other)
        self._seen[other].add(one)

    def is_joined(self, one: int, other: int) -> bool:
        return self._find(one) == self._find(other)

    def result(self) -> PhotoPieces:
        """Return the pieces, and the gaps between them."""
        groups: dict[int, list[int]] = {}
        for photo in range(len(self._root)):
            groups.setdefault(self._find(photo), []).append(photo)
        parts = sorted(map(tuple, groups.values()), key=lambda part: (-len(part), part))
        pieces = tuple(part for part in parts if len(part) > 1)
        across = [one for one in self._weaker.values() if not self.is_joined(one.one, one.other)]
        in_pieces = {photo for piece in pieces for photo in piece}
        bridges = {
            photo for one in across if one.is_verified for photo in (one.one, one.other) if photo in in_pieces
        }
        return PhotoPieces(
            pieces,
            tuple(part[0] for part in parts if len(part) == 1),
            tuple(sorted(bridges)),
            tuple(self._gaps(parts, across)),
            tuple(photo for piece in pieces for photo in self._far_apart(piece)),
        )

    def _gaps(self, parts: Sequence[Sequence[int]], across: Iterable[Overlap]) -> Iterator[PieceGap]:
        """Yield the best link of each part to the others; the largest is reached from all of them.

        Links are chosen as by Kruskal: those with most verified matches first, then with most matches, then
        between photos taken one after the other.
        """
        links = sorted(
            across,
            key=lambda one: (-one.inliers if one.is_verified else 0, -one.matches, one.other - one.one),
        )
        next_to = (Overlap(n, n + 1, 0, 0) for n in range(len(self._root) - 1))
        number = {photo: n for n, part in enumerate(parts) for photo in part}
        group = list(range(len(parts)))
        neighbours: list[list[tuple[int, PieceGap]]] = [[] for _ in parts]
        for link in (*links, *next_to):
            first, second = number[link.one], number[link.other]
            if group[first] == group[second]:
                continue
            group = [group[first] if one == group[second] else one for one in group]
            inliers = link.inliers if link.is_verified else 0
            neighbours[first].append((second, PieceGap(link.other, link.one, inliers)))
            neighbours[second].append((first, PieceGap(link.one, link.other, inliers)))
        found: dict[int, PieceGap] = {}
        reached, queue = {0}, deque([0] if parts else [])
        while queue:
            for there, gap in neighbours[queue.popleft()]:
                if there not in reached:
                    found[there] = gap
                    reached.add(there)
                    queue.append(there)
        yield from (found[n] for n in sorted(found))

    def _far_apart(self, piece: Sequence[int]) -> tuple[int, int]:
        """Choose the two photos of a piece with most photos between them."""
        best = max(piece, key=lambda photo: len(self._seen[photo]))
        first = self._farthest(best)
        return first, self._farthest(first)

    def _farthest(self, start: int) -> int:
        reached, queue, last = {start}, deque([start]), start
        while queue:
            last = queue.popleft()
            for photo in sorted(self._seen[last]):
                if photo not in reached and self.is_joined(photo, start):
                    reached.add(photo)
                    queue.append(photo)
        return last

    def _join(self, one: int, other: int) -> None:
        self._root[self._find(one)] = self._find(other)

    def _find(self, photo: int) -> int:
        while self._root[photo] != photo:
            self._root[photo] = photo = self._root[self._root[photo]]
        return photo
