"""PhotoPrism: https://docs.photoprism.app/developer-guide/api/, with an app password as bearer token."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import PurePosixPath
from typing import Any

from webapp.connect.libraries.http import LibraryHttp
from webapp.connect.libraries.protocol import Album, Asset, local_time, position_of
from webapp.core.geo.types import LatLon
from webapp.net.street import plain_id, short_text
from webapp.settings import LibrarySettings

_PAGE = 1000
_SIZE = "fit_1920"
_PHOTOS = ("image", "raw", "live")
_GUESSED = "estimate"
"""Source of a place that PhotoPrism has guessed from photos taken at about the same time."""

_PUBLIC = "public"
"""Token for previews of a server without accounts."""


class PhotoPrism:
    """A server of PhotoPrism.

    Previews have addresses with a token, which is in the configuration for clients. Of each photo only the
    primary file is listed, a JPEG made from a raw file, for example.
    """

    name = "PhotoPrism"

    def __init__(
        self, address: str, *, key: str, settings: LibrarySettings, check: Callable[[], object] = lambda: None
    ) -> None:
        headers = {"Authorization": f"Bearer {key}", "Accept": "application/json, image/*"}
        site = address.rstrip("/").removesuffix("/api/v1")
        self.http = LibraryHttp(
            self.name, site, api="/api/v1", headers=headers, settings=settings, check=check
        )
        self._token: str | None = None

    def albums(self) -> list[Album]:
        """List the albums that people have made."""
        found = []
        for items in self._listed("/albums", {"type": "album", "order": "name"}):
            try:
                found += [_album(item) for item in items]
            except (AttributeError, KeyError, TypeError, ValueError) as error:
                raise self.http.error("did not send a list of albums") from error
        return found

    def pages(self, album_id: str) -> Iterator[list[Asset]]:
        """Yield the photos of an album, without videos and the archive."""
        for items in self._listed("/photos", {"s": album_id, "primary": "true", "order": "oldest"}):
            try:
                yield [_asset(item) for item in items if item["Type"] in _PHOTOS]
            except (AttributeError, KeyError, TypeError, ValueError) as error:
                raise self.http.error("did not send a list of photos") from error

    def page(self, asset_id: str) -> str:
        """Return the address of a search that finds a photo."""
        return f"{self.http.site}/library/browse?q=uid:{asset_id}"

    def preview(self, asset: Asset, *, most_bytes: int) -> bytes:
        """Fetch a preview of at most 1920 by 1200 pixels."""
        data = self.http.file(f"/t/{asset.preview}/{self._preview_token()}/{_SIZE}", most_bytes=most_bytes)
        if data.lstrip().startswith(b"<svg"):
            raise self.http.error("has no preview of this photo yet")
        return data

    def set_position(self, asset_id: str, position: LatLon) -> None:
        """Set the position of a photo as a person does, so that no index of PhotoPrism changes it again."""
        content = {"Lat": position.lat, "Lng": position.lon, "PlaceSrc": "manual"}
        self.http.json("PUT", f"/photos/{asset_id}", content=content)

    def _listed(self, path: str, params: dict[str, str]) -> Iterator[list[Any]]:
        """Yield the pages of a list: one that is not full is the last."""
        offset, size = 0, _PAGE
        while size == _PAGE:
            asked = {**params, "count": str(_PAGE), "offset": str(offset)}
            items = self.http.json("GET", path, params=asked)
            if not isinstance(items, list):
                raise self.http.error("did not send a list")
            yield items
            size = len(items)
            offset += size

    def _preview_token(self) -> str:
        if self._token is None:
            stated = self.http.json("GET", "/config")
            given = stated.get("previewToken") if isinstance(stated, dict) else None
            try:
                self._token = plain_id(given or _PUBLIC)
            except ValueError as error:
                raise self.http.error("did not send a token for previews") from error
        return self._token


def _album(item: Any) -> Album:
    id = plain_id(item["UID"])
    return Album(id, short_text(item["Title"]) or id, int(item.get("PhotoCount") or 0))


def _asset(item: Any) -> Asset:
    id, file = plain_id(item["UID"]), plain_id(item["Hash"])
    names = (item.get("CameraMake"), item.get("CameraModel"))
    made_by = [text for name in names if (text := short_text(name)) and text != "Unknown"]
    named = short_text(item.get("OriginalName")) or short_text(item.get("FileName")) or id
    lat, lon = item.get("Lat"), item.get("Lng")
    is_stated = item.get("PlaceSrc") != _GUESSED and (lat, lon) != (0, 0)  # zeros stand for none
    return Asset(
        id,
        checksum=file,
        name=PurePosixPath(named.replace("\\", "/")).name,
        preview=file,
        position=position_of(lat, lon) if is_stated else None,
        taken_at=local_time(item.get("TakenAtLocal")) if item.get("TakenSrc") else None,
        camera=" ".join(made_by) or None,
    )
