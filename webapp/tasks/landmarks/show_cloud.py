"""Landmarks of a library map for its page, georegistered by the current positions of the photos."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from webapp.core.landmarks.cloud import CloudFrame, MapCloud, align_cloud
from webapp.core.landmarks.placing import AlignedSubmodel, NotAligned
from webapp.core.landmarks.submodels import view_rotation
from webapp.core.mapmodel.model import Experience, Map
from webapp.core.mapmodel.panorama import experience_of
from webapp.core.mapmodel.views import content_of, level_views
from webapp.errors import NotFound
from webapp.files.landmarks.cloud import (
    CLOUD_FILE,
    COLOURS_FILE,
    POINTS_FILE,
    Colours,
    MapPoints,
    StoredCloud,
    read_cloud,
    read_colours,
    read_points,
    write_points,
)
from webapp.files.landmarks.colmap import SUBMODELS_FILE, StoredSubmodels, read_submodels
from webapp.files.localize.index_store import IndexFolder
from webapp.files.maps.lists import control_point_fields
from webapp.store.library import Library
from webapp.store.maps import maps
from webapp.store.maps.blurred import blurred_elsewhere
from webapp.store.schema import MapRecord
from webapp.tasks.landmarks.accuracy import accuracy_fields, accuracy_of, residual_fields
from webapp.tasks.landmarks.control_points import PhotoLenses, Residual, georegister_all, residuals_of
from webapp.tasks.landmarks.known import AnyPhoto
from webapp.tasks.localize.index_location import landmarks_folder
from webapp.tasks.maps.library_map import as_map

BLOCK_POINTS = 131_072
"""Points that are sent at once; each block is a sample of the whole map."""

VERSION = 6
"""Version of the georegistration and the stored data."""
_BY_PLACED = "seen_by_placed"
"""Key of `MapPoints.about`: number of points that placed photos see. These come first."""
_PLACED = "placed"
"""Key of `MapPoints.about`: these photos, by the beginnings of their content hashes."""
_BEGINNING = 16
_GREY = 128
_MOST_SEEN = 255
_STEPS = 65_535
"""Quantisation of the coordinates that are sent: steps along each axis."""


@dataclass(frozen=True, slots=True, eq=False)
class ShownCloud:
    """The stored landmarks of a map."""

    # As last georegistered. `about` has further data for the page: `unit` ("m" or "px"), `origin`, `frame`
    # (the same in words), `coloured`, `cameras` (`id, panorama, at, rotation, focal_px`), `corners` of the
    # image, its height `ground`, `left_out`: photos of submodels that cannot be georegistered (`photos`,
    # `reason`), `residuals` of placed photos and control points, and their `accuracy`.
    points: MapPoints | None
    is_current: bool  # Whether nothing has changed since; also True without landmarks
    new_photos: int = 0  # Photos of the map that were added after the landmarks were computed


def shown_cloud(library: Library, record: MapRecord) -> ShownCloud:
    """Read the landmarks of a map as last georegistered, and whether they are up to date."""
    task = _task(library, record)
    return ShownCloud(stored_points(library, record), True) if task is None else task.shown()


def stored_points(library: Library, record: MapRecord) -> MapPoints | None:
    """Read only the points, as last georegistered."""
    return read_points(landmarks_folder(library.cfg(record.slug)) / POINTS_FILE)


def points_for_visitors(library: Library, record: MapRecord) -> MapPoints | None:
    """Read the points that placed photos see.

    None if there are none, or if one of these photos has been blurred, removed or moved to the tray since:
    which points the others see is known only after the next georegistration. One that is blurred only on
    another map hides them until it is blurred on this map, too.
    """
    points = stored_points(library, record)
    found = None if points is None else _now(library, record)
    if points is None or found is None:
        return None
    with library.database.read() as session:
        hidden = blurred_elsewhere(session, maps.photos(session, record))
    placed = {
        content[:_BEGINNING]
        for content, one in found[1].items()
        if isinstance(one, Experience) and experience_of(one.id) not in hidden
    }
    if _PLACED not in points.about or not placed.issuperset(points.about[_PLACED]):
        return None
    some = slice(points.about[_BY_PLACED])
    return replace(points, xyz=points.xyz[some], rgb=points.rgb[some], times_seen=points.times_seen[some])


def align_in_library(library: Library, record: MapRecord) -> None:
    """Georegister the landmarks of a map if they are out of date, and store them for its page.

    Raises StorageError.
    """
    task = _task(library, record)
    if task is not None and not task.shown().is_current:
        write_points(task.folder / POINTS_FILE, _aligned_points(task))


@dataclass(frozen=True, slots=True, eq=False)
class _Task:
    folder: Path
    stored: StoredCloud
    submodels: StoredSubmodels
    rgb: Colours | None
    the_map: Map
    photos: Mapping[str, AnyPhoto]
    """By content hash; the views of panoramas instead of these."""

    @property
    def key(self) -> str:
        placed = sorted(
            (content, one.id, *one.position, one.gps_accuracy_m, one.radius_px)
            if isinstance(one, Experience)
            else (content, one.id)
            for content, one in self.photos.items()
        )
        where = None if self.the_map.georeference is None else asdict(self.the_map.georeference)
        size = self.the_map.satellite.width, self.the_map.satellite.height
        points = control_point_fields(self.the_map.control_points)
        all_of_it = [VERSION, self.stored.key, self.rgb is not None, placed, where, size, points]
        return hashlib.sha256(json.dumps(all_of_it).encode()).hexdigest()[:32]

    def shown(self) -> ShownCloud:
        points = read_points(self.folder / POINTS_FILE)
        described = IndexFolder(self.folder)
        new = {experience_of(p.id) for c, p in self.photos.items() if not described.spool_path(c).exists()}
        return ShownCloud(points, points is not None and points.key == self.key, len(new))


def _task(library: Library, record: MapRecord) -> _Task | None:
    """Read the inputs; None without landmarks, or without an image."""
    folder = landmarks_folder(library.cfg(record.slug))
    stored, submodels = read_cloud(folder / CLOUD_FILE), read_submodels(folder / SUBMODELS_FILE)
    if stored is None or submodels is None or stored.key != submodels.cloud_key:
        return None
    now = _now(library, record)
    if now is None:
        return None
    return _Task(folder, stored, submodels, read_colours(folder / COLOURS_FILE, key=stored.key), *now)


def _now(library: Library, record: MapRecord) -> tuple[Map, dict[str, AnyPhoto]] | None:
    """Read the map and its photos by content hash; None if it has no image."""
    with library.database.read() as session:
        found = as_map(session, record)
        own = {photo.id: photo.sha256 for photo in maps.photos(session, record) if not photo.removed}
    if found is None:
        return None
    everyone: list[AnyPhoto] = [*found.experiences, *found.unplaced]
    return found, {content_of(one, own[experience_of(one.id)]): one for one in level_views(everyone)}


def block(points: MapPoints, number: int) -> bytes:
    """Pack a block of points: x, y, z of each (uint16), then red, green, blue, times seen of each (uint8).

    Coordinates are steps of `scaling`. Raises NotFound.
    """
    some = slice(number * BLOCK_POINTS, (number + 1) * BLOCK_POINTS)
    xyz = points.xyz[some]
    if not len(xyz):
        raise NotFound("this part of the landmarks does not exist")
    offset, scale = scaling(points)
    steps = np.rint((xyz - offset) / scale).astype("<u2")
    colours = np.column_stack([points.rgb[some], points.times_seen[some]])
    return steps.tobytes() + colours.tobytes()


def scaling(points: MapPoints) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return offset and size of a step along each axis, (3,) each, in the unit of the frame."""
    if not len(points.xyz):
        return np.zeros(3), np.ones(3)
    low, high = (np.asarray(end(points.xyz, 0), np.float64) for end in (np.min, np.max))
    return low, np.maximum(high - low, 1e-6) / _STEPS


