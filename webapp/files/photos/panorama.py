"""Panoramas: their XMP (Google's Photo Sphere), masks and views; the rigs that take them."""

from __future__ import annotations

import math
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from webapp.core.boxes import BlurBox
from webapp.core.geometry.equirectangular import ViewSize, sample, view_pixels, view_size
from webapp.core.geometry.rig import RigCamera
from webapp.core.geometry.tilt import LEVEL, Tilt
from webapp.core.mapmodel.panorama import FOCAL_35MM, LevelView, boxes_of_mask
from webapp.errors import InputError, PhotoError
from webapp.files.json_fields import JsonField, finite, parse_json
from webapp.files.listing import natural_key
from webapp.files.photos.photo import GrayPhoto, PhotoFacts, read_file, read_gray, scaled_gray
from webapp.files.photos.xmp import read_tilt
from webapp.settings import PhotoLimits

_GPANO = re.compile(rb'GPano:(\w+)\s*(?:=\s*["\']|>)\s*([^"\'<]+)')
_ASPECT, _TOLERANCE = 2.0, 0.01

MOST_MASKED = 300
"""Maximum number of boxes of a mask; those of a hundred panoramas are one edit."""

GREY = 128
"""Fills masked parts, which thus have no texture and no keypoints."""


@dataclass(frozen=True, slots=True)
class PanoramaTags:
    is_marked: bool  # It has the XMP of an equirectangular panorama
    is_whole: bool  # It is twice as wide as high, and was not cropped
    heading_deg: float | None  # Heading of its middle
    tilt: Tilt = LEVEL


def read_panorama(content: bytes, size: tuple[int, int]) -> PanoramaTags:
    """Read a photo's properties as a panorama."""
    tags = {
        name.decode(): value.decode("utf-8", "replace").strip() for name, value in _GPANO.findall(content)
    }
    is_whole = is_whole_sphere(*size)
    full, shown = tags.get("FullPanoWidthPixels"), tags.get("CroppedAreaImageWidthPixels")
    if full is not None and shown is not None and full != shown:
        is_whole = False
    marked = tags.get("ProjectionType", "").lower() == "equirectangular"
    tilt, _ = read_tilt(tags)
    return PanoramaTags(marked, is_whole, _number(tags.get("PoseHeadingDegrees")), tilt)


def is_whole_sphere(width: int, height: int) -> bool:
    """Check whether a photo has the aspect ratio of an equirectangular panorama of the whole sphere."""
    return height > 0 and abs(width / height - _ASPECT) <= _TOLERANCE * _ASPECT


def find_panorama(
    source: Path | bytes, facts: PhotoFacts, *, limits: PhotoLimits, assume: bool = False
) -> PanoramaTags | None:
    """Read a photo's properties as a panorama; None if it does not show the whole sphere.

    Args:
        assume: Whether to also accept a photo that is twice as wide as high but not marked as a panorama.
    """
    size = facts.width, facts.height
    if not is_whole_sphere(*size):  # saves reading most photos
        return None
    content = source if isinstance(source, bytes) else read_file(source, limits=limits)
    found = read_panorama(content, size)
    return found if found.is_whole and (found.is_marked or assume) else None


@dataclass(frozen=True, slots=True, eq=False)
class CutView:
    """A level view in grey, its horizontal field of view, and a mask of the pixels that are used."""

    photo: GrayPhoto
    fov_deg: float
    used: NDArray[np.bool_]


def read_level_view(
    source: bytes, view: LevelView, *, limits: PhotoLimits, max_side: int | None = None
) -> CutView:
    """Cut a level view out of a panorama's file, in grey. Raises PhotoError.

    Args:
        source: Content of the panorama's file.
        max_side: As for `read_gray`, for the view.
    """
    pixels = read_gray(source, limits=limits).pixels
    wide = pixels.shape[1]
    full = view_size(wide, FOCAL_35MM)
    scale = 1.0 if max_side is None else min(1.0, max_side / full.width)
    size = ViewSize(round(full.width * scale), round(full.height * scale), FOCAL_35MM)
    # Scaling the panorama down first avoids aliasing; its width must be even, as its height is half of it.
    cut, used = cut_level_view(scaled_gray(pixels, 2 * round(wide * scale / 2)).pixels, view, size=size)
    return CutView(GrayPhoto(cut, scale, (full.width, full.height)), full.camera.fov_deg, used)


