"""Reads the capabilities of map services: WMS 1.3.0 (OGC 06-042) and WMTS 1.0.0 (OGC 07-057r7).

Only layers that come as tiles of 256 pixels in the usual web Mercator grid can be used: of WMS those in
EPSG:3857, or in EPSG:4326, of which parts as small as a tile are all but the same; of WMTS those whose set of
tile matrices is this grid, named by zooms.
"""

from __future__ import annotations

import io
import math
from collections.abc import Iterable, Iterator, Mapping
from dataclasses import dataclass, replace
from typing import NamedTuple
from urllib.parse import parse_qsl, quote, urlencode, urlsplit, urlunsplit
from xml.etree.ElementTree import Element

from webapp.core.geo.tilegrid import MAX_ZOOM, TILE_PX, GeoBox
from webapp.errors import InputError, TrackError
from webapp.files.exchange.xml import child_text, local_name, number, walk

_WMS, _WMTS = "WMS_Capabilities", "Capabilities"
_ERRORS = ("ServiceExceptionReport", "ExceptionReport")
_MERCATOR = ("EPSG:3857", "EPSG:900913", "EPSG:102100", "EPSG:3785")
_DEGREES = "EPSG:4326"
PICTURES = ("image/jpeg", "image/png", "image/webp")
"""Media types of tiles that can be used, the best for photos of the ground first."""

_WHOLE_EARTH_SCALE = 559_082_264.028_717_8
"""Scale denominator of zoom 0, with pixels of 0.28 mm."""

_HALF_M = math.pi * 6378137.0
_OWN = frozenset({"service", "request", "version"})
"""Parameters of an address that the requests set themselves."""

_USUAL_ZOOM = 20
"""Largest zoom of a layer that states no limit."""

_HREF = "{http://www.w3.org/1999/xlink}href"


@dataclass(frozen=True, slots=True)
class OfferedLayer:
    name: str
    title: str
    addresses: Mapping[str, str]  # Templates of its tiles by media type, the best first
    problem: str | None = None  # Why it cannot be used
    max_zoom: int = _USUAL_ZOOM
    attribution: str = ""
    box: GeoBox | None = None


@dataclass(frozen=True, slots=True)
class MapService:
    title: str
    layers: tuple[OfferedLayer, ...]


class Where(NamedTuple):
    """The address of capabilities, and the hosts besides its own from which tiles may come."""

    address: str
    hosts: frozenset[str]


def parse_capabilities(data: bytes, where: Where) -> MapService:
    """Parse the capabilities of a WMS or WMTS.

    Raises:
        InputError: They are neither, damaged or hostile.
    """
    try:
        root = next(element for _, element in walk(io.BytesIO(data), whole=(_WMS, _WMTS, *_ERRORS)))
    except (TrackError, StopIteration) as error:
        said = error.message if isinstance(error, TrackError) else "it is empty"
        raise _no_capabilities(said, where) from error
    for element in root.iter():
        element.tag = local_name(element)
    if root.tag == _WMS:
        return _wms(root, where)
    if root.tag == _WMTS and root.find("Contents") is not None:
        return _wmts(root, where)
    text = plain("".join(root.itertext()))
    raise _no_capabilities(f"it is <{root.tag[:40]}>{f': {text[:200]}' if text else ''}", where)


def plain(text: str) -> str:
    """Return a text of a stranger in one line, without characters that control a terminal."""
    return " ".join("".join(c if c.isprintable() else " " for c in text).split())


def _no_capabilities(said: str, where: Where) -> InputError:
    return InputError(
        f"this is not the capabilities document of a WMS 1.3.0 or WMTS 1.0.0: {said}",
        where=where.address,
        hint="give the address that ends in request=GetCapabilities, or WMTSCapabilities.xml",
    )


def capabilities_address(address: str) -> str:
    """Complete the address of a service to that of its capabilities; `.xml` and complete ones stay."""
    parts = urlsplit(address)
    given = {name.lower(): value for name, value in parse_qsl(parts.query, keep_blank_values=True)}
    if "request" in given or parts.path.lower().endswith(".xml"):
        return address
    kind = given.get("service") or ("WMTS" if "wmts" in address.lower() else "WMS")
    version = {"WMTS": "1.0.0"}.get(kind.upper(), "1.3.0")
    return _with_query(address, {"SERVICE": kind, "REQUEST": "GetCapabilities", "VERSION": version})