def _aligned_points(task: _Task) -> MapPoints:
    stored, submodels, the_map = task.stored, task.submodels, task.the_map
    of_cloud = [task.photos.get(content) for content in submodels.contents]
    lenses = PhotoLenses(task.folder, stored.cloud, dict(enumerate(submodels.contents)))
    results = georegister_all(submodels.submodels, of_cloud, the_map=the_map, lenses=lenses)
    aligned = [result.aligned for result in results]
    residuals = residuals_of(submodels.submodels, results, photos=of_cloud, the_map=the_map)
    frame = CloudFrame(the_map.georeference, (the_map.satellite.width, the_map.satellite.height))
    cloud = align_cloud(stored.cloud, submodels.submodels, aligned=aligned, frame=frame)
    order = np.random.default_rng(0).permutation(len(cloud.point))
    by_placed = _by_placed(stored, of_cloud)[cloud.point]
    order = order[np.argsort(~by_placed[order], kind="stable")]
    rows = cloud.point[order]
    times = np.bincount(stored.cloud.seen_point, minlength=len(stored.cloud.point))
    return MapPoints(
        task.key,
        cloud.xyz[order].astype(np.float32),
        np.full((len(rows), 3), _GREY, np.uint8) if task.rgb is None else np.asarray(task.rgb)[rows],
        np.minimum(times[rows], _MOST_SEEN).astype(np.uint8),
        {
            **_about(frame, cloud),
            "coloured": task.rgb is not None,
            _BY_PLACED: int(by_placed.sum()),
            _PLACED: [
                content[:_BEGINNING]
                for content, one in zip(submodels.contents, of_cloud, strict=True)
                if isinstance(one, Experience)
            ],
            "cameras": list(_cameras(cloud, of_cloud, focal_px=stored.cloud.focal_px)),
            "left_out": _left_out(submodels, aligned, of_cloud),
            "residuals": [_residual(one, the_map) for one in residuals],
            "accuracy": accuracy_fields(accuracy_of(residuals, the_map)),
        },
    )


