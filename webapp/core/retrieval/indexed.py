"""A map and its index, as localization methods use them."""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, field, replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from webapp.core.features.lightglue import PairMatcher
from webapp.core.features.types import Features
from webapp.core.geo.floors import BASE_FLOOR
from webapp.core.geometry import so3
from webapp.core.geometry.extrinsics import MIN_TRUST, MapExtrinsics
from webapp.core.geometry.relative_pose import Camera
from webapp.core.hypotheses.places import MapKind
from webapp.core.hypotheses.priors import PathPrior, fit_path_prior
from webapp.core.retrieval.engines.twostage import TwoStage
from webapp.core.retrieval.engines.types import DescriptorSearch, Segment
from webapp.core.retrieval.global_descriptors import GlobalDescriptors
from webapp.core.tuning import DEFAULT, Tuning


@dataclass(frozen=True, slots=True, eq=False)
class IndexedMap:
    """The photos of a map with positions and a search over their descriptors."""

    ids: NDArray[np.int64]  # (p,) int64. Experience ids, in the map's order.
    position: NDArray[np.float64]  # (p, 2) float64. Map pixels.
    # (p,) float64. Horizontal field of view of the upright photos; NaN if unknown.
    fov_deg: NDArray[np.float64]
    segments: Sequence[Segment]
    # (e,) int64. For each photo of each segment, in order, its number in `ids`; -1 if it is no longer in the
    # map.
    photo_of_entry: NDArray[np.int64]
    search: DescriptorSearch | TwoStage  # Over the rows of all segments, in order
    place_radius_px: float  # Maximum error of a right answer
    kind: MapKind = "metric"  # "schematic" only if stated by the user; otherwise calibration detects that
    kind_is_given: bool = False  # Whether the user stated the kind
    # (p,) int64. Number of each photo's area, -1 if its position is where it was taken; by default all are
    # -1.
    area: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    # (p,) int64. Id of each photo's floor; by default all are on one.
    floor: NDArray[np.int64] = field(default_factory=lambda: np.zeros(0, np.int64))
    # Extrinsics of the photos and depths of their keypoints, if known.
    extrinsics: MapExtrinsics | None = None
    # Matches the photos that are verified; its matches replace those of the search.
    pair_matcher: PairMatcher | None = None
    # Number of photos, those with most votes, that it matches at first; None for all.
    rematched: int | None = None
    global_descriptors: GlobalDescriptors | None = None  # Of the photos, if there is a model
    binary: bool = False  # Whether descriptors are bit strings
    tuning: Tuning = DEFAULT
    extract_side_px: float = 800.0  # Photos are scaled down to this longer side before keypoints are detected
    # (e + 1,) int64. Rows of entry i are `first_row[i]` to `first_row[i + 1]`; derived from the segments.
    first_row: NDArray[np.int64] = field(init=False)
    paths: PathPrior = field(init=False)  # Prior over camera positions; derived from the photos' positions
    _entry_of_photo: NDArray[np.int64] = field(init=False)

    def __post_init__(self) -> None:
        if len(self.area) != len(self.ids):
            object.__setattr__(self, "area", np.full(len(self.ids), -1, np.int64))
        if len(self.floor) != len(self.ids):
            object.__setattr__(self, "floor", np.full(len(self.ids), BASE_FLOOR, np.int64))
        lengths = [np.diff(s.first) for s in self.segments]
        first = np.concatenate([[0], np.cumsum(np.concatenate(lengths))]) if lengths else np.zeros(1)
        object.__setattr__(self, "first_row", first.astype(np.int64))
        paths = fit_path_prior(self.position, place_radius_px=self.place_radius_px, floor=self.floor)
        object.__setattr__(self, "paths", paths)
        entry = np.full(len(self.ids), -1, np.int64)
        alive = np.flatnonzero(self.photo_of_entry >= 0)
        entry[self.photo_of_entry[alive]] = alive
        object.__setattr__(self, "_entry_of_photo", entry)

    def photo_of_row(self, row: NDArray[np.int64]) -> NDArray[np.int64]:
        """Look up the photo of rows, any shape; -1 for row -1 or a removed photo."""
        entry = np.searchsorted(self.first_row, row, side="right") - 1
        photo = self.photo_of_entry[np.clip(entry, 0, len(self.photo_of_entry) - 1)]
        return np.where(row >= 0, photo, -1)

    def row_in_photo(self, row: NDArray[np.int64]) -> NDArray[np.int64]:
        """Convert descriptor rows, any shape, to keypoint numbers within their photo."""
        return row - self.first_row[np.searchsorted(self.first_row, row, side="right") - 1]

    def keypoint_angle(self, row: NDArray[np.int64]) -> NDArray[np.float32]:
        """Look up the orientation of descriptor rows, any shape, degrees; 0 for row -1."""
        return self._gather(row, [s.angle for s in self.segments])

    def keypoint_xy(self, row: NDArray[np.int64]) -> NDArray[np.float32]:
        """Look up the pixels of the keypoints of descriptor rows, any shape, in their photos; (..., 2)."""
        return self._gather(row, [s.xy for s in self.segments])

    def image_headings_deg(self) -> NDArray[np.float64]:
        """Compute the headings of the photos: (p,), degrees clockwise from image-up, NaN where unknown."""
        if self.extrinsics is None:
            return np.full(len(self.ids), np.nan)
        known = self.extrinsics.trust >= MIN_TRUST
        return np.where(known, np.degrees(so3.heading(self.extrinsics.rotation)) % 360.0, np.nan)

    @staticmethod
    def _gather(row: NDArray[np.int64], arrays: Sequence[NDArray[np.float32]]) -> NDArray[np.float32]:
        found = np.zeros((*row.shape, *arrays[0].shape[1:]), np.float32)
        first = 0
        for array in arrays:
            here = (row >= first) & (row < first + len(array))
            found[here] = array[row[here] - first]
            first += len(array)
        return found

    def features(self, photo: int) -> Features | None:
        """Return the features of a photo by its number; None if the photo could not be read."""
        place = self._place(photo)
        if place is None:
            return None
        features = place[0].entry(place[1]).features
        described = self.global_descriptors
        return features if described is None else replace(features, vector=described.of(photo))

    def photo_size(self, photo: int) -> tuple[int, int]:
        """Look up width and height, pixels, of an upright photo that has features."""
        place = self._place(photo)
        if place is None:
            raise IndexError(f"photo {photo} has no features")
        width, height = place[0].photo_size[place[1]]
        return int(width), int(height)

    def has_size(self, width: int, height: int) -> bool:
        """Check whether a photo of the map has this size, upright or turned, pixels."""
        sizes = [[width, height], [height, width]]
        return any((s.photo_size == size).all(axis=1).any() for s in self.segments for size in sizes)

    def camera(self, photo: int) -> Camera:
        return Camera(*self.photo_size(photo), float(self.fov_deg[photo]))

    def ray_sigmas(self, sigma_px: float) -> NDArray[np.float64]:
        """Convert the noise of keypoints to that of rays at depth 1, for each photo; see `Camera.ray_sigma`.

        Args:
            sigma_px: Standard deviation, pixels of the photos as extracted.

        Returns:
            (p,) float64: NaN for photos without features.
        """
        sigma = np.full(len(self.ids), np.nan)
        for photo in np.flatnonzero(self._entry_of_photo >= 0).tolist():
            sigma[photo] = self.camera(photo).ray_sigma(sigma_px, extract_side_px=self.extract_side_px)
        return sigma

    def _place(self, photo: int) -> tuple[Segment, int] | None:
        """Find a photo's segment and its number in the segment; None if it is in none."""
        entry = int(self._entry_of_photo[photo])
        for segment in self.segments if entry >= 0 else ():
            if entry < len(segment.content):
                return segment, entry
            entry -= len(segment.content)
        return None


