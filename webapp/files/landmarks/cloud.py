"""The cloud of a map's landmarks, from pycolmap's models, and its points and their colours, on disk."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from webapp.core.landmarks.cloud import LandmarkCloud, observed_twice
from webapp.errors import IndexDamaged
from webapp.files.landmarks.colmap import StoredSubmodels, as_model, pycolmap
from webapp.files.localize.arrays import read_arrays, write_settled

COLOURS_FILE = "colours.arrays"
POINTS_FILE = "points.arrays"

Colours = NDArray[np.uint8]


def write_colours(path: Path, rgb: Colours, *, key: str) -> None:
    """Replace the file atomically. Raises StorageError.

    Args:
        rgb: (k, 3) uint8. Colours of the points of a cloud.
    """
    write_settled(path, {"rgb": rgb}, meta={"format": _FORMAT, "key": key})


def read_colours(path: Path, *, key: str) -> Colours | None:
    """Read the colours of a cloud's points; None if the file is missing, unusable or of another cloud."""
    try:
        arrays, meta = read_arrays(path)
        return arrays["rgb"] if (meta["format"], meta["key"]) == (_FORMAT, key) else None
    except (IndexDamaged, KeyError):
        return None


@dataclass(frozen=True, slots=True, eq=False)
class MapPoints:
    """Points of landmarks in the frame of their map, in any order."""

    key: str  # Identifies the inputs from which they were computed
    xyz: NDArray[np.float32]  # (k, 3) float32
    rgb: Colours  # (k, 3) uint8
    times_seen: NDArray[np.uint8]  # (k,) uint8. Number of photos that see each point; 255 means 255 or more.
    about: Mapping[str, Any]  # JSON values that are stored with the points


def write_points(path: Path, points: MapPoints) -> None:
    """Replace the file atomically. Raises StorageError."""
    arrays: dict[str, NDArray[Any]] = {"xyz": points.xyz, "rgb": points.rgb, "times_seen": points.times_seen}
    write_settled(path, arrays, meta={"format": _FORMAT, "key": points.key, "about": dict(points.about)})


def read_points(path: Path) -> MapPoints | None:
    """Read points; None if the file is missing or unusable."""
    try:
        arrays, meta = read_arrays(path)
        if meta["format"] != _FORMAT:
            return None
        return MapPoints(str(meta["key"]), about=meta["about"], **arrays)
    except (IndexDamaged, KeyError, TypeError):
        return None


def as_ply(points: MapPoints) -> bytes:
    """Write points as PLY (binary, little-endian): x, y, z, red, green, blue."""
    names = ("x", "y", "z", "red", "green", "blue")
    kinds = ("<f4",) * 3 + ("u1",) * 3
    table = np.empty(len(points.xyz), np.dtype(list(zip(names, kinds, strict=True))))
    for column, name in enumerate(names):
        table[name] = points.xyz[:, column] if column < 3 else points.rgb[:, column - 3]
    properties = [
        f"property {'float' if kind == '<f4' else 'uchar'} {name}"
        for name, kind in zip(names, kinds, strict=True)
    ]
    about = f"comment {points.about['frame']}"
    head = ["ply", "format binary_little_endian 1.0", about, f"element vertex {len(table)}", *properties]
    return "\n".join([*head, "end_header", ""]).encode() + table.tobytes()


CLOUD_FILE = "cloud.arrays"
_FORMAT = 1

Descriptors = NDArray[np.uint8]


@dataclass(frozen=True, slots=True, eq=False)
class StoredCloud:
    """A cloud, and the `cloud_key` of the submodels that it belongs to."""

    cloud: LandmarkCloud
    key: str


class _Seen(NamedTuple):
    """Observations in a part of a model (the numbers of point, photo of the cloud, and keypoint), and its
    points."""

    point: NDArray[np.int64]
    photo: NDArray[np.int64]
    keypoint: NDArray[np.int64]
    at: NDArray[np.float64]


def read_models(
    folders: Iterable[Path], stored: StoredSubmodels, *, described: Callable[[str], tuple[Any, Descriptors]]
) -> LandmarkCloud:
    """Collect the submodels' points from their models, with the descriptors of the observations.

    Args:
        folders: Of the models that contain the submodels; if several contain one, the first is used.
        described: Keypoints (n, 2) and descriptors (n, d) of a photo, by its content.
    """
    number = {content: n for n, content in enumerate(stored.contents)}
    submodel_of = {frozenset(submodel.photo.tolist()): n for n, submodel in enumerate(stored.submodels)}
    camera = np.zeros((2, len(number)))
    own = np.array([len(described(content)[0]) for content in stored.contents], np.int64)
    parts: list[tuple[int, _Seen]] = []
    for folder in folders:
        reconstruction = pycolmap().Reconstruction(folder)
        model = as_model(reconstruction)
        # A model that was joined by known positions is one submodel as a whole.
        for part in [np.arange(len(model.contents)), *model.parts()]:
            photos = {
                model.contents[i]: number[model.contents[i]] for i in part if model.contents[i] in number
            }
            submodel = submodel_of.pop(frozenset(photos.values()), None)
            if submodel is not None:
                parts.append((submodel, _observations(reconstruction, photos, own=own, camera=camera)))
    return _gather(parts, stored.contents, camera=camera, described=described)


