"""Immich: https://api.immich.app, with an API key in the header `x-api-key`."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from typing import Any

from webapp.connect.libraries.http import LibraryHttp
from webapp.connect.libraries.protocol import Album, Asset, local_time, position_of
from webapp.core.geo.types import LatLon
from webapp.net.street import plain_id, short_text
from webapp.settings import LibrarySettings

_PAGE = 1000
"""Photos in one answer: the most that Immich allows."""

_NO_LIST = "did not send a list of photos"


class Immich:
    """A server of Immich.

    Photos are listed by the search for metadata, which has pages; an album by itself lists all at once.
    """

    name = "Immich"

    def __init__(
        self, address: str, *, key: str, settings: LibrarySettings, check: Callable[[], object] = lambda: None
    ) -> None:
        headers = {"x-api-key": key, "Accept": "application/json, image/*"}
        site = address.rstrip("/").removesuffix("/api")
        self.http = LibraryHttp(self.name, site, api="/api", headers=headers, settings=settings, check=check)

    def albums(self) -> list[Album]:
        """List the own albums, and those that others share."""
        found: dict[str, Album] = {}
        for params in ({}, {"shared": "true"}):
            listed = self.http.json("GET", "/albums", params=params)
            try:
                albums = [_album(item) for item in listed]
            except (AttributeError, KeyError, TypeError, ValueError) as error:
                raise self.http.error("did not send a list of albums") from error
            found |= {album.id: album for album in albums}
        return sorted(found.values(), key=lambda album: (album.name.casefold(), album.id))

    def pages(self, album_id: str) -> Iterator[list[Asset]]:
        """Yield the photos of an album, without videos and the trash."""
        wanted = {"albumIds": [album_id], "type": "IMAGE", "withExif": True, "order": "asc", "size": _PAGE}
        page: int | None = 1
        while page is not None:
            answer = self.http.json("POST", "/search/metadata", content={**wanted, "page": page})
            try:
                items, following = answer["assets"]["items"], answer["assets"]["nextPage"]
                photos = [_asset(one) for one in items if one["type"] == "IMAGE" and not one.get("isTrashed")]
                after = None if following is None else int(following)
            except (AttributeError, KeyError, TypeError, ValueError) as error:
                raise self.http.error(_NO_LIST) from error
            yield photos
            if after is not None and (after <= page or not items):
                raise self.http.error(_NO_LIST)
            page = after

    def page(self, asset_id: str) -> str:
        """Return the address of a photo's page."""
        return f"{self.http.site}/photos/{asset_id}"

    def preview(self, asset: Asset, *, most_bytes: int) -> bytes:
        """Fetch the preview, whose longer side has 1440 pixels unless the server is set up otherwise."""
        path = f"/assets/{asset.preview}/thumbnail"
        return self.http.file(path, params={"size": "preview"}, most_bytes=most_bytes)

    def set_position(self, asset_id: str, position: LatLon) -> None:
        """Set the position of a photo, which Immich also writes into a file beside the original."""
        content = {"ids": [asset_id], "latitude": position.lat, "longitude": position.lon}
        self.http.json("PUT", "/assets", content=content)


def _album(item: Any) -> Album:
    id = plain_id(item["id"])
    return Album(id, short_text(item["albumName"]) or id, int(item.get("assetCount") or 0))


def _asset(item: Any) -> Asset:
    id, exif = plain_id(item["id"]), item.get("exifInfo") or {}
    made_by = [part for part in (short_text(exif.get("make")), short_text(exif.get("model"))) if part]
    return Asset(
        id,
        checksum=str(item["checksum"])[:200],
        name=short_text(item.get("originalFileName")) or id,
        preview=id,
        position=position_of(exif.get("latitude"), exif.get("longitude")),
        taken_at=local_time(item.get("localDateTime")) if exif.get("dateTimeOriginal") else None,
        camera=" ".join(made_by) or None,
    )
