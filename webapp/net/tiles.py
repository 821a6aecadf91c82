"""The available map tile services, and their tiles, fetched through a cache.

Parallel requests, the request rate and sizes are limited.
"""

from __future__ import annotations

import hashlib
import json
import re
import secrets
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from dataclasses import dataclass, replace
from pathlib import Path
from urllib.parse import quote, urlsplit
from xml.sax.saxutils import unescape

import requests
from urllib3.util import Retry

from webapp import __version__
from webapp.core.geo.tilegrid import MAX_ZOOM, Tile, tile_box, tile_metres
from webapp.errors import InputError, NotFound, StorageError, UsageError
from webapp.net.bounded import BoundedAdapter, answering, body, bounded_session
from webapp.net.polite import RateLimit
from webapp.progress import Progress
from webapp.settings import TileSettings
from webapp.threads import ContextThreads

_USER_AGENT = f"experience-map/{__version__} (map tiles for one satellite image)"
_MAX_BYTES = 4_000_000
_PARALLEL = 4
_TRIES = 4
_LONGEST_PAUSE_S = 60
"""Longest pause before a retry, even if the server asks for a longer one."""

_LISTEN_S = 0.5
"""Interval at which cancellation is checked while waiting for tiles."""

_TRY_AGAIN = (429, 500, 502, 503, 504)
_NO_TILE = (204, 404, 410)
_EXCEPTION = re.compile(
    r"<(?:\w+:)?(?:ServiceException|ExceptionText)\b[^>]*>\s*(?:<!\[CDATA\[)?([^<\]]{1,300})"
)
_MAX_MESSAGE = 10_000
_IMAGES = (b"\x89PNG\r\n\x1a\n", b"\xff\xd8\xff", b"RIFF")


class TileFetcher:
    """Tiles of one service, from its host or from the cache.

    Args:
        cache: Folder for the tiles of all services; created if missing.
    """

    def __init__(self, service: TileService, *, cache: Path, settings: TileSettings) -> None:
        self._service = service
        self._folder = cache / hashlib.sha256(service.url.encode()).hexdigest()[:16]
        self._settings = settings
        self._pace = RateLimit(settings.requests_per_second)
        # retried after 0.5, 1, 2 s, or when the server says (Retry-After)
        retry = Retry(
            _TRIES - 1,
            backoff_factor=0.5,
            status_forcelist=_TRY_AGAIN,
            raise_on_status=False,
            retry_after_max=_LONGEST_PAUSE_S,
        )
        adapter = BoundedAdapter(pool_maxsize=_PARALLEL, max_retries=retry)
        self._session = bounded_session(_USER_AGENT, adapter)

    def fetch(
        self, tiles: Iterable[Tile], *, zoom: int, progress: Progress
    ) -> Iterator[tuple[Tile, bytes | None]]:
        """Fetch tiles, in the order in which they arrive.

        Each one is in the cache before it is yielded, so that a stopped download can be resumed.

        Yields:
            A PNG, JPEG or WebP file; None where the service has no tile.

        Raises:
            InputError: The service does not answer, refuses, or does not send an image.
            StorageError: The cache cannot be written.
        """
        todo = iter(tiles)
        pool = ContextThreads(_PARALLEL)
        running: dict[Future[bytes | None], Tile] = {}
        try:
            while True:
                while len(running) < 2 * _PARALLEL and (tile := next(todo, None)):
                    running[pool.submit(self._tile, zoom, tile)] = tile
                if not running:
                    return
                for future in wait(running, timeout=_LISTEN_S, return_when=FIRST_COMPLETED).done:
                    yield running.pop(future), future.result()
                progress.check()
        finally:
            # do not wait for pending requests, which may take until their timeout
            pool.shutdown(wait=False, cancel_futures=True)
            self._session.close()

    def _tile(self, zoom: int, tile: Tile) -> bytes | None:
        cached = self._folder / f"{zoom}" / f"{tile.x}" / f"{tile.y}"
        data = self._cached(cached)
        if data is None:
            self._pace.wait(time.sleep)
            data = self._ask(self._service.address(z=zoom, x=tile.x, y=tile.y))
            if data is not None:
                _keep(cached, data)
        return data

    def _cached(self, path: Path) -> bytes | None:
        try:
            if time.time() - path.stat().st_mtime > self._settings.cache_days * 86400:
                return None
            return path.read_bytes()
        except FileNotFoundError:
            return None
        except OSError as error:
            raise StorageError(f"a tile cannot be read: {error.strerror}", where="cache of tiles") from error

    def _ask(self, address: str) -> bytes | None:
        """Request one tile from the service; answers other than images are never passed on."""
        hint = "try again later, or choose another service"
        try:
            with answering(
                self._session, address, most_bytes=_MAX_BYTES, timeout_s=self._settings.timeout_s
            ) as answer:
                if answer.status_code in _NO_TILE:
                    return None
                if answer.status_code != requests.codes.ok:
                    message = f"{self._service.name} answered {answer.status_code}"
                    raise InputError(message, where="tile service", hint=hint)
                data = body(answer, most_bytes=_MAX_BYTES)
        except requests.RequestException as error:
            message = f"{self._service.name} cannot be reached"
            raise InputError(message, where="tile service", hint=hint) from error
        if data is None or not data.startswith(_IMAGES):
            message = f"{self._service.name} did not send a tile{_instead(data)}"
            raise InputError(message, where="tile service", hint=hint)
        return data


