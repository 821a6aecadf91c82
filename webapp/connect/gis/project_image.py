"""The images of a map as GDAL reads them in place: a picture, and a `.vrt` that says where it is."""

from __future__ import annotations

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from webapp.core.geo.affine import Affine
from webapp.core.geo.crs import latlon_from_plane, parse_crs
from webapp.core.geo.floors import BASE_FLOOR, FloorImage
from webapp.core.mapmodel.model import SatelliteImage
from webapp.errors import PhotoError, UsageError
from webapp.files.atomic import write_bytes
from webapp.files.decode import Pixels
from webapp.settings import Settings
from webapp.tasks.exchange.export_source import Source, satellite_picture

_SIDE = 8192
"""Pixels of the longer side that a picture has at most."""

_QUALITY = 90
_STRAIGHT = 1e-9
_CORNERS = ((0.0, 0.0), (0.0, 1.0), (1.0, 1.0), (1.0, 0.0))

Matrix = NDArray[np.float64]
Box = tuple[float, float, float, float]


@dataclass(frozen=True, slots=True)
class ProjectImage:
    """An image of a map, and where it is."""

    title: str
    file: Path
    description: bytes  # A `.vrt` of GDAL, which names the file
    plane: str  # Its coordinate system
    plane_box: Box  # West, south, east, north
    box: Box | None  # The same in degrees; None if a corner has no position

    @property
    def description_name(self) -> str:
        return f"{self.file.stem}.vrt"


def images_of(source: Source, folder: Path, *, settings: Settings) -> list[ProjectImage]:
    """Write the images of a map and of its floors into a folder, the map's own first.

    A floor whose file is missing is left out; the checks of the map report it.

    Raises:
        UsageError: The map has no georeference.
        PhotoError: The map's own image cannot be read.
    """
    map_, georeference = source.map, source.georeference()
    own = map_.floor_named(BASE_FLOOR)
    title = source.title if own is None else f"{source.title}: {own.name}"
    wanted: list[tuple[str, SatelliteImage | FloorImage, Matrix]] = [(title, map_.satellite, np.eye(3))]
    wanted += [
        (f"{source.title}: {floor.name}", floor.image, _matrix(floor.image.map_from_image))
        for floor in map_.floors
        if floor.image is not None
    ]
    found = []
    for number, (title, image, map_from_image) in enumerate(wanted):
        pixels = satellite_picture(source.cfg, image.path, side=_SIDE, settings=settings)
        if pixels is None and number == 0:
            raise PhotoError("the image of the map cannot be read", where=image.path)
        if pixels is not None:
            height, width = pixels.shape[:2]
            scale = np.diag([image.width / width, image.height / height, 1.0])
            name = f"image-{number}{'.png' if image.path.lower().endswith('.png') else '.jpg'}"
            matrix = georeference.matrix @ map_from_image @ scale
            found.append(_image(pixels, matrix, plane=georeference.plane, title=title, file=folder / name))
    return found


def _matrix(affine: Affine) -> Matrix:
    return np.vstack([np.reshape(affine, (2, 3)), [0.0, 0.0, 1.0]])


def _image(pixels: Pixels, matrix: Matrix, *, plane: str, title: str, file: Path) -> ProjectImage:
    """Write an image; one whose lines are not straight on the plane is resampled.

    Args:
        matrix: (3, 3). From its pixels to the plane.
    """
    height, width = pixels.shape[:2]
    corners = matrix @ np.array([(x * width, y * height, 1.0) for x, y in _CORNERS]).T
    if (corners[2] <= 0.0).any() and (corners[2] >= 0.0).any():
        raise UsageError(
            "a part of the image is beyond the horizon", where=title, hint="georeference it anew"
        )
    x, y = corners[:2] / corners[2]
    box = (float(x.min()), float(y.min()), float(x.max()), float(y.max()))
    to_plane = matrix / matrix[2, 2]
    if np.ptp(corners[2] / matrix[2, 2]) > _STRAIGHT:
        west, south, east, north = box
        warped = np.array([[(east - west) / width, 0, west], [0, (south - north) / height, north], [0, 0, 1]])
        # pixels are numbered by their centres there
        there = np.array([[1, 0, -0.5], [0, 1, -0.5], [0, 0, 1]])
        move = there @ np.linalg.inv(warped) @ to_plane @ np.linalg.inv(there)
        opaque = np.dstack([pixels, np.full((height, width), 255, np.uint8)])
        pixels, to_plane, file = (
            cv2.warpPerspective(opaque, move, (width, height)),
            warped,
            file.with_suffix(".png"),
        )
    done, data = cv2.imencode(file.suffix, pixels, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])
    assert done, "pictures of at most a few thousand pixels can always be encoded"
    write_bytes(file, np.asarray(data).tobytes())
    latlon = latlon_from_plane(plane, np.column_stack([x, y]))
    degrees = None
    if np.isfinite(latlon).all():
        (south, west), (north, east) = latlon.min(axis=0).tolist(), latlon.max(axis=0).tolist()
        degrees = (west, south, east, north)
    described = _described(pixels, to_plane, name=file.name, plane=plane)
    return ProjectImage(title, file, described, plane, box, degrees)


def _described(pixels: Pixels, to_plane: Matrix, *, name: str, plane: str) -> bytes:
    """Return a virtual raster of GDAL (VRT): x is east or longitude, whatever the system's own order is."""
    height, width, bands = pixels.shape
    root = ET.Element("VRTDataset", {"rasterXSize": str(width), "rasterYSize": str(height)})
    ET.SubElement(root, "SRS").text = parse_crs(plane).to_wkt()
    (a, b, c), (d, e, f) = to_plane[:2].tolist()
    ET.SubElement(root, "GeoTransform").text = ", ".join(map(repr, (c, a, b, f, d, e)))
    for number, colour in enumerate(("Red", "Green", "Blue", "Alpha")[:bands], start=1):
        band = ET.SubElement(root, "VRTRasterBand", {"dataType": "Byte", "band": str(number)})
        ET.SubElement(band, "ColorInterp").text = colour
        source = ET.SubElement(band, "SimpleSource")
        ET.SubElement(source, "SourceFilename", {"relativeToVRT": "1"}).text = name
        ET.SubElement(source, "SourceBand").text = str(number)
    return bytes(ET.tostring(root, "utf-8"))
