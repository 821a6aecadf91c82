"""A photo: its metadata, its upright pixels, and small pictures of it without EXIF, for privacy."""

from __future__ import annotations

import hashlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from threading import BoundedSemaphore
from typing import Literal

import cv2
import numpy as np
from PIL import Image

from webapp.core.blur import blur
from webapp.core.boxes import BlurBox
from webapp.core.texts import tidy_name
from webapp.errors import PhotoError
from webapp.files.atomic import write_bytes
from webapp.files.decode import Pixels, check_bytes, decode, open_image
from webapp.files.listing import DERIVED
from webapp.files.part_file import discard
from webapp.files.photos.exif import (
    EXIF,
    Fov,
    Gps,
    Heading,
    NoGps,
    fov_note,
    orientation,
    read_exif,
    read_fov,
    read_time,
    text,
)
from webapp.files.photos.xmp import locate, panorama_notes, read_xmp
from webapp.settings import PhotoLimits
from webapp.threads import permit

POSITION_FROM = "its position is from "
"""How the remark on the source of a position begins."""

_MAKER, _MODEL = 0x010F, 0x0110
_DECODING = BoundedSemaphore(2)
"""Limit of parallel decoding: a photo of the largest size takes several hundred MB."""

_MOST_CAMERA = 100
"""Maximum characters of the name of a camera."""


@dataclass(frozen=True, slots=True)
class PhotoFacts:
    """Facts about a photo that are known without decoding it."""

    # `width`, `height`: Of the upright photo, pixels.
    width: int
    height: int
    # 1 to 8: how the stored pixels are turned (EXIF). 1 if the decoder itself turns them (HEIC).
    orientation: int
    gps: Gps | NoGps
    heading: Heading | None  # With its reference, true or magnetic north
    taken_at: str | None  # ISO 8601; local time if it has no offset
    fov: Fov | None  # Horizontal field of view of the upright photo, and its source
    notes: tuple[str, ...] = ()  # Sentences about oddities
    format: str = ""  # By content, as Pillow names it: `JPEG`, `HEIF`, `PNG` ..
    maker: str | None = None  # Manufacturer of the camera; empty if EXIF lacks it, None if there is no EXIF
    camera: str | None = None  # Maker and model of the camera, if EXIF has them
    pitch_deg: float | None = None  # Of the camera above the horizon (below: negative), as drones write it

    @property
    def heading_deg(self) -> float | None:
        """Degrees clockwise from the north that `heading.reference` names."""
        return None if self.heading is None else self.heading.deg

    @property
    def fov_deg(self) -> float | None:
        """Horizontal field of view of the upright photo, degrees."""
        return None if self.fov is None else self.fov.deg


def remarks(facts: PhotoFacts) -> tuple[str, ...]:
    """Return sentences about a photo's file: where its position is from, unless from EXIF, and the notes."""
    gps = facts.gps
    if isinstance(gps, Gps) and gps.source != EXIF:
        return (f"{POSITION_FROM}{gps.source}", *facts.notes)
    return facts.notes


@dataclass(frozen=True, slots=True)
class GrayPhoto:
    """An upright grey photo, possibly scaled down."""

    pixels: Pixels  # (h, w) uint8
    scale: float  # At most 1; lengths in `pixels` divided by this are lengths in the full-size upright photo
    full_size: tuple[int, int]  # Width and height of the full-size upright photo, pixels

    def turned(self, quarters: int) -> GrayPhoto:
        """Return it rotated clockwise by quarter turns."""
        width, height = self.full_size
        size = (height, width) if quarters % 2 else (width, height)
        return GrayPhoto(np.ascontiguousarray(np.rot90(self.pixels, -quarters)), self.scale, size)


def read_file(path: Path, *, limits: PhotoLimits) -> bytes:
    try:
        check_bytes(path, limits)
        return path.read_bytes()
    except PhotoError as error:
        raise PhotoError(error.message, where=str(path), hint=error.hint) from error
    except OSError as error:
        raise PhotoError(f"it cannot be read: {error.strerror or error}", where=str(path)) from error