def _observations(
    reconstruction: Any, photos: Mapping[str, int], *, own: NDArray[np.int64], camera: NDArray[np.float64]
) -> _Seen:
    """Read the observations of some photos of a model; fill in their columns of `camera`.

    Args:
        own: (n,) int64. Number of keypoints of each photo; those after them are a matching network's, by
            whose descriptors no query is compared with the landmarks.
    """
    photo_of = {}
    for id in reconstruction.reg_image_ids():
        image = reconstruction.image(id)
        if image.name in photos:
            photo_of[id] = photos[image.name]
            lens = image.camera
            camera[:, photos[image.name]] = lens.mean_focal_length(), lens.params[-1]
    rows: list[tuple[int, int, int]] = []
    at: list[NDArray[np.float64]] = []
    for point in reconstruction.points3D.values():
        elements = point.track.elements
        rows += [(len(at), photo_of[e.image_id], e.point2D_idx) for e in elements if e.image_id in photo_of]
        at.append(point.xyz)
    seen = np.array(rows, np.int64).reshape(-1, 3)
    seen = seen[seen[:, 2] < own[seen[:, 1]]]
    seen = seen[observed_twice(seen[:, 0], seen[:, 1])]
    return _Seen(seen[:, 0], seen[:, 1], seen[:, 2], np.array(at, np.float64).reshape(-1, 3))


def _gather(
    parts: Sequence[tuple[int, _Seen]],
    contents: tuple[str, ...],
    *,
    camera: NDArray[np.float64],
    described: Callable[[str], tuple[Any, Descriptors]],
) -> LandmarkCloud:
    used = [np.unique(seen.point, return_inverse=True) for _, seen in parts]
    start = np.cumsum([0, *(len(kept) for kept, _ in used)])
    none = np.zeros(0, np.int64)
    point = np.concatenate([none, *(row + first for (_, row), first in zip(used, start, strict=False))])
    photo = np.concatenate([none, *(seen.photo for _, seen in parts)])
    keypoint = np.concatenate([none, *(seen.keypoint for _, seen in parts)])
    order = np.argsort(photo, kind="stable")
    first = np.searchsorted(photo[order], np.arange(len(contents) + 1))
    xy, descriptors = _described(contents, keypoint[order], first, described=described)
    submodels = [np.full(len(kept), submodel) for (submodel, _), (kept, _) in zip(parts, used, strict=True)]
    return LandmarkCloud(
        contents,
        np.concatenate(
            [np.zeros((0, 3)), *(s.at[kept] for (_, s), (kept, _) in zip(parts, used, strict=True))]
        ),
        np.concatenate([none, *submodels]).astype(np.int32),
        first.astype(np.int64),
        point[order].astype(np.int32),
        xy,
        descriptors,
        camera[0],
        camera[1],
    )


def _described(
    contents: Sequence[str],
    keypoint: NDArray[np.int64],
    first: NDArray[np.int64],
    *,
    described: Callable[[str], tuple[Any, Descriptors]],
) -> tuple[NDArray[np.float32], Descriptors]:
    def each() -> Iterator[tuple[NDArray[np.float32], Descriptors]]:
        for number, content in enumerate(contents):
            rows = keypoint[first[number] : first[number + 1]]
            if len(rows):
                xy, descriptors = described(content)
                yield xy[rows], descriptors[rows]

    found = [*each()]
    if not found:
        return np.zeros((0, 2), np.float32), np.zeros((0, 128), np.uint8)
    return np.concatenate([xy for xy, _ in found]), np.concatenate([rows for _, rows in found])


def write_cloud(path: Path, stored: StoredCloud) -> None:
    """Replace the file atomically. Raises StorageError."""
    cloud = stored.cloud
    arrays: dict[str, NDArray[Any]] = {
        "point": cloud.point,
        "piece": cloud.submodel,
        "first": cloud.first,
        "seen_point": cloud.seen_point,
        "seen_xy": cloud.seen_xy,
        "descriptors": cloud.descriptors,
        "focal_px": cloud.focal_px,
        "distortion": cloud.distortion,
    }
    meta = {"format": _FORMAT, "key": stored.key, "contents": list(cloud.contents)}
    write_settled(path, arrays, meta=meta)


def read_cloud(path: Path) -> StoredCloud | None:
    """Read the file; None if it is missing or unusable, so that it is recomputed."""
    try:
        arrays, meta = read_arrays(path, verify=True)
        if meta["format"] != _FORMAT:
            return None
        arrays["submodel"] = arrays.pop("piece")
        return StoredCloud(LandmarkCloud(tuple(meta["contents"]), **arrays), str(meta["key"]))
    except (IndexDamaged, KeyError, TypeError):
        return None