def _with_query(address: str, parameters: dict[str, str], *, filled: str = "") -> str:
    """Replace the parameters of a request in an address; `filled` is added as it is."""
    parts = urlsplit(address)
    own = _OWN | {name.lower() for name in parameters}
    kept = [
        (name, value)
        for name, value in parse_qsl(parts.query, keep_blank_values=True)
        if name.lower() not in own
    ]
    query = urlencode([*kept, *parameters.items()], safe=":/,", quote_via=quote)
    return urlunsplit((parts.scheme, parts.netloc, parts.path, query + filled, ""))


def _origin(address: str) -> tuple[str, int | None]:
    parts = urlsplit(address)
    return (parts.hostname or "").lower(), parts.port or {"https": 443, "http": 80}.get(parts.scheme)


def _is_allowed(address: str, where: Where) -> bool:
    """Return whether tiles may be asked for there: on the host of the service, or one that was named."""
    try:
        parts, origin = urlsplit(address), _origin(address)
        own = _origin(where.address)
    except ValueError:
        return False
    if parts.scheme not in ("http", "https") or set(parts.netloc) & set("{}@;, \"'\\"):
        return False
    return origin == own or origin[0] in where.hosts


def _zoom_of(scale: float) -> float:
    return math.log2(_WHOLE_EARTH_SCALE / scale) if scale > 0 else math.nan


def _box(sides: Iterable[str]) -> GeoBox | None:
    """Return an area by its western, southern, eastern and northern sides; None if it is none."""
    west, south, east, north = map(number, sides)
    known = all(map(math.isfinite, (west, south, east, north)))
    return GeoBox(north=north, south=south, west=west, east=east) if known and south < north else None


# WMS


class _Inherited(NamedTuple):
    """What a layer has from those around it."""

    systems: frozenset[str] = frozenset()
    attribution: str = ""
    box: GeoBox | None = None
    finest_scale: float = math.nan


def _wms(root: Element, where: Where) -> MapService:
    service = root.find("Service")
    title = plain(child_text(service, "Title")) if service is not None else ""
    online = root.find("Capability/Request/GetMap/DCPType/HTTP/Get/OnlineResource")
    base = where.address if online is None else online.get(_HREF, "")
    if _origin_or_none(base) != _origin(where.address):
        # behind a proxy, services often name themselves by an address that only they can reach
        base = where.address
    pictures = _usable(element.text for element in root.iterfind("Capability/Request/GetMap/Format"))
    problem = None if pictures else "it has no pictures in JPEG, PNG or WebP"
    sides = [] if service is None else [child_text(service, f"Max{side}") for side in ("Width", "Height")]
    if any(number(side) < TILE_PX for side in sides):
        problem = f"it gives no pictures of {TILE_PX} pixels"
    layers = [
        found
        for top in root.iterfind("Capability/Layer")
        for found in _wms_layers(top, _Inherited(), base=base, pictures=pictures, problem=problem)
    ]
    return MapService(title, tuple(layers))


def _origin_or_none(address: str) -> tuple[str, int | None] | None:
    try:
        return _origin(address)
    except ValueError:
        return None


def _wms_layers(
    layer: Element, outer: _Inherited, *, base: str, pictures: tuple[str, ...], problem: str | None
) -> Iterator[OfferedLayer]:
    here = _inherited(layer, outer)
    name = child_text(layer, "Name")
    if name:
        system = next((s for s in (*_MERCATOR, _DEGREES) if s in here.systems), None)
        own = problem
        if layer.get("noSubsets") in ("1", "true") or layer.get("fixedWidth", "0") not in ("0", ""):
            own = own or "only the whole picture can be fetched"
        if system is None:
            others = ", ".join(sorted(here.systems)[:5]) or "none"
            own = own or f"it has neither EPSG:3857 nor EPSG:4326, but {plain(others)}"
        zoom = _zoom_of(here.finest_scale)
        yield OfferedLayer(
            name,
            plain(child_text(layer, "Title")) or plain(name),
            {} if own else {p: _map_address(base, name, str(system), picture=p) for p in pictures},
            own,
            _USUAL_ZOOM if math.isnan(zoom) else min(max(math.floor(zoom + 1e-6), 0), MAX_ZOOM),
            here.attribution,
            here.box,
        )
    for inner in layer.iterfind("Layer"):
        yield from _wms_layers(inner, here, base=base, pictures=pictures, problem=problem)


