"""Landmarks: points of a reconstruction with their observations; the cloud in the map's frame."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from webapp.core.geo.georeference import Georeference
from webapp.core.geo.local import LocalFrame
from webapp.core.geo.types import LatLon, MapPixel
from webapp.core.landmarks.placing import AlignedSubmodel, MapCameras, NotAligned
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


Array = NDArray[np.float64]

_WIDE_PERCENT, _REACH = 10.0, 2.0
"""Percentage of points trimmed at each end to measure the extent of a cloud, and how many extents beyond that
a point may lie. Points farther away come from nearly parallel rays."""

_GROUND_PERCENT = 5.0
"""Percentile of the points' heights that is taken for the ground."""


@dataclass(frozen=True, slots=True)
class CloudFrame:
    """A frame of metres east, north and up from the middle of the image.

    On a map without a georeference its unit is the map pixel: to the right, towards image-up, and up.
    """

    georeference: Georeference | None
    size: tuple[int, int]  # Width and height of the image

    @property
    def _middle(self) -> MapPixel:
        return MapPixel(self.size[0] / 2.0, self.size[1] / 2.0)

    @property
    def unit_per_pixel(self) -> float:
        """Size of a pixel at the middle of the image, metres; 1 if the unit is the pixel."""
        if self.georeference is None:
            return 1.0
        metres = self.georeference.metres_per_pixel(self._middle)
        return metres if math.isfinite(metres) and metres > 0.0 else 1.0

    @property
    def origin(self) -> LatLon | None:
        """Position of the origin on the Earth; None if the unit is the pixel."""
        if self.georeference is None:
            return None
        found = self.georeference.latlon_of(self._middle)
        return found if math.isfinite(found.lat) and math.isfinite(found.lon) else None

    @property
    def unit(self) -> Literal["m", "px"]:
        """Unit of all three axes."""
        return "px" if self.origin is None else "m"

    def from_map(self, pixels: Array) -> Array:
        """Convert map pixels (n, 2) to the plane of the frame; NaN if they have no position on the Earth."""
        origin = self.origin
        if origin is None or self.georeference is None:
            return np.asarray((pixels - np.array(self._middle)) * (1.0, -1.0))
        return self.georeference.enu_from_pixel(pixels, LocalFrame(origin))


class MapCloud(NamedTuple):
    """k points and n cameras on a map."""

    point: NDArray[np.int64]  # (k,) int64. Numbers in the cloud; points that are far off are left out.
    # (k, 3) float64. In the frame of the map. Up is 0 at the height of the placed cameras, as maps have no
    # heights.
    xyz: Array
    photo: NDArray[np.int64]  # (n,) int64. Numbers in the cloud.
    centre: Array  # (n, 3) float64
    # (n, 3, 3) float64. The rows are the directions of a camera's right, down and front axes.
    rotation: Array
    ground: float  # Height at which the image is drawn


def align_cloud(
    cloud: LandmarkCloud,
    submodels: Sequence[Submodel],
    *,
    aligned: Sequence[AlignedSubmodel | NotAligned],
    frame: CloudFrame,
) -> MapCloud:
    """Align a cloud with a map; submodels that cannot be aligned are left out.

    Each photo has its own similarity, as a long submodel bends. A point is mapped by the similarities of the
    photos that see it, and the results are averaged.
    """
    photos = len(cloud.contents)
    centre = np.full((photos, 3), np.nan)  # x, y and height, map pixels
    factor = np.full(photos, complex(np.nan, np.nan))
    rotation = np.full((photos, 3, 3), np.nan)
    level = np.zeros((len(submodels), 3, 3))
    local = np.zeros((photos, 3))
    for number, (submodel, result) in enumerate(zip(submodels, aligned, strict=True)):
        if not isinstance(result, AlignedSubmodel):
            continue
        cameras = result.transform.map_cameras(submodel.centre)
        level[number] = result.transform.frame
        local[submodel.photo] = submodel.centre @ result.transform.frame.T
        centre[submodel.photo] = np.column_stack([cameras.at.real, cameras.at.imag, cameras.height_px])
        factor[submodel.photo] = cameras.factor
        rotation[submodel.photo] = _turned(submodel.rotation @ result.transform.frame.T, cameras)
    own = np.einsum("kij,kj->ki", level[cloud.submodel], cloud.point)
    laid_points = _mean_of_views(cloud, own, local=local, centre=centre, factor=factor)
    return _in_frame(laid_points, centre, rotation, frame=frame)


def _turned(axes: Array, cameras: MapCameras) -> Array:
    """Rotate camera axes (n, 3, 3) from the submodel's frame (x, y, down) to the map's (x, y, up)."""
    turn = cameras.factor / np.abs(cameras.factor)
    plane = (axes[..., 0] + 1j * axes[..., 1]) * turn[:, None]
    return np.stack([plane.real, plane.imag, -axes[..., 2]], -1)


def _mean_of_views(cloud: LandmarkCloud, own: Array, *, local: Array, centre: Array, factor: Array) -> Array:
    """Map points (k, 3), each by all photos that see it; NaN if its submodel is not aligned."""
    photo = np.repeat(np.arange(len(cloud.contents)), np.diff(cloud.first))
    point = np.asarray(cloud.seen_point)
    off = own[point] - local[photo]
    plane = (off[:, 0] + 1j * off[:, 1]) * factor[photo]
    views = (plane.real, plane.imag, -off[:, 2] * np.abs(factor[photo]))
    times = np.bincount(point, minlength=len(own))
    total = np.stack(
        [
            np.bincount(point, centre[photo, axis] + view, minlength=len(own))
            for axis, view in enumerate(views)
        ],
        -1,
    )
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.asarray(total / times[:, None])


def _in_frame(points: Array, centre: Array, rotation: Array, *, frame: CloudFrame) -> MapCloud:
    unit = frame.unit_per_pixel

    def to_frame(aligned: Array) -> Array:
        return np.column_stack([frame.from_map(aligned[:, :2]), aligned[:, 2] * unit])

    photo = np.flatnonzero(np.isfinite(centre).all(1))
    at = to_frame(centre[photo])
    # directions by the displacement of a point one pixel away along each axis
    aside = [to_frame(centre[photo] + rotation[photo, axis]) - at for axis in range(3)]
    turned = np.stack(aside, 1)
    turned /= np.linalg.norm(turned, axis=2, keepdims=True)
    point = np.flatnonzero(np.isfinite(points).all(1))
    xyz = to_frame(points[point])
    kept = _near(xyz)
    up = xyz[kept, 2]
    lowest = [float(np.percentile(up, _GROUND_PERCENT))] if len(up) else []
    ground = min([*lowest, *([float(np.median(at[:, 2]))] if len(at) else [0.0])])
    return MapCloud(point[kept], xyz[kept], photo, at, turned, ground)


def _near(xyz: Array) -> NDArray[np.bool_]:
    known = np.asarray(np.isfinite(xyz).all(1))
    if not known.any():
        return known
    low, high = np.percentile(xyz[known], [_WIDE_PERCENT, 100.0 - _WIDE_PERCENT], axis=0)
    reach = _REACH * float((high - low).max())
    with np.errstate(invalid="ignore"):
        return np.asarray(((xyz >= low - reach) & (xyz <= high + reach)).all(1))
