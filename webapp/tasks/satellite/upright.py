"""Makes plans and satellite images upright, in a format that is shown, no matter how they arrive."""

from __future__ import annotations

import json
import math
import secrets
from dataclasses import dataclass, replace
from pathlib import Path, PurePosixPath

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from webapp.core.geo.types import MapPixel
from webapp.core.mapmodel.model import Map
from webapp.errors import MapError, PhotoError
from webapp.extras import extra
from webapp.files.atomic import write_bytes
from webapp.files.decode import contrast_note, decode, open_image
from webapp.files.maps.cfg import format_cfg, read_bytes, read_cfg
from webapp.files.maps.folder import MapFolder, json_path, read_map_json
from webapp.files.photos.exif import orientation, read_exif
from webapp.files.photos.photo import read_facts, turn_upright
from webapp.files.satellite.raster import (
    QUALITY,
    Raster,
    image_kind,
    keep_file,
    on_white,
    opened_raster,
    writing,
)
from webapp.settings import PhotoLimits, Settings

_AS_PNG_PIXELS = 40_000_000
"""A TIFF with more pixels is converted to JPEG."""

_MAX_JPEG_SIDE = 65500
_UPRIGHT = 1
_LOSSY = frozenset({"JPEG", "MPO", "HEIF", "AVIF", "WEBP", "JPEG2000"})
_ANY_SIZE = PhotoLimits(max_mb=math.inf, max_megapixels=math.inf)

Size = tuple[int, int]


def as_shown(path: Path, *, scratch: Path, settings: Settings, turned: bool = True) -> Path:
    """Return an upright PNG or JPEG of an image: the file itself, or a copy in `scratch`.

    Args:
        path: An image of any format of photos.
        scratch: Folder for temporary files.
        turned: Apply the EXIF orientation; otherwise drop it.

    Raises:
        PhotoError: It is damaged, too large, or of another format.
        StorageError: Writing failed.
    """
    if image_kind(path) is None and _is_photo(path):
        return _decoded_copy(path, scratch=scratch, settings=settings, turned=turned)
    copy = scratch / f"{secrets.token_hex(8)}.image"
    with opened_raster(path, limits=settings.satellite) as raster:
        pixels, converted, placed = raster.width * raster.height, raster.kind == "GTiff", raster.georeferenced
        if converted:
            _convert(raster, copy, scratch=scratch)
    shown = copy if converted else path
    # images of drones and scanners may be rotated by EXIF, which not all viewers apply
    turn = _UPRIGHT if placed else _orientation(path)
    dark = not converted and _is_dark(path, settings)
    if (turn == _UPRIGHT and not dark) or (converted and not turned):
        return shown
    limits = replace(_ANY_SIZE, max_megapixels=settings.photo.max_megapixels)
    if pixels > limits.max_megapixels * 1e6:
        raise PhotoError(
            "the image is rotated by its EXIF and too large to be turned", hint="rotate it and save it again"
        )
    with open_image(shown, limits=limits) as image:
        kind, stored = image.format or "", decode(image, "RGB")
    _save(turn_upright(stored, turn if turned else _UPRIGHT), copy, lossy=kind in _LOSSY)
    return copy


def _is_dark(path: Path, settings: Settings) -> bool:
    """Return whether a PNG uses a small part of its 16 bits, and has to be stretched to be seen."""
    limits = replace(_ANY_SIZE, max_megapixels=settings.photo.max_megapixels)
    try:
        return image_kind(path) == "PNG" and contrast_note(path, limits=limits) is not None
    except PhotoError:
        return False


def _is_photo(path: Path) -> bool:
    try:
        with open_image(path, limits=_ANY_SIZE):
            return True
    except PhotoError:
        return False


