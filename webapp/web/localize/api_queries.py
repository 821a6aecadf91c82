"""API of the queries of a map: history, matches, export, and adding a query's photo to the map."""

from __future__ import annotations

from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import Dict, Float, Integer, List, Nested, String
from apiflask.validators import Range
from flask import Response, url_for
from sqlalchemy.orm import Session

from webapp.core.geo.types import MapPixel
from webapp.errors import NotAllowed, UsageError
from webapp.files.photos.photo import Kind
from webapp.store import queries
from webapp.store.maps import maps
from webapp.store.schema import MapRecord, QueryRecord
from webapp.tasks.exchange import export_files
from webapp.tasks.exchange.export_files import AnswerFormat, AnswerRange
from webapp.tasks.localize import adopt_query, show_query
from webapp.tasks.localize.adopt_query import Spot
from webapp.web.context import account, library, map_role, open_map, reading_map, settings
from webapp.web.fields import Boolean, RecordNumber
from webapp.web.localize.answers import Located
from webapp.web.openapi import file_answer
from webapp.web.sending import send_original, send_picture, send_pieces

blueprint = APIBlueprint(
    "api_queries", __name__, url_prefix="/api/v1/maps/<slug>/queries", tag="Localization"
)

_MOST = 100
_ID = "<id:id>"


class ListIn(Schema):
    """The requested part of the history."""

    before = RecordNumber(load_default=None, metadata={"description": "Only older ones than this id."})
    limit = Integer(load_default=50, validate=Range(1, _MOST))


class AnswersIn(Schema):
    """The answers to export."""

    first = RecordNumber(load_default=None, metadata={"description": "Id of the first one."})
    last = RecordNumber(load_default=None, metadata={"description": "Id of the last one."})
    mine = Boolean(load_default=False, metadata={"description": "Only what you asked yourself."})


class QueryOut(Schema):
    """A query."""

    id = Integer()
    name = String()
    at = String()
    who = String(allow_none=True)
    width = Integer()
    height = Integer()
    options = Dict()
    answer = Nested(Located)
    adopted = Integer(allow_none=True, metadata={"description": "Id of the photo that it has become."})
    photo = String()
    preview = String()
    thumb = String()


class QueryList(Schema):
    """The history of a map, the newest first."""

    queries = List(Nested(QueryOut))


class MatchesOut(Schema):
    """Matches between the query and one photo of the map, pixels of the upright photos."""

    experience = Integer()
    query_xy = List(List(Float()))
    photo_xy = List(List(Float()))
    inlier = List(Integer(), metadata={"description": "1 where a match agrees with the geometry."})


class MatchesList(Schema):
    """Matches with the photos that support the hypotheses, the best first."""

    matches = List(Nested(MatchesOut))


class AdoptIn(Schema):
    """Position and heading of the new experience; by default those of the answer."""

    x_px = Float(allow_none=True, load_default=None)
    y_px = Float(allow_none=True, load_default=None)
    heading_deg = Float(allow_none=True, load_default=None)
    floor = RecordNumber(allow_none=True, load_default=None, metadata={"description": "Id of its floor."})


class AdoptOut(Schema):
    """The new experience."""

    id = Integer()
    x_px = Float()
    y_px = Float()
    heading_deg = Float(allow_none=True)
    job = Integer(allow_none=True)


@blueprint.get("")
@blueprint.input(ListIn, location="query", arg_name="query")
@blueprint.output(QueryList)
def history(slug: str, query: dict[str, Any]) -> dict[str, Any]:
    """List the queries of a map."""
    with reading_map(slug) as (session, record):
        return {"queries": _queries_json(session, record, queries.list_queries(session, record, **query))}


@blueprint.get("/answers.<any(csv,gpx,geojson):form>")
@map_role("viewer")
@blueprint.input(AnswersIn, location="query", arg_name="query")
@blueprint.doc(responses=file_answer("The answers, the oldest first.", "*/*"))
def export(slug: str, form: AnswerFormat, *, query: dict[str, Any]) -> Response:
    """Download the most probable place of each photo as a CSV table, GPX waypoints or GeoJSON points."""
    record, who = open_map(slug), account()
    which = AnswerRange(query["first"], query["last"], who.id if query["mine"] else None)
    return send_pieces(export_files.export_answers(library(), record.id, form=form, which=which))


