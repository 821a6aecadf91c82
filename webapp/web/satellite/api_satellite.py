"""API of the satellite image of a map and its georeference, and of places by their names."""

from __future__ import annotations

import json
import secrets
from collections.abc import Sequence
from datetime import timedelta
from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import Dict, File, Float, Integer, List, Nested, String
from apiflask.validators import Length, OneOf, Range
from flask import Response, request, send_file
from werkzeug.datastructures import FileStorage

from webapp.core.geo.fit import NEEDED, ControlPoint, GeoreferenceFit
from webapp.core.geo.tilegrid import MAX_ZOOM, GeoBox
from webapp.core.geo.types import LatLon, MapPixel
from webapp.errors import NotFound, UsageError
from webapp.files.part_file import receive, show_file_as
from webapp.files.satellite.georeference_files import parse_corners
from webapp.files.satellite.tile_archive import PICTURES
from webapp.net.tiles import named_service, tile_services
from webapp.store.operate import jobs
from webapp.store.operate.job_views import TILES_JOB
from webapp.store.schema import MapRecord
from webapp.tasks.maps.add_photo import tidy_name
from webapp.tasks.maps.place_photos import MapImage
from webapp.tasks.maps.placing import needed_image
from webapp.tasks.satellite import display, new_image
from webapp.tasks.satellite import georeference as satellite_georeference
from webapp.tasks.satellite import tiles as satellite_tiles
from webapp.tasks.satellite.apply import ImageChoice, ImageEditResult, set_georeference
from webapp.tasks.satellite.display import DisplayFile
from webapp.tasks.satellite.geocode import geocode
from webapp.tasks.satellite.georeference import GeoreferenceRequest
from webapp.tasks.satellite.new_image import PlanSize
from webapp.tasks.satellite.tile_files import opened_archive
from webapp.tasks.satellite.tiles import TileRequest
from webapp.web import language
from webapp.web.concurrency import ConcurrencyLimit
from webapp.web.context import account, library, map_role, open_map, public, settings
from webapp.web.fields import Boolean, BoundedList, JsonValue, RecordNumber
from webapp.web.json_bodies import limit_image
from webapp.web.maps import state
from webapp.web.maps.schemas import EditAnswer
from webapp.web.openapi import file_answer