def _by_placed(stored: StoredCloud, photos: Sequence[AnyPhoto | None]) -> NDArray[np.bool_]:
    """Return for each point of the cloud whether a placed photo sees it."""
    cloud = stored.cloud
    found = np.zeros(len(cloud.point), np.bool_)
    for number, one in enumerate(photos):
        if isinstance(one, Experience):
            found[cloud.seen_point[cloud.rows_of(number)]] = True
    return found


def _about(frame: CloudFrame, cloud: MapCloud) -> dict[str, Any]:
    width, height = frame.size
    corners = frame.from_map(np.array([[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]]))
    origin = frame.origin
    words = "map pixels right, towards the top of the image and up, from its middle"
    if origin is not None:
        words = f"metres east, north and up, from latitude {origin.lat:.8f}, longitude {origin.lon:.8f}"
    return {
        "unit": frame.unit,
        "origin": origin and [origin.lat, origin.lon],
        "frame": f"{words}; 0 is the height of the placed cameras",
        "corners": [[round(x, 3) for x in corner] for corner in corners.tolist()]
        if np.isfinite(corners).all()
        else None,
        "ground": round(cloud.ground, 3),
    }


def _residual(one: Residual, the_map: Map) -> dict[str, Any]:
    return {
        **residual_fields(one, the_map),
        "x_px": one.at and round(one.at.x, 2),
        "y_px": one.at and round(one.at.y, 2),
        "others_x_px": one.predicted and round(one.predicted.x, 2),
        "others_y_px": one.predicted and round(one.predicted.y, 2),
        "problem": one.problem,
    }


def _cameras(
    cloud: MapCloud, photos: Sequence[AnyPhoto | None], *, focal_px: NDArray[np.float64]
) -> list[dict[str, Any]]:
    """List the cameras of photos that are still on the map or in its tray; one per panorama."""
    found: dict[int, dict[str, Any]] = {}
    for number, centre, rotation in zip(cloud.photo.tolist(), cloud.centre, cloud.rotation, strict=True):
        one = photos[number]
        if one is None or not np.isfinite(centre).all() or experience_of(one.id) in found:
            continue
        middle = rotation if one.view is None else view_rotation(one.view.turn_deg).T @ rotation
        found[experience_of(one.id)] = {
            "id": experience_of(one.id),
            "panorama": one.view is not None,
            "at": centre.round(3).tolist(),
            "rotation": middle.round(4).tolist(),
            "focal_px": round(float(focal_px[number]), 1),
        }
    return [*found.values()]


def _left_out(
    submodels: StoredSubmodels,
    aligned: Sequence[AlignedSubmodel | NotAligned],
    photos: Sequence[AnyPhoto | None],
) -> list[dict[str, Any]]:
    """List the reasons why submodels are not georegistered, with their photos."""
    found: dict[str, list[int]] = {}
    for submodel, result in zip(submodels.submodels, aligned, strict=True):
        if isinstance(result, NotAligned):
            there = (one.id for number in submodel.photo.tolist() if (one := photos[number]) is not None)
            found.setdefault(result.reason, []).extend(dict.fromkeys(map(experience_of, there)))
    return [{"photos": ids, "reason": reason} for reason, ids in found.items()]
