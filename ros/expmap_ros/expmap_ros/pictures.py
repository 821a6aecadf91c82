"""Converts image messages to photos in common formats, and back, without cv_bridge."""

from __future__ import annotations

import struct
import zlib
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import CompressedImage, Image

Pixels = NDArray[np.uint8]


class UnusableImage(Exception):
    """An image message cannot be read."""


def _as(*channels: int) -> Callable[[Pixels], Pixels]:
    """Return a function that selects these channels, in this order."""
    return lambda pixels: pixels[..., list(channels)]


_ENCODINGS: dict[str, tuple[int, Callable[[Pixels], Pixels]]] = {
    "mono8": (1, _as(0)),
    "8UC1": (1, _as(0)),
    "mono16": (2, _as(1)),  # the high byte
    "rgb8": (3, _as(0, 1, 2)),
    "8UC3": (3, _as(2, 1, 0)),
    "bgr8": (3, _as(2, 1, 0)),
    "rgba8": (4, _as(0, 1, 2)),
    "bgra8": (4, _as(2, 1, 0)),
    "yuv422": (2, _as(1)),  # luminance: localization needs no colour
    "uyvy": (2, _as(1)),
    "yuv422_yuy2": (2, _as(0)),
    "yuyv": (2, _as(0)),
}
"""Bytes per pixel, and the conversion to grey or red, green, blue."""


def pixels_of(message: Image) -> Pixels:
    """Read an image message. Raises UnusableImage.

    Returns:
        (height, width, 1 or 3) uint8: Grey, or red, green, blue.
    """
    if message.encoding not in _ENCODINGS:
        known = ", ".join(_ENCODINGS)
        raise UnusableImage(f"images of the encoding {message.encoding!r} cannot be read; these can: {known}")
    size, convert = _ENCODINGS[message.encoding]
    row, height, width = message.step, message.height, message.width
    data = np.frombuffer(message.data, np.uint8)
    if not (height and width) or row < width * size or len(data) < row * height:
        raise UnusableImage(f"an image of {width} x {height} pixels with {len(data)} bytes, {row} a row")
    pixels = data[: row * height].reshape(height, row)[:, : width * size].reshape(height, width, size)
    if message.encoding == "mono16" and message.is_bigendian:
        return pixels[..., :1]
    return convert(pixels)


def photo_of(message: Image | CompressedImage) -> tuple[bytes, str]:
    """Convert an image message to a photo; a compressed image is returned unchanged. Raises UnusableImage.

    Returns:
        data:
        ending: Suffix of its file name.
    """
    if isinstance(message, Image):
        return png_of(pixels_of(message)), ".png"
    data = bytes(message.data)
    if not data:
        raise UnusableImage("a compressed image without content")
    return data, ".png" if data.startswith(b"\x89PNG") else ".jpg"


def png_of(pixels: Pixels) -> bytes:
    """Encode (height, width, 1 or 3) uint8 as PNG; fast rather than small."""
    height, width, channels = pixels.shape
    rows = np.zeros((height, 1 + width * channels), np.uint8)  # each row begins with its filter type: 0, none
    rows[:, 1:] = pixels.reshape(height, -1)
    head = struct.pack(">IIBBBBB", width, height, 8, 2 if channels == 3 else 0, 0, 0, 0)
    chunks = ((b"IHDR", head), (b"IDAT", zlib.compress(rows.tobytes(), 1)), (b"IEND", b""))
    return b"\x89PNG\r\n\x1a\n" + b"".join(
        struct.pack(">I", len(data)) + kind + data + struct.pack(">I", zlib.crc32(kind + data))
        for kind, data in chunks
    )


def image_of(pixels: Pixels, header: Any) -> Image:
    """Convert (height, width, 3) uint8, red, green, blue, to an image message."""
    height, width, _ = pixels.shape
    message = Image(header=header, height=height, width=width, encoding="rgb8", step=3 * width)
    message.data.frombytes(np.ascontiguousarray(pixels).tobytes())
    return message
