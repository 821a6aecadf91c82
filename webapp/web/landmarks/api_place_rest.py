"""API of suggested positions for the photos in the tray, computed from the placed photos."""

from __future__ import annotations

from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import Float, Integer, List, Nested, String
from sqlalchemy import select

from webapp.core.geo.types import MapPixel
from webapp.extras import require
from webapp.store.maps import maps
from webapp.store.operate import jobs
from webapp.store.operate.jobs import ENDED
from webapp.store.schema import Job, MapRecord
from webapp.tasks.landmarks import stored
from webapp.tasks.landmarks.accept import accept_in_library, correct_in_library, is_where_it_was
from webapp.web.context import account, library, map_role, open_map
from webapp.web.fields import Boolean, BoundedList, RecordNumber
from webapp.web.maps.api_placing import PlacingOut, placing_json

landmarks_api = APIBlueprint(
    "api_landmarks", __name__, url_prefix="/api/v1/maps/<slug>/place-rest", tag="Placing"
)

_JOB = "place-rest"
_MOST = 100_000


class SuggestedPlaceOut(Schema):
    """Suggested position of a photo in the tray."""

    id = Integer()
    name = String()
    x_px = Float()
    y_px = Float()
    radius_px = Float(metadata={"description": "Contains the true position in 68 % of cases."})
    heading_deg = Float(allow_none=True)
    placed_by = List(Integer(), metadata={"description": "Nearest placed photos that it was placed by."})
    is_checked = Boolean(
        metadata={"description": "False where two placed photos are too few to show how far off it is."}
    )


class LeftPhotoOut(Schema):
    """A photo that stays in the tray."""

    id = Integer()
    name = String()
    reason = String()
    place_first = List(Integer(), metadata={"description": "Photos that would help if they were placed."})


class DoubtfulPhotoOut(Schema):
    """A placed photo that contradicts the others."""

    id = Integer()
    name = String()
    residual_px = Float(metadata={"description": "Distance from the position predicted from the others."})


class CorrectedPhotoOut(Schema):
    """A photo placed by its GPS, with its position from the reconstruction of all photos."""

    id = Integer()
    name = String()
    x_px = Float()
    y_px = Float()
    moved_m = Float(metadata={"description": "Distance from its GPS position."})
    radius_px = Float(metadata={"description": "Contains the true position in 68 % of cases."})
    heading_deg = Float(allow_none=True, metadata={"description": "Null where the photo has one."})


class RestOut(Schema):
    """Suggested positions and corrections."""

    revision = Integer(
        allow_none=True, metadata={"description": "Of the map then; null: none were made yet."}
    )
    current = Boolean(metadata={"description": "Whether nothing was changed since."})
    suggested = List(Nested(SuggestedPlaceOut))
    left = List(Nested(LeftPhotoOut))
    doubtful = List(Nested(DoubtfulPhotoOut))
    corrected = List(Nested(CorrectedPhotoOut))
    place_next = List(
        Integer(), metadata={"description": "Photos that help most if they are placed by hand."}
    )
    job = Integer(allow_none=True, metadata={"description": "Id of the job that is looking for them now."})


class AcceptIn(Schema):
    """Photos to place or to move to their suggested positions."""

    ids = BoundedList(RecordNumber(), required=True, least=1, most=_MOST)


@landmarks_api.get("")
@landmarks_api.output(RestOut)
def show(slug: str) -> dict[str, Any]:
    """Get the latest suggested positions for photos in the tray."""
    return _rest(open_map(slug))


@landmarks_api.post("")
@landmarks_api.output(RestOut, status_code=202)
def find(slug: str) -> dict[str, Any]:
    """Queue a job that suggests positions for the photos in the tray."""
    record, who = open_map(slug, "editor"), account()
    require("sfm")
    with library().database.write() as session:
        jobs.enqueue(session, _JOB, map_id=record.id, account_id=who.id)
    return _rest(record)


@landmarks_api.post("/accept")
@map_role("editor")
@landmarks_api.input(AcceptIn, arg_name="data")
@landmarks_api.output(PlacingOut)
def accept(slug: str, data: dict[str, list[int]]) -> dict[str, Any]:
    """Place photos of the tray at their suggested positions, as one step that can be undone."""
    record = open_map(slug, "editor")
    chosen = stored.suggested_of(
        library().cfg(record.slug),
        dict.fromkeys(data["ids"]),
        satellite_revision=record.satellite_revision,
    )
    placing = accept_in_library(library(), record.id, suggested=chosen, account_id=account().id)
    return placing_json(placing)


@landmarks_api.post("/correct")
@map_role("editor")
@landmarks_api.input(AcceptIn, arg_name="data")
@landmarks_api.output(PlacingOut)
def correct(slug: str, data: dict[str, list[int]]) -> dict[str, Any]:
    """Move photos from their GPS to their reconstructed positions, as one step that can be undone."""
    record = open_map(slug, "editor")
    chosen = stored.corrected_of(library().cfg(record.slug), dict.fromkeys(data["ids"]))
    placing = correct_in_library(library(), record.id, corrected=chosen, account_id=account().id)
    return placing_json(placing)


def _rest(record: MapRecord) -> dict[str, Any]:
    found = stored.read(library().cfg(record.slug))
    with library().database.read() as session:
        running = select(Job.id).where(Job.map_id == record.id, Job.kind == _JOB, Job.state.not_in(ENDED))
        job = session.scalars(running.limit(1)).first()
        names = {p.id: p for p in maps.photos(session, record) if not p.removed}
    if found is None:
        lists = ("suggested", "left", "doubtful", "corrected", "place_next")
        nothing: dict[str, Any] = {name: [] for name in lists}
        return {"revision": None, "current": False, **nothing, "job": job}
    tray = [p for p in found["photos"] if p["id"] in names and names[p["id"]].x_px is None]
    return {
        "revision": found["revision"],
        "current": found["revision"] == record.revision,
        "suggested": [
            {**p, "name": names[p["id"]].name}
            for p in tray
            if "error" not in p and stored.is_of_image(p, record.satellite_revision)
        ],
        "left": [{**p, "name": names[p["id"]].name, "reason": p["error"]} for p in tray if "error" in p],
        "doubtful": [
            {**p, "name": names[p["id"]].name}
            for p in found["checked"]
            if p["contradicts"] and p["id"] in names
        ],
        "corrected": [
            {**one, "name": names[one["id"]].name}
            for one in found["corrected"]
            if one["id"] in names
            and is_where_it_was(names[one["id"]], MapPixel(one["from_x_px"], one["from_y_px"]))
        ],
        "place_next": [id for id in found["place_next"] if id in names and names[id].x_px is None],
        "job": job,
    }