georeference_api = APIBlueprint(
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


@georeference_api.post("/preview")
@map_role("editor")
@georeference_api.input(GeoreferenceIn, arg_name="given")
@georeference_api.output(PreviewOut)
def preview(slug: str, given: dict[str, Any]) -> dict[str, Any]:
    """Compute a georeference and its residuals; nothing is changed."""
    image, data, found = _fitted(open_map(slug, "editor"), given)
    return satellite_georeference.preview(found, data, width=image.width, height=image.height)


@georeference_api.put("")
@map_role("editor")
@georeference_api.input(GeoreferenceIn, arg_name="given")
@georeference_api.output(ImageAnswer)
def put(slug: str, given: dict[str, Any]) -> dict[str, Any]:
    """Set the georeference of the image, as one step that can be undone."""
    record = open_map(slug, "editor")
    _, _, found = _fitted(record, given)
    choice = ImageChoice(account().id, seen=given["seen"])
    applied = set_georeference(library().changing, record.id, georeference=found.georeference, choice=choice)
    return answer(record, applied, warnings=found.warnings)


@georeference_api.delete("")
@georeference_api.output(ImageAnswer)
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
    """Return the changes made by an edit of the image or its georeference."""
    who = account()
    with library().database.read() as session:
        row = session.get_one(MapRecord, record.id)
        changed = state.changes(session, row, account=who, since=record.revision)
    report = {"to_tray": applied.to_tray, "from_tray": applied.from_tray, "warnings": list(warnings)}
    return {**changed, **report}


blueprint = APIBlueprint("api_satellite", __name__, url_prefix="/api/v1", tag="Satellite image")
blueprint.before_request(limit_image)

_limit = ConcurrencyLimit("satellite images", share=0.125)
"""An image of the maximum size occupies a core for about ten seconds."""

blueprint.record(_limit.set_up)

_KEPT = timedelta(days=365)

_WORLDFILE_BYTES = 10_000


class OutsideIn(Schema):
    """Handling of the photos' positions, in particular of those outside the new image."""

    scale = Boolean(
        load_default=False,
        metadata={"description": "Scale the positions with the image, where not both are georeferenced."},
    )
    tray = Boolean(load_default=False, metadata={"description": "Put photos outside back into the tray."})
    seen = RecordNumber(
        load_default=None, metadata={"description": "Newest revision you know; a later image is a conflict."}
    )


class ImageIn(OutsideIn):
    """An image, optionally with its georeference."""

    file = File(required=True)  # type: ignore[no-untyped-call]
    corners = String(
        validate=Length(max=MOST_CORNERS),
        metadata={"description": "JSON: `top_left` and `bottom_right`, or all four."},
    )
    worldfile = File()  # type: ignore[no-untyped-call]
    crs = String(
        validate=Length(max=5000), metadata={"description": "Of the world file, such as EPSG:32633."}
    )


class BlankIn(OutsideIn):
    """Size of a plan; by default it covers the GPS positions of the photos."""

    width = Integer(load_default=None)
    height = Integer(load_default=None)


class TilesIn(OutsideIn):
    """An area of a tile service."""

    service = String(required=True, validate=Length(max=200))
    zoom = Integer(required=True, validate=Range(0, MAX_ZOOM))
    north = Float(required=True)
    south = Float(required=True)
    west = Float(required=True)
    east = Float(required=True)


class TilesOut(Schema):
    """The tiles to fetch, and the job that does it."""

    job = Integer()
    width = Integer()
    height = Integer()
    tiles = Integer()
    metres_per_pixel = Float()
    attribution = String()


class ServiceOut(Schema):
    """A tile service."""

    name = String()
    url = String(
        metadata={
            "description": "Template with `{z}`, `{x}` and `{y}`, or with the area of a tile: `{bbox}` "
            "(west, south, east, north in EPSG:3857) or `{bbox-4326}` (south, west, north, east)."
        }
    )
    attribution = String()
    max_zoom = Integer()
    max_tiles = Integer()


class ServicesOut(Schema):
    """The available tile services."""

    services = List(Nested(ServiceOut))


@blueprint.get("/tile-services")
@blueprint.output(ServicesOut)
def services() -> dict[str, Any]:
    """List the available tile services, with their attributions."""
    account()
    found = tile_services(settings().tile_services)
    usable = [one for one in found if one.remote is None or settings().remote.enabled == "yes"]
    return {"services": [*map(service_json, usable)]}


@blueprint.get("/tile-services/<path:name>/tiles/<int:z>/<int:x>/<int:y>")
@public
@blueprint.doc(responses=file_answer("The tile.", "image/png", "image/jpeg", "image/webp"))
def service_tile(*, name: str, z: int, x: int, y: int) -> Response:
    """Get a tile of a service that is a file, of this server or a remote one: a PNG, JPEG or WebP file."""
    service = named_service(tile_services(settings().tile_services), name)
    if not service.public:
        account()
    missing = NotFound("tile not found", where=f"{z}/{x}/{y}")
    if not service.is_own or z > service.max_zoom or not max(x, y) < 1 << z:
        raise missing
    with opened_archive(service, cache=library().inner / "remote", settings=settings().remote) as archive:
        data = archive.tile(z, x, y)
    if data is None:
        raise missing
    media_type = next(kind for begin, kind in PICTURES.items() if data.startswith(begin))
    return Response(data, mimetype=media_type, headers={"Cache-Control": "private, max-age=86400"})


def service_json(service: Any) -> dict[str, Any]:
    """Return a tile service as JSON for pages."""
    most = settings().tiles.max_tiles
    return {
        "name": service.name,
        "url": service.url,
        "attribution": service.attribution,
        "max_zoom": service.max_zoom,
        "max_tiles": min(most, service.max_tiles or most),
    }


@blueprint.put("/maps/<slug>/satellite")
@map_role("editor")
@blueprint.input(ImageIn, location="form_and_files", arg_name="given")
@blueprint.output(ImageAnswer)
def put_image(slug: str, given: dict[str, Any]) -> dict[str, Any]:
    """Set the image of a map from an upload: PNG, JPEG, TIFF or GeoTIFF."""
    record, file = open_map(slug, "editor"), given["file"]
    georeference = _georeference_request(given)
    part = library().uploads / f"{secrets.token_hex(16)}.image"
    with show_file_as(tidy_name(file.filename or ""), part), _limit.slot():
        receive(part, file.stream, max_bytes=int(settings().satellite.max_mb * 1e6))
        uploaded = new_image.store_upload(
            library(),
            record.id,
            file=part,
            request=georeference,
            choice=_choice(given),
            settings=settings(),
        )
    return answer(record, uploaded.applied, warnings=uploaded.warnings)


@blueprint.post("/maps/<slug>/satellite/blank")
@map_role("editor")
@blueprint.input(BlankIn, arg_name="given")
@blueprint.output(ImageAnswer)
def put_blank(slug: str, given: dict[str, Any]) -> dict[str, Any]:
    """Set a blank plan as the image of a map: of a given size, or around its photos' GPS positions."""
    record = open_map(slug, "editor")
    width, height = given["width"], given["height"]
    if (width is None) != (height is None):
        raise UsageError("width and height are needed together", hint="give both, or neither")
    sheet = None if width is None else PlanSize(width, height)
    applied = new_image.make_blank(library(), record.id, sheet=sheet, choice=_choice(given))
    return answer(record, applied)


@blueprint.post("/maps/<slug>/satellite/tiles")
@map_role("editor")
@blueprint.input(TilesIn, arg_name="given")
@blueprint.output(TilesOut, status_code=202)
def put_tiles(slug: str, given: dict[str, Any]) -> dict[str, Any]:
    """Queue a job that downloads an area from a tile service and sets it as the image of the map."""
    record, who = open_map(slug, "editor"), account()
    box = GeoBox(given["north"], given["south"], given["west"], given["east"])
    data = TileRequest(given["service"], box, given["zoom"])
    service, cut = satellite_tiles.plan(data, settings=settings())
    arguments = {
        "service": data.service,
        "zoom": data.zoom,
        **box._asdict(),
        "scale": given["scale"],
        "tray": given["tray"],
    }
    with library().database.write() as session:
        # the newest request replaces a waiting one
        job = jobs.enqueue(session, TILES_JOB, map_id=record.id, account_id=who.id, arguments=arguments)
        job.arguments = arguments
        session.flush()
        id = job.id
    return {
        "job": id,
        "width": cut.width,
        "height": cut.height,
        "tiles": cut.tile_count,
        "metres_per_pixel": cut.metres_per_pixel,
        "attribution": service.attribution,
    }


@blueprint.get("/maps/<slug>/satellite")
@blueprint.doc(responses=file_answer("The image, or a smaller copy of a large one.", "image/*"))
def get_image(slug: str) -> Response:
    """Get the image for display."""
    return _sent(display.whole(library(), open_map(slug), settings=settings()))


@blueprint.get("/maps/<slug>/thumbnail")
@blueprint.doc(responses=file_answer("A picture of at most 480 pixels a side.", "image/*"))
def get_thumbnail(slug: str) -> Response:
    """Get a small copy of the image, for lists."""
    return _sent(display.thumbnail(library(), open_map(slug, binned=True), settings=settings()))


@blueprint.get("/maps/<slug>/satellite/tiles/<int:z>/<int:x>/<int:y>")
@blueprint.doc(responses=file_answer("A tile of 256 x 256 pixels.", "image/*"))
def get_tile(slug: str, *, z: int, x: int, y: int) -> Response:
    """Get a tile of a large image; the largest zoom has its full resolution."""
    return _sent(display.tile(library(), open_map(slug), z=z, x=x, y=y))


def _georeference_request(given: dict[str, Any]) -> GeoreferenceRequest | None:
    if given.get("corners") and given.get("worldfile"):
        raise UsageError("corners and a world file are given", hint="give one of them")
    if given.get("corners"):
        return GeoreferenceRequest(
            "corners", corners=parse_corners(given["corners"].encode("utf-8", "replace"))
        )
    file: FileStorage | None = given.get("worldfile")
    if file is None:
        return None
    text = file.stream.read(_WORLDFILE_BYTES).decode("utf-8", "replace")
    return GeoreferenceRequest("worldfile", worldfile=text, crs=given.get("crs"))


def _choice(given: dict[str, Any]) -> ImageChoice:
    return ImageChoice(account().id, scale=given["scale"], tray=given["tray"], seen=given["seen"])


def _sent(shown: DisplayFile) -> Response:
    """Send a file; if the request has its key, the response may be cached permanently."""
    if request.if_none_match.contains_weak(shown.key):
        response = Response(status=304)
        response.set_etag(shown.key)
    else:
        response = send_file(shown.path, mimetype=shown.mime, etag=shown.key, conditional=True)
    if request.args.get("v") == shown.key:
        response.headers["Cache-Control"] = f"private, max-age={int(_KEPT.total_seconds())}, immutable"
    return response


places_api = APIBlueprint("api_places", __name__, url_prefix="/api/v1", tag="Satellite image")


class PlaceQuery(Schema):
    """The name of a place."""

    q = String(required=True, validate=Length(min=1, max=200), metadata={"example": "Lund, Sweden"})


class PlaceOut(Schema):
    """A place, and its extent in degrees."""

    name = String()
    lat = Float()
    lon = Float()
    north = Float()
    south = Float()
    west = Float()
    east = Float()


class PlacesOut(Schema):
    """Places, the best match first."""

    places = List(Nested(PlaceOut))
    attribution = String(metadata={"description": "to be shown with them"})


@places_api.get("/places")
@places_api.input(PlaceQuery, location="query", arg_name="query")
@places_api.output(PlacesOut)
def search(query: dict[str, str]) -> dict[str, Any]:
    """Search places by name; 404 if the setting `geocoder.address` is not given."""
    account()
    chosen = settings().geocoder
    found = geocode(
        query["q"], language=language.current(), cache=library().inner / "places", settings=chosen
    )
    return {
        "places": [{"name": p.name, **p.position._asdict(), **p.box._asdict()} for p in found],
        "attribution": chosen.attribution,
    }
