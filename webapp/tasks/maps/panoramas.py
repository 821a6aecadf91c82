"""Cuts panoramas into level views, which are ordinary photos; joins photos of cameras into panoramas."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import asdict, dataclass
from datetime import datetime
from pathlib import Path

import cv2
import numpy as np
import piexif
from numpy.typing import NDArray

from webapp.core.geo.types import LatLon
from webapp.core.geometry.equirectangular import ViewSize, cut_view, view_size
from webapp.core.geometry.rig import RigPhoto, join, panorama_width
from webapp.core.mapmodel.panorama import FOCAL_35MM, VIEWS, boxes_of_mask
from webapp.errors import PhotoError, UsageError
from webapp.files.atomic import write_bytes
from webapp.files.decode import DAMAGED
from webapp.files.listing import list_photos
from webapp.files.photos.exif import Gps
from webapp.files.photos.exif_write import CameraTags, write_panorama, write_view
from webapp.files.photos.panorama import (
    GREY,
    MOST_MASKED,
    MountedCamera,
    PanoramaTags,
    photos_by_instant,
    read_panorama,
)
from webapp.files.photos.photo import PhotoFacts, read_facts, read_file, read_upright
from webapp.progress import Progress
from webapp.settings import PhotoLimits

_FORMAT = 1
"""Version of the joining, part of a panorama's key: panoramas of another version are made again."""

_WIDEST = 32_000
"""Maximum width of a panorama, pixels."""

_CELLS_DEG = (1, 2, 3, 4, 5, 6, 10, 15)
"""Possible cell sizes of a mask; the finest that needs few enough boxes is used."""


@dataclass(frozen=True, slots=True)
class CutOptions:
    views: int = VIEWS  # Number of views, evenly spaced; the first is at the middle of the panorama
    # 35 mm equivalent focal length of each view, mm; 17 corresponds to 91 degrees.
    focal_35mm: int = FOCAL_35MM
    lowest_deg: float = 90.0  # Parts farther below the horizon are masked (robot, tripod)
    highest_deg: float = 90.0  # Parts farther above it are masked (sky)
    # Treat all photos twice as wide as high as panoramas, even without panorama metadata.
    assume: bool = False


@dataclass(frozen=True, slots=True)
class PanoramaPose:
    """Position of a panorama and heading of its middle, degrees clockwise from north; None if unknown."""

    position: LatLon | None = None
    heading_deg: float | None = None
    accuracy_m: float | None = None
    taken_at: str | None = None


@dataclass(frozen=True, slots=True)
class CutPhoto:
    """Result for a photo of the folder: the views that were written, or why there are none."""

    photo: str
    views: tuple[str, ...] = ()
    problem: str = ""


def cut_panoramas(
    folder: Path, out: Path, *, options: CutOptions, limits: PhotoLimits, progress: Progress
) -> Iterator[CutPhoto]:
    """Cut the panoramas of a folder and its subfolders; yield each photo when its views are written.

    Raises:
        UsageError: There is no photo, or the views would be among the panoramas.
    """
    if out.resolve().is_relative_to(folder.resolve()):
        raise UsageError(
            "the views would be among the panoramas", where=str(out), hint="choose another folder"
        )
    names = list_photos(folder)
    if not names:
        raise UsageError("there is no photo in it", where=str(folder))
    progress.size(len(names))
    taken: set[Path] = set()
    for name in names:
        progress.check()
        try:
            if (views := (out / name).with_suffix("")) in taken:
                raise PhotoError("its views would have the same names as those of another photo")
            taken.add(views)
            cut = cut_panorama(folder / name, out / name, options=options, limits=limits)
            yield CutPhoto(name, tuple(cut))
        except PhotoError as error:
            yield CutPhoto(name, problem=error.message)
        progress.advance()


def view_turns(options: CutOptions) -> tuple[int, ...]:
    """Return the rotations of the views from the middle of the panorama, degrees, as in their names."""
    return tuple(round(360.0 * number / options.views) for number in range(options.views))


