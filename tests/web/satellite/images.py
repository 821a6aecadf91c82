"""Images for tests, and a check of error responses."""

import io

import numpy as np
import rasterio
from affine import Affine
from PIL import Image

CORNERS = {"top_left": {"lat": 50.001, "lon": 14.0}, "bottom_right": {"lat": 50.0, "lon": 14.002}}
LARGER = {"top_left": {"lat": 50.002, "lon": 13.999}, "bottom_right": {"lat": 49.999, "lon": 14.003}}


def png(width, height, *, shade=120, kind="PNG", **options):
    y, x = np.mgrid[0:height, 0:width]
    pixels = np.stack([x % 256, y % 256, np.full_like(x, shade)], axis=2).astype(np.uint8)
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, format=kind, **options)
    return buffer.getvalue()


def geotiff(width=60, height=40, crs="EPSG:32633", west=500000.0):
    with rasterio.MemoryFile() as memory:
        options = {"width": width, "height": height, "count": 3, "dtype": "uint8"}
        transform = Affine(0.5, 0.0, west, 0.0, -0.5, 5540000.0)
        with memory.open(driver="GTiff", crs=crs, transform=transform, **options) as out:
            out.write(np.full((3, height, width), 77, np.uint8))
        return memory.read()


def message(answer, status):
    assert answer.status_code == status, answer.text
    return answer.json["error"]["message"]