def _inherited(layer: Element, outer: _Inherited) -> _Inherited:
    systems = {(element.text or "").strip().upper() for element in layer.iterfind("CRS")}
    found = layer.find("EX_GeographicBoundingBox")
    sides = ("westBoundLongitude", "southBoundLatitude", "eastBoundLongitude", "northBoundLatitude")
    box = None if found is None else _box(child_text(found, side) for side in sides)
    scale = number(child_text(layer, "MinScaleDenominator"))
    return _Inherited(
        outer.systems | systems,
        plain(layer.findtext("Attribution/Title") or "") or outer.attribution,
        box or outer.box,
        outer.finest_scale if math.isnan(scale) else scale,
    )


def _map_address(base: str, name: str, system: str, *, picture: str) -> str:
    parameters = {"SERVICE": "WMS", "VERSION": "1.3.0", "REQUEST": "GetMap", "LAYERS": name, "STYLES": ""}
    parameters |= {"CRS": system, "WIDTH": str(TILE_PX), "HEIGHT": str(TILE_PX), "FORMAT": picture}
    box = "{bbox-4326}" if system == _DEGREES else "{bbox}"
    return _with_query(base, parameters, filled=f"&BBOX={box}")


def _usable(formats: Iterable[str | None]) -> tuple[str, ...]:
    offered = {(text or "").strip().lower() for text in formats}
    return tuple(picture for picture in PICTURES if picture in offered)


# WMTS


class _Grid(NamedTuple):
    """A set of tile matrices that is the usual grid."""

    name: str
    prefix: str  # Of the names of its matrices, before the zoom
    zooms: frozenset[int]


def _wmts(root: Element, where: Where) -> MapService:
    contents = root.find("Contents")
    assert contents is not None, "checked by the caller"
    sets = [_grid(one) for one in contents.iterfind("TileMatrixSet")]
    grids = {grid.name: grid for grid in sets if grid is not None}
    title = plain(root.findtext("ServiceIdentification/Title") or "")
    provider = plain(root.findtext("ServiceProvider/ProviderName") or "")
    get_tile = _get_tile(root)
    layers = [_wmts_layer(one, grids, get_tile=get_tile, where=where) for one in contents.iterfind("Layer")]
    return MapService(
        title, tuple(_credited(layer, provider or title) for layer in layers if layer is not None)
    )


def _credited(layer: OfferedLayer, credit: str) -> OfferedLayer:
    return replace(layer, attribution=layer.attribution or credit)


def _grid(found: Element) -> _Grid | None:
    """Return a set of tile matrices; None if it is another grid, or is not named by zooms."""
    system = child_text(found, "SupportedCRS").rpartition(":")[2]
    prefixes, zooms = set(), set()
    for matrix in found.iterfind("TileMatrix"):
        zoom = _zoom_of(number(child_text(matrix, "ScaleDenominator")))
        corner = [number(text) for text in child_text(matrix, "TopLeftCorner").split()]
        sides = [child_text(matrix, side) for side in ("TileWidth", "TileHeight")]
        name = child_text(matrix, "Identifier")
        if math.isnan(zoom) or abs(zoom - round(zoom)) > 0.01 or sides != [str(TILE_PX)] * 2:
            return None
        if len(corner) != 2 or not (abs(corner[0] + _HALF_M) < 1.0 and abs(corner[1] - _HALF_M) < 1.0):
            return None
        zoom = round(zoom)
        if not name.endswith(str(zoom)):
            return None
        prefixes.add(name[: -len(str(zoom))])
        zooms.add(zoom)
    if f"EPSG:{system}" not in _MERCATOR or len(prefixes) != 1:
        return None
    return _Grid(child_text(found, "Identifier"), prefixes.pop(), frozenset(zooms))


def _get_tile(root: Element) -> str | None:
    """Return the address of requests with parameters, if the service takes them."""
    for get in root.iterfind("OperationsMetadata/Operation[@name='GetTile']/DCP/HTTP/Get"):
        values = get.iterfind("Constraint/AllowedValues/Value")
        encodings = {(value.text or "").strip().upper() for value in values}
        if not encodings or "KVP" in encodings:
            return get.get(_HREF)
    return None


