"""Mapillary: street-level photos, through its API v4 with a token. Its photos are under CC BY-SA 4.0.

https://www.mapillary.com/developer/api-documentation
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from datetime import UTC, datetime
from typing import Any
from urllib.parse import urlencode

from webapp.core.geo.tilegrid import GeoBox
from webapp.net.street import (
    ListedPage,
    StreetPhoto,
    estimated_bytes,
    heading,
    number,
    plain_id,
    position,
    short_text,
)

_LICENCE = "CC BY-SA 4.0"
_PANORAMAS = ("spherical", "equirectangular")
_FIELDS = (
    "id,computed_geometry,geometry,compass_angle,computed_compass_angle,captured_at,thumb_2048_url,"
    "thumb_original_url,is_pano,camera_type,camera_parameters,width,height,creator"
)


class Mapillary:
    """The service; lists of an area have no next page, so that a full one is queried again in quarters."""

    name = "Mapillary"
    key = "mapillary"
    page_size = 2000
    max_area_deg2 = 0.01

    def __init__(self, base: str, *, token: str) -> None:
        self.base = base.rstrip("/")
        self.headers: Mapping[str, str] = {"Authorization": f"OAuth {token}"}

    def address(self, box: GeoBox) -> str:
        """Return the address of the list of an area."""
        sides = ",".join(f"{side:.7f}" for side in (box.west, box.south, box.east, box.north))
        wish = {"bbox": sides, "limit": self.page_size, "fields": _FIELDS}
        return f"{self.base}/images?{urlencode(wish, safe=',')}"

    def page(self, content: Any) -> ListedPage:
        """Parse a page of a list."""
        return ListedPage(content["data"], (content.get("paging") or {}).get("next"))

    def photo(self, item: Any) -> StreetPhoto:
        """Parse a photo; its position is that by structure from motion, else by GPS."""
        is_panorama = bool(item.get("is_pano")) or item.get("camera_type") in _PANORAMAS
        width, height = number(item.get("width")), number(item.get("height"))
        id = plain_id(item["id"])
        computed = heading(item.get("computed_compass_angle"))
        original = item.get("thumb_original_url") if is_panorama else None
        return StreetPhoto(
            id,
            position(item.get("computed_geometry") or item["geometry"]),
            address=str(original or item["thumb_2048_url"]),
            licence=_LICENCE,
            page=f"https://www.mapillary.com/app/?pKey={id}&focus=photo",
            size_bytes=estimated_bytes(width, height, is_panorama=is_panorama),
            is_panorama=is_panorama,
            heading_deg=heading(item.get("compass_angle")) if computed is None else computed,
            fov_deg=None if is_panorama else _fov_deg(item, width, height),
            taken_at=_time(item.get("captured_at")),
            author=short_text((item.get("creator") or {}).get("username")),
        )


def _fov_deg(item: Any, width: float | None, height: float | None) -> float | None:
    """Compute the horizontal field of view; the focal length is in units of the longer side."""
    parameters = item.get("camera_parameters") or [None]
    focal = number(parameters[0]) if item.get("camera_type") == "perspective" else None
    if not focal or not width or not height or min(focal, width, height) <= 0:
        return None
    return math.degrees(2.0 * math.atan(width / (2.0 * focal * max(width, height))))


def _time(value: Any) -> str | None:
    milliseconds = number(value)
    if milliseconds is None:
        return None
    return datetime.fromtimestamp(milliseconds / 1000.0, UTC).isoformat(timespec="milliseconds")
