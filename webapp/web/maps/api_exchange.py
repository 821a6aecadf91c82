"""API of exporting, printing, importing and copying maps."""

from __future__ import annotations

import secrets
from contextlib import suppress
from dataclasses import replace
from datetime import date
from pathlib import Path, PurePosixPath
from typing import Any, cast

from apiflask import APIBlueprint, Schema
from apiflask.fields import Dict, File, Integer, List, String
from apiflask.validators import Length, OneOf, Range
from flask import Response, jsonify, request
from flask_babel import format_date, ngettext
from flask_babel import gettext as _

from webapp.core.geo.floors import BASE_FLOOR
from webapp.errors import NotFound, UsageError
from webapp.files.exchange.map_zip import is_quick, read_title
from webapp.files.part_file import receive
from webapp.render import export_file
from webapp.render.export_file import FORMATS
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
from webapp.store.maps import maps
from webapp.store.operate import jobs
from webapp.store.schema import MapRecord
from webapp.tasks.exchange import duplicate_map, export_files, import_map
from webapp.tasks.exchange.export_source import Download, of_library
from webapp.tasks.exchange.import_map import MapRefused
from webapp.tasks.maps.add_photo import tidy_name
from webapp.tasks.maps.delete_map import delete_orphans
from webapp.web.concurrency import ConcurrencyLimit
from webapp.web.context import account, library, map_role, open_map, settings
from webapp.web.errors import as_json
from webapp.web.fields import Boolean, RecordNumber
from webapp.web.openapi import file_answer, json_answer
from webapp.web.sending import send_kept, send_pieces

blueprint = APIBlueprint("api_exchange", __name__, url_prefix="/api/v1/maps", tag="Import and export")

_MAX_NAME = 120
_PARTS = 20


class ImportIn(Schema):
    """A zip archive with a `.cfg`, its image and its photos."""

    file = File(required=True)  # type: ignore[no-untyped-call]
    name = String(
        load_default=None,
        validate=Length(max=_MAX_NAME),
        metadata={
            "description": "of the new map; by default its title in the zip, else the file's name, with a "
            "number if there is such a map"
        },
    )


class NewMapOut(Schema):
    """The new map; a long import is done by `job`."""

    slug = String()
    job = Integer(allow_none=True)
    findings = List(Dict(), metadata={"description": "warnings of the linter: code, severity, message, fix"})
    left_out = List(
        String(),
        metadata={"description": "files that do not belong to a map; photos of `unplaced/` with the reason"},
    )


class CopyIn(Schema):
    """The name of the copy."""

    name = String(load_default=None, allow_none=True, validate=Length(max=_MAX_NAME))


class ExportIn(Schema):
    """The format to export."""

    format = String(required=True, validate=OneOf(FORMATS))


class JobOut(Schema):
    """The queued job."""

    job = Integer()


@blueprint.get("/<slug>/map.cfg")
@map_role("viewer")
@blueprint.doc(responses=file_answer("The map file.", "*/*"))
def cfg(slug: str) -> Response:
    """Download the map file."""
    return send_pieces(export_files.export_map_cfg(library(), open_map(slug).id))


@blueprint.get("/<slug>/placements/<name>.cfg")
@map_role("viewer")
@blueprint.doc(responses=file_answer("The map file of the placement.", "*/*"))
def placement_cfg(slug: str, name: str) -> Response:
    """Download the map file of another placement."""
    return send_pieces(export_files.export_map_cfg(library(), open_map(slug).id, placement=name))


@blueprint.get("/<slug>/export.<string(maxlength=8):form>")
@map_role("viewer")
@blueprint.doc(responses=file_answer("The file, made while it is sent.", "*/*"))
def export(slug: str, form: str) -> Response:
    """Download a map as `zip`, `geojson`, `kml`, `kmz`, or as `html` that opens offline.

    `exif` is a zip archive of the photos with positions and headings in EXIF, `xmp` one of XMP sidecars,
    `csv` a table for `exiftool -csv`, which writes it into photos.
    """
    if form not in FORMATS:
        raise NotFound(f"unknown export format {form!r}", hint=f"use one of {', '.join(FORMATS)}")
    return send_pieces(
        export_file.export_map_file(library(), open_map(slug).id, form=form, settings=settings())
    )


@blueprint.post("/<slug>/exports")
@map_role("viewer")
@blueprint.input(ExportIn, arg_name="data")
@blueprint.output(JobOut, status_code=202)
def export_by_job(slug: str, data: dict[str, str]) -> dict[str, int]:
    """Queue a large export; the job's result names the file to fetch."""
    record, who = open_map(slug), account()
    with library().database.write() as session:
        job = jobs.enqueue(
            session, "export", map_id=record.id, account_id=who.id, arguments=data, key=data["format"]
        )
        session.flush()
        return {"job": job.id}