def _wmts_layer(
    layer: Element, grids: dict[str, _Grid], *, get_tile: str | None, where: Where
) -> OfferedLayer | None:
    name = child_text(layer, "Identifier")
    if not name:
        return None
    links = {child_text(link, "TileMatrixSet"): link for link in layer.iterfind("TileMatrixSetLink")}
    grid = next((grids[one] for one in links if one in grids), None)
    addresses = {} if grid is None else _tile_addresses(layer, grid, get_tile)
    zooms = frozenset() if grid is None else _limited(links[grid.name], grid)
    problem = None
    if grid is None:
        problem = "it does not have the usual grid of web Mercator with tiles of 256 pixels, named by zooms"
    elif not addresses or not zooms:
        problem = "it has no address of tiles in JPEG, PNG or WebP that can be used"
    elif not all(_is_allowed(address, where) for address in addresses.values()):
        host = plain(next(iter(addresses.values())).partition("://")[2].partition("/")[0])
        problem = f"its tiles are on another host, {host[:100]}: see --host"
    box = layer.find("WGS84BoundingBox")
    ends = ("LowerCorner", "UpperCorner")
    corners = [] if box is None else " ".join(child_text(box, end) for end in ends).split()
    return OfferedLayer(
        name,
        plain(child_text(layer, "Title")) or plain(name),
        {} if problem else addresses,
        problem,
        min(max(zooms, default=0), MAX_ZOOM),
        box=_box(corners) if len(corners) == 4 else None,
    )


def _limited(link: Element, grid: _Grid) -> frozenset[int]:
    """Return the zooms that a layer has of a grid."""
    limits = {child_text(one, "TileMatrix") for one in link.iterfind("TileMatrixSetLimits/TileMatrixLimits")}
    return grid.zooms if not limits else frozenset(z for z in grid.zooms if f"{grid.prefix}{z}" in limits)


def _tile_addresses(layer: Element, grid: _Grid, get_tile: str | None) -> dict[str, str]:
    """Return the templates of a layer's tiles: the addresses that it lists, else with parameters."""
    style = _style(layer)
    names = {child_text(d, "Identifier"): child_text(d, "Default") for d in layer.iterfind("Dimension")}
    listed = {
        resource.get("format", "").lower(): resource.get("template", "")
        for resource in layer.iterfind("ResourceURL")
        if resource.get("resourceType") == "tile"
    }
    fixed = {"style": style, "tilematrixset": grid.name, **{n.lower(): v for n, v in names.items()}}
    fixed = {name: quote(value, safe="") for name, value in fixed.items()}
    filled = {picture: _filled(listed[picture], fixed, grid) for picture in PICTURES if picture in listed}
    found = {picture: address for picture, address in filled.items() if address is not None}
    if found or get_tile is None:
        return found
    parameters = {"SERVICE": "WMTS", "VERSION": "1.0.0", "REQUEST": "GetTile"}
    parameters |= {"LAYER": child_text(layer, "Identifier"), "STYLE": style, "TILEMATRIXSET": grid.name}
    prefix = quote(grid.prefix, safe=":")
    tile = f"&TILEMATRIX={prefix}{{z}}&TILEROW={{y}}&TILECOL={{x}}"
    pictures = _usable(element.text for element in layer.iterfind("Format"))
    return {p: _with_query(get_tile, {**parameters, **names, "FORMAT": p}, filled=tile) for p in pictures}


def _filled(template: str, fixed: dict[str, str], grid: _Grid) -> str | None:
    """Fill the places of a listed address; None if one is unknown."""
    prefix = quote(grid.prefix, safe=":")
    places = {**fixed, "tilematrix": f"{prefix}{{z}}", "tilerow": "{y}", "tilecol": "{x}"}
    parts = template.replace("}", "{").split("{")
    if len(parts) % 2 == 0 or any(place.lower() not in places for place in parts[1::2]):
        return None
    return "".join(places[part.lower()] if n % 2 else part for n, part in enumerate(parts))


def _style(layer: Element) -> str:
    styles = layer.findall("Style")
    usual = [one for one in styles if one.get("isDefault") in ("true", "1")] or styles
    return child_text(usual[0], "Identifier") if usual else "default"