def cut_level_view(
    pixels: NDArray[np.uint8], view: LevelView, *, size: ViewSize | None = None
) -> tuple[NDArray[np.uint8], NDArray[np.bool_]]:
    """Cut a level view out of a panorama.

    Args:
        pixels: (H, W) or (H, W, 3) uint8. The whole sphere.
        size: By default, the one with as many pixels per degree.

    Returns:
        view: (h, w) or (h, w, 3) uint8. Masked pixels are grey.
        used: (h, w) bool. Pixels that are not masked.
    """
    high, wide = pixels.shape[:2]
    size = size or view_size(wide, FOCAL_35MM)
    x, y, _ = view_pixels(size, panorama=(wide, high), turn_deg=view.turn_deg, tilt=view.tilt)
    cut = sample(pixels, x, y)
    used = np.ones(cut.shape[:2], np.bool_)
    across, down = ((x + 0.5) / wide) % 1.0, (y + 0.5) / high
    for box in view.masked:
        # where the panorama is level, `across` is the same in all rows
        inside = (across >= box.x) & (across <= box.x + box.width)
        columns = np.flatnonzero(inside.any(0))
        below, above = down[:, columns] < box.y, down[:, columns] > box.y + box.height
        used[:, columns] &= below | above | ~inside[:, columns]
    cut[~used] = GREY
    return cut, used


def _number(text: str | None) -> float | None:
    try:
        value = float(text) if text is not None else math.nan
    except ValueError:
        return None
    return value % 360.0 if math.isfinite(value) else None


def read_mask(source: Path, *, limits: PhotoLimits) -> tuple[BlurBox, ...]:
    """Read a mask of panoramas: an image twice as wide as high, with masked parts black."""
    pixels = read_gray(source, limits=limits).pixels
    if not is_whole_sphere(pixels.shape[1], pixels.shape[0]):
        raise PhotoError("a mask must be twice as wide as high, like the panoramas", where=str(source))
    boxes = boxes_of_mask(pixels >= GREY)
    if len(boxes) > MOST_MASKED:
        raise PhotoError(
            f"the mask is too ragged: it would take {len(boxes)} boxes, more than the limit of {MOST_MASKED}",
            where=str(source),
            hint="draw what is masked as a few black areas with straight edges",
        )
    return boxes


_MOST = 64
"""Maximum number of cameras of a rig."""


@dataclass(frozen=True, slots=True)
class MountedCamera:
    """A camera of a rig, and the pattern of its photos' names."""

    photos: str  # Pattern with one `*` for the instant: `left/*.jpg`, `frame_*_left.png`
    # `yaw_deg`, `pitch_deg`, `roll_deg`: See `RigCamera`.
    yaw_deg: float
    pitch_deg: float
    roll_deg: float
    fov_deg: float | None  # None to use the EXIF of each photo

    def with_fov(self, fov_deg: float) -> RigCamera:
        return RigCamera(self.yaw_deg, self.pitch_deg, self.roll_deg, fov_deg)

    def instant(self, name: str) -> str | None:
        """Return the part of a photo's name that identifies the instant; None if it is not this camera's."""
        before, after = self.photos.split("*")
        if not name.startswith(before) or not name.endswith(after) or len(name) <= len(before + after):
            return None
        found = name[len(before) : len(name) - len(after)]
        return None if "/" in found else found


def read_rig(path: Path) -> tuple[MountedCamera, ...]:
    try:
        data = path.read_bytes()
    except OSError as error:
        raise InputError(f"the file cannot be read: {error.strerror}", where=str(path)) from error
    field = parse_json(data, where=str(path)).record(required=["cameras"])["cameras"]
    cameras = tuple(_camera(item) for item in field.items())
    if not 1 <= len(cameras) <= _MOST:
        raise field.error(f"has {len(cameras)} cameras", hint=f"name 1 to {_MOST}")
    if len({camera.photos for camera in cameras}) < len(cameras):
        raise field.error("has two cameras with the same photos", hint="give each camera photos of its own")
    return cameras


def _camera(item: JsonField) -> MountedCamera:
    fields = item.record(required=["photos", "yaw_deg"], optional=["pitch_deg", "roll_deg", "fov_deg"])
    photos = fields["photos"].text()
    if photos.count("*") != 1:
        raise fields["photos"].error("needs one * for the instant", hint="as in left/*.jpg")

    def angle(name: str, most: float) -> float:
        if fields[name].missing:
            return 0.0
        return fields[name].number(
            f"from {-most:g} to {most:g} degrees", valid=lambda value: finite(value) and abs(value) <= most
        )

    fov = None
    if not fields["fov_deg"].missing:
        fov = fields["fov_deg"].number("from 1 to 170 degrees", valid=lambda value: 1.0 <= value <= 170.0)
    return MountedCamera(
        photos, angle("yaw_deg", 360.0), angle("pitch_deg", 90.0), angle("roll_deg", 360.0), fov
    )


def photos_by_instant(
    cameras: Sequence[MountedCamera], names: Sequence[str]
) -> Mapping[str, tuple[str | None, ...]]:
    """Group photos by the instant in their names, in natural order; one name or None per camera."""
    found: dict[str, list[str | None]] = {}
    for number, camera in enumerate(cameras):
        for name in names:
            instant = camera.instant(name)
            if instant is not None:
                found.setdefault(instant, [None] * len(cameras))[number] = name
    return {instant: tuple(found[instant]) for instant in sorted(found, key=natural_key)}