@blueprint.get("/<slug>/exports/<string(maxlength=200):name>")
@map_role("viewer")
@blueprint.doc(responses=file_answer("The file.", "*/*"))
def exported(slug: str, name: str) -> Response:
    """Download the file that an export job has made."""
    path = export_file.kept(library(), open_map(slug), name=name)
    return send_kept(path, name)


@blueprint.post("/import")
@blueprint.input(ImportIn, location="form_and_files", arg_name="given")
@blueprint.output(NewMapOut, status_code=201)
@blueprint.doc(responses=json_answer("A job fills the new map.", NewMapOut, status=202))
def import_zip(given: dict[str, Any]) -> Any:
    """Make a map from a zip archive: at once, or by a job (202) if it is large."""
    who, place = account(), library()
    token = secrets.token_hex(16)
    archive = import_map.archive_path(place, token)
    kept = False
    try:
        receive(archive, given["file"].stream, max_bytes=int(settings().web.max_request_mb * 1e6))
        name = _name_of(given["name"], archive, given["file"].filename)
        if not given["name"]:
            with place.database.read() as session:
                name = maps.free_name(session, name, account=who)
        if not is_quick(archive, limits=settings().imports):
            answer = _by_job(name, token)
            kept = True
            return answer, 202
        done = import_map.import_map(place, archive, account_id=who.id, name=name, settings=settings())
    except MapRefused as refused:
        response = jsonify(error=as_json(refused), findings=_findings_json(refused.findings))
        response.status_code = 422
        return response
    finally:
        if not kept:
            archive.unlink(missing_ok=True)
    return {
        "slug": done.slug,
        "job": None,
        "findings": _findings_json(done.findings),
        "left_out": done.left_out,
    }


@blueprint.post("/<slug>/duplicate")
@map_role("viewer")
@blueprint.input(CopyIn, arg_name="data")
@blueprint.output(NewMapOut, status_code=201)
def duplicate(slug: str, data: dict[str, Any]) -> dict[str, Any]:
    """Copy a map; the caller owns the copy."""
    record, who = open_map(slug), account()
    name = data["name"] or _("%(name)s (copy)", name=record.name)[:_MAX_NAME]
    copy = duplicate_map.duplicate_map(library(), record.id, account_id=who.id, name=name)
    return {"slug": copy, "job": None, "findings": [], "left_out": []}


@blueprint.before_request
def limit_parts() -> None:
    """Limit the number of form parts, which is enforced while the request is read."""
    request.max_form_parts = _PARTS


def _by_job(name: str, token: str) -> dict[str, Any]:
    """Make an empty map, and queue a job that imports the archive."""
    who, place = account(), library()
    delete_orphans(place)  # otherwise the new map could not reuse the name of a deleted one
    folders = [path.name for path in place.folder.iterdir()]
    with place.database.write() as session:
        record: MapRecord = maps.create(session, name, account_id=who.id, folders=folders)
        job = jobs.enqueue(session, "import", map_id=record.id, account_id=who.id, arguments={"token": token})
        session.flush()
        return {"slug": record.slug, "job": job.id, "findings": [], "left_out": []}


def _name_of(given: str | None, archive: Path, filename: str | None) -> str:
    """Choose the name of an imported map: the given one, its title in the archive, or the file name."""
    if given:
        return maps.checked_name(given)
    stem = PurePosixPath(tidy_name(filename or "").replace("\\", "/")).stem
    for name in (read_title(archive, most_files=settings().imports.max_files), stem[:_MAX_NAME]):
        with suppress(UsageError):
            return maps.checked_name(name or "")
    return str(_("Imported map"))


def _findings_json(findings: Any) -> list[dict[str, str]]:
    return [
        {"code": str(f.code), "severity": f.severity, "message": f.message, "fix": f.fix} for f in findings
    ]


print_api = APIBlueprint("api_print", __name__, url_prefix="/api/v1/maps", tag="Import and export")

_limit = ConcurrencyLimit("print", share=0.25)
print_api.record(_limit.set_up)


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


@print_api.get("/<slug>/print.<any(pdf,png):sheet>")
@map_role("viewer")
@print_api.input(PrintIn, location="query", arg_name="query")
@print_api.doc(responses=file_answer("One sheet of paper, or one for each floor.", "*/*"))
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