def _decoded_copy(path: Path, *, scratch: Path, settings: Settings, turned: bool) -> Path:
    """Convert an image that only the reader of photos can open, such as HEIC."""
    limits = PhotoLimits(max_mb=settings.satellite.max_mb, max_megapixels=settings.photo.max_megapixels)
    with open_image(path, limits=limits) as image:
        kind, turn = image.format or "", orientation(read_exif(image))[0]
        image.load()
        if image.has_transparency_data:
            rgba = np.asarray(image.convert("RGBA"))
            pixels = on_white(rgba[:, :, :3], rgba[:, :, 3])
        else:
            pixels = decode(image, "RGB")
    copy = scratch / f"{secrets.token_hex(8)}.image"
    _save(turn_upright(pixels, turn if turned else _UPRIGHT), copy, lossy=kind in _LOSSY)
    return copy


def _save(pixels: NDArray[np.uint8], path: Path, *, lossy: bool) -> None:
    with writing(path.parent):
        Image.fromarray(pixels).save(path, format="JPEG" if lossy else "PNG", quality=95)


def _orientation(path: Path) -> int:
    """Return the EXIF orientation, 1 to 8; 1 for TIFFs that only GDAL can open."""
    try:
        with open_image(path, limits=_ANY_SIZE) as image:
            return orientation(read_exif(image))[0]
    except PhotoError:
        return _UPRIGHT


@dataclass(frozen=True, slots=True)
class _Shape:
    """How the pixels of an image are stored."""

    turn: int  # EXIF orientation, 1 to 8; 1 for images that place their stored pixels on the Earth
    upright: Size

    @property
    def stored(self) -> Size:
        return self.upright[::-1] if self.turn >= 5 else self.upright

    def fits_as_stored(self, described: Size | None) -> bool:
        """Return whether a size is that of the stored pixels, and not of the upright image."""
        return described is not None and described != self.upright and described == self.stored


def _shape(path: Path, settings: Settings) -> _Shape:
    facts = read_facts(path, limits=_ANY_SIZE)
    if facts.orientation == _UPRIGHT or image_kind(path) != "GTiff":
        return _Shape(facts.orientation, (facts.width, facts.height))
    with opened_raster(path, limits=settings.satellite) as raster:
        if raster.georeferenced:
            return _Shape(_UPRIGHT, (raster.width, raster.height))
    return _Shape(facts.orientation, (facts.width, facts.height))


def turned_note(path: Path, settings: Settings) -> str | None:
    """Return a sentence if an image is turned by its EXIF orientation; None if it is shown as stored."""
    try:
        shape = _shape(path, settings)
    except PhotoError:
        return None
    if shape.turn == _UPRIGHT:
        return None
    width, height = shape.upright
    return f"it was turned by its EXIF orientation {shape.turn}, to {width} x {height} pixels"


def upright_copy(
    path: Path, *, scratch: Path, settings: Settings, described: Size | None = None
) -> Path | None:
    """Return an upright copy of a map's image, a PNG or JPEG in `scratch`; None if it can be used as it is.

    Args:
        path: A missing or unreadable file can be used as it is: its reader reports it.
        described: Size that a map states. If only the stored pixels have it, they are kept as they are,
            without the orientation.
    """
    try:
        shape = _shape(path, settings)
    except PhotoError:
        return None
    if shape.turn == _UPRIGHT and image_kind(path) is not None and not _is_dark(path, settings):
        return None
    return as_shown(path, scratch=scratch, settings=settings, turned=not shape.fits_as_stored(described))


def upright_name(name: str, copy: Path) -> str:
    """Return a name for an upright copy, made of the image's own: `plan.upright.png`."""
    suffix = ".jpg" if image_kind(copy) == "JPEG" else ".png"
    return PurePosixPath(name).with_suffix(f".upright{suffix}").as_posix()


def make_plan_upright(cfg: Path, *, scratch: Path, settings: Settings) -> None:
    """Make the image of an unpacked map upright, and of a format that is shown.

    What the map says about its size decides to which pixels its positions refer: to the upright ones, or to
    the stored ones if only these fit. Then the positions of a plain `.cfg` are turned with the image; in a
    map with further files, the pixels are kept as they are stored, without the orientation.

    Args:
        cfg: A map that cannot be read is left as it is: the linter reports it.
        scratch: On the same disk.
    """
    try:
        map_ = read_cfg(cfg).map
        path = MapFolder(cfg).path(map_.satellite.path)
        shape = _shape(path, settings)
    except (MapError, PhotoError):
        return
    described = (map_.satellite.width, map_.satellite.height)
    cfgs = sorted(cfg.parent.glob("*.cfg"))
    moved = shape.fits_as_stored(described) and cfgs == [cfg] and not json_path(cfg).exists()
    copy = upright_copy(path, scratch=scratch, settings=settings, described=None if moved else described)
    if copy is None:
        return
    name = keep_file(copy, cfg.parent)
    for one in cfgs:
        _rewrite(one, map_, name=name, shape=shape if moved else None)
    if all(e.photo != map_.satellite.path for e in map_.experiences):
        path.unlink()


