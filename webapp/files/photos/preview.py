"""Small upright pictures of a photo for web pages; they have no EXIF, for privacy."""

from __future__ import annotations

import hashlib
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Literal

import cv2

from webapp.core.blur import blur
from webapp.core.boxes import BlurBox
from webapp.files.atomic import write_bytes
from webapp.files.listing import DERIVED
from webapp.files.part_file import discard
from webapp.files.photos.photo import read_in_turn
from webapp.settings import PhotoLimits

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

    Args:
        blurred: Parts of the upright photo to blur.

    Returns:
        A JPEG file for the preview, a WebP file for the thumb.

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
    """Return the path of a preview of a photo of a map or a mission."""
    return previews_folder(map_folder) / preview_name(f"{photo_id}", kind, blurred=blurred)


def write_previews(
    folder: Path, stem: str, *, previews: Mapping[Kind, bytes], blurred: Sequence[BlurBox] = ()
) -> None:
    """Write the previews of a photo into a folder, which is created if missing.

    Args:
        stem: Beginning of their names.
        blurred: Those with which the previews were made.

    Raises:
        StorageError: Writing failed; they can be made again from the photo.
    """
    folder.mkdir(parents=True, exist_ok=True)
    for kind, data in previews.items():
        path = folder / preview_name(stem, kind, blurred=blurred)
        write_bytes(path, data)
        if path.suffix != ".jpg":
            discard(path.with_suffix(".jpg"))  # its name in version 0.7.0
