"""API of photos that visitors give to shared maps: sending them, and what waits for a decision."""

from __future__ import annotations

from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import File, Float, Integer, List, Nested, String
from flask import request
from werkzeug.datastructures import FileStorage

from webapp.errors import NotFound, UsageError
from webapp.store import contributions, sharing
from webapp.store.clock import now
from webapp.store.schema import Contribution, MapRecord, Photo
from webapp.store.sharing import OpenedShare
from webapp.tasks.localize import readiness
from webapp.tasks.maps.contribute import Given, accept, check_allowance, contribute, suggest
from webapp.web.context import (
    account,
    authorized_by,
    library,
    map_role,
    open_map,
    public,
    reading_map,
    settings,
)
from webapp.web.fields import Boolean
from webapp.web.json_bodies import limit_photo
from webapp.web.localize.api_localize import map_cache, received
from webapp.web.sharing.api_shared import count_visit, visitors_limit

visitors_api = APIBlueprint(
    "api_contributions", __name__, url_prefix="/api/v1/shared/<token>/contributions", tag="Shared"
)
visitors_api.before_request(limit_photo)
waiting_api = APIBlueprint("api_waiting", __name__, url_prefix="/api/v1/maps/<slug>", tag="Sharing")

_MOST = 100
"""Photos that are listed at once."""


class GiveIn(Schema):
    """A photo that a visitor gives."""

    file = File(required=True)  # type: ignore[no-untyped-call]
    consent = Boolean(
        required=True,
        metadata={
            "description": "The visitor took it, and lets the owners of the map keep, show and share it."
        },
    )


class GivenOut(Schema):
    """A photo that waits for the owners of the map."""

    found = Boolean(metadata={"description": "Whether the place where it was taken was found."})
    searching = Boolean(metadata={"description": "Whether it is looked for later, when the map is ready."})
    x_px = Float(allow_none=True, metadata={"description": "That place on the image, if it was found."})
    y_px = Float(allow_none=True)


class WaitingOut(Schema):
    """A photo from a visitor, and the suggested place: null where none was found."""

    id = Integer(metadata={"description": "Of the photo on the map: removing it refuses it."})
    name = String()
    sent_at = String()
    thumb = String()
    preview = String()
    width = Integer()
    height = Integer()
    x_px = Float(allow_none=True)
    y_px = Float(allow_none=True)
    radius_px = Float(allow_none=True)
    heading_deg = Float(allow_none=True)
    probability = Float(allow_none=True)
    searching = Boolean(metadata={"description": "Whether a place is looked for when the map is ready."})


class WaitingList(Schema):
    """Photos from visitors that wait for a decision, the oldest first."""

    photos = List(Nested(WaitingOut))
    waiting = Integer(metadata={"description": f"Number of all; at most {_MOST} are listed."})


def _for_givers(token: str) -> OpenedShare:
    with library().database.read() as session:
        opened = sharing.open_share(session, token)
    if not opened.share.contribute:
        raise NotFound("photos cannot be given here", hint="ask the person who sent the link")
    return opened


@visitors_api.post("")
@public
@authorized_by(_for_givers)
@visitors_api.input(GiveIn, location="form_and_files", arg_name="given")
@visitors_api.output(GivenOut, status_code=201)
def give(token: str, given: dict[str, Any]) -> dict[str, Any]:
    """Give a photo to a map, if the share allows it; it waits until an editor of the map accepts it."""
    opened = _for_givers(token)
    if not given["consent"]:
        raise UsageError("the photo was not sent", where="consent", hint="agree to what happens with it")
    count_visit(opened)
    file: FileStorage = given["file"]
    visitor = contributions.visitor_of(opened.share, address=request.remote_addr or "", at=now())
    limits = settings().contributions
    # before the file is received, and again in the transaction that adds it
    check_allowance(library(), opened.share, visitor=visitor, size_bytes=0, limits=limits)
    with visitors_limit.slot(), received(opened.map, [file], again=None) as (photo,):
        size_bytes = photo.path.stat().st_size
        check_allowance(library(), opened.share, visitor=visitor, size_bytes=size_bytes, limits=limits)
        suggestion = suggest(map_cache(), opened.map.id, photo=photo)
        sent = Given(opened.share.id, visitor, photo.path, photo.name)
        contribute(library(), opened.map.id, given=sent, suggestion=suggestion, settings=settings())
    if suggestion.to_find:
        _find_later(opened.map)
    place = suggestion.place
    at = {name: None if place is None else place[name] for name in ("x_px", "y_px")}
    return {"found": place is not None, "searching": suggestion.to_find, **at}


def _find_later(record: MapRecord) -> None:
    """Have the index built, or looked at again: its job then finds the places of photos that wait."""
    readiness.build_first(library(), record, settings=settings())


@waiting_api.get("/contributions")
@map_role("editor")
@waiting_api.output(WaitingList)
def list_waiting(slug: str) -> dict[str, Any]:
    """List the photos from visitors that wait for a decision."""
    return _all_waiting(slug)


def _all_waiting(slug: str) -> dict[str, Any]:
    with reading_map(slug, "editor") as (session, record):
        found = contributions.waiting(session, record, most=_MOST)
        count = contributions.waiting_amount(session, record.id).photos
    if any(given.to_find for given, _photo in found):
        _find_later(record)
    return {"photos": [_waiting(slug, *row) for row in found], "waiting": count}


@waiting_api.post("/contributions/<id:id>/accept")
@map_role("editor")
@waiting_api.output(WaitingList)
def accept_one(slug: str, id: int) -> dict[str, Any]:
    """Place a photo from a visitor where suggested, as one step that can be undone."""
    record = open_map(slug, "editor")
    accept(library(), record.id, photo_id=id, account_id=account().id)
    return _all_waiting(slug)


def _waiting(slug: str, given: Contribution, photo: Photo) -> dict[str, Any]:
    base = f"/api/v1/maps/{slug}/photos/{photo.id}"
    return {
        "id": photo.id,
        "name": photo.name,
        "sent_at": given.sent_at.isoformat(timespec="seconds"),
        "thumb": f"{base}/thumb?v={photo.revision}",
        "preview": f"{base}/preview?v={photo.revision}",
        "width": photo.width,
        "height": photo.height,
        "x_px": given.x_px,
        "y_px": given.y_px,
        "radius_px": given.radius_px,
        "heading_deg": given.heading_deg,
        "probability": given.probability,
        "searching": given.to_find,
    }
