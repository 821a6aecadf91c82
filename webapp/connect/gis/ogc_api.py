"""OGC API - Features, read only, for QGIS and other programs: core, GeoJSON, and filters (Part 3, CQL2)."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any
from urllib.parse import quote

from apiflask import APIBlueprint, Schema
from apiflask.fields import Dict, List, Nested, String
from flask import request, url_for

from webapp.connect.gis.cql2 import Kind
from webapp.connect.gis.ogc_collections import (
    Collection,
    check_right,
    describe,
    item,
    items,
    list_collections,
    queryables,
)
from webapp.connect.gis.ogc_query import CRS84, FORMAT_PARAMETER, ITEM_PARAMETERS, checked, parse_items
from webapp.files.exchange.times import utc
from webapp.missions.web.context import allow_any_text
from webapp.store.clock import now
from webapp.web.context import authorized_by
from webapp.web.openapi import PATH, file_answer

blueprint = APIBlueprint("api_ogc", __name__, url_prefix="/api/v1/ogc", tag="Import and export")
blueprint.record(allow_any_text)

_GEOJSON = "application/geo+json"
_JSON = "application/json"
_OPENAPI = "application/vnd.oai.openapi+json;version=3.1"
_GREGORIAN = "http://www.opengis.net/def/uom/ISO-8601/0/Gregorian"
_SPEC = "http://www.opengis.net/spec"
_CONFORMANCE = (
    *(f"{_SPEC}/ogcapi-features-1/1.0/conf/{name}" for name in ("core", "geojson")),
    *(f"{_SPEC}/ogcapi-features-3/1.0/conf/{name}" for name in ("queryables", "filter", "features-filter")),
    *(f"{_SPEC}/cql2/1.0/conf/{name}" for name in ("cql2-text", "basic-cql2")),
)
_SCHEMA = "application/schema+json"
_QUERYABLES = "http://www.opengis.net/def/rel/ogc/1.0/queryables"
_TYPES: Mapping[Kind, dict[str, str]] = {
    "number": {"type": "number"},
    "text": {"type": "string"},
    "time": {"type": "string", "format": "date-time"},
    "boolean": {"type": "boolean"},
}

_right = authorized_by(lambda collection, **_: check_right(collection))

Answer = tuple[dict[str, Any], int, dict[str, str]]


class OgcLink(Schema):
    """A link."""

    href = String()
    rel = String()
    type = String()
    title = String()


class OgcLanding(Schema):
    """Where everything else is."""

    title = String()
    description = String()
    links = List(Nested(OgcLink))


class OgcConformance(Schema):
    """The classes of the standard that are implemented."""

    conformsTo = List(String())  # noqa: N815  # as the standard has it


class OgcCollection(Schema):
    """A collection of features."""

    id = String()
    title = String()
    description = String()
    extent = Dict(metadata={"description": "Area and time span, if they are known."})
    itemType = String()  # noqa: N815
    crs = List(String())
    links = List(Nested(OgcLink))


class OgcCollections(Schema):
    """The collections that the caller may see."""

    links = List(Nested(OgcLink))
    collections = List(Nested(OgcCollection))


@blueprint.get("", strict_slashes=False)
@blueprint.output(OgcLanding)
def landing() -> dict[str, Any]:
    """Show where the features are (OGC API - Features)."""
    _only_format()
    return {
        "title": "Experience Map",
        "description": "Maps and missions: photos, notes, tracks and objects.",
        "links": [
            _link(_address("landing"), "self", "This page"),
            _link(request.host_url.rstrip("/") + PATH, "service-desc", "The API", type=_OPENAPI),
            _link(
                url_for("manual_pages.show", name="gis", _external=True),
                "service-doc",
                "GIS",
                type="text/html",
            ),
            _link(_address("conformance"), "conformance", "What is implemented"),
            _link(_address("collections"), "data", "The collections"),
        ],
    }


@blueprint.get("/conformance")
@blueprint.output(OgcConformance)
def conformance() -> dict[str, Any]:
    """List the classes of the standard that are implemented."""
    _only_format()
    return {"conformsTo": list(_CONFORMANCE)}


@blueprint.get("/collections")
@blueprint.output(OgcCollections)
def collections() -> dict[str, Any]:
    """List the collections: photos and notes of maps, tracks and objects of missions."""
    _only_format()
    links = [_link(_address("collections"), "self", "The collections")]
    return {"links": links, "collections": [_collection_json(one) for one in list_collections()]}


@blueprint.get("/collections/<collection>")
@_right
@blueprint.output(OgcCollection)
def show_collection(collection: str) -> dict[str, Any]:
    """Describe a collection."""
    _only_format()
    return _collection_json(describe(collection))


@blueprint.get("/collections/<collection>/queryables")
@_right
@blueprint.doc(responses=file_answer("A JSON Schema.", _SCHEMA))
def show_queryables(collection: str) -> Answer:
    """List the properties that a filter on a collection may name (OGC API - Features, Part 3)."""
    _only_format()
    named = {name: {"title": name, **_TYPES[kind]} for name, kind in queryables(collection).items()}
    answer = {
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "$id": _address("show_queryables", collection=collection),
        "type": "object",
        "title": describe(collection).title,
        "properties": named,
        "additionalProperties": False,
    }
    return answer, 200, {"Content-Type": _SCHEMA}


@blueprint.get("/collections/<collection>/items")
@_right
@blueprint.doc(responses=file_answer("A feature collection.", _GEOJSON))
def list_items(collection: str) -> Answer:
    """Get features of a collection, by area and time, in pages."""
    query = parse_items(request.args.to_dict(flat=False), queryables(collection))
    found = items(collection, query)
    own = {name: value for name, value in request.args.items() if name != "after"}
    links = [
        _link(_address("list_items", collection=collection, **request.args), "self", "This", type=_GEOJSON),
        _link(_address("show_collection", collection=collection), "collection", "The collection"),
    ]
    if found.after is not None:
        following = _address("list_items", collection=collection, **own, after=found.after)
        links.append(_link(following, "next", "More", type=_GEOJSON))
    answer = {
        "type": "FeatureCollection",
        "features": found.features,
        "links": links,
        "timeStamp": utc([now().timestamp()])[0],
        "numberReturned": len(found.features),
    }
    if found.matched is not None:
        answer["numberMatched"] = found.matched
    return answer, 200, {"Content-Type": _GEOJSON}


@blueprint.get("/collections/<collection>/items/<text:feature>", merge_slashes=False)
@_right
@blueprint.doc(responses=file_answer("A feature.", _GEOJSON))
def show_item(collection: str, feature: str) -> Answer:
    """Get one feature."""
    _only_format()
    links = [
        _link(
            f"{_address('list_items', collection=collection)}/{quote(feature)}", "self", "This", type=_GEOJSON
        ),
        _link(_address("show_collection", collection=collection), "collection", "The collection"),
    ]
    return item(collection, feature) | {"links": links}, 200, {"Content-Type": _GEOJSON}


def _only_format() -> None:
    checked(request.args.to_dict(flat=False), {"f"})


def _address(view: str, **values: Any) -> str:
    return url_for(f"{blueprint.name}.{view}", _external=True, **values)


def _link(href: str, rel: str, title: str, *, type: str = _JSON) -> dict[str, str]:
    return {"href": href, "rel": rel, "type": type, "title": title}


def _collection_json(one: Collection) -> dict[str, Any]:
    extent: dict[str, Any] = {}
    if one.box is not None:
        extent["spatial"] = {"bbox": [one.box], "crs": CRS84}
    if one.span_s is not None:
        extent["temporal"] = {"interval": [utc(one.span_s)], "trs": _GREGORIAN}
    own = _address("show_collection", collection=one.id)
    links = [
        _link(own, "self", one.title),
        _link(_address("list_items", collection=one.id), "items", one.title, type=_GEOJSON),
        _link(_address("show_queryables", collection=one.id), _QUERYABLES, "Queryables", type=_SCHEMA),
    ]
    about = {"id": one.id, "title": one.title, "description": one.about, "itemType": "feature"}
    return {**about, "crs": [CRS84], "links": links, **({"extent": extent} if extent else {})}


PATH_PARAMETERS = {
    "collection": {"description": "Id of the collection, such as `map-park-photos` or `mission-7-tracks`."},
    "feature": {"description": "Id of the feature."},
}
OPERATIONS: dict[str, dict[str, Any]] = {
    f"api_ogc.{view}": {"parameters": [*more, FORMAT_PARAMETER]}
    for view, more in (
        ("landing", ()),
        ("conformance", ()),
        ("collections", ()),
        ("show_collection", ()),
        ("show_queryables", ()),
        ("list_items", ITEM_PARAMETERS),
        ("show_item", ()),
    )
}