def cut_panorama(
    path: Path, out: Path, *, options: CutOptions, limits: PhotoLimits, pose: PanoramaPose | None = None
) -> Iterator[str]:
    """Cut one panorama; yield the name of each view when it is written, in the order of `view_turns`.

    Args:
        out: `NAME.jpg` for views such as `NAME_060.jpg`; its folder is created.
        pose: Used instead of the pose in the file.

    Raises:
        PhotoError: It is damaged, or not a full panorama.
    """
    content = read_file(path, limits=limits)
    facts = read_facts(content, limits=limits)
    pixels = read_upright(content, limits=limits)
    size = pixels.shape[1], pixels.shape[0]
    panorama = read_panorama(content, size)
    if not panorama.is_whole:
        raise PhotoError("it is not a full panorama, twice as wide as high")
    if not (panorama.is_marked or options.assume):
        raise PhotoError("it is not marked as a panorama")
    known = pose or _pose_in_file(facts, panorama)
    view = view_size(size[0], options.focal_35mm)
    for number in range(options.views):
        turn = 360.0 * number / options.views
        cut, elevation = cut_view(pixels, view, turn_deg=turn, tilt=panorama.tilt)
        cut[(elevation < -options.lowest_deg) | (elevation > options.highest_deg)] = GREY
        file = out.with_name(f"{out.stem}_{round(turn):03}.jpg")
        write_view(file, cut, tags=_tags(known, view, turn_deg=turn))
        yield file.name


def _pose_in_file(facts: PhotoFacts, panorama: PanoramaTags) -> PanoramaPose:
    middle = panorama.heading_deg
    if middle is None and facts.heading is not None and facts.heading.reference != "M":
        middle = facts.heading.deg
    if not isinstance(facts.gps, Gps):
        return PanoramaPose(heading_deg=middle, taken_at=facts.taken_at)
    at = LatLon(facts.gps.lat, facts.gps.lon)
    return PanoramaPose(at, middle, facts.gps.accuracy_m, facts.taken_at)


def _tags(pose: PanoramaPose, view: ViewSize, *, turn_deg: float) -> CameraTags:
    return CameraTags(
        None if pose.taken_at is None else datetime.fromisoformat(pose.taken_at),
        view.focal_35mm,
        position=pose.position,
        heading_deg=None if pose.heading_deg is None else (pose.heading_deg + turn_deg) % 360.0,
        accuracy_m=pose.accuracy_m,
    )


@dataclass(frozen=True, slots=True)
class JoinOptions:
    width: int | None = None  # Width of the panoramas, pixels; None for the angular resolution of the photos
    mask: Path | None = None  # Output file for the mask of the parts that no camera of the rig sees


@dataclass(frozen=True, slots=True)
class JoinedPanorama:
    """The panorama of an instant, whether it is new, or why there is none."""

    panorama: str
    photos: tuple[str, ...]
    is_new: bool = True
    problem: str = ""


def join_panoramas(
    folder: Path,
    out: Path,
    *,
    cameras: Sequence[MountedCamera],
    options: JoinOptions,
    limits: PhotoLimits,
    progress: Progress,
) -> Iterator[JoinedPanorama]:
    """Join the photos of a folder; yield each panorama when it is written.

    An existing panorama of the same photos and the same rig is not made again.

    Raises:
        UsageError: No photo belongs to any camera, or the panoramas would be among the photos.
    """
    if out.resolve().is_relative_to(folder.resolve()):
        raise UsageError(
            "the panoramas would be among the photos", where=str(out), hint="choose another folder"
        )
    instants = photos_by_instant(cameras, list_photos(folder))
    for number, camera in enumerate(cameras):
        if not any(names[number] for names in instants.values()):
            raise UsageError(
                f"there is no photo of the camera {camera.photos}",
                where=str(folder),
                hint="names are relative to the folder; * stands for the instant",
            )
    progress.size(len(instants))
    is_masked = options.mask is None
    for instant, names in instants.items():
        progress.check()
        job = _Instant(folder, out / f"{instant}.jpg", cameras, names, options, limits)
        done = job.join()
        if not is_masked and not done.problem and options.mask is not None:
            write_mask(options.mask, job.seen())
            is_masked = True
        yield done
        progress.advance()


