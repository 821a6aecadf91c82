"""API of the landmarks of a shared map, for visitors; only placed photos are shown as cameras."""

from __future__ import annotations

from contextlib import suppress
from dataclasses import replace
from typing import Any

from apiflask import APIBlueprint
from flask import Response

from webapp.errors import StorageError
from webapp.store.maps import maps
from webapp.store.maps.blurred import blurred_elsewhere
from webapp.tasks.landmarks.show_cloud import points_for_visitors, shown_cloud
from webapp.web.context import library, public
from webapp.web.landmarks import cloud_answers
from webapp.web.landmarks.api_cloud import queue_for_visitors
from webapp.web.landmarks.cloud_answers import ColmapIn, SharedCloudOut
from webapp.web.sharing import shared_state
from webapp.web.sharing.api_shared import visitors_limit

blueprint = APIBlueprint(
    "api_shared_cloud", __name__, url_prefix="/api/v1/shared/<token>/landmarks", tag="Shared"
)


@blueprint.get("")
@public
@blueprint.output(SharedCloudOut)
def show(token: str) -> dict[str, Any]:
    """Get the landmarks of a shared map, and the cameras that see them, if the share includes them.

    If photos were placed or moved since the landmarks were aligned with the map, a job aligns them again; if
    one was blurred, removed or moved to the tray, there are no landmarks until then.
    """
    with library().database.read() as session:
        opened = shared_state.open_landmarks(session, token)
        cameras = shared_state.cameras(session, opened, token=token)
    with visitors_limit.slot():
        shown = shown_cloud(library(), opened.map)
        if not shown.is_current:
            with suppress(StorageError):  # disk full: still show the existing landmarks
                queue_for_visitors(opened.map)
        visible = replace(shown, points=points_for_visitors(library(), opened.map))
        return cloud_answers.cloud_json(visible, cameras)


@blueprint.get("/points/<string(length=32):key>/<int(max=100000):number>")
@public
@blueprint.doc(responses=cloud_answers.POINTS_DOC)
def points(token: str, key: str, number: int) -> Response:
    """Get a block of the points; browsers cache it, as the key changes with the content."""
    with library().database.read() as session:
        record = shared_state.open_landmarks(session, token).map
    with visitors_limit.slot():
        return cloud_answers.send_block(record, key=key, number=number, visitor=True)


@blueprint.get("/points.ply")
@public
@blueprint.doc(responses=cloud_answers.PLY_DOC)
def ply(token: str) -> Response:
    """Download the points, in the frame of the map, if the share includes original files."""
    with library().database.read() as session:
        record = shared_state.open_landmarks(session, token, originals=True).map
    with visitors_limit.slot():
        return cloud_answers.send_ply(record, visitor=True)


@blueprint.get("/colmap.zip")
@public
@blueprint.input(ColmapIn, location="query", arg_name="query")
@blueprint.doc(responses=cloud_answers.COLMAP_DOC)
def colmap(token: str, query: dict[str, str]) -> Response:
    """Download the models of the placed photos in COLMAP's format, if the share includes original files."""
    with library().database.read() as session:
        record = shared_state.open_landmarks(session, token, originals=True).map
        placed = [photo for photo in maps.photos(session, record) if photo.is_placed]
        hidden = blurred_elsewhere(session, placed)
        placed = [photo for photo in placed if photo.id not in hidden]
    names = cloud_answers.names_of({f"{photo.id}-{photo.name}": photo for photo in placed})
    with visitors_limit.slot():
        return cloud_answers.send_colmap(record, names=names, form=query["form"], only_named=True)
