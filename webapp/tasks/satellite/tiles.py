"""Fetches an image for a library map from a tile service: stitched and cropped, not resampled."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from webapp.core.geo.tilegrid import TILE_PX, GeoBox, Tile, TileCut, cut_of
from webapp.errors import InputError, PhotoError, UsageError
from webapp.files.decode import open_image
from webapp.files.satellite.raster import keep_pixels
from webapp.net.tiles import TileFetcher, TileService, named_service, tile_services
from webapp.progress import Progress
from webapp.settings import PhotoLimits, Settings
from webapp.store.clock import now
from webapp.store.library import Library
from webapp.store.schema import MapRecord
from webapp.tasks.maps.place_photos import MapImage
from webapp.tasks.satellite import display
from webapp.tasks.satellite.apply import DISPLAY_SIDE_PX, NewImage
from webapp.tasks.satellite.files import keep_source
from webapp.tasks.satellite.tile_files import opened_archive

_MISSING = 204
"""Grey where the service has no tile."""

_TILE_LIMITS = PhotoLimits(max_mb=4.0, max_megapixels=1.0)
_PNG = b"\x89PNG"


@dataclass(frozen=True, slots=True)
class TileRequest:
    """The area and zoom to fetch from a service."""

    service: str  # Name of the service
    box: GeoBox
    zoom: int


@dataclass(frozen=True, slots=True)
class TileDownload:
    new: NewImage  # The image to set
    metres_per_pixel: float  # In its middle
    # `tiles`, `missing`: Number of its tiles, and of those that the service does not have.
    tiles: int
    missing: int
    attribution: str  # Attribution to show with it

    @property
    def warnings(self) -> tuple[str, ...]:
        if not self.missing:
            return ()
        return (f"the service has no image for {self.missing} of {self.tiles} tiles: they are grey",)


def plan(request: TileRequest, *, settings: Settings) -> tuple[TileService, TileCut]:
    """Return the service and the tiles of a request; refuse requests above the limits.

    Raises:
        NotFound: The service does not exist.
        UsageError, GeoreferenceError: The area is empty, or too large for this zoom; or the service does not
            offer this zoom.
    """
    service = named_service(tile_services(settings.tile_services), request.service)
    if request.zoom > service.max_zoom:
        raise UsageError(
            f"{service.name} has no zoom {request.zoom}",
            where="zoom",
            hint=f"choose at most {service.max_zoom}",
        )
    cut = cut_of(request.box, request.zoom)
    most = min(settings.tiles.max_tiles, service.max_tiles or settings.tiles.max_tiles)
    if cut.tile_count > most:
        raise UsageError(
            f"this area has {cut.tile_count} tiles at zoom {request.zoom}, but only {most} are allowed",
            where="zoom",
            hint="choose a smaller area or a smaller zoom",
        )
    return service, cut


def fetch_tiles(
    library: Library, map_id: int, *, request: TileRequest, settings: Settings, progress: Progress
) -> TileDownload:
    """Fetch an area and store its image in the map's folder; set it with `apply.set_image`.

    Fetched tiles stay in the library's cache, so that an interrupted download can be resumed.

    Raises:
        NotFound, UsageError, GeoreferenceError: As `plan`.
        InputError: The service does not answer, refuses, or has no tile of the area at all.
    """
    service, cut = plan(request, settings=settings)
    with library.database.read() as session:
        folder = library.map_folder(session.get_one(MapRecord, map_id).slug)
    progress.size(cut.tile_count)
    progress.note(service.name)
    with _tiles(service, cut.zoom, inner=library.inner, settings=settings) as fetch:
        canvas, missing, lossless = _stitch(cut, fetch, progress=progress)
    if missing == cut.tile_count:
        raise InputError(
            f"{service.name} has no image of this area at zoom {request.zoom}",
            hint="choose a smaller zoom or another service",
        )
    name = keep_pixels(canvas, folder, lossless=lossless)
    keep_source(folder, name, source=_source(service, request, missing=missing))
    small = display.shrunk(canvas, display.PREVIEW_PX)[:, :, ::-1]
    large = max(cut.width, cut.height) > DISPLAY_SIDE_PX
    display.write_small(folder, name, small=small, large=large)
    new = NewImage(name, MapImage(cut.width, cut.height, cut.georeference))
    return TileDownload(new, cut.metres_per_pixel, cut.tile_count, missing, service.attribution)


_Fetch = Callable[[Iterable[Tile], Progress], Iterator[tuple[Tile, bytes | None]]]
"""Yields tiles as they come; None where there is none."""


@contextmanager
def _tiles(service: TileService, zoom: int, *, inner: Path, settings: Settings) -> Iterator[_Fetch]:
    if not service.is_own:
        fetcher = TileFetcher(service, cache=inner / "tiles", settings=settings.tiles)
        yield lambda tiles, progress: fetcher.fetch(tiles, zoom=zoom, progress=progress)
        return
    with opened_archive(service, cache=inner / "remote", settings=settings.remote) as archive:

        def read(tiles: Iterable[Tile], progress: Progress) -> Iterator[tuple[Tile, bytes | None]]:
            for tile in tiles:
                progress.check()
                yield tile, archive.tile(zoom, tile.x, tile.y)

        yield read


def _stitch(cut: TileCut, fetch: _Fetch, *, progress: Progress) -> tuple[NDArray[np.uint8], int, bool]:
    """Stitch the tiles.

    Returns:
        canvas: (height, width, 3) uint8. Blue, green, red.
        lossless: Whether every tile came as PNG.
    """
    canvas = np.full((cut.height, cut.width, 3), _MISSING, np.uint8)
    # at small zooms, a cut across the 180th meridian can show a tile twice
    where: dict[Tile, list[tuple[int, int]]] = {}
    for tile, left, top in cut.tiles():
        where.setdefault(tile, []).append((left, top))
    missing, lossless = 0, True
    for tile, data in fetch(where, progress):
        if data is None:
            missing += len(where[tile])
        else:
            lossless &= data.startswith(_PNG)
            pixels = _decoded(data)[:, :, ::-1]
            for left, top in where[tile]:
                _paste(canvas, pixels, left=left, top=top)
        progress.advance(len(where[tile]))
    return canvas, missing, lossless


def _decoded(data: bytes) -> NDArray[np.uint8]:
    try:
        with open_image(data, limits=_TILE_LIMITS) as image:
            if image.size == (TILE_PX, TILE_PX):
                ground = Image.new("RGBA", image.size, (_MISSING, _MISSING, _MISSING, 255))
                ground.alpha_composite(image.convert("RGBA"))
                return np.asarray(ground.convert("RGB"))
            size = f"{image.width} x {image.height}"
    except PhotoError as error:
        raise InputError(f"the service sent a damaged tile: {error.message}", hint="try again") from error
    raise InputError(
        f"the service's tiles have {size} pixels, not {TILE_PX} x {TILE_PX}", hint="choose another service"
    )


def _paste(canvas: NDArray[np.uint8], pixels: NDArray[np.uint8], *, left: int, top: int) -> None:
    part = canvas[max(top, 0) : top + TILE_PX, max(left, 0) : left + TILE_PX]
    y, x = max(-top, 0), max(-left, 0)
    part[:] = pixels[y : y + part.shape[0], x : x + part.shape[1]]


def _source(service: TileService, request: TileRequest, *, missing: int) -> Mapping[str, Any]:
    return {
        "source": "tiles",
        "service": service.name,
        "attribution": service.attribution,
        "zoom": request.zoom,
        "box": request.box._asdict(),
        "missing_tiles": missing,
        "fetched_at": now().isoformat(timespec="seconds"),
    }