def _instead(data: bytes | None) -> str:
    """Return what a service sent instead of a tile: the message of an OGC service, if it is one."""
    found = _EXCEPTION.search((data or b"")[:_MAX_MESSAGE].decode("utf-8", "replace"))
    return f": {' '.join(unescape(found[1]).split())}" if found else ""


def _keep(path: Path, data: bytes) -> None:
    """Write a tile to the cache atomically."""
    temporary = path.with_name(f".{path.name}.{secrets.token_hex(4)}")
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        temporary.write_bytes(data)
        temporary.replace(path)
    except OSError as error:
        raise StorageError(
            f"a tile cannot be kept: {error.strerror}", where="cache of tiles", hint="is the disk full?"
        ) from error


_HINT = "see docs/satellite.md for how such a file is written"
_FILE_URL = "/api/v1/tile-services/{name}/tiles/{{z}}/{{x}}/{{y}}"
_FIELDS = ("name", "attribution", "max_zoom", "url", "file", "remote", "max_tiles", "public")


def _axes_of_4326(tile: Tile, zoom: int) -> tuple[float, float, float, float]:
    box = tile_box(tile, zoom)
    return box.south, box.west, box.north, box.east


_AREAS = {"{bbox}": tile_metres, "{bbox-4326}": _axes_of_4326}
"""The area of a tile, as WMS 1.3.0 wants it in EPSG:3857, and in EPSG:4326 with its order of axes."""


@dataclass(frozen=True, slots=True)
class TileService:
    """Tiles in the standard grid of Web Mercator, of a service or in a file of this server."""

    name: str
    # Template with `{z}`, `{x}` and `{y}`, counted from the north, or with the area of a tile: `{bbox}` or
    # `{bbox-4326}`; of a file: of this server.
    url: str
    attribution: str  # Attribution to show with the image
    max_zoom: int  # Highest zoom that it has
    # Maximum number of tiles per image, if the service wants fewer than the settings allow.
    max_tiles: int | None = None
    public: bool = False  # Whether visitors of shared maps may see its address, which may contain a key
    file: Path | None = None  # MBTiles or PMTiles with its tiles
    remote: str | None = None  # Address of PMTiles or a cloud-optimised GeoTIFF with its tiles

    @property
    def is_own(self) -> bool:
        """Whether this server gives its tiles, from a file."""
        return self.file is not None or self.remote is not None

    @property
    def origin(self) -> str:
        """Scheme and host, as a content security policy names them."""
        parts = urlsplit(self.url)
        return f"{parts.scheme}://{parts.netloc}"

    def address(self, *, z: int, x: int, y: int) -> str:
        found = self.url.replace("{z}", str(z)).replace("{x}", str(x)).replace("{y}", str(y))
        for name, bounds in _AREAS.items():
            if name in found:
                found = found.replace(name, ",".join(map(repr, bounds(Tile(x, y), z))))
        return found


_WITHOUT_A_KEY = (
    TileService(
        "OpenStreetMap",
        "https://tile.openstreetmap.org/{z}/{x}/{y}.png",
        "© OpenStreetMap contributors (ODbL)",
        19,
        max_tiles=64,
    ),
    TileService(
        "Esri World Imagery",
        "https://server.arcgisonline.com/ArcGIS/rest/services/World_Imagery/MapServer/tile/{z}/{y}/{x}",
        "Esri, Vantor, Earthstar Geographics, and the GIS User Community",
        19,
        max_tiles=256,
    ),
    TileService(
        "Czechia: orthophoto",
        "https://ags.cuzk.gov.cz/arcgis1/rest/services/ORTOFOTO_WM/MapServer/tile/{z}/{y}/{x}",
        "© ČÚZK (CC BY 4.0)",
        20,
    ),
    TileService(
        "Austria: orthophoto",
        "https://mapsneu.wien.gv.at/basemap/bmaporthofoto30cm/normal/google3857/{z}/{y}/{x}.jpeg",
        "basemap.at (CC BY 4.0)",
        19,
    ),
    TileService(
        "Switzerland: SWISSIMAGE",
        "https://wmts.geo.admin.ch/1.0.0/ch.swisstopo.swissimage/default/current/3857/{z}/{x}/{y}.jpeg",
        "© swisstopo",
        20,
    ),
    TileService(
        "France: BD ORTHO",
        "https://data.geopf.fr/wmts?SERVICE=WMTS&REQUEST=GetTile&VERSION=1.0.0"
        "&LAYER=ORTHOIMAGERY.ORTHOPHOTOS&STYLE=normal&FORMAT=image/jpeg&TILEMATRIXSET=PM"
        "&TILEMATRIX={z}&TILEROW={y}&TILECOL={x}",
        "© IGN (Licence Ouverte 2.0)",
        19,
    ),
    TileService(
        "USA: National Map imagery",
        "https://basemap.nationalmap.gov/arcgis/rest/services/USGSImageryOnly/MapServer/tile/{z}/{y}/{x}",
        "U.S. Geological Survey (public domain)",
        16,
    ),
    TileService(
        "World: Sentinel-2 cloudless 2016 (10 m)",
        "https://tiles.maps.eox.at/wmts/1.0.0/s2cloudless_3857/default/g/{z}/{y}/{x}.jpg",
        "Sentinel-2 cloudless by EOX IT Services GmbH, modified Copernicus Sentinel data 2016 (CC BY 4.0)",
        14,
    ),
)

