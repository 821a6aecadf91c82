"""Small upright pictures of a photo for pages: without EXIF, so that they give nothing away."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from pathlib import Path
from threading import BoundedSemaphore
from typing import Literal

import cv2

from webapp.core.blur import BlurBox, blur
from webapp.files.atomic import write_bytes
from webapp.files.listing import DERIVED
from webapp.files.photos.photo import read_upright
from webapp.settings import PhotoLimits

Kind = Literal["thumb", "preview"]

SIDES: Mapping[Kind, int] = {"preview": 1600, "thumb": 256}
"""Pixels of the longer side, the larger first; a smaller photo stays as it is."""

_QUALITY = 85
_DECODING = BoundedSemaphore(2)
"""A photo of the largest size takes several hundred MB while it is decoded."""


def make_previews(source: Path, *, limits: PhotoLimits, blurred: Sequence[BlurBox] = ()) -> dict[Kind, bytes]:
    """Decode a photo completely and make its previews.

    Parameters
    ----------
    blurred : sequence of BlurBox
        Parts of the upright photo that are made unrecognisable.

    Returns
    -------
    dict of str to bytes
        JPEG files.

    Raises
    ------
    PhotoError
        It is not a photo, damaged, cut off, or larger than the limits.
    """
    found: dict[Kind, bytes] = {}
    with _DECODING:
        pixels = read_upright(source, limits=limits, max_side=max(SIDES.values()))
    pixels = blur(pixels, blurred)
    for kind, side in SIDES.items():
        height, width = pixels.shape[:2]
        scale = side / max(height, width)
        if scale < 1.0:
            size = (max(1, round(width * scale)), max(1, round(height * scale)))
            pixels = cv2.resize(pixels, size, interpolation=cv2.INTER_AREA)
        done, data = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
        assert done, "a JPEG of at most 1600 pixels can always be written"
        found[kind] = data.tobytes()
    return found


def preview_path(map_folder: Path, photo_id: int | str, *, kind: Kind) -> Path:
    """Name the file of a preview, by the id of the photo: it is never used for another one."""
    return map_folder / DERIVED / "previews" / f"{photo_id}-{SIDES[kind]}.jpg"


def write_previews(map_folder: Path, photo_id: int | str, *, previews: Mapping[Kind, bytes]) -> None:
    """Keep the previews of a photo.

    Raises
    ------
    StorageError
        The disk refused; they can be made again from the photo.
    """
    for kind, data in previews.items():
        path = preview_path(map_folder, photo_id, kind=kind)
        path.parent.mkdir(parents=True, exist_ok=True)
        write_bytes(path, data)
