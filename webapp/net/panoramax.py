"""Panoramax: an open federation of street-level photos, through the STAC API of one of its instances.

Uses `requests`: pystac-client has its own retries, and its own handling of hosts and redirects.
https://docs.panoramax.fr/api/
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any
from urllib.parse import urlencode, urljoin

from webapp.core.geo.tilegrid import GeoBox
from webapp.net.street import (
    ListedPage,
    StreetPhoto,
    amount,
    estimated_bytes,
    heading,
    number,
    plain_id,
    position,
    short_text,
    time_text,
)

_MOST_ACCURACY_M = 10_000.0
_MOST_BYTES = 1e9
"""Larger values are taken for errors."""


class Panoramax:
    """One instance, which may list photos of others.

    Args:
        base: Its address, with or without `/api`.
    """

    name = "Panoramax"
    key = "panoramax"
    page_size = 1000
    max_area_deg2 = 1.0

    def __init__(self, base: str) -> None:
        self.base = base.rstrip("/").removesuffix("/api")
        self.headers: Mapping[str, str] = {}

    def address(self, box: GeoBox) -> str:
        """Return the address of the first page of the list of an area."""
        sides = ",".join(f"{side:.7f}" for side in (box.west, box.south, box.east, box.north))
        return f"{self.base}/api/search?{urlencode({'bbox': sides, 'limit': self.page_size}, safe=',')}"

    def page(self, content: Any) -> ListedPage:
        """Parse a page of a list."""
        links = content.get("links") or []
        following = next((link["href"] for link in links if link.get("rel") == "next"), None)
        return ListedPage(content["features"], following and urljoin(f"{self.base}/api/search", following))

    def photo(self, item: Any) -> StreetPhoto:
        """Parse a STAC item: a flat photo in the size that a map uses, a panorama in full size."""
        facts, assets = item["properties"], item["assets"]
        camera = facts.get("pers:interior_orientation") or {}
        width, height = (number(side) for side in (camera.get("sensor_array_dimensions") or [None, None])[:2])
        fov = number(camera.get("field_of_view"))
        is_panorama = fov == 360.0
        asset = assets.get("hd" if is_panorama else "sd") or assets["hd"]
        is_whole = asset is assets.get("hd")
        said = amount(facts.get("original_file:size"), most=_MOST_BYTES) if is_whole else None
        id = plain_id(item["id"])
        return StreetPhoto(
            id,
            position(item["geometry"]),
            address=urljoin(f"{self.base}/api/", str(asset["href"])),
            licence=_needed(short_text(facts.get("license"))),
            page=f"{self.base}/#focus=pic&pic={id}",
            size_bytes=round(said or estimated_bytes(width, height, is_panorama=is_panorama)),
            is_panorama=is_panorama,
            heading_deg=heading(facts.get("view:azimuth")),
            fov_deg=fov if fov is not None and 0.0 < fov < 360.0 else None,
            accuracy_m=amount(facts.get("quality:horizontal_accuracy"), most=_MOST_ACCURACY_M),
            taken_at=time_text(facts.get("datetimetz") or facts.get("datetime")),
            author=_producer(item, facts),
        )


def _needed(licence: str | None) -> str:
    if licence is None:
        raise ValueError("no licence")
    return licence


def _producer(item: Any, facts: Any) -> str | None:
    """Return the attribution: the providers with the role `producer`, else Panoramax' own field for it."""
    providers = item.get("providers") or facts.get("providers") or []
    names = [short_text(one.get("name")) for one in providers if "producer" in (one.get("roles") or [])]
    known = [name for name in dict.fromkeys(names) if name]
    return ", ".join(known) or short_text(facts.get("geovisio:producer"))
