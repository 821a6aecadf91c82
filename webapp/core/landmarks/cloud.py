"""Landmarks: points of a reconstruction with the descriptors of their observations in photos."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from webapp.core.landmarks.placing import AlignedSubmodel, NotAligned
from webapp.core.landmarks.submodels import Submodel

_LEAST_SEEN = 2
"""Least number of photos that see a point: one alone does not determine its position."""

_LEAST_SHARED = 10
"""Least number of points that two photos of a group share."""


@dataclass(frozen=True, slots=True, eq=False)
class LandmarkCloud:
    """k points in the worlds of their submodels, seen m times by p photos."""

    contents: tuple[str, ...]  # SHA-256 of the photos' files
    point: NDArray[np.float64]  # (k, 3) float64
    submodel: NDArray[np.int32]  # (k,) int32. Number of each point's submodel.
    first: NDArray[np.int64]  # (p + 1,) int64. Observations of photo i are `first[i]` to `first[i + 1]`.
    # (m,) int32. Point of each observation; a photo observes a point at most once.
    seen_point: NDArray[np.int32]
    seen_xy: NDArray[np.float32]  # (m, 2) float32. Position of each observation, pixels of the upright photo.
    descriptors: NDArray[np.uint8]  # (m, d) uint8
    # `focal_px`, `distortion`: (p,) float64. Intrinsics of the photos' cameras in the reconstruction; the
    # distortion is COLMAP's radial one.
    focal_px: NDArray[np.float64]
    distortion: NDArray[np.float64]

    def rows_of(self, photo: int) -> NDArray[np.int64]:
        """List the observations of a photo."""
        return np.arange(self.first[photo], self.first[photo + 1])


class PhotoGroup(NamedTuple):
    """Covisible photos of a cloud, the best first, and their observations of points that at least two visible
    photos see."""

    photos: list[int]
    rows: NDArray[np.int64]
    photo_of_row: NDArray[np.int64]


@dataclass(frozen=True, slots=True, eq=False)
class AlignedCloud:
    """A cloud on a map; p photos."""

    cloud: LandmarkCloud
    key: str  # Identifies the data that the cloud was made from
    # (p,) int64. Number of each photo on the map; -1 if it is no longer placed there.
    map_photo: NDArray[np.int64]
    submodels: tuple[Submodel, ...]  # With the photo numbers of the cloud
    aligned: tuple[AlignedSubmodel | NotAligned, ...]  # One for each submodel
    # (k,) int64. Number of photos that see each point; computed from the cloud.
    times_seen: NDArray[np.int64] = field(init=False)

    def __post_init__(self) -> None:
        times = np.bincount(self.cloud.seen_point, minlength=len(self.cloud.point))
        object.__setattr__(self, "times_seen", times)

    def submodel_of(self, photo: int) -> Submodel:
        """Return the submodel of a photo that sees some of the points."""
        return self.submodels[int(self.cloud.submodel[self.cloud.seen_point[self.cloud.first[photo]]])]

    def groups(self, photos: NDArray[np.int64], *, visible: NDArray[np.bool_], most: int) -> list[PhotoGroup]:
        """Group covisible photos.

        Args:
            photos: (n,) int64. Numbers on the map, the best first.
            visible: (p,) bool. Photos of the cloud that may be used.
            most: Largest number of groups; those with the best photos are returned.
        """
        own = {
            int(number): photo
            for photo, number in enumerate(self.map_photo)
            if number >= 0 and visible[photo]
        }
        chosen = [own[number] for number in photos.tolist() if number in own]
        if not chosen:
            return []
        known = self._times_seen(visible) >= _LEAST_SEEN
        rows = [self._rows(photo, known) for photo in chosen]
        seen = np.zeros((len(chosen), len(self.cloud.point)), np.float32)
        for number, some in enumerate(rows):
            seen[number, self.cloud.seen_point[some]] = 1.0
        together = seen @ seen.T >= _LEAST_SHARED
        found: list[PhotoGroup] = []
        left = list(range(len(chosen)))
        while left and len(found) < most:
            inside = _connected(together, left[0])
            left = [number for number in left if number not in inside]
            members = sorted(inside)
            length = [len(rows[number]) for number in members]
            if sum(length):
                found.append(
                    PhotoGroup(
                        [chosen[number] for number in members],
                        np.concatenate([rows[number] for number in members]),
                        np.repeat([chosen[number] for number in members], length),
                    )
                )
        return found

    def _rows(self, photo: int, known: NDArray[np.bool_]) -> NDArray[np.int64]:
        rows = self.cloud.rows_of(photo)
        return rows[known[self.cloud.seen_point[rows]]]

    def _times_seen(self, visible: NDArray[np.bool_]) -> NDArray[np.int64]:
        hidden = [self.cloud.rows_of(photo) for photo in np.flatnonzero(~visible).tolist()]
        if not hidden:
            return self.times_seen
        unseen = self.cloud.seen_point[np.concatenate(hidden)]
        return self.times_seen - np.bincount(unseen, minlength=len(self.times_seen))


def _connected(together: NDArray[np.bool_], start: int) -> set[int]:
    inside, border = {start}, [start]
    while border:
        beside = np.flatnonzero(together[border.pop()]).tolist()
        border += [other for other in beside if other not in inside]
        inside |= set(beside)
    return inside


def observed_twice(point: NDArray[np.int64], photo: NDArray[np.int64]) -> NDArray[np.bool_]:
    """Mark observations (m,) of points that at least two photos see; only the first per photo and point."""
    pairs = np.stack([point, photo], 1)
    _, first = np.unique(pairs, axis=0, return_index=True)
    once = np.zeros(len(point), np.bool_)
    once[first] = True
    times = np.bincount(point[once], minlength=int(point.max(initial=-1)) + 1)
    return once & (times[point] >= _LEAST_SEEN)
