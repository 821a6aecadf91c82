"""API of exports of field forms: a job adds their photos to a map."""

from __future__ import annotations

import secrets
from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import File
from werkzeug.datastructures import FileStorage

from webapp.files.part_file import receive
from webapp.store.operate import jobs
from webapp.tasks.exchange.import_map import archive_path
from webapp.tasks.maps.add_photo import tidy_name
from webapp.web.context import account, library, map_role, open_map, settings
from webapp.web.fields import Boolean
from webapp.web.maps.schemas import JobSchema
from webapp.web.operate.jobs import job_json

blueprint = APIBlueprint(
    "api_field_forms", __name__, url_prefix="/api/v1/maps/<slug>/field-forms", tag="Photos"
)

_JOB = "field-form"


class FieldFormIn(Schema):
    """An export of ODK, KoboToolbox or QField."""

    file = File(required=True, metadata={"description": "A zip, a CSV or a GeoPackage."})  # type: ignore[no-untyped-call]
    media = File(load_default=None, metadata={"description": "A zip with the photos, if `file` has none."})  # type: ignore[no-untyped-call]
    all_answers = Boolean(
        load_default=False, metadata={"description": "Write all answers into the notes, not only comments."}
    )


@blueprint.post("")
@map_role("editor")
@blueprint.input(FieldFormIn, location="form_and_files", arg_name="given")
@blueprint.output(JobSchema, status_code=202)
def add(slug: str, given: dict[str, Any]) -> dict[str, Any]:
    """Queue a job that adds the photos of an export of a field form, with positions and notes."""
    record, who = open_map(slug, "editor"), account()
    files = [_receive(file) for file in (given["file"], given["media"]) if file is not None]
    arguments = {"files": files, "all_answers": given["all_answers"]}
    with library().database.write() as session:
        job = jobs.enqueue(
            session,
            _JOB,
            map_id=record.id,
            account_id=who.id,
            arguments=arguments,
            key=files[0]["token"],
        )
        session.flush()
        return job_json(session, job, account=who)


def _receive(file: FileStorage) -> dict[str, str]:
    """Store a file for the job; one whose job is never queued is deleted as old files of imports are."""
    token = secrets.token_hex(16)
    receive(archive_path(library(), token), file.stream, max_bytes=int(settings().web.max_request_mb * 1e6))
    return {"token": token, "name": tidy_name(file.filename or "")}
