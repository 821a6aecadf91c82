"""The image of a floor, resampled so that it covers a map."""

from __future__ import annotations

import math

import cv2
import numpy as np

from webapp.core.geo.floors import FloorImage
from webapp.files.satellite.raster import Pixels, Raster, reduced


def warp_to_map(raster: Raster, image: FloorImage, *, size: tuple[int, int], side: int) -> Pixels:
    """Resample the image of a floor to cover the whole map.

    Args:
        size: Width and height of the map, map pixels.
        side: Maximum pixels of the longer side; fewer if the image has a lower resolution.

    Returns:
        (h, w, 4) uint8: Red, green, blue, opacity; transparent outside the image.
    """
    pixels = reduced(raster, side)
    a, b, c, d, e, f = image.map_from_image
    shrunk = raster.width / pixels.shape[1], raster.height / pixels.shape[0]
    map_from_pixel = np.array([[a * shrunk[0], b * shrunk[1], c], [d * shrunk[0], e * shrunk[1], f]])
    finest = 1.0 / math.sqrt(abs(float(np.linalg.det(map_from_pixel[:, :2]))))
    scale = min(side / max(size), finest)
    width, height = (max(1, round(length * scale)) for length in size)
    matrix = np.diag([width / size[0], height / size[1]]) @ map_from_pixel
    # the origin of OpenCV is the centre of the first pixel, that of a map its outer corner
    matrix[:, 2] += matrix[:, :2] @ (0.5, 0.5) - 0.5
    opaque = np.dstack([pixels, np.full(pixels.shape[:2], 255, np.uint8)])
    return np.asarray(cv2.warpAffine(opaque, matrix, (width, height), flags=cv2.INTER_LINEAR), np.uint8)
