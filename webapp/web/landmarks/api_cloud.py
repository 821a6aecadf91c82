"""The landmarks of a map by the API: points and cameras for the page, and models for other programs."""

from __future__ import annotations

import tempfile
import zipfile
from contextlib import suppress
from pathlib import Path
from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import Float, Integer, List, Nested, String
from apiflask.validators import OneOf
from flask import Response, send_file

from webapp.errors import NotFound, StorageError
from webapp.extras import require
from webapp.files.landmarks.points import MapPoints, as_ply
from webapp.files.maps.map_json import parse_panorama
from webapp.store.maps import maps
from webapp.store.schema import MapRecord, Photo
from webapp.tasks.landmarks.export_models import export_models
from webapp.tasks.landmarks.mapping import model_folders
from webapp.tasks.landmarks.show_cloud import (
    BLOCK_POINTS,
    ShownCloud,
    block,
    scaling,
    shown_cloud,
    stored_points,
)
from webapp.tasks.localize.index_location import landmarks_folder
from webapp.tasks.maps.show_photo import look_of_photo
from webapp.web.compression import accepts_gzip, gzipped
from webapp.web.context import library, open_map
from webapp.web.fields import Boolean
from webapp.web.landmarks.jobs import queue_landmarks, running_job
from webapp.web.maps.schemas import SourceOut
from webapp.web.maps.state import source_of_photo
from webapp.web.openapi import file_answer

blueprint = APIBlueprint("api_cloud", __name__, url_prefix="/api/v1/maps/<slug>/landmarks", tag="Landmarks")

_OCTETS = "application/octet-stream"
_SPOOL_BYTES = 32_000_000
_NONE = "the map has no landmarks"
_HINT = "compute them on the page 3D, or run expmap landmarks build"


class ShownCameraOut(Schema):
    """A photo of the reconstruction."""

    id = Integer()
    name = String()
    panorama = Boolean(metadata={"description": "Whether it shows the whole sphere."})
    at = List(Float(), metadata={"description": "Where it was taken, x, y, z."})
    rotation = List(
        List(Float()),
        metadata={
            "description": "Unit vectors to the camera's right, down and front: the middle of a panorama."
        },
    )
    width = Integer(metadata={"description": "Of the upright photo, pixels."})
    height = Integer()
    focal_px = Float(
        metadata={"description": "Focal length as the reconstruction has it; of a panorama its views'."}
    )
    placed = Boolean(metadata={"description": "Whether it is placed on the map."})
    source = Nested(
        SourceOut, allow_none=True, metadata={"description": "Of a photo from a street-level service."}
    )
    preview = String(metadata={"description": "Address of a picture of at most 1600 x 1600 pixels."})


class LeftOutOut(Schema):
    """Photos that are joined, but cannot be laid on the map."""

    photos = List(Integer())
    reason = String()


class CloudOut(Schema):
    """Landmarks in metres east, north and up, or in map pixels where the map has no georeference."""

    key = String(
        allow_none=True, metadata={"description": "Another one means other points; null: there are none."}
    )
    job = Integer(allow_none=True, metadata={"description": "That computes them just now."})
    points = Integer()
    blocks = Integer(metadata={"description": "Parts in which the points are sent."})
    block_points = Integer(metadata={"description": "Points of each but the last."})
    offset = List(Float(), metadata={"description": "Of the coordinates in blocks, x, y, z."})
    scale = List(Float(), metadata={"description": "Of a step of these coordinates."})
    unit = String(metadata={"description": "`m` or `px`"})
    frame = String(metadata={"description": "Axes and origin, in words."})
    origin = List(Float(), allow_none=True, metadata={"description": "Latitude and longitude."})
    coloured = Boolean(metadata={"description": "Whether the points have the colours of the photos."})
    corners = List(
        List(Float()),
        allow_none=True,
        metadata={"description": "Of the image: top left, top right, bottom right, bottom left."},
    )
    ground = Float(metadata={"description": "Height at which the image is drawn."})
    cameras = List(Nested(ShownCameraOut))
    left_out = List(Nested(LeftOutOut))
    photos = Integer(metadata={"description": "Of the map, those in the tray included."})
    new_photos = Integer(metadata={"description": "Added after the landmarks were computed."})


class ColmapIn(Schema):
    """Which of COLMAP's formats."""

    form = String(load_default="binary", validate=OneOf(["binary", "text"]))


@blueprint.get("")
@blueprint.output(CloudOut)
def show(slug: str) -> dict[str, Any]:
    """Get what the landmarks of a map are, and the cameras that see them.

    Where photos were placed or moved since they were laid on the map, a job lays them anew.
    """
    record = open_map(slug)
    shown = shown_cloud(library(), record)
    if not shown.is_current:
        with suppress(StorageError):  # a full disk: what is there is shown all the same
            queue_landmarks(record, only_lay=True)
    return _cloud(record, shown)