def make_floors_upright(cfg: Path, *, scratch: Path, settings: Settings) -> None:
    """Make the images of the floors of an unpacked map upright, and of a format that is shown.

    If only the stored pixels have the size that the map states, they are kept as they are, without the
    orientation. Parameters and errors are those of `make_plan_upright`.
    """
    path = json_path(cfg)
    try:
        floors = read_map_json(cfg).floors
    except MapError:
        return
    names: dict[str, str] = {}
    for image in (floor.image for floor in floors if floor.image is not None):
        try:
            file = MapFolder(cfg).path(image.path)
        except MapError:
            continue
        size = (image.width, image.height)
        copy = upright_copy(file, scratch=scratch, settings=settings, described=size)
        if copy is not None:
            names[image.path] = keep_file(copy, cfg.parent)
    if names:
        content = json.loads(read_bytes(path))
        for floor in content["floors"]:
            image_fields = floor.get("image") or {}
            if image_fields.get("path") in names:
                image_fields["path"] = names[image_fields["path"]]
        write_bytes(path, json.dumps(content, indent=1, ensure_ascii=False).encode("utf-8", "surrogatepass"))


def _rewrite(cfg: Path, of: Map, *, name: str, shape: _Shape | None) -> None:
    """Name the new image in a `.cfg` that has the image of a map; move its positions if `shape` is given."""
    try:
        document = read_cfg(cfg)
    except MapError:
        return  # the linter reports it
    map_ = document.map
    if map_.satellite != of.satellite:
        return
    satellite, experiences = replace(map_.satellite, path=name), map_.experiences
    if shape is not None:
        satellite = replace(satellite, width=shape.upright[0], height=shape.upright[1])
        experiences = tuple(replace(e, position=_turned(e.position, shape)) for e in experiences)
    write_bytes(cfg, format_cfg(replace(map_, satellite=satellite, experiences=experiences), like=document))


def _turned(pixel: MapPixel, shape: _Shape) -> MapPixel:
    """Turn a position like `turn_upright` turns the image."""
    x, y = (pixel.y, pixel.x) if shape.turn >= 5 else pixel
    if shape.turn in (3, 4, 7, 8):
        y = shape.upright[1] - y
    if shape.turn in (2, 3, 6, 7):
        x = shape.upright[0] - x
    return MapPixel(x, y)


def _convert(raster: Raster, target: Path, *, scratch: Path) -> None:
    """Convert a TIFF to PNG or JPEG, with only a few rows in memory."""
    with extra("geotiff"):
        import rasterio
        import rasterio.shutil
    large = raster.width * raster.height > _AS_PNG_PIXELS or raster.lossy
    jpeg = large and max(raster.width, raster.height) <= _MAX_JPEG_SIDE
    plain = scratch / f"{secrets.token_hex(8)}.tif"
    size = {"width": raster.width, "height": raster.height, "count": 3, "dtype": "uint8"}
    options = {"QUALITY": QUALITY} if jpeg else {"ZLEVEL": 6}
    try:
        with writing(scratch):
            out = rasterio.open(plain, "w", driver="GTiff", interleave="pixel", photometric="RGB", **size)
        with out:
            top = 0
            for strip in raster.strips():
                window = ((top, top + len(strip)), (0, raster.width))
                with writing(scratch):
                    out.write(strip.transpose(2, 0, 1), window=window)
                top += len(strip)
        with writing(scratch):
            rasterio.shutil.copy(plain, target, driver="JPEG" if jpeg else "PNG", **options)
    finally:
        plain.unlink(missing_ok=True)