@dataclass(frozen=True, slots=True, eq=False)
class Candidates:
    """Neighbours of the query's descriptors, and their photos."""

    distance: NDArray[np.float32]  # (n, k) float32. Infinite if there is no further neighbour.
    # `row`, `photo`: (n, k) int64. -1 if there is none.
    row: NDArray[np.int64]
    photo: NDArray[np.int64]


_SPARE = 20
"""Number of additional neighbours that are looked up at first if some photos are hidden."""

_MOST_NEIGHBOURS = 1000
"""Maximum number of neighbours that are looked up to find visible ones."""


def candidates(
    indexed: IndexedMap, descriptors: NDArray[np.uint8], *, k: int, hide: Collection[int] = ()
) -> Candidates:
    """Find the k nearest visible map descriptors of each query descriptor.

    Args:
        descriptors: (n, d) uint8
    """
    hidden = np.isin(indexed.ids, np.fromiter(hide, np.int64, len(hide)))
    search = indexed.search
    if isinstance(search, TwoStage):
        visible = (indexed.photo_of_entry >= 0) & ~hidden[indexed.photo_of_entry]
        found = search.search_among(descriptors, k, visible=visible)
        return Candidates(found.distance, found.row, indexed.photo_of_row(found.row))
    whole = not hidden.any() and bool((indexed.photo_of_entry >= 0).all())
    wanted = k if whole else k + _SPARE
    answer = _visible(indexed, descriptors, search=search, hidden=hidden, k=k, looked_up=wanted)
    # Hidden photos can fill the list of a descriptor; then look up more neighbours for it.
    while not whole and wanted < _MOST_NEIGHBOURS:
        short = np.flatnonzero(answer.more & (answer.photo[:, -1] < 0))
        if not len(short):
            break
        wanted = min(4 * wanted, _MOST_NEIGHBOURS)
        longer = _visible(indexed, descriptors[short], search=search, hidden=hidden, k=k, looked_up=wanted)
        answer.distance[short] = longer.distance
        answer.row[short] = longer.row
        answer.photo[short] = longer.photo
        answer.more[short] = longer.more
    return Candidates(answer.distance, answer.row, answer.photo)


class _Visible(NamedTuple):
    """As `Candidates`; `more` (n,) bool: whether further neighbours can be looked up."""

    distance: NDArray[np.float32]
    row: NDArray[np.int64]
    photo: NDArray[np.int64]
    more: NDArray[np.bool_]


def _visible(
    indexed: IndexedMap,
    descriptors: NDArray[np.uint8],
    *,
    search: DescriptorSearch,
    hidden: NDArray[np.bool_],
    k: int,
    looked_up: int,
) -> _Visible:
    """Keep the first k of `looked_up` neighbours that are in photos of the map and not `hidden`."""
    found = search.search(descriptors, looked_up)
    photo = indexed.photo_of_row(found.row)
    photo = np.where((photo >= 0) & hidden[photo], -1, photo)
    order = np.argsort(photo < 0, axis=1, kind="stable")[:, :k]
    photo = np.take_along_axis(photo, order, 1)
    distance = np.where(photo >= 0, np.take_along_axis(found.distance, order, 1), np.float32(np.inf))
    row = np.where(photo >= 0, np.take_along_axis(found.row, order, 1), -1)
    return _Visible(distance, row, photo, found.row[:, -1] >= 0)