@blueprint.post("")
@blueprint.output(CloudOut, status_code=202)
def build(slug: str) -> dict[str, Any]:
    """Queue a job that computes the landmarks, or adds new photos to them."""
    record = open_map(slug, "editor")
    require("sfm")
    queue_landmarks(record, only_lay=False)
    return _cloud(record, shown_cloud(library(), record))


@blueprint.get("/points/<string(length=32):key>/<int(max=100000):number>")
@blueprint.doc(
    responses=file_answer(
        "n points: x, y, z of each (uint16, little-endian), then red, green, blue and the number of photos "
        "of each (uint8).",
        _OCTETS,
    )
)
def points(slug: str, key: str, number: int) -> Response:
    """Get a part of the points; browsers keep it, as another content has another key."""
    found = _points(open_map(slug))
    if found.key != key:
        raise NotFound("these landmarks have changed", hint="load the page again")
    data = block(found, number)
    response = Response(gzipped(data) if accepts_gzip() else data, mimetype=_OCTETS)
    if accepts_gzip():
        response.headers["Content-Encoding"] = "gzip"
    response.vary.add("Accept-Encoding")
    response.headers["Cache-Control"] = "private, max-age=31536000, immutable"
    return response


@blueprint.get("/points.ply")
@blueprint.doc(responses=file_answer("The points with their colours, as PLY (binary).", _OCTETS))
def ply(slug: str) -> Response:
    """Download the points, in the frame of the map."""
    record = open_map(slug)
    response = Response(as_ply(_points(record)), mimetype=_OCTETS)
    return _to_save(response, f"{record.slug}.ply")


@blueprint.get("/colmap.zip")
@blueprint.input(ColmapIn, location="query", arg_name="query")
@blueprint.doc(responses=file_answer("A folder for each model.", "application/zip"))
def colmap(slug: str, query: dict[str, str]) -> Response:
    """Download the models for COLMAP and programs that read its files, first that which is on the map."""
    record = open_map(slug)
    require("sfm")
    folder = landmarks_folder(library().cfg(record.slug))
    if not model_folders(folder):
        raise NotFound(_NONE, hint=_HINT)
    with library().database.read() as session:
        photos = maps.photos(session, record)
        names = {photo.sha256: photo.path for photo in photos}
        for photo in photos:
            around = parse_panorama(photo.panorama, where=photo.path)
            for view in () if around is None else around.views():
                names[view.content(photo.sha256)] = f"{photo.path}#{view.turn_deg:03}"
    spool = tempfile.SpooledTemporaryFile(_SPOOL_BYTES)  # noqa: SIM115 the answer closes it
    with tempfile.TemporaryDirectory() as out, zipfile.ZipFile(spool, "w", zipfile.ZIP_DEFLATED) as archive:
        export_models(folder, Path(out), names=names, binary=query["form"] == "binary")
        for path in sorted(Path(out).rglob("*.*")):
            archive.write(path, path.relative_to(out).as_posix())
    spool.seek(0)
    return _to_save(send_file(spool, mimetype="application/zip"), f"{record.slug}-colmap.zip")


def preview_address(record: MapRecord, photo: Photo) -> str:
    """Return where the picture of a photo is."""
    look = f"?look={look_of_photo(photo)}" if photo.blurred else ""
    return f"/api/v1/maps/{record.slug}/photos/{photo.id}/preview{look}"


def _to_save(response: Response, name: str) -> Response:
    response.headers.set("Content-Disposition", "attachment", filename=name)
    response.headers["Cache-Control"] = "private, no-store"
    return response


def _points(record: MapRecord) -> MapPoints:
    found = stored_points(library(), record)
    if found is None:
        raise NotFound(_NONE, hint=_HINT)
    return found


def _cloud(record: MapRecord, shown: ShownCloud) -> dict[str, Any]:
    found = shown.points
    with library().database.read() as session:
        job = running_job(session, record)
        photos = {photo.id: photo for photo in maps.photos(session, record) if not photo.removed}
    if found is None:
        nothing: dict[str, Any] = {"points": 0, "blocks": 0, "cameras": [], "left_out": [], "new_photos": 0}
        return {"key": None, "job": job, "photos": len(photos), **nothing}
    about = dict(found.about)
    cameras = [
        {
            **camera,
            "name": photo.name,
            "width": photo.width,
            "height": photo.height,
            "placed": photo.x_px is not None,
            "source": source_of_photo(photo),
            "preview": preview_address(record, photo),
        }
        for camera in about.pop("cameras")
        if (photo := photos.get(camera["id"])) is not None
    ]
    offset, scale = scaling(found)
    return {
        **about,
        "key": found.key,
        "job": job,
        "points": len(found.xyz),
        "blocks": -(-len(found.xyz) // BLOCK_POINTS),
        "block_points": BLOCK_POINTS,
        "offset": offset.tolist(),
        "scale": scale.tolist(),
        "cameras": cameras,
        "photos": len(photos),
        "new_photos": shown.new_photos,
    }
