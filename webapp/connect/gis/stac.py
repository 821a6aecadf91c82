"""STAC API, read only, for readers of street-level photos: a collection per map, an item per photo.

It follows STAC 1.1 and STAC API 1.0 (core, collections, features, item search), and has what readers of
Panoramax use: https://docs.panoramax.fr/api/
"""

from __future__ import annotations

import json
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import Dict, Float, Integer, List, Nested, String
from apiflask.validators import Length, Range
from flask import request, url_for

from webapp.connect.gis.ogc_api import OgcLink
from webapp.connect.gis.ogc_query import (
    COMMON_PARAMETERS,
    FORMAT_PARAMETER,
    ItemQuery,
    checked,
    parse_common,
)
from webapp.connect.gis.stac_items import (
    VERSION,
    Found,
    Scope,
    check_right,
    collection,
    item,
    of_map,
    visible,
)
from webapp.connect.gis.stac_items import search as search_items
from webapp.connect.gis.stac_regions import MOST_CORNERS, parse_region
from webapp.errors import UsageError
from webapp.files.exchange.times import utc
from webapp.missions.web.context import allow_any_text
from webapp.store.clock import now
from webapp.store.schema import MapRecord
from webapp.web.context import authorized_by, open_map
from webapp.web.fields import BoundedList, JsonValue
from webapp.web.openapi import PATH

blueprint = APIBlueprint("api_stac", __name__, url_prefix="/api/v1/stac", tag="Import and export")
blueprint.record(allow_any_text)

_GEOJSON = "application/geo+json"
_JSON = "application/json"
_OPENAPI = "application/vnd.oai.openapi+json;version=3.1"
_CONFORMANCE = (
    *(
        f"https://api.stacspec.org/v1.0.0/{name}"
        for name in ("core", "collections", "ogcapi-features", "item-search")
    ),
    *(f"http://www.opengis.net/spec/ogcapi-features-1/1.0/conf/{name}" for name in ("core", "geojson")),
)
_MOST_IDS, _MOST_MAPS = 100, 20
_MOST_REGION = 60 * MOST_CORNERS
"""Characters of a geometry."""

_LONG = {"ids": 20_000, "collections": 20_000, "intersects": _MOST_REGION}

_right = authorized_by(lambda slug, **_: check_right(slug))

Answer = tuple[dict[str, Any], int, dict[str, str]]


class StacLink(OgcLink):
    """A link; with a method and a body where it is to be posted."""

    method = String()
    body = Dict()
    id = String(metadata={"description": "Of the photo before or after this one by time."})
    geometry = Dict(allow_none=True, metadata={"description": "Where that one was taken."})


class StacCatalog(Schema):
    """Where everything else is."""

    type = String()
    stac_version = String()
    id = String()
    title = String()
    description = String()
    conformsTo = List(String())  # noqa: N815  # as the standard has it
    links = List(Nested(StacLink))


class StacConformance(Schema):
    """The classes of the standard that are implemented."""

    conformsTo = List(String())  # noqa: N815


class StacCollection(Schema):
    """The photos of a map."""

    type = String()
    stac_version = String()
    stac_extensions = List(String())
    id = String(metadata={"description": "Name of the map in addresses."})
    title = String()
    description = String()
    license = String(metadata={"description": "`other`: items have that of photos from services."})
    providers = List(Dict())
    extent = Dict(metadata={"description": "Area and time span."})
    links = List(Nested(StacLink))


class StacCollections(Schema):
    """The maps that the caller may see."""

    collections = List(Nested(StacCollection))
    links = List(Nested(StacLink))


class StacItem(Schema):
    """A photo."""

    type = String()
    stac_version = String()
    stac_extensions = List(String())
    id = String(metadata={"description": "Name of the map and number of the photo."})
    collection = String()
    geometry = Dict(allow_none=True, metadata={"description": "Where it was taken."})
    bbox = List(Float())
    properties = Dict(
        metadata={
            "description": "`datetime`, or null with `start_datetime` and `end_datetime`; `view:azimuth`, "
            "`pers:interior_orientation`, `quality:horizontal_accuracy` and so on, if they are known."
        }
    )
    assets = Dict(metadata={"description": "`thumb`, `sd`, and `hd` if no part of it is blurred."})
    links = List(Nested(StacLink))


class StacItems(Schema):
    """Some photos."""

    type = String()
    features = List(Nested(StacItem))
    links = List(Nested(StacLink))
    timeStamp = String()  # noqa: N815
    numberReturned = Integer()  # noqa: N815
    numberMatched = Integer(  # noqa: N815
        metadata={"description": "Of a search, only if all are in the answer."}
    )


