"""Measures the maximum cost of decoding a photo within the limits: time and memory, by format.

    python -m benchmarks.decode_costs [--megapixels 120]

Makes files of the largest size allowed: flat ones, which have few bytes, and noise. Each is then read in a
separate process, like an upload. Prints a JSON object: seconds of processor time, megabytes by which the
process grew, and megabytes of the file; or why the file is refused. HEIC and AVIF have a sixteenth of the
pixels: they take long to encode, and more than proportionally long to decode. Colours of 16 bits have 30
megapixels, as larger ones are not stretched.
"""

from __future__ import annotations

import argparse
import functools
import io
import json
import multiprocessing
import resource
import time
from collections.abc import Callable
from typing import Any

import cv2
import numpy as np
import pillow_heif
from PIL import Image

from tests.photo_files import progressive_jpeg
from webapp.errors import PhotoError
from webapp.files.decode import MOST_OF_16_BITS
from webapp.files.photos.photo import read_upright
from webapp.settings import PhotoLimits

_MAX_SIDE = 1600


def main() -> None:
    """Measure and print one JSON object."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--megapixels", type=float, default=PhotoLimits().max_megapixels)
    megapixels = parser.parse_args().megapixels
    height = int((megapixels * 1e6 / 1.5) ** 0.5)
    size = (int(megapixels * 1e6 // height), height)
    context = multiprocessing.get_context("spawn")
    figures = {}
    for name in _kinds():
        with context.Pool(1, maxtasksperchild=1) as pool:
            data = pool.apply(_make, (name, size))
            figures[name] = pool.apply(_measure, (data,))
        print(name, figures[name], flush=True)
    print(json.dumps({"megapixels": megapixels, "formats": figures}, indent=2))


def _kinds() -> dict[str, Callable[[Image.Image], bytes]]:
    """Return the encoder of each kind of file, by name."""
    save = _saved
    return {
        "jpeg flat": functools.partial(save, form="JPEG"),
        "jpeg noise": functools.partial(save, form="JPEG", quality=60, subsampling=0),
        "jpeg progressive flat": functools.partial(save, form="JPEG", progressive=True, subsampling=0),
        "jpeg progressive noise": functools.partial(save, form="JPEG", progressive=True, quality=40),
        "jpeg 32 scans": lambda image: progressive_jpeg(32, size=image.size),
        "png flat": functools.partial(save, form="PNG", compress_level=9),
        "png 16 bits black": functools.partial(_deep_png, white=0),
        "png 16 bits dark": functools.partial(_deep_png, white=1000),
        "webp flat": functools.partial(save, form="WEBP", lossless=True, method=0),
        "webp noise": functools.partial(save, form="WEBP", quality=30, method=0),
        "tiff lzw flat": functools.partial(save, form="TIFF", compression="tiff_lzw"),
        "jpeg2000 flat": functools.partial(save, form="JPEG2000"),
        "jpeg2000 noise": functools.partial(save, form="JPEG2000", quality_mode="rates", quality_layers=[8]),
        "gif flat": functools.partial(save, form="GIF"),
        "heic flat": functools.partial(save, form="HEIF", quality=10),
        "heic noise": functools.partial(save, form="HEIF", quality=5),
        "avif flat": functools.partial(save, form="AVIF", quality=10, speed=10),
        "avif noise": functools.partial(save, form="AVIF", quality=10, speed=10),
    }


def _saved(image: Image.Image, *, form: str, **options: Any) -> bytes:
    file = io.BytesIO()
    image.save(file, form, **options)
    return file.getvalue()


def _deep_png(image: Image.Image, *, white: int) -> bytes:
    """Make a PNG of 16 bits per colour, with alpha, of no more pixels than are stretched."""
    width, height = image.size
    scale = min(1.0, (MOST_OF_16_BITS / (width * height)) ** 0.5)
    width, height = int(width * scale), int(height * scale)
    row = np.full((1, width, 4), 65535, np.uint16)
    row[:, :, :3] = np.linspace(0, white, width)[:, None]
    return bytes(cv2.imencode(".png", np.repeat(row, height, axis=0))[1])


def _make(name: str, size: tuple[int, int]) -> bytes:
    pillow_heif.register_heif_opener()
    if name.startswith(("webp", "jpeg2000")):
        size = (size[0] // 2, size[1] // 2)  # their limit is a third of the pixels
    if name.startswith(("heic", "avif")):
        size = (size[0] // 4, size[1] // 4)
    if name.endswith("flat"):
        image = Image.new("RGB", size, (90, 120, 60))
    else:
        noise = np.random.default_rng(0).integers(0, 256, (1000, 1000, 3), dtype=np.uint8)
        repeats = (-(-size[1] // 1000), -(-size[0] // 1000), 1)
        image = Image.fromarray(np.tile(noise, repeats)[: size[1], : size[0]])
    return _kinds()[name](image)


def _measure(data: bytes) -> dict[str, Any]:
    before = resource.getrusage(resource.RUSAGE_SELF)
    started = time.perf_counter()
    result: dict[str, Any] = {"file_mb": round(len(data) / 1e6, 1)}
    try:
        read_upright(data, limits=PhotoLimits(), max_side=_MAX_SIDE)
    except PhotoError as error:
        result["refused"] = error.message
    after = resource.getrusage(resource.RUSAGE_SELF)
    cpu = after.ru_utime + after.ru_stime - before.ru_utime - before.ru_stime
    grown = (after.ru_maxrss - before.ru_maxrss) / 1024
    return {
        **result,
        "cpu_s": round(cpu, 2),
        "wall_s": round(time.perf_counter() - started, 2),
        "peak_mb": round(grown),
    }


if __name__ == "__main__":
    main()
