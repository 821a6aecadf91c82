"""API of the georeference of a map's image: preview, set and remove it."""

from __future__ import annotations

import json
from collections.abc import Sequence
from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import Dict, Float, Integer, List, Nested, String
from apiflask.validators import Length, OneOf

from webapp.core.geo.controlpoints import NEEDED, ControlPoint
from webapp.core.geo.fit import GeoreferenceFit
from webapp.core.geo.types import LatLon, MapPixel
from webapp.files.satellite.georeference_files import parse_corners
from webapp.store.schema import MapRecord
from webapp.tasks.maps.place_photos import MapImage
from webapp.tasks.maps.placing import needed_image
from webapp.tasks.satellite import georeference as satellite_georeference
from webapp.tasks.satellite.apply import ImageChoice, ImageEditResult, set_georeference
from webapp.tasks.satellite.georeference import GeoreferenceRequest
from webapp.web.context import account, library, map_role, open_map
from webapp.web.fields import BoundedList, JsonValue, RecordNumber
from webapp.web.maps import state
from webapp.web.maps.schemas import EditAnswer

blueprint = APIBlueprint(
    "api_georeference", __name__, url_prefix="/api/v1/maps/<slug>/georeference", tag="Satellite image"
)

_MOST_POINTS = 500
_CORNER_VALUES = 20
MOST_CORNERS = 10_000
"""Bytes of corners as JSON."""


class PointIn(Schema):
    """A control point: a spot in the image with known latitude and longitude."""

    x = Float(required=True, metadata={"description": "Pixels from the outer left edge."})
    y = Float(required=True, metadata={"description": "Pixels from the outer top edge."})
    lat = Float(required=True)
    lon = Float(required=True)


class GeoreferenceIn(Schema):
    """Corners, control points, or a world file."""

    kind = String(required=True, validate=OneOf(("corners", "control-points", "worldfile")))
    corners = JsonValue(
        bytes=MOST_CORNERS,
        values=_CORNER_VALUES,
        load_default=None,
        metadata={
            "type": "object",
            "additionalProperties": {},
            "description": "`top_left` and `bottom_right`, or all four.",
        },
    )
    points = BoundedList(Nested(PointIn), load_default=[], most=_MOST_POINTS)
    model = String(load_default=None, allow_none=True, validate=OneOf(tuple(NEEDED)))
    worldfile = String(load_default=None, validate=Length(max=10_000))
    crs = String(load_default=None, allow_none=True, validate=Length(max=5000))
    seen = RecordNumber(
        load_default=None, metadata={"description": "Newest revision you know; a later image is a conflict."}
    )


class PreviewOut(Schema):
    """A georeference that is not applied yet."""

    kind = String(metadata={"description": "What was fitted."})
    residuals = List(Float(), metadata={"description": "Metres, one for each control point."})
    rms_m = Float(allow_none=True)
    warnings = List(String())
    corners = Dict()
    metres_per_pixel = Float(allow_none=True)
    north_deg = Float(
        allow_none=True, metadata={"description": "Where north is, clockwise from the image's top."}
    )
    points = List(Dict())
    georeference = Dict()


class ImageAnswer(EditAnswer):
    """The map's new image, and the photos that changed with it."""

    to_tray = Integer(metadata={"description": "Photos that went back to the tray."})
    from_tray = Integer(metadata={"description": "Photos that were placed by their GPS."})
    warnings = List(String())


@blueprint.post("/preview")
@map_role("editor")
@blueprint.input(GeoreferenceIn, arg_name="given")
@blueprint.output(PreviewOut)
def preview(slug: str, given: dict[str, Any]) -> dict[str, Any]:
    """Compute a georeference and its residuals; nothing is changed."""
    image, data, found = _fitted(open_map(slug, "editor"), given)
    return satellite_georeference.preview(found, data, width=image.width, height=image.height)


@blueprint.put("")
@map_role("editor")
@blueprint.input(GeoreferenceIn, arg_name="given")
@blueprint.output(ImageAnswer)
def put(slug: str, given: dict[str, Any]) -> dict[str, Any]:
    """Set the georeference of the image, as one step that can be undone."""
    record = open_map(slug, "editor")
    _, _, found = _fitted(record, given)
    choice = ImageChoice(account().id, seen=given["seen"])
    applied = set_georeference(library().changing, record.id, georeference=found.georeference, choice=choice)
    return answer(record, applied, warnings=found.warnings)


@blueprint.delete("")
@blueprint.output(ImageAnswer)
def delete(slug: str) -> dict[str, Any]:
    """Remove the georeference; photos keep their positions on the image."""
    record = open_map(slug, "editor")
    applied = set_georeference(
        library().changing, record.id, georeference=None, choice=ImageChoice(account().id)
    )
    return answer(record, applied)


def _fitted(
    record: MapRecord, given: dict[str, Any]
) -> tuple[MapImage, GeoreferenceRequest, GeoreferenceFit]:
    image = needed_image(record, with_georeference=False)
    corners = given["corners"]
    points = [ControlPoint(MapPixel(p["x"], p["y"]), LatLon(p["lat"], p["lon"])) for p in given["points"]]
    data = GeoreferenceRequest(
        given["kind"],
        corners=None if corners is None else parse_corners(json.dumps(corners).encode()),
        points=points,
        model=given["model"],
        worldfile=given["worldfile"],
        crs=given["crs"],
    )
    return image, data, satellite_georeference.fit(data, width=image.width, height=image.height)


def answer(record: MapRecord, applied: ImageEditResult, *, warnings: Sequence[str] = ()) -> dict[str, Any]:
    """Return the changes made by an edit of the image or its georeference.

    Args:
        record: Its state before the edit.
    """
    who = account()
    with library().database.read() as session:
        row = session.get_one(MapRecord, record.id)
        changed = state.changes(session, row, account=who, since=record.revision)
    report = {"to_tray": applied.to_tray, "from_tray": applied.from_tray, "warnings": list(warnings)}
    return {**changed, **report}