class StacSearch(Schema):
    """What to look for."""

    bbox = BoundedList(Float(), least=4, most=6)
    datetime = String(validate=Length(max=100))
    intersects = JsonValue(
        bytes=_MOST_REGION,
        values=4 * MOST_CORNERS,
        metadata={"description": "A GeoJSON geometry.", "type": "object"},
    )
    ids = BoundedList(String(validate=Length(max=230)), most=_MOST_IDS)
    collections = BoundedList(String(validate=Length(max=230)), most=_MOST_MAPS)
    limit = Integer(validate=Range(min=1, max=10**9))  # more than the server gives is that much
    after = String(validate=Length(max=300))


@blueprint.get("", strict_slashes=False)
@blueprint.output(StacCatalog)
def landing() -> dict[str, Any]:
    """Show where the photos are (STAC API)."""
    _only_format()
    return {
        "type": "Catalog",
        "stac_version": VERSION,
        "id": "experience-map",
        "title": "Experience Map",
        "description": "Photos of maps.",
        "conformsTo": list(_CONFORMANCE),
        "links": [
            _link(_address("landing"), "self", "This page"),
            _link(_address("landing"), "root", "This page"),
            _link(request.host_url.rstrip("/") + PATH, "service-desc", "The API", type=_OPENAPI),
            _link(
                url_for("manual_pages.show", name="stac", _external=True),
                "service-doc",
                "STAC",
                type="text/html",
            ),
            _link(_address("conformance"), "conformance", "What is implemented"),
            _link(_address("collections"), "data", "The maps"),
            _link(_address("search"), "search", "Search", type=_GEOJSON) | {"method": "GET"},
            _link(_address("search"), "search", "Search", type=_GEOJSON) | {"method": "POST"},
            *(
                _link(_address("show_collection", slug=record.slug), "child", record.name)
                for record in visible()
            ),
        ],
    }


@blueprint.get("/conformance")
@blueprint.output(StacConformance)
def conformance() -> dict[str, Any]:
    """List the classes of the standard that are implemented."""
    _only_format()
    return {"conformsTo": list(_CONFORMANCE)}


@blueprint.get("/collections")
@blueprint.output(StacCollections)
def collections() -> dict[str, Any]:
    """List the maps, as collections of photos."""
    _only_format()
    links = [_link(_address("collections"), "self", "The maps"), _root()]
    return {"links": links, "collections": [_collection(record) for record in visible()]}


@blueprint.get("/collections/<slug>")
@_right
@blueprint.output(StacCollection)
def show_collection(slug: str) -> dict[str, Any]:
    """Describe a map, as a collection of photos."""
    _only_format()
    return _collection(open_map(slug))


@blueprint.get("/collections/<slug>/items")
@_right
@blueprint.output(StacItems, content_type=_GEOJSON)
def list_items(slug: str) -> Answer:
    """Get photos of a map, by area and time, in pages."""
    query, scope = _parsed()
    found = of_map(slug, query, scope=scope)
    own = {name: value for name, value in request.args.items() if name != "after"}
    links = [
        _link(_address("list_items", slug=slug, **request.args), "self", "This", type=_GEOJSON),
        _link(_address("show_collection", slug=slug), "collection", "The map"),
    ]
    for rel, title, more in _pages(found):
        other = _link(_address("list_items", slug=slug, **own, **more), rel, title, type=_GEOJSON)
        links.append(other | {"method": "GET"})
    return _features(found, links)


@blueprint.get("/collections/<slug>/items/<text:feature>", merge_slashes=False)
@_right
@blueprint.output(StacItem, content_type=_GEOJSON)
def show_item(slug: str, feature: str) -> Answer:
    """Get one photo."""
    _only_format()
    return _with_links(item(slug, feature)), 200, {"Content-Type": _GEOJSON}


@blueprint.get("/search")
@blueprint.output(StacItems, content_type=_GEOJSON)
def search() -> Answer:
    """Look for photos on all maps."""
    query, scope = _parsed()
    found = search_items(query, scope)
    own = {name: value for name, value in request.args.items() if name != "after"}
    links = [_link(_address("search", **request.args), "self", "This", type=_GEOJSON)]
    for rel, title, more in _pages(found):
        other = _link(_address("search", **own, **more), rel, title, type=_GEOJSON)
        links.append(other | {"method": "GET"})
    return _features(found, links)


@blueprint.post("/search")
@blueprint.input(StacSearch, arg_name="body")
@blueprint.output(StacItems, content_type=_GEOJSON)
def search_by_body(body: dict[str, Any]) -> Answer:
    """Look for photos on all maps, by a body of JSON."""
    values: dict[str, str] = {
        name: str(body[name]) for name in ("datetime", "limit", "after") if name in body
    }
    if "bbox" in body:
        values["bbox"] = ",".join(map(str, body["bbox"]))
    found = search_items(
        _query(values, body.get("intersects")), _scope(body.get("collections"), body.get("ids"))
    )
    links = [_link(_address("search"), "self", "This", type=_GEOJSON)]
    own = {name: value for name, value in body.items() if name != "after"}
    for rel, title, more in _pages(found):
        other = _link(_address("search"), rel, title, type=_GEOJSON)
        links.append(other | {"method": "POST", "body": own | more})
    return _features(found, links)


