"""A map and its index, as the methods see them."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field

import numpy as np
from numpy.typing import NDArray

from webapp.core.features.types import Features
from webapp.core.index.segment import Segment
from webapp.core.index.types import DescriptorSearch, Neighbours


@dataclass(frozen=True, slots=True, eq=False)
class IndexedMap:
    """The photos of a map with positions and a search over their descriptors.

    Attributes
    ----------
    ids : (p,) int64
        Experience ids, in the map's order.
    position : (p, 2) float64
        Map pixels.
    fov_deg : (p,) float64
        Horizontal field of view of the upright photos; NaN when unknown.
    segments : sequence of Segment
    photo_of_entry : (e,) int64
        For each photo of each segment, in order, its number in `ids`; -1 when it is no longer in the map.
    search : DescriptorSearch
        Over the rows of all segments, in order.
    place_radius_px : float
        How far an answer may be off and still be right.
    first_row : (e + 1,) int64
        Rows of entry i are `first_row[i]` to `first_row[i + 1]`; follows from the segments.
    """

    ids: NDArray[np.int64]
    position: NDArray[np.float64]
    fov_deg: NDArray[np.float64]
    segments: Sequence[Segment]
    photo_of_entry: NDArray[np.int64]
    search: DescriptorSearch
    place_radius_px: float
    first_row: NDArray[np.int64] = field(init=False)
    _entry_of_photo: NDArray[np.int64] = field(init=False)

    def __post_init__(self) -> None:
        lengths = [np.diff(s.first) for s in self.segments]
        first = np.concatenate([[0], np.cumsum(np.concatenate(lengths))]) if lengths else np.zeros(1)
        object.__setattr__(self, "first_row", first.astype(np.int64))
        entry = np.full(len(self.ids), -1, np.int64)
        alive = np.flatnonzero(self.photo_of_entry >= 0)
        entry[self.photo_of_entry[alive]] = alive
        object.__setattr__(self, "_entry_of_photo", entry)

    def photo_of_row(self, row: NDArray[np.int64]) -> NDArray[np.int64]:
        """Tell for rows, any shape, the number of their photo; -1 for row -1 or a removed photo."""
        entry = np.searchsorted(self.first_row, row, side="right") - 1
        photo = self.photo_of_entry[np.clip(entry, 0, len(self.photo_of_entry) - 1)]
        return np.where(row >= 0, photo, -1)

    def features(self, photo: int) -> Features | None:
        """Take out a photo's features, by its number; None when it could not be read."""
        entry = int(self._entry_of_photo[photo])
        if entry < 0:
            return None
        for segment in self.segments:
            if entry < len(segment.content):
                return segment.entry(entry).features
            entry -= len(segment.content)
        return None

    def first_row_of(self, photo: int) -> int:
        """Tell the first descriptor row of a photo that has features."""
        return int(self.first_row[self._entry_of_photo[photo]])


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Neighbours of the query's descriptors, with the photos they belong to.

    Attributes
    ----------
    distance : (n, k) float32
        Infinite where there is no neighbour left.
    row, photo : (n, k) int64
        -1 where there is none.
    """

    distance: NDArray[np.float32]
    row: NDArray[np.int64]
    photo: NDArray[np.int64]


_SPARE_PER_HIDDEN = 2
_MOST_SPARE = 40


def candidates(
    indexed: IndexedMap, descriptors: NDArray[np.uint8], *, k: int, hide: Collection[int] = ()
) -> Candidates:
    """Find the k nearest visible map descriptors of each query descriptor.

    Parameters
    ----------
    indexed : IndexedMap
    descriptors : (n, d) uint8
    k : int
    hide : collection of int
        Experience ids to leave out, as if they were not in the map. Their places in the list are taken by
        the next neighbours, of which a limited number is looked up; what is missing then counts as absent.

    Returns
    -------
    Candidates
    """
    removed = bool((indexed.photo_of_entry < 0).any())
    spare = min(_MOST_SPARE, _SPARE_PER_HIDDEN * len(hide)) + (4 if removed else 0)
    found = indexed.search.search(descriptors, k + spare)
    photo = indexed.photo_of_row(found.row)
    if hide:
        hidden = np.isin(indexed.ids, np.fromiter(hide, np.int64))
        photo = np.where((photo >= 0) & hidden[photo], -1, photo)
    if not spare:
        return Candidates(found.distance, found.row, photo)
    return _first_visible(found, photo, k)


def _first_visible(found: Neighbours, photo: NDArray[np.int64], k: int) -> Candidates:
    order = np.argsort(photo < 0, axis=1, kind="stable")[:, :k]
    photo = np.take_along_axis(photo, order, 1)
    distance = np.where(photo >= 0, np.take_along_axis(found.distance, order, 1), np.inf)
    row = np.where(photo >= 0, np.take_along_axis(found.row, order, 1), -1)
    return Candidates(distance.astype(np.float32), row, photo)
