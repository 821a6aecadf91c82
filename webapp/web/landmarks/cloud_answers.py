"""Responses with a map's landmarks, for its members and visitors: JSON, blocks of points, and models."""

from __future__ import annotations

import tempfile
import zipfile
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

from apiflask import Schema
from apiflask.fields import Float, Integer, List, Nested, String
from apiflask.validators import OneOf
from flask import Response, send_file

from webapp.core.mapmodel.views import content_of_part
from webapp.errors import NotFound
from webapp.extras import require
from webapp.files.landmarks.cloud import MapPoints, as_ply
from webapp.files.maps.facts import parse_panorama
from webapp.store.maps.blurred import boxes_of
from webapp.store.schema import MapRecord, Photo
from webapp.tasks.landmarks.mapping import model_folders
from webapp.tasks.landmarks.show_cloud import (
    BLOCK_POINTS,
    ShownCloud,
    block,
    points_for_visitors,
    scaling,
    stored_points,
)
from webapp.tasks.landmarks.stored import export_models
from webapp.tasks.localize.index_location import landmarks_folder
from webapp.web.compression import accepts_gzip, gzipped
from webapp.web.context import library
from webapp.web.fields import Boolean
from webapp.web.maps.schemas import SourceOut
from webapp.web.openapi import file_answer

OCTETS = "application/octet-stream"
POINTS_DOC = file_answer(
    "n points: x, y, z of each (uint16, little-endian), then red, green, blue and the number of photos "
    "of each (uint8).",
    OCTETS,
)
PLY_DOC = file_answer("The points with their colours, as PLY (binary).", OCTETS)
COLMAP_DOC = file_answer("A folder for each model.", "application/zip")

_SPOOL_BYTES = 32_000_000
_NONE = "the map has no landmarks"
_HINT = "compute them on the page 3D, or run expmap landmarks build"


class ShownCameraOut(Schema):
    """A photo of the reconstruction."""

    id = Integer()
    name = String(allow_none=True, metadata={"description": "Null for visitors who get no original files."})
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
    preview = String(
        allow_none=True,
        metadata={
            "description": "Address of a picture of at most 1600 x 1600 pixels; null where none is shared."
        },
    )


class LeftOutOut(Schema):
    """Photos of a submodel that cannot be aligned with the map."""

    photos = List(Integer())
    reason = String()


class SharedCloudOut(Schema):
    """Landmarks in metres east, north and up, or in map pixels where the map has no georeference."""

    key = String(
        allow_none=True, metadata={"description": "Changes with the points; null if there are none."}
    )
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
    photos = Integer(metadata={"description": "Of the map; for visitors those that are placed."})


class CloudOut(SharedCloudOut):
    """Landmarks for members of the map."""

    job = Integer(allow_none=True, metadata={"description": "Id of the job that is computing them now."})
    left_out = List(Nested(LeftOutOut))
    new_photos = Integer(metadata={"description": "Added after the landmarks were computed."})


class ColmapIn(Schema):
    """Choice of COLMAP's format."""

    form = String(load_default="binary", validate=OneOf(["binary", "text"]))


def cloud_json(shown: ShownCloud, cameras: Mapping[int, Mapping[str, Any]]) -> dict[str, Any]:
    """Return landmarks in the form of `SharedCloudOut`, with `left_out`."""
    found = shown.points
    if found is None:
        return {"key": None, "points": 0, "blocks": 0, "cameras": [], "left_out": [], "photos": len(cameras)}
    about = dict(found.about)
    there = about.pop("cameras")
    offset, scale = scaling(found)
    return {
        **about,
        "key": found.key,
        "points": len(found.xyz),
        "blocks": -(-len(found.xyz) // BLOCK_POINTS),
        "block_points": BLOCK_POINTS,
        "offset": offset.tolist(),
        "scale": scale.tolist(),
        "cameras": [{**camera, **cameras[camera["id"]]} for camera in there if camera["id"] in cameras],
        "photos": len(cameras),
    }


def send_block(record: MapRecord, *, key: str, number: int, visitor: bool = False) -> Response:
    """Send a block of the points; browsers cache it, as the key changes with the content. Raises NotFound.

    Args:
        visitor: Whether points seen only by photos in the tray are left out.
    """
    found = _points(record, visitor=visitor)
    if found.key != key:
        raise NotFound("these landmarks have changed", hint="load the page again")
    data = block(found, number)
    response = Response(gzipped(data) if accepts_gzip() else data, mimetype=OCTETS)
    if accepts_gzip():
        response.headers["Content-Encoding"] = "gzip"
    response.vary.add("Accept-Encoding")
    response.headers["Cache-Control"] = "private, max-age=31536000, immutable"
    return response


def send_ply(record: MapRecord, *, visitor: bool = False) -> Response:
    """Send the points as a PLY file, in the frame of the map. Raises NotFound."""
    return _to_save(Response(as_ply(_points(record, visitor=visitor)), mimetype=OCTETS), f"{record.slug}.ply")


def send_colmap(
    record: MapRecord, *, names: Mapping[str, str], form: str, only_named: bool = False
) -> Response:
    """Send the models as a zip archive, the one that is aligned with the map first.

    Raises NotFound, MissingPart, IndexDamaged, StorageError.

    Args:
        names: As `names_of` returns them.
        form: `text` or `binary`.
        only_named: Whether photos without a name are left out.
    """
    require("sfm")
    folder = landmarks_folder(library().cfg(record.slug))
    if not model_folders(folder):
        raise NotFound(_NONE, hint=_HINT)
    spool = tempfile.SpooledTemporaryFile(_SPOOL_BYTES)  # noqa: SIM115 the answer closes it
    with tempfile.TemporaryDirectory() as out, zipfile.ZipFile(spool, "w", zipfile.ZIP_DEFLATED) as archive:
        export_models(folder, Path(out), names=names, binary=form == "binary", only_named=only_named)
        for path in sorted(Path(out).rglob("*.*")):
            archive.write(path, path.relative_to(out).as_posix())
    spool.seek(0)
    return _to_save(send_file(spool, mimetype="application/zip"), f"{record.slug}-colmap.zip")


def names_of(photos: Mapping[str, Photo]) -> dict[str, str]:
    """Return the names of photos in models by content hash; views of panoramas have their angle appended.

    A model that was made before a photo was blurred has another hash for that photo, and thus no name.
    """
    names = {}
    for name, photo in photos.items():
        blurred = tuple(boxes_of(photo))
        around = parse_panorama(photo.panorama, where=photo.path)
        if around is None:
            names[content_of_part(photo.sha256, view=None, blurred=blurred)] = name
            continue
        for view in replace(around, masked=around.masked + blurred).views():
            names[view.content(photo.sha256)] = f"{name}#{view.turn_deg:03}"
    return names


def _to_save(response: Response, name: str) -> Response:
    response.headers.set("Content-Disposition", "attachment", filename=name)
    response.headers["Cache-Control"] = "private, no-store"
    return response


def _points(record: MapRecord, *, visitor: bool) -> MapPoints:
    found = (points_for_visitors if visitor else stored_points)(library(), record)
    if found is None:
        raise NotFound(_NONE, hint=_HINT)
    return found