@dataclass(frozen=True, slots=True)
class _Instant:
    """Photos of one instant, by camera, and the file of their panorama."""

    folder: Path
    path: Path
    cameras: Sequence[MountedCamera]
    names: Sequence[str | None]
    options: JoinOptions
    limits: PhotoLimits

    def join(self) -> JoinedPanorama:
        there = tuple(name for name in self.names if name is not None)
        try:
            missing = [
                camera.photos for camera, name in zip(self.cameras, self.names, strict=True) if not name
            ]
            if missing:
                raise PhotoError(f"no photo of the camera {missing[0]}")
            contents = [read_file(self.folder / name, limits=self.limits) for name in there]
            key = self._key(contents)
            if _key_in(self.path) == key:
                return JoinedPanorama(self.path.name, there, is_new=False)
            photos, facts = self._read(contents)
            pixels, _ = join(photos, self._width(photos))
            write_panorama(self.path, pixels, tags=self._tags(facts, key))
            return JoinedPanorama(self.path.name, there)
        except PhotoError as error:
            return JoinedPanorama(self.path.name, there, problem=str(error))

    def seen(self) -> NDArray[np.bool_]:
        """Return which pixels of the panorama are seen by a camera, at two pixels per degree."""
        photos, _ = self._read(
            [read_file(self.folder / str(name), limits=self.limits) for name in self.names]
        )
        return join(photos, 720)[1]

    def _read(self, contents: Sequence[bytes]) -> tuple[list[RigPhoto], list[PhotoFacts]]:
        photos, facts = [], []
        for content, camera, name in zip(contents, self.cameras, self.names, strict=True):
            try:
                known = read_facts(content, limits=self.limits)
                fov = camera.fov_deg if camera.fov_deg is not None else known.fov_deg
                if fov is None:
                    raise PhotoError("its field of view is not known", hint="give fov_deg in the rig's file")
                photos.append(RigPhoto(read_upright(content, limits=self.limits), camera.with_fov(fov)))
                facts.append(known)
            except PhotoError as error:
                raise PhotoError(error.message, where=name, hint=error.hint) from error
        return photos, facts

    def _width(self, photos: Sequence[RigPhoto]) -> int:
        most = int((2e6 * self.limits.max_megapixels) ** 0.5)
        return min(self.options.width or panorama_width(photos), most, _WIDEST) // 2 * 2

    def _key(self, contents: Sequence[bytes]) -> str:
        rig = [[asdict(camera) for camera in self.cameras], self.options.width, _FORMAT]
        digests = [hashlib.sha256(content).hexdigest() for content in contents]
        return hashlib.sha256(json.dumps([rig, digests]).encode()).hexdigest()[:32]

    def _tags(self, facts: Sequence[PhotoFacts], key: str) -> CameraTags:
        """Collect time, position and heading, each from the most forward-looking photo that has it."""
        ahead = sorted(
            zip(self.cameras, facts, strict=True),
            key=lambda one: abs((one[0].yaw_deg + 180.0) % 360.0 - 180.0),
        )
        taken = next((known.taken_at for _, known in ahead if known.taken_at), None)
        gps = next((known.gps for _, known in ahead if isinstance(known.gps, Gps)), None)
        headings = (
            (known.heading.deg - camera.yaw_deg) % 360.0
            for camera, known in ahead
            if known.heading is not None and known.heading.reference != "M"
        )
        return CameraTags(
            None if taken is None else datetime.fromisoformat(taken),
            None,
            position=None if gps is None else LatLon(gps.lat, gps.lon),
            heading_deg=next(headings, None),
            accuracy_m=None if gps is None else gps.accuracy_m,
            unique_id=key,
        )


def _key_in(path: Path) -> str | None:
    """Read the key of an existing panorama; None if it is missing or has no key."""
    try:
        found: Mapping[int, object] = piexif.load(str(path))["Exif"]
    except (*DAMAGED, OSError):
        return None
    key = found.get(piexif.ExifIFD.ImageUniqueID)
    return key.decode("ascii", "replace") if isinstance(key, bytes) else None


def write_mask(path: Path, seen: NDArray[np.bool_]) -> None:
    """Write a mask for panoramas, black where nothing is seen, with the smallest possible cells.

    Raises StorageError.
    """
    for cell in _CELLS_DEG:
        rows, columns = 180 // cell, 360 // cell
        cells = seen.reshape(rows, seen.shape[0] // rows, columns, seen.shape[1] // columns)
        used: NDArray[np.bool_] = np.logical_and.reduce(cells, axis=(1, 3))
        if len(boxes_of_mask(used)) <= MOST_MASKED:
            break
    data = cv2.imencode(".png", np.repeat(np.repeat(used, cell, 0), cell, 1).astype(np.uint8) * 255)[1]
    path.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(path, data.tobytes())
