"""Colours the points of a cloud from the photos."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from webapp.core.boxes import BlurBox
from webapp.core.geometry.tilt import LEVEL
from webapp.core.landmarks.cloud import LandmarkCloud
from webapp.core.mapmodel.panorama import LevelView
from webapp.errors import MapError, PhotoError
from webapp.files.landmarks.cloud import CLOUD_FILE, COLOURS_FILE, read_cloud, read_colours, write_colours
from webapp.files.maps.folder import photo_path
from webapp.files.photos.panorama import cut_level_view
from webapp.files.photos.photo import read_blurred, read_facts
from webapp.progress import Progress
from webapp.settings import PhotoLimits
from webapp.tasks.landmarks.reconstruct import Reconstruction
from webapp.threads import cores, in_threads

_SIDE_PX = 500
"""Photos are scaled down to this side: a pixel then covers about as much as a keypoint."""

_UNKNOWN = 128
"""Grey, for points that are seen only by photos that can no longer be read."""

Sampled = tuple[NDArray[np.int64], NDArray[np.float64]]


def colour_cloud(cfg: Path, found: Reconstruction, *, limits: PhotoLimits, progress: Progress) -> None:
    """Sample the colours of the points from the photos, unless done already; store them with the cloud.

    Raises StorageError, Cancelled.
    """
    stored = read_cloud(found.folder / CLOUD_FILE)
    file = found.folder / COLOURS_FILE
    if stored is None or read_colours(file, key=stored.key) is not None:
        return
    cloud = stored.cloud
    progress.note("sampling colours")
    progress.size(len(cloud.contents))
    total, times = np.zeros((len(cloud.point), 3)), np.zeros(len(cloud.point))

    def sample(number: int) -> Sampled | None:
        photo = found.number_of.get(cloud.contents[number])
        if photo is None or cloud.first[number] == cloud.first[number + 1]:
            return None
        try:
            one = found.photos[photo]
            turn = found.turn_of.get(cloud.contents[number])
            tilt = LEVEL if one.panorama is None else one.panorama.tilt
            view = None if turn is None else LevelView(turn, tilt=tilt)
            picture = _Picture(photo_path(cfg, one.photo), one.blurred, view)
            return _sample(picture, cloud, number, limits=limits)
        except (PhotoError, MapError, OSError):
            return None  # e.g. deleted since; other photos see the points, too

    together = 4 * cores()
    for first in range(0, len(cloud.contents), together):
        progress.check()
        some = range(first, min(first + together, len(cloud.contents)))
        for sampled in in_threads(sample, some):
            progress.advance()
            if sampled is not None:
                point, rgb = sampled
                total[point] += rgb
                times[point] += 1.0
    known = times > 0
    colours = np.full((len(cloud.point), 3), _UNKNOWN, np.uint8)
    colours[known] = np.rint(total[known] / times[known, None])
    write_colours(file, colours, key=stored.key)


@dataclass(frozen=True, slots=True)
class _Picture:
    """A photo, or a view of a panorama."""

    path: Path
    blurred: tuple[BlurBox, ...]
    view: LevelView | None


def _sample(picture: _Picture, cloud: LandmarkCloud, number: int, *, limits: PhotoLimits) -> Sampled:
    """Return the points that a picture shows and their colours: red, green, blue."""
    rows = slice(int(cloud.first[number]), int(cloud.first[number + 1]))
    path, blurred = picture.path, picture.blurred
    if picture.view is None:
        full = read_facts(path, limits=limits)
        pixels = read_blurred(path, blurred, limits=limits, max_side=_SIDE_PX)
        scale = max(pixels.shape[:2]) / max(full.width, full.height)
    else:
        pixels, _ = cut_level_view(read_blurred(path, blurred, limits=limits), picture.view)
        scale = 1.0
    column, row = np.floor((cloud.seen_xy[rows] + 0.5) * scale).astype(np.int64).T
    high, wide = pixels.shape[:2]
    rgb = pixels[np.clip(row, 0, high - 1), np.clip(column, 0, wide - 1), ::-1]
    return cloud.seen_point[rows].astype(np.int64), rgb.astype(np.float64)
