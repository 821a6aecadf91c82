"""What a photo library can do, whatever its program: albums, their photos, previews and positions."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from datetime import datetime
from typing import Any, NamedTuple, Protocol

from webapp.connect.libraries.http import LibraryHttp
from webapp.core.geo.types import LatLon
from webapp.errors import UsageError
from webapp.net.street import number


class Album(NamedTuple):
    id: str
    name: str
    items: int  # Photos and videos


@dataclass(frozen=True, slots=True)
class Asset:
    """A photo of an album."""

    id: str  # Letters, digits, `_` and `-`
    checksum: str  # Of the original
    name: str  # Name of the original file
    preview: str  # What its preview is fetched by
    position: LatLon | None = None
    taken_at: str | None = None  # ISO 8601, local time
    camera: str | None = None  # Maker and model


class LibraryClient(Protocol):
    """An adapter for one program. All methods raise InputError and TooMany as `LibraryHttp` does."""

    http: LibraryHttp

    def albums(self) -> list[Album]:
        """List the albums that the API key gives access to."""

    def pages(self, album_id: str) -> Iterator[list[Asset]]:
        """Yield the photos of an album, a page at a time."""

    def page(self, asset_id: str) -> str:
        """Return the address of a photo's page, for people."""

    def preview(self, asset: Asset, *, most_bytes: int) -> bytes:
        """Fetch a preview, large enough to be localized."""

    def set_position(self, asset_id: str, position: LatLon) -> None:
        """Set the position of a photo."""


def list_assets(client: LibraryClient, album: Album, *, most: int) -> dict[str, Asset]:
    """List the photos of an album by id, completely: else an error is raised.

    Raises:
        UsageError: It has more photos than allowed.
        InputError, TooMany: The library does not answer, or not with a list of photos.
    """
    found: dict[str, Asset] = {}
    for page in client.pages(album.id):
        before = len(found)
        found |= {asset.id: asset for asset in page}
        if len(found) > most:
            raise UsageError(
                f"the album has more than {most} photos",
                hint="choose a smaller album, or have the operator raise libraries.max_photos",
            )
        if page and len(found) == before:
            raise client.http.error("lists the same photos again and again")
    return found


def position_of(latitude: Any, longitude: Any) -> LatLon | None:
    """Read an optional position; None where it is missing or not on the Earth."""
    lat, lon = number(latitude), number(longitude)
    if lat is None or lon is None or abs(lat) > 90.0 or abs(lon) > 180.0:
        return None
    return LatLon(lat, lon)


def local_time(value: Any) -> str | None:
    """Read an optional local time, which both programs write as if it were UTC."""
    try:
        return datetime.fromisoformat(value).replace(tzinfo=None).isoformat(timespec="seconds")
    except (TypeError, ValueError):
        return None
