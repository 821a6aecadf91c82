"""API of shared maps and answers, for visitors who have the token and need no sign-in."""

from __future__ import annotations

from contextlib import ExitStack
from typing import Any, cast

from apiflask import APIBlueprint, Schema
from apiflask.fields import Boolean, Dict, File, Integer, List, Nested, String
from flask import Response, current_app, request
from flask.blueprints import BlueprintSetupState
from limits import RateLimitItemPerMinute
from limits.storage import storage_from_string
from limits.strategies import FixedWindowRateLimiter
from werkzeug.datastructures import FileStorage

from webapp.errors import IndexDamaged, NotFound, NotReady, TooMany
from webapp.files.photos.photo import Kind
from webapp.store import sharing
from webapp.store.sharing import OpenedShare
from webapp.tasks.localize import readiness, show_query, upload
from webapp.tasks.localize.upload import LocalizeRequest, Send
from webapp.tasks.maps import pictures
from webapp.tasks.satellite import display
from webapp.tasks.satellite.floors import found_floor
from webapp.web.concurrency import ConcurrencyLimit
from webapp.web.context import authorized_by, library, public, settings
from webapp.web.counting import storage_address
from webapp.web.json_bodies import limit_photo
from webapp.web.localize.answers import Located, answer_or_events
from webapp.web.localize.api_localize import map_cache, received
from webapp.web.maps.schemas import FloorOut, NoteOut, PageQuery
from webapp.web.openapi import file_answer
from webapp.web.operate import metrics
from webapp.web.sending import send_original, send_picture
from webapp.web.sharing import shared_state
from webapp.web.state import KEY

blueprint = APIBlueprint("api_shared", __name__, url_prefix="/api/v1/shared/<token>", tag="Shared")
blueprint.before_request(limit_photo)

_LIMITER = "expmap-visits"
_MINUTE_S = 60
visitors_limit = ConcurrencyLimit("visitors", share=0.25)
"""Leaves threads for users who are signed in."""

blueprint.record(visitors_limit.set_up)
_ID = "<id:id>"


class AllowsOut(Schema):
    """Contents of the share in addition to the image, the positions of photos, and its answer."""

    photos = Boolean()
    localize = Boolean()
    originals = Boolean()
    notes = Boolean()
    landmarks = Boolean()
    contribute = Boolean()


class SharedOut(Schema):
    """A shared map, or a shared answer on its map."""

    name = String()
    description = String(allow_none=True)
    revision = Integer()
    allows = Nested(AllowsOut)
    satellite = Dict(allow_none=True)
    georeference = Dict(allow_none=True)
    photos = List(Dict(), metadata={"description": "Those that have a place."})
    notes = List(Nested(NoteOut), metadata={"description": "On spots of the map."})
    floors = List(Nested(FloorOut), metadata={"description": "The lowest first."})
    answer = Dict(allow_none=True, metadata={"description": "The shared answer; null for a shared map."})


class SharedPhotoPage(Schema):
    """Some photos of a share."""

    photos = List(Dict())
    next = Integer(allow_none=True, metadata={"description": "Continue after this id; null at the end."})


class VisitIn(Schema):
    """A photo of a visitor."""

    file = File(required=True)  # type: ignore[no-untyped-call]


@blueprint.record_once
def _make_limiter(state: BlueprintSetupState) -> None:
    address, options = storage_address(state.app.extensions[KEY].library.database)
    state.app.extensions[_LIMITER] = FixedWindowRateLimiter(storage_from_string(address, **options))


@blueprint.get("")
@public
@blueprint.output(SharedOut)
def show(token: str) -> dict[str, Any]:
    """Get the whole state of a shared map or answer."""
    with library().database.read() as session:
        return shared_state.whole(session, sharing.open_share(session, token), token=token)


@blueprint.get("/photos")
@public
@blueprint.input(PageQuery, location="query", arg_name="query")
@blueprint.output(SharedPhotoPage)
def list_photos(token: str, query: dict[str, int]) -> dict[str, Any]:
    """List the placed photos, in pages."""
    with library().database.read() as session:
        opened = sharing.open_share(session, token)
        return shared_state.photos_after(
            session, opened, after=query["after"], most=query["limit"], token=token
        )


@blueprint.get("/satellite")
@public
@blueprint.doc(responses=file_answer("The image, or a smaller copy of a large one.", "image/*"))
def image(token: str) -> Response:
    """Get the image of the map."""
    opened = _opened(token)
    give = display.whole if opened.share.originals else display.copy
    return shared_state.send_display(give(library(), opened.map, settings=settings()))


@blueprint.get(f"/floors/{_ID}/image")
@public
@blueprint.doc(responses=file_answer("A picture that covers the map.", "image/webp"))
def floor_image(token: str, id: int) -> Response:
    """Get the image of a floor."""
    record = _opened(token).map
    return shared_state.send_display(
        display.floor_picture(library(), record, floor=found_floor(record, id), settings=settings())
    )


