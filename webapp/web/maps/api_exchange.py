"""API of exporting, importing and copying maps."""

from __future__ import annotations

import secrets
from contextlib import suppress
from pathlib import Path, PurePosixPath
from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import Dict, File, Integer, List, String
from apiflask.validators import Length, OneOf
from flask import Response, jsonify, request
from flask_babel import gettext as _

from webapp.errors import NotFound, UsageError
from webapp.files.exchange.map_zip import is_quick, read_title
from webapp.files.part_file import receive
from webapp.render import export_file
from webapp.render.export_file import FORMATS
from webapp.store.maps import maps
from webapp.store.operate import jobs
from webapp.store.schema import MapRecord
from webapp.tasks.exchange import duplicate_map, export_files, import_map
from webapp.tasks.exchange.import_map import MapRefused
from webapp.tasks.maps.add_photo import tidy_name
from webapp.tasks.maps.delete_map import delete_orphans
from webapp.web.context import account, library, map_role, open_map, settings
from webapp.web.errors import as_json
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
    """Choose the name of an imported map: the given one, its title in the archive, or the file name.

    Raises:
        UsageError: The given name is not valid.
    """
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