def _parsed() -> tuple[ItemQuery, Scope]:
    known = {"f", *(parameter["name"] for parameter in _SEARCH_PARAMETERS)}
    values = checked(request.args.to_dict(flat=False), known, long=_LONG)
    region = None
    if "intersects" in values:
        try:
            region = json.loads(values["intersects"])
        except (ValueError, RecursionError) as error:
            raise UsageError(
                "this is not JSON", where="intersects", hint="send a GeoJSON geometry"
            ) from error
    listed = [values[name].split(",") if name in values else None for name in ("collections", "ids")]
    return _query(values, region), _scope(*listed)


def _query(values: Mapping[str, str], geometry: Any) -> ItemQuery:
    query = parse_common(values)
    if geometry is None:
        return query
    if query.box is not None:
        raise UsageError("an area is given twice", where="intersects", hint="use either bbox or intersects")
    return query.in_region(parse_region(geometry))


def _scope(collections: Sequence[str] | None, ids: Sequence[str] | None) -> Scope:
    for name, some, most in (("ids", ids, _MOST_IDS), ("collections", collections, _MOST_MAPS)):
        if some is not None and len(some) > most:
            raise UsageError("there are too many", where=name, hint=f"use at most {most}")
    return Scope(*(None if some is None else frozenset(some) for some in (collections, ids)))


def _pages(found: Found) -> Iterator[tuple[str, str, dict[str, str]]]:
    """Yield the relation, the title and the parameters of the pages before and after."""
    if found.before is not None:
        yield "prev", "Before", {"after": found.before} if found.before else {}
    if found.after is not None:
        yield "next", "More", {"after": found.after}


def _features(found: Found, links: list[dict[str, Any]]) -> Answer:
    answer = {
        "type": "FeatureCollection",
        "features": [_with_links(one) for one in found.items],
        "links": [*links, _root()],
        "timeStamp": utc([now().timestamp()])[0],
        "numberReturned": len(found.items),
    }
    if found.matched is not None:
        answer["numberMatched"] = found.matched
    return answer, 200, {"Content-Type": _GEOJSON}


def _with_links(one: dict[str, Any]) -> dict[str, Any]:
    own, slug = one["id"], one["collection"]
    of_map = _address("show_collection", slug=slug)
    beside = [
        link
        | _link(_address("show_item", slug=slug, feature=link["id"]), link["rel"], link["id"], type=_GEOJSON)
        for link in one["links"]
    ]
    return one | {
        "links": [
            *beside,
            _link(_address("show_item", slug=slug, feature=own), "self", own, type=_GEOJSON),
            _link(of_map, "collection", "The map"),
            _link(of_map, "parent", "The map"),
            _root(),
        ]
    }


def _collection(record: MapRecord) -> dict[str, Any]:
    own = _address("show_collection", slug=record.slug)
    items = _address("list_items", slug=record.slug)
    view = url_for("map_pages.show", slug=record.slug, _external=True)
    return collection(record) | {
        "links": [
            _link(own, "self", record.name),
            _link(items, "items", "The photos", type=_GEOJSON),
            _link(_address("landing"), "parent", "Experience Map"),
            _link(view, "alternate", "The map in a browser", type="text/html"),
            _root(),
        ]
    }


def _only_format() -> None:
    checked(request.args.to_dict(flat=False), {"f"})


def _address(view: str, **values: Any) -> str:
    return url_for(f"{blueprint.name}.{view}", _external=True, **values)


def _link(href: str, rel: str, title: str, *, type: str = _JSON) -> dict[str, Any]:
    return {"href": href, "rel": rel, "type": type, "title": title}


def _root() -> dict[str, Any]:
    return _link(_address("landing"), "root", "Experience Map")


_SEARCH_PARAMETERS: tuple[dict[str, Any], ...] = (
    *COMMON_PARAMETERS,
    *(
        {
            "name": name,
            "in": "query",
            "description": f"{what}, with commas between them; at most {most}.",
            "style": "form",
            "explode": False,
            "schema": {"type": "array", "items": {"type": "string"}},
        }
        for name, what, most in (
            ("ids", "Ids of photos", _MOST_IDS),
            ("collections", "Names of maps", _MOST_MAPS),
        )
    ),
    {
        "name": "intersects",
        "in": "query",
        "description": "A GeoJSON geometry; photos in or on it are found.",
        "schema": {"type": "string", "maxLength": _MOST_REGION},
    },
)
OPERATIONS: dict[str, dict[str, Any]] = {
    f"api_stac.{view}": {"parameters": [*more, FORMAT_PARAMETER]}
    for view, more in (
        ("landing", ()),
        ("conformance", ()),
        ("collections", ()),
        ("show_collection", ()),
        ("list_items", _SEARCH_PARAMETERS),
        ("show_item", ()),
        ("search", _SEARCH_PARAMETERS),
    )
}