@blueprint.get("/satellite/tiles/<int:z>/<int:x>/<int:y>")
@public
@blueprint.doc(responses=file_answer("A tile of 256 x 256 pixels.", "image/*"))
def tile(token: str, *, z: int, x: int, y: int) -> Response:
    """Get a tile of a large image."""
    return shared_state.send_display(display.tile(library(), _opened(token).map, z=z, x=x, y=y))


@blueprint.get(f"/photos/{_ID}/thumb")
@public
@blueprint.doc(responses=file_answer("A picture of at most 256 x 256 pixels.", "image/webp"))
def photo_thumb(token: str, id: int) -> Response:
    """Get a thumbnail of a photo of the map."""
    return _photo_preview(token, id, "thumb")


@blueprint.get(f"/photos/{_ID}/preview")
@public
@blueprint.doc(responses=file_answer("A picture of at most 1600 x 1600 pixels.", "image/jpeg"))
def photo_preview(token: str, id: int) -> Response:
    """Get a preview of a photo of the map, large enough to fill a screen."""
    return _photo_preview(token, id, "preview")


@blueprint.get(f"/photos/{_ID}/original")
@public
@blueprint.doc(responses=file_answer("The original file.", "image/*"))
def photo_original(token: str, id: int) -> Response:
    """Get the original file of a photo of the map, if the share includes original files."""
    opened = _opened(token, originals=True)
    with library().database.read() as session:
        record, photo = shared_state.photo(session, opened, id=id)
    file = pictures.file_of(library(), record.slug, photo=photo)
    return send_original(file, photo.name, audience="visitors")


@blueprint.get("/query/thumb")
@public
@blueprint.doc(responses=file_answer("A picture of at most 256 x 256 pixels.", "image/webp"))
def query_thumb(token: str) -> Response:
    """Get a thumbnail of the photo of the shared answer."""
    return _query_preview(token, "thumb")


@blueprint.get("/query/preview")
@public
@blueprint.doc(responses=file_answer("A picture of at most 1600 x 1600 pixels.", "image/jpeg"))
def query_preview(token: str) -> Response:
    """Get a preview of the photo of the shared answer, large enough to fill a screen."""
    return _query_preview(token, "preview")


@blueprint.get("/query/original")
@public
@blueprint.doc(responses=file_answer("The original file.", "image/*"))
def query_original(token: str) -> Response:
    """Get the original file of the photo of the shared answer, if the share includes original files."""
    query = shared_state.query(_opened(token, originals=True))
    return send_original(show_query.file_of(library(), query), query.name, audience="visitors")


def _opened(token: str, *, originals: bool = False) -> OpenedShare:
    with library().database.read() as session:
        opened = sharing.open_share(session, token)
    if originals and not opened.share.originals:
        raise shared_state.files_not_shared()
    return opened


def _for_visitors(token: str) -> OpenedShare:
    opened = _opened(token)
    if not opened.share.localize:
        raise NotFound("photos cannot be localized here")
    return opened


@blueprint.post("/localize")
@public
@authorized_by(_for_visitors)
@blueprint.input(VisitIn, location="files", arg_name="given")
@blueprint.output(Located)
def localize(token: str, given: dict[str, FileStorage]) -> dict[str, Any] | Response:
    """Localize a visitor's photo, if the share allows it; neither photo nor answer is stored.

    With `Accept: text/event-stream` the response is server-sent events, as for members of the map.
    """
    opened = _for_visitors(token)
    count_visit(opened)
    cache, map_id = map_cache(), opened.map.id
    with ExitStack() as held:
        held.enter_context(visitors_limit.slot())
        photos = held.enter_context(received(opened.map, [given["file"]], again=None))

        def answer(send: Send | None) -> dict[str, Any]:
            try:
                result = upload.localize_uploads(cache, map_id, request=LocalizeRequest(photos, send=send))
            except (NotReady, IndexDamaged) as error:
                readiness.build_first(library(), opened.map, settings=settings())
                raise NotReady(
                    "photos cannot be localized on this map yet", hint="come back in a few minutes"
                ) from error
            metrics.count_answer(result.form["seconds"])
            return result.form

        return answer_or_events(held, answer, form=Located())


def count_visit(opened: OpenedShare) -> None:
    """Enforce the rate limits of queries, per visitor and of all visitors of the share."""
    limiter = cast(FixedWindowRateLimiter, current_app.extensions[_LIMITER])
    share, limits = str(opened.share.id), settings().web
    for most, who in (
        (limits.visitor_questions_per_minute, request.remote_addr or "unknown"),
        (limits.share_questions_per_minute, "all"),
    ):
        if not limiter.hit(RateLimitItemPerMinute(most), share, who):
            raise TooMany(
                "too many photos in a short time", wait_s=_MINUTE_S, hint="wait a minute and try again"
            )


def _photo_preview(token: str, id: int, kind: Kind) -> Response:
    opened = _opened(token)
    with library().database.read() as session:
        record, photo = shared_state.photo(session, opened, id=id)
    file = pictures.file_of(library(), record.slug, photo=photo)
    return send_picture(file, kind=kind, audience="visitors")


def _query_preview(token: str, kind: Kind) -> Response:
    query = shared_state.query(_opened(token))
    return send_picture(show_query.file_of(library(), query), kind=kind, audience="visitors")