def read_facts(source: Path | bytes, *, limits: PhotoLimits) -> PhotoFacts:
    """Read the metadata of a photo from its header.

    Damaged or odd EXIF is left out and noted. Truncation after the header is not detected.

    Raises:
        PhotoError: The file is missing, not an image of a known format, exceeds the limits, or its header is
            damaged.
    """
    with open_image(source, limits=limits) as image:
        exif, xmp = read_exif(image), read_xmp(image)
        turn, note = orientation(exif)
        kind = image.format or ""
        width, height = image.size if turn < 5 or _turned_by_decoder(image) else image.size[::-1]
    there = locate(exif.gps, xmp)
    fov = read_fov(exif, width=width, height=height)
    shape = panorama_notes(xmp, width=width, height=height, has_fov=fov is not None)
    notes = (note, xmp.note, fov_note(exif, width=width, height=height), *shape)
    return PhotoFacts(
        width=width,
        height=height,
        orientation=turn,
        gps=there.gps,
        heading=there.heading,
        taken_at=read_time(exif),
        fov=fov,
        notes=(*exif.notes, *filter(None, notes)),
        format=kind,
        maker=text(exif.image.get(_MAKER)) if exif.image else None,
        camera=_camera(text(exif.image.get(_MAKER)), text(exif.image.get(_MODEL))) if exif.image else None,
        pitch_deg=there.pitch_deg,
    )


def _camera(maker: str, model: str) -> str | None:
    """Return the name of a camera; the names of many models already begin with the maker."""
    first = maker.casefold().split()[:1]
    known = first and model.casefold().split()[:1] == first
    return tidy_name(model if known else f"{maker} {model}", most=_MOST_CAMERA)


def read_upright(source: Path | bytes, *, limits: PhotoLimits, max_side: int | None = None) -> Pixels:
    """Read a photo in colour, upright.

    Args:
        source: A file, or its content; of several frames or pages, the first is read.
        max_side: Scale down to this many pixels on the longer side; never up.

    Returns:
        (h, w, 3) uint8: Blue, green, red.
    """
    pixels, _ = _scaled(_read(source, "RGB", limits=limits), max_side)
    return np.asarray(cv2.cvtColor(pixels, cv2.COLOR_RGB2BGR), dtype=np.uint8)


def read_blurred(
    source: Path | bytes, boxes: Iterable[BlurBox], *, limits: PhotoLimits, max_side: int | None = None
) -> Pixels:
    """Read a photo like `read_upright`, with boxes blurred: for everything that is shown to somebody."""
    return blur(read_upright(source, limits=limits, max_side=max_side), boxes)


def read_in_turn(source: Path, *, limits: PhotoLimits, max_side: int) -> Pixels:
    """Read a photo like `read_upright`, with a limit of parallel decoding in this process.

    Raises PhotoError, Busy.
    """
    with permit(_DECODING):
        return read_upright(source, limits=limits, max_side=max_side)


def read_gray(source: Path | bytes, *, limits: PhotoLimits, max_side: int | None = None) -> GrayPhoto:
    """Read a photo in grey, upright; for a colour JPEG, this is the stored luma.

    Args:
        source: A file, or its content; of several frames or pages, the first is read.
        max_side: Scale down to this many pixels on the longer side; never up.
    """
    return scaled_gray(_read(source, "L", limits=limits), max_side)


def scaled_gray(full: Pixels, max_side: int | None) -> GrayPhoto:
    """Scale a grey photo down to `max_side` pixels on the longer side; never up."""
    pixels, scale = _scaled(full, max_side)
    return GrayPhoto(pixels, scale, (full.shape[1], full.shape[0]))


def turn_upright(pixels: Pixels, orientation: int) -> Pixels:
    """Rotate and mirror stored pixels according to an EXIF orientation of 1 to 8.

    Args:
        pixels: (h, w) or (h, w, 3) uint8
    """
    if orientation >= 5:
        pixels = pixels.swapaxes(0, 1)
    if orientation in (3, 4, 7, 8):
        pixels = pixels[::-1]
    if orientation in (2, 3, 6, 7):
        pixels = pixels[:, ::-1]
    return np.ascontiguousarray(pixels)


