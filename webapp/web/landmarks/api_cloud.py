"""API of the landmarks of a map: points and cameras for the page, and models for other programs."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from apiflask import APIBlueprint
from flask import Response
from sqlalchemy import select
from sqlalchemy.orm import Session

from webapp.errors import StorageError
from webapp.extras import require
from webapp.store.maps import maps
from webapp.store.operate import jobs
from webapp.store.operate.jobs import ENDED
from webapp.store.schema import Job, MapRecord
from webapp.tasks.landmarks.show_cloud import VERSION, ShownCloud, shown_cloud
from webapp.web.context import account, library, open_map
from webapp.web.landmarks import cloud_answers
from webapp.web.landmarks.cloud_answers import CloudOut, ColmapIn
from webapp.web.maps.state import picture_address, source_of_photo

blueprint = APIBlueprint("api_cloud", __name__, url_prefix="/api/v1/maps/<slug>/landmarks", tag="Landmarks")


@blueprint.get("")
@blueprint.output(CloudOut)
def show(slug: str) -> dict[str, Any]:
    """Get the description of a map's landmarks, and the cameras that see them.

    If photos were placed or moved since the landmarks were aligned with the map, a job aligns them again.
    """
    record = open_map(slug)
    shown = shown_cloud(library(), record)
    if not shown.is_current:
        with suppress(StorageError):  # disk full: still show the existing landmarks
            queue_landmarks(record, only_lay=True, account_id=account().id)
    return _cloud(record, shown)


@blueprint.post("")
@blueprint.output(CloudOut, status_code=202)
def build(slug: str) -> dict[str, Any]:
    """Queue a job that computes the landmarks, or adds new photos to them."""
    record = open_map(slug, "editor")
    require("sfm")
    queue_landmarks(record, only_lay=False, account_id=account().id)
    return _cloud(record, shown_cloud(library(), record))


@blueprint.get("/points/<string(length=32):key>/<int(max=100000):number>")
@blueprint.doc(responses=cloud_answers.POINTS_DOC)
def points(slug: str, key: str, number: int) -> Response:
    """Get a block of the points; browsers cache it, as the key changes with the content."""
    return cloud_answers.send_block(open_map(slug), key=key, number=number)


@blueprint.get("/points.ply")
@blueprint.doc(responses=cloud_answers.PLY_DOC)
def ply(slug: str) -> Response:
    """Download the points, in the frame of the map."""
    return cloud_answers.send_ply(open_map(slug))


@blueprint.get("/colmap.zip")
@blueprint.input(ColmapIn, location="query", arg_name="query")
@blueprint.doc(responses=cloud_answers.COLMAP_DOC)
def colmap(slug: str, query: dict[str, str]) -> Response:
    """Download the models in COLMAP's format, the one that is aligned with the map first."""
    record = open_map(slug)
    with library().database.read() as session:
        names = cloud_answers.names_of({photo.path: photo for photo in maps.photos(session, record)})
    return cloud_answers.send_colmap(record, names=names, form=query["form"])


def _cloud(record: MapRecord, shown: ShownCloud) -> dict[str, Any]:
    with library().database.read() as session:
        job = running_job(session, record)
        photos = [photo for photo in maps.photos(session, record) if not photo.removed]
    cameras = {
        photo.id: {
            "name": photo.name,
            "width": photo.width,
            "height": photo.height,
            "placed": photo.x_px is not None,
            "source": source_of_photo(photo),
            "preview": picture_address(record, photo, kind="preview"),
        }
        for photo in photos
    }
    return {**cloud_answers.cloud_json(shown, cameras), "job": job, "new_photos": shown.new_photos}


_JOB = "landmarks"
_JOBS = (_JOB, "place-rest")
"""Kinds of jobs that compute landmarks."""
_LAY = f"lay-{VERSION}"
"""Job key of the alignment; as it has the version, a failure of an older version is tried again."""


def queue_landmarks(record: MapRecord, *, only_lay: bool, account_id: int | None) -> None:
    """Queue the job unless it is already waiting."""
    with library().database.write() as session:
        jobs.enqueue(
            session,
            _JOB,
            map_id=record.id,
            account_id=account_id,
            arguments={"only_lay": only_lay},
            key=_LAY if only_lay else "",
        )


def queue_for_visitors(record: MapRecord) -> None:
    """Queue an alignment for no account, unless the last since the map's change failed or was cancelled."""
    with library().database.read() as session:
        last = jobs.newest(session, record.id, kind=_JOB, key=_LAY)
    if last is None or last.state not in ("failed", "cancelled") or last.created_at < record.changed_at:
        queue_landmarks(record, only_lay=True, account_id=None)


def running_job(session: Session, record: MapRecord) -> int | None:
    """Return the id of a queued or running job that computes landmarks of a map, if there is one."""
    running = select(Job.id).where(Job.map_id == record.id, Job.kind.in_(_JOBS), Job.state.not_in(ENDED))
    return session.scalars(running.limit(1)).first()
