"""Writes satellite images into a map's folder, named by their content."""

from __future__ import annotations

import hashlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from webapp.files.atomic import storage_error, write_bytes
from webapp.files.part_file import move_in

QUALITY = 92
"""Of JPEG."""


def keep_file(source: Path, folder: Path) -> str:
    """Move a PNG or JPEG file into the map's folder, named by its hash.

    Args:
        source: On the same disk.
        folder: Folder of the map.

    Returns:
        `satellite-<8 hexadecimal digits of its hash>.png` or `.jpg`.
    """
    with source.open("rb") as file:
        digest = hashlib.file_digest(file, "sha256").hexdigest()
        file.seek(0)
        suffix = ".png" if file.read(4) == b"\x89PNG" else ".jpg"
    name = f"satellite-{digest[:8]}{suffix}"
    move_in(source, folder / name)
    return name


def keep_pixels(pixels: NDArray[np.uint8], folder: Path, *, lossless: bool = True) -> str:
    """Write an image to the map's folder, named by its hash.

    Args:
        pixels: (h, w, 3) uint8. Blue, green, red.
        folder: Folder of the map.
        lossless: PNG, else JPEG.

    Returns:
        As `keep_file`.
    """
    if lossless:
        data = cv2.imencode(".png", pixels)[1].tobytes()
    else:
        data = cv2.imencode(".jpg", pixels, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])[1].tobytes()
    name = f"satellite-{hashlib.sha256(data).hexdigest()[:8]}{'.png' if lossless else '.jpg'}"
    with writing(folder):
        folder.mkdir(parents=True, exist_ok=True)
    write_bytes(folder / name, data)
    return name


@contextmanager
def writing(folder: Path) -> Iterator[None]:
    """Distinguish a failing disk from a damaged image."""
    try:
        yield
    except OSError as error:
        raise storage_error(error, where=folder.name) from error
