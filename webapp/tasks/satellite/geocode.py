"""Geocodes place names: only if enabled, with one request at a time across processes, and a cache.

The usage policy of Nominatim requires at most one request per second from a server (all its processes
together), a `User-Agent` that names the software, a cache, the attribution, and no autocomplete search:
https://operations.osmfoundation.org/policies/nominatim/
"""

from __future__ import annotations

import hashlib
import json
import time
from pathlib import Path

from webapp.core.geo.tilegrid import GeoBox
from webapp.core.geo.types import LatLon
from webapp.errors import NotFound
from webapp.files.atomic import write_text
from webapp.files.lock import rate_limited
from webapp.net import geocoder
from webapp.net.geocoder import GeocoderResult
from webapp.settings import GeocoderSettings

_PATIENCE_S = 8.0
"""Maximum time that a search waits for earlier ones."""


def geocode(
    text: str, *, language: str, cache: Path, settings: GeocoderSettings
) -> tuple[GeocoderResult, ...]:
    """Find places with a name.

    Args:
        cache: Folder of earlier results; created if missing.

    Raises:
        NotFound: The search is disabled.
        Busy: Too many others are searching.
        InputError: The host does not answer, or sends an invalid answer.
        StorageError: The cache cannot be written.
    """
    if settings.address is None:
        raise NotFound(
            "place search is disabled here", hint="give coordinates, or set geocoder.address on the server"
        )
    wanted = " ".join(text.split())
    key = hashlib.sha256("\n".join((settings.address, language, wanted.casefold())).encode()).hexdigest()
    kept = cache / f"{key[:32]}.json"
    found = _cached(kept, days=settings.cache_days)
    if found is not None:
        return found
    with rate_limited(cache / "turn", gap_s=1.0 / settings.requests_per_second, wait_s=_PATIENCE_S):
        found = geocoder.search(wanted, language=language, settings=settings)
    write_text(kept, json.dumps([[*place] for place in map(_fields, found)]))
    _forget(cache, days=settings.cache_days)
    return found


def _forget(cache: Path, *, days: float) -> None:
    """Delete the cached results that have expired."""
    for kept in cache.glob("*.json"):
        if _is_old(kept, days=days):
            kept.unlink(missing_ok=True)


def _fields(place: GeocoderResult) -> tuple[object, ...]:
    return place.name, place.position, place.box


def _is_old(path: Path, *, days: float) -> bool:
    return time.time() - path.stat().st_mtime > days * 86400


def _cached(path: Path, *, days: float) -> tuple[GeocoderResult, ...] | None:
    try:
        if _is_old(path, days=days):
            return None
        content = json.loads(path.read_text("utf-8"))
    except FileNotFoundError:
        return None
    return tuple(GeocoderResult(name, LatLon(*position), GeoBox(*box)) for name, position, box in content)
