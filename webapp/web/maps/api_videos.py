"""API of videos: uploaded in chunks like photos, then cut into photos of the map by a job."""

from __future__ import annotations

import secrets
from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import Boolean, Float, Integer, String
from apiflask.validators import Length, Range

from webapp.errors import NotFound, UsageError
from webapp.extras import install_line, is_installed, require
from webapp.files.exchange.times import unix_time
from webapp.files.part_file import arrived, one_at_a_time
from webapp.files.video.clip import is_begin
from webapp.store.maps import maps
from webapp.store.operate import jobs
from webapp.store.schema import MapRecord, Upload
from webapp.tasks.video.add_video import JOB, is_clip, is_track, take
from webapp.web.context import account, library, map_role, open_map, settings
from webapp.web.maps.api_photos import find_upload, part_of
from webapp.web.maps.schemas import JobSchema
from webapp.web.operate.jobs import job_json

blueprint = APIBlueprint("api_videos", __name__, url_prefix="/api/v1/maps/<slug>/videos", tag="Photos")

_MOST_ID = 40


class VideosOut(Schema):
    """Whether videos can be cut here."""

    available = Boolean()
    install = String(allow_none=True, metadata={"description": "The command that installs what is missing."})
    most_mb = Float(metadata={"description": "Largest video, megabytes (10^6 bytes)."})


class VideoIn(Schema):
    """What is made of a video."""

    clip = String(
        required=True,
        validate=Length(1, _MOST_ID),
        metadata={"description": "Id of its complete upload (`POST /uploads`)."},
    )
    track = String(
        load_default=None,
        allow_none=True,
        validate=Length(1, _MOST_ID),
        metadata={"description": "Id of the upload of a GPX or SRT file; null: what the video itself says."},
    )
    spread = Float(
        load_default=25.0,
        validate=Range(2.0, 100.0),
        metadata={"description": "How far the view moves between two photos, percent of its width."},
    )
    most = Integer(
        load_default=1000, strict=True, validate=Range(1, 10_000), metadata={"description": "Photos."}
    )
    fov_deg = Float(
        load_default=None,
        allow_none=True,
        validate=Range(1.0, 179.0),
        metadata={"description": "Horizontal field of view, if it is known."},
    )
    starts = String(
        load_default=None,
        allow_none=True,
        validate=Length(max=_MOST_ID),
        metadata={"description": "When it begins; null: as it says.", "example": "2026-05-01T10:00:00Z"},
    )


@blueprint.get("")
@blueprint.output(VideosOut)
def show(slug: str) -> dict[str, Any]:
    """Get whether this server can cut videos, and how large they may be."""
    open_map(slug, "editor")
    there = is_installed("video")
    return {
        "available": there,
        "install": None if there else install_line("video"),
        "most_mb": settings().upload.video_mb,
    }


@blueprint.post("")
@map_role("editor")
@blueprint.input(VideoIn, arg_name="data")
@blueprint.output(JobSchema, status_code=202)
def cut(slug: str, data: dict[str, Any]) -> dict[str, Any]:
    """Queue a job that cuts an uploaded video and adds its sharp, spread frames to the map."""
    record, who = open_map(slug, "editor"), account()
    require("video")
    starts_s = None if data["starts"] is None else unix_time(data["starts"])
    if starts_s is not None and not is_begin(starts_s):
        raise UsageError("this is not a time", where="starts", hint="write it like 2026-05-01T10:00:00Z")
    clip = _complete(record, data["clip"])
    track = None if data["track"] is None else _complete(record, data["track"])
    if not is_clip(clip.name):
        raise UsageError("it is not a video", where=clip.name, hint="upload an MP4 or MOV, for example")
    if track is not None and not is_track(track.name):
        raise UsageError("a track of a video is an SRT or a GPX file", where=track.name)
    token = secrets.token_hex(16)
    names = [None if one is None else _take(one, token) for one in (clip, track)]
    arguments = {
        "token": token,
        "clip": names[0],
        "track": names[1],
        "spread": data["spread"],
        "most": data["most"],
        "fov_deg": data["fov_deg"],
        "starts_s": starts_s,
    }
    with library().database.write() as session:
        for one in (clip, track):
            if one is not None:
                maps.finish_upload(session, one.id)
        job = jobs.enqueue(session, JOB, map_id=record.id, account_id=who.id, arguments=arguments, key=token)
        session.flush()
        return job_json(session, job, account=who)


def _complete(record: MapRecord, id: str) -> Upload:
    upload = find_upload(record, id)
    there = arrived(part_of(upload))
    if there < upload.size_bytes:
        raise UsageError(
            f"{there} of {upload.size_bytes} bytes have arrived",
            where=upload.name,
            hint="send the rest of it first",
        )
    return upload


def _take(upload: Upload, token: str) -> str:
    part = part_of(upload)
    with one_at_a_time(part):
        if not part.is_file():
            raise NotFound("the uploaded file no longer exists", where=upload.name, hint="upload it again")
        return take(library(), token, part=part, name=upload.name)
