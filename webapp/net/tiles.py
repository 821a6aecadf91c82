"""Fetches map tiles through a cache, with limits for parallel requests, request rate and size."""

from __future__ import annotations

import hashlib
import secrets
import time
from collections.abc import Iterable, Iterator
from concurrent.futures import FIRST_COMPLETED, Future, wait
from pathlib import Path

import requests
from urllib3.util import Retry

from webapp import __version__
from webapp.core.geo.tilegrid import Tile
from webapp.errors import InputError, StorageError
from webapp.net.bounded import BoundedAdapter, answering, body, bounded_session
from webapp.net.polite import RateLimit
from webapp.net.services import TileService
from webapp.progress import Progress
from webapp.settings import TileSettings
from webapp.threads import ContextThreads

_USER_AGENT = f"experience-map/{__version__} (map tiles for one satellite image)"
_MAX_BYTES = 4_000_000
_TRIES = 4
_LONGEST_PAUSE_S = 60
"""Longest pause before a retry, even if the server asks for a longer one."""

_LISTEN_S = 0.5
"""Interval at which cancellation is checked while waiting for tiles."""

_TRY_AGAIN = (429, 500, 502, 503, 504)
_NO_TILE = (204, 404, 410)
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
        adapter = BoundedAdapter(pool_maxsize=settings.parallel, max_retries=retry)
        self._session = bounded_session(_USER_AGENT, adapter)

    def fetch(
        self, tiles: Iterable[Tile], *, zoom: int, progress: Progress
    ) -> Iterator[tuple[Tile, bytes | None]]:
        """Fetch tiles, in the order in which they arrive.

        Each one is in the cache before it is yielded, so that a stopped download can be resumed.

        Args:
            progress: Used only for cancellation, also while waiting for the service.

        Yields:
            A PNG, JPEG or WebP file; None where the service has no tile.

        Raises:
            InputError: The service does not answer, refuses, or does not send an image.
            StorageError: The cache cannot be written.
            Cancelled
        """
        todo = iter(tiles)
        pool = ContextThreads(self._settings.parallel)
        running: dict[Future[bytes | None], Tile] = {}
        try:
            while True:
                while len(running) < 2 * self._settings.parallel and (tile := next(todo, None)):
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
            message = f"{self._service.name} did not send a tile"
            raise InputError(message, where="tile service", hint=hint)
        return data


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
