"""Services of street-level photos: Panoramax and Mapillary, their interface, and how photos are listed.

Panoramax is an open federation, asked through the STAC API of one of its instances with `requests`:
pystac-client has its own retries, and its own handling of hosts and redirects. https://docs.panoramax.fr/api/

Mapillary is asked through its API v4 with a token. Its photos are under CC BY-SA 4.0.
https://www.mapillary.com/developer/api-documentation
"""

from __future__ import annotations

import math
import re
import unicodedata
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from datetime import UTC, datetime
from typing import Any, Protocol
from urllib.parse import urlencode, urljoin

from webapp.core.geo.tilegrid import GeoBox
from webapp.core.geo.types import LatLon
from webapp.errors import InputError, UsageError
from webapp.net.polite import PoliteClient
from webapp.progress import Progress

SIDE_PX = 2048
"""Longer side of the photos that are fetched; a map needs no more. Panoramas are fetched in full size."""

_BYTES_PER_PIXEL = 0.25
"""Of a typical JPEG, if a service does not state the size of its file."""

_SMALLEST_DEG = 1e-5
"""Height below which a box is not divided further: about a metre."""

_MOST_REQUESTS = 2000
_MOST_TEXT = 200
_PLAIN_ID = re.compile(r"[A-Za-z0-9][A-Za-z0-9_-]{0,79}")
_WHERE = "street-level photos"


@dataclass(frozen=True, slots=True)
class StreetPhoto:
    id: str  # In the service: letters, digits, `_` and `-`
    position: LatLon
    address: str  # Address of the file
    licence: str
    page: str  # Web page of the photo at the service
    size_bytes: int  # Size of the file, as stated by the service or estimated from its pixels
    is_panorama: bool = False  # Equirectangular, of the whole sphere
    # Viewing direction, or that of the middle of a panorama, degrees clockwise from north.
    heading_deg: float | None = None
    fov_deg: float | None = None  # Horizontal field of view
    accuracy_m: float | None = None  # 68 % radius of its position
    taken_at: str | None = None  # ISO 8601
    author: str | None = None


@dataclass(frozen=True, slots=True)
class ListedPage:
    items: list[Any]  # Descriptions of photos, in the format of the service
    next: str | None = None  # Address of the next page


class StreetService(Protocol):
    """A service: addresses of its requests, and parsers of its answers."""

    name: str
    """Display name."""

    key: str
    """Identifier."""

    base: str
    """Its address."""

    headers: Mapping[str, str]
    """Sent with every request to it."""

    page_size: int
    """Maximum number of photos in one answer; an answer with fewer is complete."""

    max_area_deg2: float
    """Maximum area of one request."""

    def address(self, box: GeoBox) -> str:
        """Return the address of the first page of the list of an area."""

    def page(self, content: Any) -> ListedPage:
        """Parse a page of a list; raise KeyError, TypeError and the like if it is not one."""

    def photo(self, item: Any) -> StreetPhoto:
        """Parse the description of a photo; raise KeyError, TypeError, ValueError if it cannot be used."""


@dataclass(frozen=True, slots=True)
class StreetListing:
    photos: tuple[StreetPhoto, ...]
    # Number of photos whose descriptions cannot be used: without a file, a position, or a licence.
    unusable: int


def list_photos(
    service: StreetService, box: GeoBox, *, client: PoliteClient, most: int, progress: Progress
) -> StreetListing:
    """List the photos of an area, in a stable order.

    A full page without a next one is assumed to be truncated: its area is queried again in quarters.

    Raises:
        UsageError: The area has more, or is too large for the service.
        InputError, TooMany: The service does not answer, or not with a list of photos.
    """
    found: dict[str, StreetPhoto] = {}
    unusable: set[str] = set()
    todo = list(_cells(box, service.max_area_deg2))
    asked: set[str] = set()
    while todo:
        cell = todo.pop()
        address: str | None = service.address(cell)
        is_full = False
        while address is not None:
            progress.check()
            if address in asked or len(asked) >= _MOST_REQUESTS:
                raise InputError(f"{service.name} keeps returning more pages of photos", where=_WHERE)
            asked.add(address)
            page = _read_page(service, client.json(address))
            for item in page.items:
                _take(service, item, found=found, unusable=unusable, box=box)
            if len(found) > most:
                raise UsageError(
                    f"this area has more than {most} photos", where=_WHERE, hint="choose a smaller area"
                )
            address, is_full = page.next, len(page.items) >= service.page_size
        if is_full and cell.north - cell.south > _SMALLEST_DEG:
            todo += _quarters(cell)
    return StreetListing(tuple(found[id] for id in sorted(found)), len(unusable - found.keys()))


