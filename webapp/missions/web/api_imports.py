"""API for importing files with tracks into a mission."""

from __future__ import annotations

import secrets
from pathlib import PurePosixPath
from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import File, Integer, String
from apiflask.validators import Length, OneOf
from flask import request

from webapp.files.part_file import receive
from webapp.missions.core.trajectory.axes import AXES
from webapp.missions.core.trajectory.records import SOURCES
from webapp.missions.files.track_reader import kind_of, listed, with_axes
from webapp.missions.tasks.import_order import order_of, waiting_path
from webapp.missions.web.context import mission_role, open_mission
from webapp.store.operate import jobs
from webapp.tasks.maps.add_photo import tidy_name
from webapp.web.context import account, library, settings

blueprint = APIBlueprint("api_mission_imports", __name__, url_prefix="/api/v1/missions", tag="Missions")

_PARTS = 20
MAX_TEXT = 2000
_OPTIONS = ("columns", "source", "min_move", "axes", "start", "topics")


class ReadOptionsIn(Schema):
    """Options for reading a file with tracks."""

    columns = String(
        load_default="",
        validate=Length(max=MAX_TEXT),
        metadata={
            "description": "Of a table: what each column holds.",
            "example": "time=stamp:ms, lat=Lat, lon=Lon",
        },
    )
    source = String(
        load_default="",
        validate=OneOf(("", *SOURCES)),
        metadata={"description": "Of all tracks; by default what the kind of the file says."},
    )
    axes = String(
        load_default="",
        validate=OneOf(("", *AXES)),
        metadata={"description": f"Of a frame in {with_axes()}; by default detected."},
    )


class TrackFileIn(ReadOptionsIn):
    """A file, and options for reading it."""

    file = File(
        required=True,
        metadata={"description": "Of one of the formats that are recognised by their content."},
    )  # type: ignore[no-untyped-call]
    min_move = String(
        load_default="",
        validate=Length(max=40),
        metadata={"description": "Poses that moved less are left out: `0.5m`, `0.00001deg` (usual), `0`."},
    )
    start = String(
        load_default="",
        validate=Length(max=200),
        metadata={
            "description": "Latitude, longitude and heading of the first pose, for poses in the robot's "
            "frame; the mission's own start by default, and its start from now on where it has none.",
            "example": "50.0,14.0,90",
        },
    )
    topics = String(
        load_default="",
        validate=Length(max=MAX_TEXT),
        metadata={"description": "Only these topics of a bag or lines of a KML, separated by commas."},
    )


class TrackJobOut(Schema):
    """The job that imports the file; its result lists what was left out and why."""

    job = Integer()


@blueprint.before_request
def limit_parts() -> None:
    """Limit the number of form parts, which is enforced while the request is read."""
    request.max_form_parts = _PARTS


@blueprint.post("/<id:mission_id>/imports")
@mission_role("editor")
@blueprint.input(TrackFileIn, location="form_and_files", arg_name="given")
@blueprint.output(TrackJobOut, status_code=202)
@blueprint.doc(
    description=f"The kind of the file is detected from its content: {listed()}. A file without a track is "
    "refused at once, other errors fail the job. The same file again, read in the same way, stores nothing "
    "twice."
)
def import_file(mission_id: int, given: dict[str, Any]) -> dict[str, int]:
    """Import a file with tracks and objects."""
    mission, who, place = open_mission(mission_id, "editor"), account(), library()
    token = secrets.token_hex(16)
    path = waiting_path(place, token)
    name = PurePosixPath(tidy_name(given["file"].filename or "").replace("\\", "/")).name
    form = {key: given[key] for key in _OPTIONS} | {"name": name}
    order = order_of(path, form)
    kept = False
    try:
        receive(path, given["file"].stream, max_bytes=int(settings().web.max_request_mb * 1e6))
        kind_of(path, table=order.options.columns is not None)
        arguments = form | {"mission": mission.id, "token": token}
        with place.database.write() as session:
            job = jobs.enqueue(
                session,
                "mission-import",
                map_id=mission.map_id,
                account_id=who.id,
                arguments=arguments,
                key=token,
            )
            session.flush()
            answer = {"job": job.id}
        kept = True
        return answer
    finally:
        if not kept:
            path.unlink(missing_ok=True)
