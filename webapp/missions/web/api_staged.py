"""API for staged track files: uploaded in chunks, inspected, and then imported or dropped."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager, suppress
from dataclasses import replace
from math import ceil
from pathlib import PurePosixPath
from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import Dict, Float, Integer, List, Nested, String
from apiflask.validators import Length, OneOf, Range
from flask import request
from flask_babel import gettext as _

from webapp.errors import TooSlow, UsageError
from webapp.files.gate import budget_for
from webapp.files.lock import exclusive, one_of
from webapp.files.part_file import WrongOffset, append, one_at_a_time
from webapp.missions.core.trajectory.records import SOURCES
from webapp.missions.files.track_reader import kind_of
from webapp.missions.store import missions
from webapp.missions.tasks import staged_file
from webapp.missions.tasks.import_order import order_of
from webapp.missions.tasks.staged_file import StagedFile
from webapp.missions.web.api_imports import MAX_TEXT, ReadOptionsIn, TrackJobOut
from webapp.missions.web.context import open_mission
from webapp.store.operate import jobs
from webapp.tasks.maps.add_photo import tidy_name
from webapp.web import chunks
from webapp.web.clients import ClientProgress
from webapp.web.context import account, authorized_by, library, open_map, settings
from webapp.web.fields import LATER, BoundedList, RecordNumber
from webapp.web.openapi import json_answer

blueprint = APIBlueprint("api_staged", __name__, url_prefix="/api/v1/mission-files", tag="Missions")

OPERATIONS = {"api_staged.send": chunks.OPERATION}

_MOST_TRACKS = 10_000
_QUICK_BYTES = 4_000_000
"""Larger files are inspected by a job."""


class StagedFileIn(Schema):
    """A file to be uploaded."""

    name = String(required=True, validate=Length(1, MAX_TEXT))
    size_bytes = Integer(required=True, strict=True, validate=Range(min=0))


class FileOut(Schema):
    """Progress of an upload."""

    id = String()
    offset = Integer(metadata={"description": "Bytes that have arrived: where to resume."})
    size_bytes = Integer()
    chunk_bytes = Integer(metadata={"description": "Largest chunk."})


class OffsetOut(Schema):
    """Progress of an upload after a chunk."""

    offset = Integer(metadata={"description": "Bytes that have arrived."})


class ReadingIn(ReadOptionsIn):
    """Name of a file, and options for reading it."""

    name = String(
        required=True,
        validate=Length(1, MAX_TEXT),
        metadata={"description": "Of the file: tracks are named after it."},
    )


class FullStartIn(Schema):
    """Start position and heading of a robot."""

    lat = Float(required=True, validate=Range(-90, 90))
    lon = Float(required=True, validate=Range(-180, 180))
    heading_deg = Float(
        required=True, validate=Range(-360, 360), metadata={"description": "Clockwise from north."}
    )


class TrackKeyIn(Schema):
    """Key of a track of the file, from its contents."""

    source = String(required=True, validate=OneOf(SOURCES))
    track = String(required=True, validate=Length(max=MAX_TEXT))


class NewMissionIn(Schema):
    """A mission to be created for a file."""

    name = String(required=True, validate=LATER, metadata={"example": "Yard, first round"})
    map = String(
        load_default=None, allow_none=True, validate=LATER, metadata={"description": "Slug of its map."}
    )


class StagedImportIn(ReadingIn):
    """Options of an import, and its target: either `mission` or `new_mission`."""

    mission = RecordNumber(load_default=None, allow_none=True)
    new_mission = Nested(
        NewMissionIn,
        load_default=None,
        allow_none=True,
        metadata={"description": "Made once the file is read: one that cannot be read leaves none."},
    )
    tracks = BoundedList(
        Nested(TrackKeyIn),
        load_default=None,
        allow_none=True,
        most=_MOST_TRACKS,
        metadata={"description": "Only these; by default all."},
    )
    start = Nested(
        FullStartIn,
        load_default=None,
        allow_none=True,
        metadata={"description": "For poses in the robot's frame; by default the start of the mission."},
    )
    min_move = String(
        load_default="",
        validate=Length(max=40),
        metadata={"description": "Poses that moved less are left out: `0.5m`, `0.00001deg` (usual), `0`."},
    )


class FoundTrackOut(Schema):
    """A track in a file."""

    source = String(metadata={"enum": list(SOURCES)})
    track = String()
    frame = String(
        metadata={"enum": ["earth", "robot"], "description": "A track in a robot's frame needs a start."}
    )
    poses = Integer()
    first_time = String(allow_none=True)
    last_time = String(allow_none=True)
    first_time_s = Float(allow_none=True)
    last_time_s = Float(allow_none=True)
    extent = Dict(
        metadata={
            "description": "On the Earth `south`, `west`, `north`, `east`; in a robot's frame the metres "
            "`x`, `y`, `z` from the smallest to the largest coordinate."
        }
    )
    distance_m = Float(metadata={"description": "Along all poses, heights ignored."})
    headings = Integer(metadata={"description": "Poses that have one."})
    heights = Integer(metadata={"description": "Poses that have one."})
    line = List(
        List(Float()),
        metadata={
            "description": "The track, thinned: latitude and longitude, or metres forward and left of the "
            "first pose in its frame, which will be at the start."
        },
    )


class RemarkOut(Schema):
    """Items that would be left out, or are implausible."""

    reason = String()
    count = Integer()
    where = String(metadata={"description": "The first of them."})


class TableOut(Schema):
    """The beginning of a table."""

    header = List(String())
    rows = List(List(String()))
    columns = Dict(metadata={"description": "Which column holds which field, from 0."})
    units = Dict(metadata={"description": "Unit of each field that has one."})
    problem = String(metadata={"description": "Why the columns are not recognized; empty where they are."})


class ProposedStartOut(Schema):
    """Position and heading of a robot at its start."""

    lat = Float()
    lon = Float()
    heading_deg = Float(metadata={"description": "Clockwise from north."})


class ContentsOut(Schema):
    """The content of a file; or only the job that inspects it, whose result is the content."""

    job = Integer()
    kind = String(metadata={"description": "What it is, for people."})
    sources = List(Nested(FoundTrackOut))
    objects = Integer(metadata={"description": "Sightings of objects."})
    skipped = List(Nested(RemarkOut))
    doubts = List(Nested(RemarkOut))
    notes = List(String(), metadata={"description": "How the file was understood."})
    options = List(String(), metadata={"description": "Options that apply to it: `columns`, `axes`."})
    table = Nested(TableOut, allow_none=True)
    start = Nested(
        ProposedStartOut,
        allow_none=True,
        metadata={
            "description": "Proposed for tracks in the robot's frame, if the file also has positions on the "
            "Earth from the same time; else null."
        },
    )
    problem = String(metadata={"description": "Why nothing can be imported as it is; empty otherwise."})


blueprint.before_request(chunks.limit_bytes)
blueprint.errorhandler(WrongOffset)(chunks.offset_response)


def _find(file_id: str) -> StagedFile:
    return staged_file.find(library(), file_id, account_id=account().id)


@blueprint.post("")
@blueprint.input(StagedFileIn, arg_name="given")
@blueprint.output(FileOut, status_code=201)
def begin(given: dict[str, Any]) -> dict[str, Any]:
    """Begin the upload of a file; it is kept for some hours, until it is imported or deleted."""
    name = _file_name(given["name"])
    staged = staged_file.begin(
        library(), name=name, size_bytes=given["size_bytes"], account_id=account().id, settings=settings()
    )
    return _state(staged)


@blueprint.get("/<file_id>")
@blueprint.output(FileOut)
def look(file_id: str) -> dict[str, Any]:
    """Get the progress of an upload."""
    return _state(_find(file_id))


@blueprint.patch("/<file_id>")
@blueprint.output(OffsetOut)
@blueprint.doc(
    description="The body is the chunk, its place the header `Upload-Offset`. A chunk that does not fit is "
    "answered by 409 with the right `offset`."
)
def send(file_id: str) -> dict[str, int]:
    """Send the next chunk."""
    staged = _find(file_id)
    offset, data = chunks.given_offset(), request.get_data(cache=False)
    with one_at_a_time(staged.path):
        return {"offset": append(staged.path, data, offset=offset, size=staged.size_bytes)}


@blueprint.delete("/<file_id>")
@blueprint.output({}, status_code=204)
def drop(file_id: str) -> str:
    """Delete a staged file."""
    staged = _find(file_id)
    with one_at_a_time(staged.path):
        staged_file.drop(staged)
    return ""


@blueprint.post("/<file_id>/contents")
@authorized_by(_find)
@blueprint.input(ReadingIn, arg_name="given")
@blueprint.output(ContentsOut)
@blueprint.doc(responses=json_answer("A job reads it; the contents are its result.", TrackJobOut, status=202))
def contents(file_id: str, given: dict[str, Any]) -> Any:
    """Report the content of a file before it is imported."""
    staged = _find(file_id)
    staged_file.check_complete(staged)
    form = given | {"name": _file_name(given["name"])}
    if staged.size_bytes <= _QUICK_BYTES:
        with suppress(TooSlow), _reading():
            limits = settings().files
            budget = replace(budget_for(staged.path, limits), wait_s=limits.request_s)
            return staged_file.inspect_staged(staged, form, budget=budget, progress=ClientProgress())
    arguments = form | {"file": staged.id}
    with library().database.write() as session:
        job = jobs.enqueue(
            session,
            "mission-inspect",
            account_id=account().id,
            arguments=arguments,
            key=jobs.key_of(arguments),
        )
        session.flush()
        return {"job": job.id}, 202


@blueprint.post("/<file_id>/import")
@authorized_by(_find)
@blueprint.input(StagedImportIn, arg_name="given")
@blueprint.output(TrackJobOut, status_code=202)
@blueprint.doc(
    description="The staged file is removed, also if the job fails. A new mission is made once the "
    "file has been read; the result of the job names it. The same file again, read in the same way into the "
    "same mission, stores nothing twice."
)
def import_staged(file_id: str, given: dict[str, Any]) -> dict[str, int]:
    """Import a file in a job."""
    staged, who = _find(file_id), account()
    mission_id, map_id, title = _destination(given)
    staged_file.check_complete(staged)
    form = _form(given)
    kind_of(staged.path, table=order_of(staged.path, form).options.columns is not None)
    with one_at_a_time(staged.path):
        token = staged_file.take(library(), _find(file_id))
        queued = False
        try:
            arguments = form | {"mission": mission_id, "mission_name": title, "token": token}
            with library().database.write() as session:
                job = jobs.enqueue(
                    session,
                    "mission-import",
                    map_id=map_id,
                    account_id=who.id,
                    arguments=arguments,
                    key=token,
                )
                session.flush()
                answer = {"job": job.id}
            queued = True
            return answer
        finally:
            if not queued:
                staged_file.put_back(library(), staged, token=token)


@contextmanager
def _reading() -> Iterator[None]:
    """Let each account read one file at a time, and all together a few."""
    folder, wait_s = library().inner / "reading", ceil(settings().files.request_s)
    own = folder / f"account-{account().id}.lock"
    any_free = [folder / f"{number}.lock" for number in range(settings().files.at_once)]
    with (
        exclusive(own, doing=_("another file of yours is being read"), wait_s=wait_s),
        one_of(any_free, doing=_("the server is reading other files"), wait_s=wait_s),
    ):
        yield


def _state(staged: StagedFile) -> dict[str, Any]:
    return {
        "id": staged.id,
        "offset": staged.arrived,
        "size_bytes": staged.size_bytes,
        "chunk_bytes": chunks.chunk_bytes(),
    }


def _file_name(given: str) -> str:
    """Return the name of a file without folders."""
    return PurePosixPath(tidy_name(given).replace("\\", "/")).name


def _destination(given: dict[str, Any]) -> tuple[int | None, int | None, str | None]:
    """Return the mission, its map, and the name of a mission to be created.

    Raises:
        UsageError: Neither or both of `mission` and `new_mission` are given, or the name is invalid.
        NotFound, NotAllowed
    """
    new = given["new_mission"]
    if (given["mission"] is None) == (new is None):
        raise UsageError("one mission is needed", where="mission", hint="name one, or describe a new one")
    if new is None:
        mission = open_mission(given["mission"], "editor")
        return mission.id, mission.map_id, None
    title = missions.checked_name(new["name"])
    return None, None if new["map"] is None else open_map(new["map"], "editor").id, title


def _form(given: dict[str, Any]) -> dict[str, Any]:
    """Convert the options of an import to the arguments of a job."""
    start, tracks = given["start"], given["tracks"]
    return {
        **{key: given[key] for key in ("columns", "source", "axes", "min_move")},
        "name": _file_name(given["name"]),
        "start": "" if start is None else f"{start['lat']!r},{start['lon']!r},{start['heading_deg']!r}",
        "tracks": None if tracks is None else [[one["source"], one["track"]] for one in tracks],
    }
