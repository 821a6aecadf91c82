"""API of the control points of a map, with their residuals and those of the placed photos."""

from __future__ import annotations

from contextlib import suppress
from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import Float, Integer, List, Nested, String
from apiflask.validators import Length, OneOf, Range
from flask import Response

from webapp.core.geo.types import MapPixel
from webapp.core.mapmodel.control_points import (
    TAG_FAMILIES,
    TAG_MOUNTS,
    GroundControlPoint,
    PhotoClick,
    Tag,
)
from webapp.errors import StorageError, UsageError
from webapp.render.sheet.options import PAPERS
from webapp.render.sheet.tags import TagSheet, numbers_of, print_tags
from webapp.store.maps import edits, maps
from webapp.store.schema import MapRecord
from webapp.tasks.landmarks.edit_points import set_in_library
from webapp.tasks.landmarks.show_cloud import shown_cloud
from webapp.web.context import account, library, map_role, open_map
from webapp.web.fields import Boolean, BoundedList, RecordNumber
from webapp.web.landmarks.api_cloud import queue_landmarks, running_job
from webapp.web.openapi import file_answer
from webapp.web.sending import as_attachment

blueprint = APIBlueprint(
    "api_control_points",
    __name__,
    url_prefix="/api/v1/maps/<slug>/landmarks/control-points",
    tag="Landmarks",
)

_MOST_CLICKS, _MOST_IDS = 200, 400
_CHECK = "A check point: left out of every fit, to measure how accurate it is."


class ClickFields(Schema):
    """Position of a control point in a photo: fractions of the upright photo, from its top left corner."""

    id = RecordNumber(required=True, metadata={"description": "Of the photo."})
    x = Float(required=True, validate=Range(0.0, 1.0), metadata={"description": "Share of the width."})
    y = Float(required=True, validate=Range(0.0, 1.0), metadata={"description": "Share of the height."})


class TagFields(Schema):
    """A printed tag (AprilTag or ArUco) whose middle is the control point."""

    family = String(required=True, validate=OneOf(TAG_FAMILIES))
    id = RecordNumber(required=True, metadata={"description": "In the family."})
    size_mm = Float(required=True, metadata={"description": "Side of its black square."})
    mount = String(load_default="wall", validate=OneOf(TAG_MOUNTS))
    heading_deg = Float(
        load_default=None,
        allow_none=True,
        metadata={
            "description": "Where a tag on a wall faces, or the top of one on the floor points, degrees "
            "clockwise from north, 0 to below 360; null if unknown."
        },
    )


class ControlPointIn(Schema):
    """A spot in the world with a known position on the map, clicked in photos."""

    x_px = Float(load_default=None, allow_none=True, metadata={"description": "On the map; with y_px."})
    y_px = Float(load_default=None, allow_none=True)
    accuracy_m = Float(
        load_default=None,
        allow_none=True,
        validate=Range(min=0.0, min_inclusive=False),
        metadata={"description": "Standard deviation of that along each axis; null: one pixel of the map."},
    )
    height_m = Float(
        load_default=None,
        allow_none=True,
        metadata={"description": "Above any level that is the same for all."},
    )
    photos = BoundedList(Nested(ClickFields), load_default=[], most=_MOST_CLICKS)
    tag = Nested(TagFields, load_default=None, allow_none=True)
    check = Boolean(load_default=False, metadata={"description": _CHECK})


class ControlPointOut(Schema):
    """A control point."""

    name = String()
    x_px = Float(allow_none=True)
    y_px = Float(allow_none=True)
    accuracy_m = Float(allow_none=True)
    height_m = Float(allow_none=True)
    photos = List(Nested(ClickFields))
    tag = Nested(TagFields, allow_none=True)
    check = Boolean(metadata={"description": _CHECK})


class ResidualOut(Schema):
    """Residual of a placed photo or a control point, relative to all others."""

    photo = Integer(allow_none=True, metadata={"description": "Its id; null for a control point."})
    name = String()
    x_px = Float(allow_none=True)
    y_px = Float(allow_none=True)
    others_x_px = Float(
        allow_none=True,
        metadata={"description": "Position predicted from the others; null if they are too few."},
    )
    others_y_px = Float(allow_none=True)
    residual_px = Float(allow_none=True)
    residual_m = Float(allow_none=True, metadata={"description": "On a map with a georeference."})
    check = Boolean(metadata={"description": "Whether it is a check point."})
    photos = Integer(
        allow_none=True,
        metadata={"description": "How many joined photos see a control point, without wrong clicks."},
    )
    dx_px = Float(allow_none=True, metadata={"description": "Predicted minus known position."})
    dy_px = Float(allow_none=True)
    east_m = Float(allow_none=True, metadata={"description": "The same, on a map with a georeference."})
    north_m = Float(allow_none=True)
    height_off_m = Float(
        allow_none=True,
        metadata={"description": "Predicted minus known height of a check point, by the control points'."},
    )
    sigma_px = Float(
        allow_none=True,
        metadata={
            "description": "Standard deviation along each axis of a control point's own position and clicks."
        },
    )
    sigma_m = Float(allow_none=True)
    contradicts = Boolean(metadata={"description": "It was left out: the others agree on another place."})
    wrong_clicks = List(String(), metadata={"description": "Photos in which it is clicked elsewhere."})
    problem = String(allow_none=True, metadata={"description": "Why a control point takes no part."})


class RmseOut(Schema):
    """Root mean square errors of points."""

    points = Integer()
    rmse_px = Float(allow_none=True, metadata={"description": "Of the distances; null without points."})
    rmse_m = Float(allow_none=True, metadata={"description": "On a map with a georeference."})
    rmse_east_m = Float(allow_none=True)
    rmse_north_m = Float(allow_none=True)
    rmse_height_m = Float(allow_none=True, metadata={"description": "Of check points with heights."})
    heights = Integer(metadata={"description": "How many these are."})
    uncertainty = Float(
        allow_none=True, metadata={"description": "Relative standard deviation of the RMSE itself."}
    )


