"""API of placing many photos in one edit (by GPS, a list of file names, a GPX track), and of placements."""

from __future__ import annotations

import secrets
from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import File, Float, Integer, List, Nested, String
from apiflask.validators import Length
from flask import request

from webapp.core.geo.types import MapPixel
from webapp.core.trajectory import ClockOffset
from webapp.errors import UsageError
from webapp.files.exchange.gpx import parse_gpx
from webapp.files.part_file import discard, receive, show_file_as
from webapp.files.text_file import MAX_BYTES
from webapp.tasks.maps import edit_map
from webapp.tasks.maps.add_photo import tidy_name
from webapp.tasks.maps.placing import (
    Clock,
    ListPreview,
    PlacingResult,
    PositionList,
    Preview,
    parse_zone,
    place_by_gps,
    place_by_list,
    place_by_track,
    preview_list,
    preview_track,
)
from webapp.web.context import account, library, map_role, open_map
from webapp.web.fields import Boolean, BoundedDict, BoundedList, RecordNumber
from webapp.web.maps import state
from webapp.web.maps.schemas import EditAnswer

placing_api = APIBlueprint("api_placing", __name__, url_prefix="/api/v1/maps/<slug>", tag="Placing")
placements_api = APIBlueprint(
    "api_placements", __name__, url_prefix="/api/v1/maps/<slug>/placements", tag="Placements"
)


class NotPlacedOut(Schema):
    """A photo that was not placed."""

    id = Integer()
    name = String()
    reason = String()


class PlacingOut(Schema):
    """Placed photos, as one step that can be undone."""

    placed = List(Integer(), metadata={"description": "ids of the photos"})
    outside = List(Nested(NotPlacedOut), metadata={"description": "photos that lie outside the image"})
    job = Integer(allow_none=True, metadata={"description": "that brings the index up to date"})


class ListedPhotoOut(Schema):
    """Position of a photo by a list."""

    id = Integer()
    name = String()
    from_px = List(Float(), allow_none=True, metadata={"description": "x and y; null: it has no place yet"})
    x_px = Float(allow_none=True, metadata={"description": "null: outside the image"})
    y_px = Float(allow_none=True)
    moves = Boolean(metadata={"description": "whether it is placed already and the list would move it"})
    moved_px = Float(allow_none=True)
    moved_m = Float(allow_none=True)
    heading_deg = Float(allow_none=True)
    problem = String(allow_none=True, metadata={"description": "how far outside the image it is"})


class ListedOut(PlacingOut):
    """Content and result of a list of positions; `placed` is empty for a preview."""

    photos = List(Nested(ListedPhotoOut))

    unknown_names = List(
        String(),
        attribute="unknown",
        data_key="unknown",
        metadata={"description": "names in the list that no photo has"},
    )
    ambiguous = List(String(), metadata={"description": "names that several photos have, or one photo twice"})
    missing = Integer(metadata={"description": "photos without a place that the list does not name"})


class FileIn(Schema):
    """A file."""

    file = File(required=True)  # type: ignore[no-untyped-call]


class PositionListIn(FileIn):
    """A list of positions, and how to read it."""

    columns = String(
        load_default="",
        validate=Length(max=2000),
        metadata={
            "description": "Of a table: what each column holds; by default its header says so.",
            "example": "name=File, lat=Latitude, lon=Longitude",
        },
    )
    move_placed = Boolean(load_default=True, metadata={"description": "whether placed photos are moved too"})


class GpxIn(FileIn):
    """A GPX file, and the error of the camera's clock."""

    offset_s = Float(load_default=0.0, metadata={"description": "seconds to add to the camera's time"})
    max_gap_s = Float(load_default=60.0, metadata={"description": "largest gap of the track that is bridged"})
    time_zone = String(
        load_default="UTC",
        validate=Length(max=100),
        metadata={"description": "of photos that do not say theirs: `Europe/Prague`, `+02:00`"},
    )