USUAL = tuple(replace(service, public=True) for service in _WITHOUT_A_KEY)
"""Services that can be used without a key; their terms of use apply."""


def tile_services(file: Path | None) -> tuple[TileService, ...]:
    """Return the available services; the first one is the default.

    Args:
        file: JSON: a list of objects with `name`, `attribution`, `max_zoom`, one of `url`, `file` and
            `remote`, and perhaps `max_tiles` and `public`; a relative `file` is next to it. None for the
            built-in ones.

    Raises:
        UsageError: The file cannot be read, or is not such a list; `where` names the place in it.
    """
    if file is None:
        return USUAL
    try:
        content = json.loads(file.read_text("utf-8"))
    except (OSError, ValueError) as error:
        raise UsageError(f"it cannot be read: {error}", where=str(file), hint=_HINT) from error
    if not isinstance(content, list) or not content:
        raise UsageError("it does not hold a list of services", where=str(file), hint=_HINT)
    services = tuple(
        _service(item, folder=file.parent, where=f"{file}, service {n}") for n, item in enumerate(content, 1)
    )
    if len({service.name for service in services}) < len(services):
        raise UsageError("two services have the same name", where=str(file), hint="rename one")
    return services


def named_service(services: tuple[TileService, ...], name: str) -> TileService:
    """Find a service by its name. Raises NotFound."""
    found = next((service for service in services if service.name == name), None)
    if found is None:
        offered = ", ".join(service.name for service in services)
        raise NotFound("unknown tile service", where=name[:80], hint=f"choose one of: {offered}")
    return found


def _service(item: object, *, folder: Path, where: str) -> TileService:
    if not isinstance(item, dict) or not set(item).issubset(_FIELDS):
        raise UsageError(f"the allowed fields are {', '.join(_FIELDS)}", where=where, hint=_HINT)
    name, attribution, max_zoom, url, file, remote, max_tiles = (item.get(field) for field in _FIELDS[:7])
    public = item.get("public", False)
    sources = [one for one in (url, file, remote) if one is not None]
    source = sources[0] if len(sources) == 1 else None
    texts = all(isinstance(text, str) and text.strip() for text in (name, source, attribution))
    whole = _is_whole(max_zoom, MAX_ZOOM) and (max_tiles is None or _is_whole(max_tiles))
    if not texts or not whole or not isinstance(public, bool):
        raise UsageError("a field is missing or has an invalid value", where=where, hint=_HINT)
    if url is not None:
        _check_url(str(url), where=where)
    elif remote is not None:
        _check_host(str(remote), where=where)
    elif not (folder / str(file)).is_file():
        raise UsageError("its file does not exist", where=f"{where}: {file}", hint=_HINT)
    return TileService(
        str(name),
        _FILE_URL.format(name=quote(str(name), safe="")) if url is None else str(url),
        str(attribution),
        int(str(max_zoom)),
        max_tiles,
        public,
        None if file is None else folder / str(file),
        remote,
    )


def _check_host(url: str, *, where: str) -> None:
    parts = urlsplit(url)
    if parts.scheme not in ("http", "https") or not parts.hostname or set(parts.netloc) & set("{}@;, \"'"):
        raise UsageError("its url is not a web address", where=where, hint=_HINT)


def _check_url(url: str, *, where: str) -> None:
    _check_host(url, where=where)
    if [*map(url.count, ("{z}", "{x}", "{y}", *_AREAS))] not in (
        [1, 1, 1, 0, 0],
        [0, 0, 0, 1, 0],
        [0, 0, 0, 0, 1],
    ):
        raise UsageError(
            "its url needs {z}, {x} and {y} once each, or {bbox} or {bbox-4326}", where=where, hint=_HINT
        )


def _is_whole(value: object, largest: int = 1_000_000) -> bool:
    return isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= largest