@blueprint.get(f"/{_ID}")
@blueprint.output(QueryOut)
def show(slug: str, id: int) -> dict[str, Any]:
    """Get a query with its answer."""
    with reading_map(slug) as (session, record):
        return _queries_json(session, record, [queries.find(session, record, id)])[0]


@blueprint.get(f"/{_ID}/matches")
@blueprint.output(MatchesList)
def matches(slug: str, id: int) -> dict[str, Any]:
    """Get the matches with photos of the map."""
    with reading_map(slug) as (session, record):
        return {"matches": queries.find(session, record, id).evidence}


@blueprint.delete(f"/{_ID}")
@blueprint.output({}, status_code=204)
def delete(slug: str, id: int) -> str:
    """Delete a query and its photo: viewers can delete their own, editors of the map all."""
    record, who = open_map(slug), account()
    with library().database.write() as session:
        row = queries.find(session, record, id)
        if row.account_id != who.id and maps.role_of(session, record, account=who) == "viewer":
            raise NotAllowed("this query belongs to another user", hint="ask an editor of the map")
        session.delete(row)
    show_query.delete_files(library(), [row])
    return ""


@blueprint.post(f"/{_ID}/adopt")
@map_role("editor")
@blueprint.input(AdoptIn, arg_name="place")
@blueprint.output(AdoptOut, status_code=201)
def adopt(slug: str, id: int, *, place: dict[str, float | None]) -> dict[str, Any]:
    """Add the photo of a query to the map as an experience."""
    record = open_map(slug, "editor")
    x, y = place["x_px"], place["y_px"]
    if (x is None) != (y is None):
        raise UsageError("one of x_px and y_px is missing", where="x_px", hint="give both or neither")
    position = None if x is None or y is None else MapPixel(x, y)
    floor = None if place["floor"] is None else int(place["floor"])
    done = adopt_query.adopt_query(
        library(),
        record.id,
        query_id=id,
        spot=Spot(position, place["heading_deg"], floor),
        account_id=account().id,
        settings=settings(),
    )
    at = {"x_px": done.position.x, "y_px": done.position.y, "heading_deg": done.heading_deg}
    return {"id": done.id, **at, "job": done.job}


@blueprint.get(f"/{_ID}/photo")
@blueprint.doc(responses=file_answer("The original file.", "image/*"))
def photo(slug: str, id: int) -> Response:
    """Get the original file of a query."""
    row = _find(slug, id)
    return send_original(show_query.file_of(library(), row), row.name, audience="members")


@blueprint.get(f"/{_ID}/preview")
@blueprint.doc(responses=file_answer("A picture of at most 1600 x 1600 pixels.", "image/jpeg"))
def preview(slug: str, id: int) -> Response:
    """Get a preview of a query's photo, large enough to fill a screen."""
    return _preview(slug, id, "preview")


@blueprint.get(f"/{_ID}/thumb")
@blueprint.doc(responses=file_answer("A picture of at most 256 x 256 pixels.", "image/webp"))
def thumb(slug: str, id: int) -> Response:
    """Get a thumbnail of a query's photo."""
    return _preview(slug, id, "thumb")


def _queries_json(session: Session, record: MapRecord, rows: list[QueryRecord]) -> list[dict[str, Any]]:
    who = queries.names(session, rows)
    looks = show_query.looks(session, library(), rows=rows)
    return [
        {**_one(row, who.get(row.account_id or -1)), **_addresses(record.slug, row, look)}
        for row, look in zip(rows, looks, strict=True)
    ]


def _addresses(slug: str, row: QueryRecord, look: str | None) -> dict[str, str]:
    return {
        "photo": url_for("api_queries.photo", slug=slug, id=row.id),
        **{
            kind: url_for(f"api_queries.{kind}", slug=slug, id=row.id, look=look)
            for kind in ("preview", "thumb")
        },
    }


def _one(row: QueryRecord, who: str | None) -> dict[str, Any]:
    return {
        "id": row.id,
        "name": row.name,
        "at": row.at.isoformat(timespec="seconds"),
        "who": who,
        "width": row.width,
        "height": row.height,
        "options": row.options,
        "answer": row.answer,
        "adopted": row.adopted_id,
    }


def _find(slug: str, id: int) -> QueryRecord:
    with reading_map(slug) as (session, record):
        return queries.find(session, record, id)


def _preview(slug: str, id: int, kind: Kind) -> Response:
    row = _find(slug, id)
    return send_picture(show_query.file_of(library(), row), kind=kind, audience="members", changes_url=True)
