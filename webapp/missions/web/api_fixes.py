"""API for localizing robots by photos, and for fused tracks."""

from __future__ import annotations

import io
from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import Dict, File, Float, Integer, List, Nested, String
from apiflask.validators import Range
from flask import Response, send_file
from werkzeug.datastructures import FileStorage

from webapp.core.geo.types import LatLon
from webapp.core.hypotheses.priors import CirclePrior
from webapp.errors import UsageError
from webapp.missions.render import track_picture
from webapp.missions.store import missions
from webapp.missions.store.schema import Mission
from webapp.missions.tasks import add_photo, localize_photos
from webapp.missions.tasks import fuse as fuse_mission
from webapp.missions.tasks.add_photo import PhotoMetadata
from webapp.missions.web.context import mission_role, open_mission
from webapp.store.schema import MapRecord
from webapp.tasks.localize import readiness
from webapp.tasks.localize.upload import LocalizeRequest, UploadedPhoto
from webapp.tasks.maps.library_map import georeference
from webapp.web.context import account, library, settings
from webapp.web.fields import RecordNumber
from webapp.web.json_bodies import limit_photo
from webapp.web.localize.answers import Located
from webapp.web.localize.api_localize import map_cache, received
from webapp.web.openapi import file_answer
from webapp.web.operate import metrics

blueprint = APIBlueprint(
    "api_mission_fixes",
    __name__,
    url_prefix="/api/v1/missions/<id:mission_id>",
    tag="Missions",
)
blueprint.before_request(limit_photo)

_FAR = 1e12


class AskIn(Schema):
    """A photo, and prior knowledge of the robot."""

    file = File(required=True)  # type: ignore[no-untyped-call]
    time = Float(
        validate=Range(-_FAR, _FAR),
        metadata={"description": "When it was taken, Unix seconds; by default from EXIF."},
    )
    fov = Float(
        validate=Range(1, 179),
        metadata={"description": "Horizontal field of view of the upright photo, degrees."},
    )
    heading_deg = Float(
        metadata={"description": "Approximate compass heading of the camera, degrees clockwise from north."}
    )
    hint_lat = Float(
        validate=Range(-90, 90),
        metadata={
            "description": "Approximate position: places in this circle gain probability, none is excluded."
        },
    )
    hint_lon = Float(validate=Range(-180, 180))
    hint_radius_m = Float(validate=Range(0, min_inclusive=False))


class WhereOut(Located):
    """The answer; unknown values are null."""

    photo = String(metadata={"description": "SHA-256 of the photo, which the mission keeps."})
    time = Float(allow_none=True, metadata={"description": "When it was taken, Unix seconds."})
    lat = Float(allow_none=True)
    lon = Float(allow_none=True)
    heading_deg = Float(allow_none=True, metadata={"description": "Where the camera looked."})
    position_covariance_m2 = List(
        List(Float()),
        allow_none=True,
        metadata={"description": "Square metres: rows and columns are east and north."},
    )
    no_pose = String(
        allow_none=True, metadata={"description": "Why there is no position; null where there is one."}
    )


class QueuedOut(Schema):
    """Work in the background."""

    job = Integer(metadata={"description": "Id of the job."})


class FuseIn(Schema):
    """How to fuse."""

    odometry = RecordNumber(
        load_default=None,
        allow_none=True,
        metadata={
            "description": "Id of the odometry to correct, which has to be chosen if several are from the "
            "same time; by default the longest."
        },
    )


class StatisticsOfFixesOut(Schema):
    """Statistics of the fixes of a source."""

    source = String()
    track = Integer(metadata={"description": "Id of their track: a receiver or a camera."})
    used = Integer()
    gated = Integer(metadata={"description": "Number of fixes left out."})
    mean_distance = Float(
        allow_none=True,
        metadata={"description": "Mean squared Mahalanobis distance; 2 when all covariances are right."},
    )
    expected_between = List(
        Float(),
        allow_none=True,
        metadata={"description": "In 95 % of the cases, were all fixes independent."},
    )


class TooSureOut(Schema):
    """A source whose errors were larger than it stated."""

    source = String()
    track = Integer()
    factor = Float(metadata={"description": "Its errors by the stated standard deviations."})
    since_s = Float(metadata={"description": "Time of the first fix of which this is true, Unix seconds."})


class ShiftedOut(Schema):
    """Consecutive fixes that were off by a common vector, and left out."""

    source = String()
    track = Integer()
    from_s = Float(metadata={"description": "Time of the first one, Unix seconds."})
    to_s = Float(metadata={"description": "Time of the last one."})
    fixes = Integer(metadata={"description": "How many."})
    east_m = Float(metadata={"description": "Mean of how far they are off, metres east."})
    north_m = Float(metadata={"description": "Metres north."})


class FusionOut(Schema):
    """Report on the corrected track."""

    track = Integer(metadata={"description": "Id of the corrected track."})
    revision = Integer(metadata={"description": "Of the mission, when it was written."})
    odometry = Integer(allow_none=True, metadata={"description": "Id of the track that was corrected."})
    odometry_name = String(allow_none=True, metadata={"description": "Its name, often its topic."})
    others = List(Integer(), metadata={"description": "Ids of further odometry, which was not used."})
    poses = Integer()
    errors = Dict(
        metadata={
            "description": "Factors on standard deviations: `odometry` on the usual ones, `stated` on those "
            "of each source; more than 1: it was too sure. `receiver` is that of `gps`."
        }
    )
    too_sure = List(Nested(TooSureOut), metadata={"description": "Sources with larger errors than stated."})
    shifted = List(Nested(ShiftedOut))
    pieces = List(
        Float(), metadata={"description": "When each piece begins; the robot was carried in between."}
    )
    fixes = List(Nested(StatisticsOfFixesOut))
    planned = List(
        Integer(),
        metadata={"description": "Ids of odometry tracks that were not used: their topics are plans."},
    )
    gated = List(Dict(), metadata={"description": "The fixes that were left out, each with its `reason`."})