def _read(source: Path | bytes, mode: Literal["L", "RGB"], *, limits: PhotoLimits) -> Pixels:
    with open_image(source, limits=limits) as image:
        turn, _ = orientation(read_exif(image))
        by_decoder = _turned_by_decoder(image)
        pixels = decode(image, mode)
    return turn_upright(pixels, 1 if by_decoder else turn)


def _turned_by_decoder(image: Image.Image) -> bool:
    """Return whether Pillow applies the orientation itself, as for TIFF; HEIC comes without one."""
    return image.format == "TIFF"


def _scaled(pixels: Pixels, max_side: int | None) -> tuple[Pixels, float]:
    scale = 1.0 if max_side is None else min(1.0, max_side / max(pixels.shape[:2]))
    if scale == 1.0:
        return pixels, scale
    if min(pixels.shape[:2]) * scale < 0.5:
        size = tuple(max(1, round(side * scale)) for side in pixels.shape[1::-1])
        return np.asarray(cv2.resize(pixels, size, interpolation=cv2.INTER_AREA), dtype=np.uint8), scale
    small = cv2.resize(pixels, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return np.asarray(small, dtype=np.uint8), scale


Kind = Literal["thumb", "preview"]

SIDES: Mapping[Kind, int] = {"preview": 1600, "thumb": 256}
"""Pixels of the longer side, the larger first; a smaller photo is not scaled up."""

_SUFFIX: Mapping[Kind, str] = {"preview": ".jpg", "thumb": ".webp"}
"""WebP saves a third of the bytes; but a large picture takes 0.1 s, thirty times as long as JPEG."""
_ENCODING: Mapping[Kind, tuple[int, int]] = {
    "preview": (cv2.IMWRITE_JPEG_QUALITY, 85),
    "thumb": (cv2.IMWRITE_WEBP_QUALITY, 65),
}


def make_previews(source: Path, *, limits: PhotoLimits, blurred: Sequence[BlurBox] = ()) -> dict[Kind, bytes]:
    """Decode a photo completely and make its previews.

    Raises:
        PhotoError: It is not a photo, is damaged or truncated, or exceeds the limits.
        Busy: Too many others are being decoded.
    """
    found: dict[Kind, bytes] = {}
    pixels = blur(read_in_turn(source, limits=limits, max_side=max(SIDES.values())), blurred)
    for kind, side in SIDES.items():
        height, width = pixels.shape[:2]
        scale = side / max(height, width)
        if scale < 1.0:
            size = (max(1, round(width * scale)), max(1, round(height * scale)))
            pixels = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
        done, data = cv2.imencode(_SUFFIX[kind], pixels, _ENCODING[kind])
        assert done, "a picture of at most 1600 pixels can always be written"
        found[kind] = data.tobytes()
    return found


def blur_key(blurred: Sequence[BlurBox]) -> str | None:
    """Return a key of the blurred boxes; None if there are none."""
    return hashlib.sha256(repr(list(blurred)).encode()).hexdigest()[:12] if blurred else None


def preview_name(stem: str, kind: Kind, *, blurred: Sequence[BlurBox] = ()) -> str:
    """Return the file name of a preview, which depends on the blurred boxes.

    A preview made before the photo was blurred, but written afterwards, is thus not taken for a blurred one.
    """
    look = blur_key(blurred)
    return f"{f'{stem}-{look}' if look else stem}-{SIDES[kind]}{_SUFFIX[kind]}"


def previews_folder(folder: Path) -> Path:
    """Return the folder of the previews of a map's or a mission's photos, in its own folder."""
    return folder / DERIVED / "previews"


def preview_path(
    map_folder: Path, photo_id: int | str, *, kind: Kind, blurred: Sequence[BlurBox] = ()
) -> Path:
    return previews_folder(map_folder) / preview_name(f"{photo_id}", kind, blurred=blurred)


def write_previews(
    folder: Path, stem: str, *, previews: Mapping[Kind, bytes], blurred: Sequence[BlurBox] = ()
) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for kind, data in previews.items():
        path = folder / preview_name(stem, kind, blurred=blurred)
        write_bytes(path, data)
        if path.suffix != ".jpg":
            discard(path.with_suffix(".jpg"))  # its name in version 0.7.0
