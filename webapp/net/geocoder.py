"""Client of a place search by name: Nominatim, or a server with its API."""

from __future__ import annotations

import json
import math
from dataclasses import dataclass

import requests

from webapp import __version__
from webapp.core.geo.tilegrid import GeoBox
from webapp.core.geo.types import LatLon
from webapp.errors import InputError
from webapp.net.bounded import answering, body, bounded_session
from webapp.settings import GeocoderSettings

_USER_AGENT = f"experience-map/{__version__} (search for a place by a person)"
_MOST = 5
_MAX_BYTES = 1_000_000
_MAX_NAME = 300
_WHERE = "place search"


@dataclass(frozen=True, slots=True)
class GeocoderResult:
    name: str  # Display name, with the regions that the place is in
    position: LatLon
    box: GeoBox  # Its extent


def search(text: str, *, language: str, settings: GeocoderSettings) -> tuple[GeocoderResult, ...]:
    """Send one request to the host; the best match comes first."""
    wish = {"q": text, "format": "jsonv2", "limit": str(_MOST), "accept-language": language}
    try:
        content = json.loads(_ask(str(settings.address), wish, timeout_s=settings.timeout_s))
    except ValueError as error:
        raise InputError("it did not send a list of places", where=_WHERE) from error
    if not isinstance(content, list):
        raise InputError("it did not send a list of places", where=_WHERE)
    found = (_place(item) for item in content[:_MOST])
    return tuple(place for place in found if place is not None)


def _ask(address: str, wish: dict[str, str], *, timeout_s: float) -> bytes:
    headers = {"Accept": "application/json"}
    try:
        with (
            bounded_session(_USER_AGENT) as session,
            answering(
                session, address, params=wish, headers=headers, most_bytes=_MAX_BYTES, timeout_s=timeout_s
            ) as answer,
        ):
            if answer.status_code != requests.codes.ok:
                message = f"it answered {answer.status_code}"
                raise InputError(message, where=_WHERE, hint="try again later, or give the coordinates")
            data = body(answer, most_bytes=_MAX_BYTES)
    except requests.RequestException as error:
        message = "it cannot be reached"
        raise InputError(message, where=_WHERE, hint="try again later, or give the coordinates") from error
    if data is None:
        raise InputError("it sent too much data", where=_WHERE)
    return data


def _place(item: object) -> GeocoderResult | None:
    """Parse a place; None if its coordinates are not valid, or it has no name."""
    try:
        fields: dict[str, object] = dict(item)  # type: ignore[call-overload]
        south, north, west, east = (float(str(side)) for side in fields["boundingbox"])  # type: ignore[attr-defined]
        lat, lon = float(str(fields["lat"])), float(str(fields["lon"]))
        name = str(fields["display_name"])[:_MAX_NAME].strip()
    except (KeyError, TypeError, ValueError):
        return None
    latitudes, longitudes = (lat, south, north), (lon, west, east)
    sound = all(math.isfinite(value) for value in (*latitudes, *longitudes))
    sound = sound and max(map(abs, latitudes)) <= 90.0 and max(map(abs, longitudes)) <= 180.0
    if not (sound and name and south <= north):
        return None
    return GeocoderResult(name, LatLon(lat, lon), GeoBox(north, south, west, east))
