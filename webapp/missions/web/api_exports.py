"""API for exports of missions as files and links, and for queries on their rows."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import Boolean, Integer, List, Raw, String
from apiflask.validators import Length, OneOf, Range
from flask import Response, url_for

from webapp.errors import NotFound, TooMany, UsageError
from webapp.missions.core.filters import MAX_CHARACTERS
from webapp.missions.render import export_file
from webapp.missions.render.export_file import FORMATS
from webapp.missions.render.report import NOTATIONS
from webapp.missions.render.report_file import ExportOptions
from webapp.missions.store import shares
from webapp.missions.store.query import MAX_ROWS, TABLES, Question
from webapp.missions.tasks.export import LIVE_POSES, export_network_link, query_mission
from webapp.missions.web.context import mission_role, open_mission
from webapp.tasks.exchange.export_source import Download
from webapp.web import language
from webapp.web.concurrency import ConcurrencyLimit
from webapp.web.context import library, settings
from webapp.web.openapi import Responses, file_answer
from webapp.web.sending import PiecesWhileAllowed

blueprint = APIBlueprint(
    "api_mission_exports",
    __name__,
    url_prefix="/api/v1/missions/<id:mission_id>",
    tag="Missions",
)

_limit = ConcurrencyLimit("mission exports", share=0.5)
"""A slow download of a large file occupies a thread; the limit leaves others for other requests."""

blueprint.record(_limit.set_up)

_WAIT_S = 5
_TEXT = Length(max=MAX_CHARACTERS)


class ExportQuery(Schema):
    """Resolution of an export, and what a report is written in."""

    points = Integer(
        load_default=None,
        validate=Range(2, 1_000_000),
        metadata={"description": "Maximum number of poses of each track, evenly spread; by default all."},
    )
    zone = String(
        load_default="UTC",
        validate=Length(max=64),
        metadata={"description": "Time zone of a report.", "example": "Europe/Prague"},
    )
    positions = String(
        load_default="degrees",
        validate=OneOf(tuple(NOTATIONS)),
        metadata={"description": "Notation of positions in a report, beside decimal degrees."},
    )


class LinkQuery(Schema):
    """Refresh interval of a live link."""

    every = Integer(load_default=10, validate=Range(2, 86_400), metadata={"description": "Seconds."})


class TableQueryIn(Schema):
    """A query on the rows of a mission, similar to SQL."""

    table = String(data_key="from", load_default="poses", validate=OneOf(TABLES))
    select = String(
        load_default="", validate=_TEXT, metadata={"description": "Columns, with commas; by default all."}
    )
    where = String(
        load_default="",
        validate=_TEXT,
        metadata={
            "description": "Condition of =, !=, <, <=, >, >=, BETWEEN, IN, LIKE, IS NULL, AND, OR, NOT and "
            "brackets; texts and times are in single quotes.",
            "example": "class = 'car' AND confidence > 0.5",
        },
    )
    order = String(
        load_default="",
        validate=_TEXT,
        metadata={"description": "Columns to sort by, each with ASC or DESC."},
    )
    limit = Integer(load_default=1000, validate=Range(0, MAX_ROWS))
    format = String(load_default="json", validate=OneOf(("json", "csv")))


class RowsOut(Schema):
    """The matching rows."""

    columns = List(String())
    rows = List(List(Raw()), metadata={"description": "Times are seconds since 1970, UTC."})
    complete = Boolean(metadata={"description": "false: the limit cut some off."})


_ROWS: Responses = {
    200: {
        "description": "The rows that fit; or a table of them.",
        "content": {"application/json": {"schema": RowsOut}, "text/csv": {"schema": {}}},
    }
}


@blueprint.get("/export.<string(maxlength=20):ending>")
@mission_role("viewer")
@blueprint.input(ExportQuery, location="query", arg_name="query")
@blueprint.doc(responses=file_answer("The file, made while it is sent.", "*/*"))
def export_mission(mission_id: int, ending: str, *, query: dict[str, Any]) -> Response:
    """Export a mission: its data, a page (`html`), or a report to print, in the language of the caller."""
    return export(open_mission(mission_id).id, ending=ending, query=query, private=True, photos=True)


@blueprint.get("/objects.csv")
@mission_role("viewer")
@blueprint.doc(responses=file_answer("The file, made while it is sent.", "text/csv"))
def objects(mission_id: int) -> Response:
    """Export the objects of a mission with their last positions."""
    return export(open_mission(mission_id).id, ending="objects.csv", private=True)


@blueprint.get("/link.kml")
@mission_role("viewer")
@blueprint.input(LinkQuery, location="query", arg_name="query")
@blueprint.doc(responses=file_answer("The link.", "application/vnd.google-earth.kml+xml"))
def network_link(mission_id: int, query: dict[str, Any]) -> Response:
    """Get a KML link that stays up to date; programs follow it through the mission's public link."""
    mission = open_mission(mission_id)
    with library().database.read() as session:
        tokens = [share.public_token for share in shares.list_shares(session, mission)]
    token = next((token for token in tokens if token is not None), None)
    if token is None:
        raise UsageError(
            "the mission has no public link, and other programs cannot sign in",
            hint="share the mission: each link has an address of its KML",
        )
    return link(mission.name, token=token, every=query["every"])