class AccuracyOut(Schema):
    """How accurate the fit is."""

    control = Nested(
        RmseOut, metadata={"description": "Each point by all others, without those that were left out."}
    )
    check = Nested(RmseOut)


class ControlPointsOut(Schema):
    """The control points and the residuals."""

    points = List(Nested(ControlPointOut))
    residuals = List(Nested(ResidualOut), metadata={"description": "The largest first."})
    accuracy = Nested(AccuracyOut, allow_none=True, metadata={"description": "Null without landmarks."})
    laid = Boolean(metadata={"description": "Whether the map has landmarks, which the residuals are of."})
    current = Boolean(
        metadata={"description": "Whether nothing was changed since the landmarks were aligned."}
    )
    job = Integer(allow_none=True, metadata={"description": "Id of the job that is aligning them now."})
    can_undo = Boolean(metadata={"description": "Whether your last edit of the map is one of these points."})


@blueprint.get("")
@blueprint.output(ControlPointsOut)
def show(slug: str) -> dict[str, Any]:
    """Get the control points, and the residuals of these and of the placed photos.

    If the map has changed since the landmarks were aligned with it, a job aligns them again.
    """
    return _answer(open_map(slug))


@blueprint.put("/<name>")
@map_role("editor")
@blueprint.input(ControlPointIn, arg_name="data")
@blueprint.output(ControlPointsOut)
def put(slug: str, name: str, data: dict[str, Any]) -> dict[str, Any]:
    """Add a control point or replace it, as one step that can be undone."""
    record = open_map(slug, "editor")
    if (data["x_px"] is None) != (data["y_px"] is None):
        raise UsageError("x_px and y_px go together", where=name, hint="give both or none")
    clicks = {click["id"]: PhotoClick(click["id"], click["x"], click["y"]) for click in data["photos"]}
    if len(clicks) < len(data["photos"]):
        raise UsageError("a photo shows a control point once", where=name, hint="click it again to move it")
    point = GroundControlPoint(
        name,
        None if data["x_px"] is None else MapPixel(data["x_px"], data["y_px"]),
        tuple(clicks[id] for id in sorted(clicks)),
        data["accuracy_m"],
        data["height_m"],
        None if data["tag"] is None else _tag(data["tag"]),
        data["check"],
    )
    set_in_library(library(), record.id, points={name: point}, account_id=account().id)
    return _answer(open_map(slug))


@blueprint.delete("/<name>")
@blueprint.output(ControlPointsOut)
def delete(slug: str, name: str) -> dict[str, Any]:
    """Remove a control point, as one step that can be undone."""
    record = open_map(slug, "editor")
    set_in_library(library(), record.id, points={name: None}, account_id=account().id)
    return _answer(open_map(slug))


class TagsIn(Schema):
    """What is printed."""

    family = String(load_default="36h11", validate=OneOf(TAG_FAMILIES))
    ids = String(
        load_default="0-5", validate=Length(max=_MOST_IDS), metadata={"description": "Such as `0-11,20`."}
    )
    size_mm = Float(load_default=150.0, metadata={"description": "Side of the black square."})
    paper = String(load_default="a4", validate=OneOf(PAPERS))


@blueprint.get("/tags.pdf")
@blueprint.input(TagsIn, location="query", arg_name="data")
@blueprint.doc(responses=file_answer("The tags at their exact size, with a ruler.", "application/pdf"))
def print_sheet(slug: str, data: dict[str, Any]) -> Response:
    """Print tags to mount in the world."""
    open_map(slug)
    numbers = numbers_of(data["ids"], family=data["family"])
    sheet = TagSheet(data["family"], numbers, data["size_mm"], data["paper"])
    response = Response(print_tags(sheet), mimetype="application/pdf")
    return as_attachment(response, f"tags-{data['family']}.pdf", default="tags.pdf")


def _tag(data: dict[str, Any]) -> Tag:
    return Tag(data["family"], data["id"], data["size_mm"], data["mount"], data["heading_deg"])


def _answer(record: MapRecord) -> dict[str, Any]:
    shown = shown_cloud(library(), record)
    if not shown.is_current:
        with suppress(StorageError):  # disk full: still show the existing residuals
            queue_landmarks(record, only_lay=True, account_id=account().id)
    with library().database.read() as session:
        photos = [photo for photo in maps.photos(session, record) if not photo.removed]
        names = {photo.path: photo.name for photo in photos}
        there = {photo.id for photo in photos}
        job = running_job(session, record)
        last = edits.next_steps(session, record, account_id=account().id)["undo"]
    empty = {"x_px": None, "y_px": None, "accuracy_m": None, "height_m": None, "tag": None, "check": False}
    about = {} if shown.points is None else shown.points.about
    return {
        "points": [
            {
                **empty,
                **point,
                "photos": [click for click in point["photos"] if click["id"] in there],
                **({"tag": {"heading_deg": None, **point["tag"]}} if point.get("tag") else {}),
            }
            for point in record.control_points or ()
        ],
        "residuals": [
            {
                **one,
                "name": one["name"] if one["photo"] is None else names[one["name"]],
                "wrong_clicks": [names.get(path, path) for path in one["wrong_clicks"]],
            }
            for one in about.get("residuals", [])
            if one["photo"] is None or one["name"] in names
        ],
        "accuracy": about.get("accuracy"),
        "laid": shown.points is not None,
        "current": shown.is_current,
        "job": job,
        "can_undo": last is not None and last.kind == edits.POINTS_KIND,
    }