class PreviewQuery(Schema):
    """Option of a preview, which changes nothing."""

    preview = Boolean(load_default=False)


class MatchedOut(Schema):
    """Position of a photo by the track."""

    id = Integer()
    name = String()
    lat = Float()
    lon = Float()
    x_px = Float(allow_none=True)
    y_px = Float(allow_none=True)
    gap_s = Float(metadata={"description": "between the fixes of the track around it"})
    problem = String(allow_none=True, metadata={"description": "how far outside the image it is"})


class SuggestedOut(Schema):
    """Estimated offset of the camera's clock."""

    offset_s = Float()
    median_m = Float(metadata={"description": "distance of the photos' own positions from the track then"})


class GpxOut(PlacingOut):
    """Result of matching the photos in the tray to a track; `placed` is empty for a preview."""

    photos = List(Nested(MatchedOut))
    unmatched = List(Nested(NotPlacedOut))
    suggested = Nested(SuggestedOut, allow_none=True)
    fixes = Integer()
    begins_s = Float(metadata={"description": "seconds since 1970, UTC"})
    ends_s = Float(metadata={"description": "seconds since 1970, UTC"})


@placing_api.before_request
def limit_bytes() -> None:
    """Limit the size of files, which is enforced while they are read."""
    request.max_content_length = MAX_BYTES + 100_000


@placing_api.post("/photos/place-by-gps")
@placing_api.output(PlacingOut)
def by_gps(slug: str) -> dict[str, Any]:
    """Place the photos in the tray that have a GPS position."""
    record = open_map(slug, "editor")
    placing = place_by_gps(library(), record.id, account_id=account().id)
    return placing_json(placing)


@placing_api.post("/positions")
@map_role("editor")
@placing_api.input(PreviewQuery, location="query", arg_name="query")
@placing_api.input(PositionListIn, location="form_and_files", arg_name="given")
@placing_api.output(ListedOut)
@placing_api.doc(
    description="A `.cfg`; a table with any delimiter and columns of file names and positions, `lat` and "
    "`lon` or `x` and `y` in pixels of the image; GeoJSON, KML, GeoPackage or GPX with points that are named "
    "like photos. Notes of a GeoPackage are given to photos without a note."
)
def by_list(slug: str, query: dict[str, bool], given: dict[str, Any]) -> dict[str, Any]:
    """Place photos by a list of file names, or preview their positions."""
    record, file = open_map(slug, "editor"), given["file"]
    name = tidy_name(file.filename or "")
    ending = "cfg" if name.lower().endswith(".cfg") else "list"
    part = library().uploads / f"{secrets.token_hex(16)}.{ending}"
    listed = PositionList(part, name, given["columns"] or None, given["move_placed"])
    try:
        receive(part, file.stream, max_bytes=MAX_BYTES)
        if query["preview"]:
            placing = PlacingResult((), ())
            seen = preview_list(library(), record.id, listed=listed)
        else:
            placing, seen = place_by_list(library(), record.id, listed=listed, account_id=account().id)
    finally:
        discard(part)
    return {**placing_json(placing), **_listed_json(seen)}


@placing_api.post("/gpx")
@map_role("editor")
@placing_api.input(PreviewQuery, location="query", arg_name="query")
@placing_api.input(GpxIn, location="form_and_files", arg_name="given")
@placing_api.output(GpxOut)
def by_gpx(slug: str, query: dict[str, bool], given: dict[str, Any]) -> dict[str, Any]:
    """Place photos in the tray by a GPX track and their times, or preview their positions."""
    record, name = open_map(slug, "editor"), tidy_name(given["file"].filename or "")
    clock = Clock(given["offset_s"], parse_zone(given["time_zone"]), given["max_gap_s"])
    with show_file_as(name):
        track = parse_gpx(given["file"].stream.read())
    if query["preview"]:
        placing = PlacingResult((), ())
        seen = preview_track(library(), record.id, track=track, clock=clock)
    else:
        placing, seen = place_by_track(
            library(), record.id, track=track, clock=clock, account_id=account().id
        )
    span = {"fixes": len(track), "begins_s": float(track.times_s[0]), "ends_s": float(track.times_s[-1])}
    return {**placing_json(placing), **_preview_json(seen), **span}


