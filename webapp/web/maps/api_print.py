"""API that prints a map as PDF or PNG."""

from __future__ import annotations

from dataclasses import replace
from datetime import date
from typing import Any, cast

from apiflask import APIBlueprint, Schema
from apiflask.fields import Integer, String
from apiflask.validators import Length, OneOf, Range
from flask import Response
from flask_babel import format_date, ngettext
from flask_babel import gettext as _

from webapp.core.geo.floors import BASE_FLOOR
from webapp.render.sheet.make import MEDIA_TYPES, print_map
from webapp.render.sheet.options import (
    EXTENTS,
    LABELS,
    LEAST_DPI,
    MOST_DPI,
    MOST_TEXT,
    ORIENTATIONS,
    PAPERS,
    USUAL_DPI,
    SheetAnswer,
    SheetFormat,
    SheetOptions,
    SheetWords,
    answers_from_json,
)
from webapp.store import queries
from webapp.store.schema import MapRecord
from webapp.tasks.exchange.export_source import Download, of_library
from webapp.web.concurrency import ConcurrencyLimit
from webapp.web.context import account, library, map_role, open_map, settings
from webapp.web.fields import Boolean, RecordNumber
from webapp.web.openapi import file_answer
from webapp.web.sending import send_pieces

blueprint = APIBlueprint("api_print", __name__, url_prefix="/api/v1/maps", tag="Import and export")

_limit = ConcurrencyLimit("print", share=0.25)
blueprint.record(_limit.set_up)


class PrintIn(Schema):
    """Options of the print."""

    paper = String(load_default="a4", validate=OneOf(PAPERS))
    orientation = String(
        load_default="auto",
        validate=OneOf(ORIENTATIONS),
        metadata={"description": "`auto`: the one in which the map is larger."},
    )
    dpi = Integer(
        load_default=USUAL_DPI,
        validate=Range(LEAST_DPI, MOST_DPI),
        metadata={"description": "Pixels an inch; in a PDF of the satellite image alone."},
    )
    labels = String(
        load_default="numbers",
        validate=OneOf(LABELS),
        metadata={"description": "Next to the photos: nothing, their ids, their names."},
    )
    headings = Boolean(load_default=True)
    control_points = Boolean(load_default=False)
    notes = Boolean(load_default=True, metadata={"description": "Show the notes on spots of the map."})
    extent = String(
        load_default="image",
        validate=OneOf(EXTENTS),
        metadata={"description": "The whole image, or the surroundings of the photos."},
    )
    title = String(
        load_default=None, validate=Length(max=MOST_TEXT), metadata={"description": "Instead of the map's."}
    )
    attribution = String(
        load_default="",
        validate=Length(max=MOST_TEXT),
        metadata={"description": "Attribution of the image; by default that of its tile service."},
    )
    floor = RecordNumber(
        load_default=BASE_FLOOR,
        metadata={"description": "Id of the floor, on a map that has several."},
    )
    all_floors = Boolean(
        load_default=False,
        metadata={"description": "Each floor on a page of its own, the lowest first; PDF only."},
    )
    answers = Boolean(
        load_default=False, metadata={"description": "Show the best places of answers, too: all, or some."}
    )
    first = RecordNumber(load_default=None, metadata={"description": "Id of the first answer."})
    last = RecordNumber(load_default=None, metadata={"description": "Id of the last answer."})
    mine = Boolean(load_default=False, metadata={"description": "Only answers to what you asked yourself."})


@blueprint.get("/<slug>/print.<any(pdf,png):sheet>")
@map_role("viewer")
@blueprint.input(PrintIn, location="query", arg_name="query")
@blueprint.doc(responses=file_answer("One sheet of paper, or one for each floor.", "*/*"))
def print_sheet(slug: str, sheet: SheetFormat, *, query: dict[str, Any]) -> Response:
    """Print a map on one sheet, with legend, scale, north and date; or all floors as pages of a PDF."""
    record = open_map(slug)
    answers = _answers(record, query) if query["answers"] else ()
    options = SheetOptions(**{name: query[name] for name in SheetOptions.__slots__})
    if query["all_floors"]:
        options = replace(options, floor=None)
    with _limit.slot():
        source = of_library(library(), record.id)
        data = print_map(
            source, form=sheet, options=options, words=_words(), settings=settings(), answers=answers
        )
    return send_pieces(Download(f"{source.name}.{sheet}", MEDIA_TYPES[sheet], iter([data])))


def _answers(record: MapRecord, query: dict[str, Any]) -> tuple[SheetAnswer, ...]:
    who = account().id if query["mine"] else None
    with library().database.read() as session:
        row = session.get_one(MapRecord, record.id)
        found = queries.answers(session, row, first=query["first"], last=query["last"], account_id=who)
        return answers_from_json({**one.answer, "query": one.name} for one in found)


def _words() -> SheetWords:
    def photos(n: int) -> str:
        return cast(str, ngettext("%(num)s photo", "%(num)s photos", n))

    return SheetWords(
        photos=photos,
        date=format_date(date.today(), "long"),
        photo=_("photo"),
        looks=_("direction of view"),
        control_point=_("control point"),
        note=_("note"),
        answer=_("answer, by its probability"),
        radius=_("uncertainty radius"),
        labels_left_out=_("{n} labels left out for lack of space"),
        notes_left_out=_("{n} notes left out for lack of space"),
        no_scale=_("No georeference: the scale and north are not known."),
        about=_("about {scale}"),
        image=_("Image: {attribution}"),
    )