@blueprint.post("/fixes")
@mission_role("editor")
@blueprint.input(AskIn, location="form_and_files", arg_name="given")
@blueprint.output(WhereOut)
def fix(mission_id: int, given: dict[str, Any]) -> dict[str, Any]:
    """Localize a robot by a photo; photo and position are stored with the mission."""
    mission = open_mission(mission_id, "editor")
    record = _map(mission)
    files = [file for file in [given["file"]] if isinstance(file, FileStorage)]
    near = _near(record, given)
    with received(record, files, again=None) as sent:
        photo = add_photo.add_mission_photo(
            library(),
            mission.id,
            source=sent[0].path,
            name=sent[0].name,
            about=PhotoMetadata(time_s=given.get("time")),
            settings=settings(),
        )
    request = LocalizeRequest(
        (UploadedPhoto(add_photo.original(library(), photo), photo.name),),
        fov_deg=given.get("fov"),
        near=near,
        heading_deg=given.get("heading_deg"),
    )
    try:
        result = readiness.localize_or_build(map_cache(), record, request=request)
    except UsageError as error:
        if error.where == "hint_radius_px":
            error.where = "hint_radius_m"  # the field's name in this API
        raise
    metrics.count_answer(result.form["seconds"])
    answer_json = localize_photos.fix_json(result, time_s=photo.time_s)
    with library().database.write() as session:
        localize_photos.keep(session, mission.id, sha256=photo.sha256, fix=answer_json)
    return {"photo": photo.sha256, **answer_json}


@blueprint.post("/photos/<string(length=64):sha256>/fix")
@blueprint.output(QueuedOut, status_code=202)
def fix_later(mission_id: int, sha256: str) -> dict[str, int]:
    """Queue the localization of a photo of the mission."""
    mission = open_mission(mission_id, "editor")
    with library().database.write() as session:
        row = session.get_one(Mission, mission.id)
        photo = missions.find_photo(session, row.id, sha256)
        job = localize_photos.queue(session, row, photos=[photo], account_id=account().id)
        return {"job": job.id}


@blueprint.post("/fuse")
@mission_role("editor")
@blueprint.input(FuseIn, arg_name="given")
@blueprint.output(QueuedOut, status_code=202)
def fuse(mission_id: int, given: dict[str, Any]) -> dict[str, int]:
    """Queue the fusion of odometry, GPS and visual fixes to a corrected track."""
    mission = open_mission(mission_id, "editor")
    with library().database.write() as session:
        row = session.get_one(Mission, mission.id)
        job = fuse_mission.queue(session, row, account_id=account().id, odometry=given["odometry"])
        return {"job": job.id}


@blueprint.get("/fusion")
@blueprint.output(FusionOut)
def fusion(mission_id: int) -> dict[str, Any]:
    """Get the report of the corrected track: how it was computed, and which fixes were rejected."""
    return fuse_mission.read_report(library(), open_mission(mission_id, binned=True).id)


@blueprint.delete("/fusion")
@mission_role("editor")
@blueprint.output({}, status_code=204)
def remove_fusion(mission_id: int) -> str:
    """Delete the corrected track and its report; the recorded tracks, which it was made from, count again."""
    mission = open_mission(mission_id, "editor")
    fuse_mission.remove(library(), mission.id, write=library().database.write)
    return ""


@blueprint.get("/fusion.png")
@blueprint.doc(responses=file_answer("Raw tracks, the corrected one, and what was left out.", "image/png"))
def fusion_picture(mission_id: int) -> Response:
    """Get a picture of raw and corrected tracks, north up."""
    drawn = track_picture.of_mission(library(), open_mission(mission_id, binned=True).id)
    data = io.BytesIO()
    drawn.save(data, "PNG")
    data.seek(0)
    return send_file(data, mimetype="image/png")


def _map(mission: Mission) -> MapRecord:
    map_id = localize_photos.map_of(mission)
    with library().database.read() as session:
        return session.get_one(MapRecord, map_id)


def _near(record: MapRecord, given: dict[str, Any]) -> CirclePrior | None:
    """Convert the hint to pixels of the map's image."""
    lat, lon, radius = (given.get(f"hint_{part}") for part in ("lat", "lon", "radius_m"))
    if (lat, lon, radius) == (None, None, None):
        return None
    if lat is None or lon is None or radius is None:
        raise UsageError(
            "the hint is not complete", where="hint_lat", hint="give hint_lat, hint_lon and hint_radius_m"
        )
    found = georeference(record)
    if found is None:
        raise UsageError("the map has no georeference", where="hint_lat", hint="leave the hint out")
    at = found.pixel_of(LatLon(lat, lon))
    scale = found.metres_per_pixel(at)
    if not scale > 0:  # also rejects NaN, where the georeference has no solution
        raise UsageError("the hint is too far from the map", where="hint_lat")
    return CirclePrior(at.x, at.y, radius / scale)