def _read_page(service: StreetService, content: object) -> ListedPage:
    try:
        page = service.page(content)
        if isinstance(page.items, list) and (page.next is None or isinstance(page.next, str)):
            return page
    except (AttributeError, KeyError, TypeError):
        pass
    raise InputError(f"{service.name} did not send a list of photos", where=_WHERE)


def _take(
    service: StreetService, item: Any, *, found: dict[str, StreetPhoto], unusable: set[str], box: GeoBox
) -> None:
    try:
        photo = service.photo(item)
    except (AttributeError, KeyError, TypeError, ValueError, IndexError, OverflowError):
        unusable.add(str(item.get("id") if isinstance(item, dict) else item)[:_MOST_TEXT])
        return
    if _is_in(photo.position, box):
        found[photo.id] = photo


def _is_in(at: LatLon, box: GeoBox) -> bool:
    between = box.west <= at.lon <= box.east if box.west <= box.east else not box.east < at.lon < box.west
    return box.south <= at.lat <= box.north and between


def _cells(box: GeoBox, max_area_deg2: float) -> Iterator[GeoBox]:
    """Divide an area into parts that a service accepts, and at the 180th meridian."""
    if box.west > box.east:
        yield from _cells(box._replace(east=180.0), max_area_deg2)
        yield from _cells(box._replace(west=-180.0), max_area_deg2)
        return
    height, width = box.north - box.south, box.east - box.west
    side = math.sqrt(max_area_deg2) * 0.99
    rows, columns = max(1, math.ceil(height / side)), max(1, math.ceil(width / side))
    if rows * columns > _MOST_REQUESTS:
        raise UsageError("this area is too large", where=_WHERE, hint="choose a smaller one")
    for row in range(rows):
        for column in range(columns):
            north = box.north - height * row / rows
            west = box.west + width * column / columns
            yield GeoBox(north, north - height / rows, west, west + width / columns)


def _quarters(box: GeoBox) -> list[GeoBox]:
    lat, lon = (box.north + box.south) / 2, (box.west + box.east) / 2
    return [
        GeoBox(north, south, west, east)
        for north, south in ((box.north, lat), (lat, box.south))
        for west, east in ((box.west, lon), (lon, box.east))
    ]


def plain_id(value: object) -> str:
    text = str(value)
    if not _PLAIN_ID.fullmatch(text):
        raise ValueError("not a plain id")
    return text


def position(geometry: Any) -> LatLon:
    """Parse a GeoJSON point. Raises ValueError, TypeError, KeyError."""
    lon, lat = (float(value) for value in geometry["coordinates"][:2])
    if not (abs(lat) <= 90.0 and abs(lon) <= 180.0):
        raise ValueError("not on the Earth")
    return LatLon(lat, lon)


def number(value: Any) -> float | None:
    """Read an optional number; None where it is missing or not finite."""
    is_number = isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
    return float(value) if is_number else None


def heading(value: Any) -> float | None:
    """Read an optional direction, degrees clockwise from north."""
    degrees = number(value)
    return None if degrees is None else degrees % 360.0


def amount(value: Any, *, most: float) -> float | None:
    """Read an optional length or size; None also if it is below 0 or above `most`."""
    known = number(value)
    return None if known is None or not 0.0 <= known <= most else known


def short_text(value: Any) -> str | None:
    """Read an optional short text, without control characters."""
    if not isinstance(value, str):
        return None
    return "".join(c for c in value if unicodedata.category(c)[0] != "C").strip()[:_MOST_TEXT] or None


def time_text(value: Any) -> str | None:
    try:
        return datetime.fromisoformat(value).isoformat(timespec="milliseconds")
    except (TypeError, ValueError):
        return None


def estimated_bytes(width: float | None, height: float | None, *, is_panorama: bool) -> int:
    """Estimate the size of a file from the pixels of the original."""
    wide, high = (width or 4.0 * SIDE_PX), (height or (2.0 if is_panorama else 3.0) * SIDE_PX)
    shrink = 1.0 if is_panorama else min(1.0, SIDE_PX / max(wide, high, 1.0))
    return round(wide * high * shrink**2 * _BYTES_PER_PIXEL)


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
        sides = ",".join(f"{side:.7f}" for side in (box.west, box.south, box.east, box.north))
        wish = {"bbox": sides, "limit": self.page_size, "fields": _FIELDS}
        return f"{self.base}/images?{urlencode(wish, safe=',')}"

    def page(self, content: Any) -> ListedPage:
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