def placing_json(placing: PlacingResult) -> dict[str, Any]:
    """Convert the result of placing photos to the form of `PlacingOut`."""
    outside = [{"id": o.id, "name": o.name, "reason": o.reason} for o in placing.outside]
    return {"placed": list(placing.placed), "outside": outside, "job": placing.job}


def _listed_json(seen: ListPreview) -> dict[str, Any]:
    photos = [
        {
            "id": one.spot.photo.id,
            "name": one.spot.photo.name,
            "from_px": None if one.before is None else [one.before.x, one.before.y],
            "x_px": one.spot.pixel.x if one.spot.problem is None else None,
            "y_px": one.spot.pixel.y if one.spot.problem is None else None,
            "moves": one.moves,
            "moved_px": one.moved_px if one.spot.problem is None else None,
            "moved_m": one.moved_m,
            "heading_deg": one.spot.heading_deg,
            "problem": one.spot.problem,
        }
        for one in seen.photos
    ]
    return {
        "photos": photos,
        "unknown": seen.unknown,
        "ambiguous": seen.ambiguous,
        "missing": seen.missing,
    }


def _preview_json(seen: Preview) -> dict[str, Any]:
    photos = [
        {
            "id": found.spot.photo.id,
            "name": found.spot.photo.name,
            "lat": found.latlon.lat,
            "lon": found.latlon.lon,
            "x_px": found.spot.pixel.x if found.spot.problem is None else None,
            "y_px": found.spot.pixel.y if found.spot.problem is None else None,
            "gap_s": found.gap_s,
            "problem": found.spot.problem,
        }
        for found in seen.found
    ]
    suggested = None
    if isinstance(seen.suggested, ClockOffset):
        suggested = {"offset_s": seen.suggested.offset_s, "median_m": seen.suggested.median_m}
    unmatched = [{"id": u.id, "name": u.name, "reason": u.reason} for u in seen.unmatched]
    return {"photos": photos, "unmatched": unmatched, "suggested": suggested}


_MOST_PLACES = 100_000


class PlacementIn(Schema):
    """Positions of the photos in the placement; by default those on the map."""

    positions = BoundedDict(
        keys=RecordNumber(),
        values=BoundedList(Float(), least=2, most=2),
        most=_MOST_PLACES,
        load_default=None,
        metadata={"description": "x and y by the photo's id, pixels."},
    )
    clusters_px = Float(
        load_default=None,
        metadata={"description": "Instead: gather photos within this radius at their centre."},
    )


@placements_api.put("/<string(maxlength=60):name>")
@map_role("editor")
@placements_api.input(PlacementIn, arg_name="data")
@placements_api.output(EditAnswer)
def put(slug: str, name: str, *, data: dict[str, Any]) -> dict[str, Any]:
    """Create or replace a placement."""
    record, who = open_map(slug, "editor"), account()
    if data["positions"] is not None and data["clusters_px"] is not None:
        raise UsageError("positions and clusters_px exclude each other", where="clusters_px")
    positions = None
    if data["positions"] is not None:
        positions = {id: MapPixel(x, y) for id, (x, y) in data["positions"].items()}
    revision = edit_map.put_placement(
        library(),
        record.id,
        name=name,
        account_id=who.id,
        positions=positions,
        clusters_px=data["clusters_px"],
    )
    return state.edited(record, revision)


@placements_api.delete("/<string(maxlength=60):name>")
@placements_api.output(EditAnswer)
def delete(slug: str, name: str) -> dict[str, Any]:
    """Delete a placement; the photos and their positions on the map are kept."""
    record, who = open_map(slug, "editor"), account()
    return state.edited(record, edit_map.delete_placement(library(), record.id, name=name, account_id=who.id))