@blueprint.get("/query")
@mission_role("viewer")
@blueprint.input(TableQueryIn, location="query", arg_name="asked")
@blueprint.doc(responses=_ROWS)
def query(mission_id: int, asked: dict[str, Any]) -> Response:
    """Query poses, objects or sightings; syntax errors give the position of the character."""
    mission, form = open_mission(mission_id), asked.pop("format")
    place = library()
    question = Question(**asked)
    return stream_download(lambda: query_mission(place, mission.id, question=question, form=form))


def export(
    mission_id: int,
    *,
    ending: str,
    query: Mapping[str, Any] | None = None,
    private: bool = False,
    photos: bool = False,
) -> Response:
    """Send a mission as a file of a format.

    Args:
        query: The fields of `ExportQuery`.
        private: Include data that visitors do not get.
        photos: Include pictures of objects in a report.

    Raises:
        NotFound: The format is unknown.
        TooMany
    """
    if ending not in FORMATS:
        raise NotFound(f"unknown export format {ending!r}", hint=f"use one of {', '.join(FORMATS)}")
    place, limits, asked = library(), settings(), dict(query or {})
    options = ExportOptions(
        most=asked.pop("points", None), private=private, photos=photos, language=language.current(), **asked
    )
    return stream_download(
        lambda: export_file.export_mission_file(
            place, mission_id, form=ending, settings=limits, options=options
        )
    )


def link(name: str, *, token: str, every: int) -> Response:
    """Send a KML link that makes programs fetch a shared mission repeatedly."""
    data: dict[str, Any] = {"token": token, "ending": "kmz", "points": LIVE_POSES}
    href = url_for("public_mission_pages.export", _external=True, **data)
    return stream_download(lambda: export_network_link(name, href=href, refresh_s=every))


def stream_download(make: Callable[[], Download]) -> Response:
    """Stream a file as a download, as long as the caller may get it; the view is marked by `authorized_by`.

    Raises:
        TooMany: Too many downloads are running already.
    """
    free = _limit.semaphore()
    if not free.acquire(blocking=False):
        raise TooMany(
            "the server is busy with other exports", wait_s=_WAIT_S, hint="try again a little later"
        )
    try:
        download = make()
    except BaseException:
        free.release()
        raise
    pieces = _LimitedPieces(PiecesWhileAllowed(download.pieces), free.release)
    response = Response(pieces, content_type=download.media_type)
    response.headers.set("Content-Disposition", "attachment", filename=download.name)
    response.headers["Cache-Control"] = "private, no-store"
    return response


class _LimitedPieces(Iterator[bytes]):
    """Pieces of a download; closing or dropping them releases their slot."""

    def __init__(self, pieces: PiecesWhileAllowed, release: Callable[[], None]) -> None:
        self._pieces = pieces
        self._over = weakref.finalize(self, release)

    def __next__(self) -> bytes:
        return next(self._pieces)

    def close(self) -> None:
        self._pieces.close()
        self._over()
