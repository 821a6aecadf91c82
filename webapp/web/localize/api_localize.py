"""API of localization, on one map or on all maps of the caller."""

from __future__ import annotations

import secrets
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any, cast

from apiflask import APIBlueprint, Schema
from apiflask.fields import File, Float, Integer, List, Nested, String
from apiflask.validators import Length, OneOf, Range, Regexp
from flask import Response, current_app
from flask.blueprints import BlueprintSetupState
from werkzeug.datastructures import FileStorage

from webapp.core.features.table import BUNDLES, METHODS, Method, choose
from webapp.core.geo.grids import decimal, degrees_minutes_seconds, mgrs, utm
from webapp.core.geo.types import MapPixel
from webapp.core.hypotheses.priors import CirclePrior
from webapp.errors import UsageError
from webapp.files.localize.models import usable_features, usable_methods
from webapp.files.part_file import check_space, discard, receive
from webapp.progress import Progress
from webapp.store import queries
from webapp.store.maps import maps
from webapp.store.schema import MapRecord
from webapp.tasks.find.find_map import BUDGET_S, MOST_MAPS, LibrarySearch, MapRanking, find_map, search_json
from webapp.tasks.localize import readiness, show_query, upload
from webapp.tasks.localize.adopt_query import link_or_copy
from webapp.tasks.localize.map_cache import MapCache
from webapp.tasks.localize.plan import OpenOptions
from webapp.tasks.localize.upload import MAX_PHOTOS, LocalizeRequest, Send, UploadedPhoto
from webapp.tasks.maps import examples
from webapp.tasks.maps.add_photo import tidy_name
from webapp.tasks.maps.library_map import georeference
from webapp.tasks.maps.pictures import give_original
from webapp.web.context import account, authorized_by, library, map_role, open_map, settings
from webapp.web.fields import Boolean, BoundedList, RecordNumber
from webapp.web.json_bodies import limit_photo
from webapp.web.language import translate
from webapp.web.localize.answers import AnswerOut, Located, answer_or_events, answers_limit
from webapp.web.openapi import file_answer
from webapp.web.operate import metrics
from webapp.web.sending import send_picture, send_revalidated
from webapp.web.state import KEY as STATE

blueprint = APIBlueprint("api_localize", __name__, url_prefix="/api/v1/maps/<slug>", tag="Localization")
blueprint.before_request(partial(limit_photo, MAX_PHOTOS))
blueprint.record(answers_limit.set_up)

_CACHE = "expmap-map-cache"
_MOST_TOP = 20
_FAR_PX = 1e7
_ON_A_MAP = Range(-_FAR_PX, _FAR_PX)
_MOST_KEY, _MOST_SEQUENCE = 100, 64


class QuestionIn(Schema):
    """A query: one photo or several from one spot, with options and prior knowledge."""

    file = BoundedList(
        File(),  # type: ignore[no-untyped-call]
        load_default=[],
        most=MAX_PHOTOS,
        metadata={"description": "repeated: several photos that were taken at one spot"},
    )
    method = String(load_default="auto", validate=OneOf(METHODS))
    features = String(load_default="auto", validate=OneOf(("auto", *BUNDLES)))
    top = Integer(load_default=5, validate=Range(1, _MOST_TOP))
    fov = Float(
        validate=Range(1, 179),
        metadata={"description": "Horizontal field of view of the upright photo, degrees."},
    )
    hint_x_px = Float(
        validate=_ON_A_MAP,
        metadata={
            "description": "Approximate position: places in this circle gain probability, none is excluded."
        },
    )
    hint_y_px = Float(validate=_ON_A_MAP)
    hint_radius_px = Float(validate=Range(0, _FAR_PX, min_inclusive=False))
    heading_deg = Float(
        metadata={"description": "Approximate compass heading of the camera, degrees clockwise from north."}
    )
    sequence = String(
        validate=[Length(1, _MOST_SEQUENCE), Regexp("^[A-Za-z0-9_-]+$")],
        metadata={
            "description": "Chosen by you, the same one for all frames of a sequence, asked in their order: "
            "the frames before count, too. Forgotten ten minutes after the last frame."
        },
    )
    query = RecordNumber(
        metadata={"description": "Ask again about the photo of this answer, instead of a file."}
    )
    keep = Boolean(load_default=True, metadata={"description": "Remember photo and answer."})


class KeyIn(Schema):
    """Idempotency key of a query."""

    key = String(
        load_default=None,
        data_key="Idempotency-Key",
        validate=Length(1, _MOST_KEY),
        metadata={
            "description": "Idempotency key, unique for each query: a repeated request is processed once."
        },
    )


class PixelIn(Schema):
    """A position on the image."""

    x_px = Float(required=True)
    y_px = Float(required=True)


class CoordinatesOut(Schema):
    """A position in several notations; null where there is none."""

    lat = Float(allow_none=True)
    lon = Float(allow_none=True)
    decimal = String(allow_none=True)
    dms = String(allow_none=True)
    utm = String(allow_none=True)
    mgrs = String(allow_none=True)


@blueprint.record_once
def _make_cache(state: BlueprintSetupState) -> None:
    made_with = state.app.extensions[STATE]
    state.app.extensions[_CACHE] = MapCache(
        made_with.library, made_with.settings, on_look=metrics.look_counter(state.app)
    )


@blueprint.get("/examples/<string(maxlength=200):name>")
@blueprint.doc(responses=file_answer("The photo.", "image/*"))
def example(slug: str, name: str) -> Response:
    """Get an example query that comes with the map, such as `query_02.jpg` of the sample."""
    photo = examples.file_of(library().cfg(open_map(slug).slug), name)
    return send_revalidated(give_original(library(), photo, audience="members"), etag=photo.sha256)


@blueprint.get("/examples/<string(maxlength=200):name>/thumb")
@blueprint.doc(responses=file_answer("A picture of at most 256 x 256 pixels.", "image/webp"))
def example_thumb(slug: str, name: str) -> Response:
    """Get a thumbnail of an example query."""
    photo = examples.file_of(library().cfg(open_map(slug).slug), name)
    return send_picture(photo, kind="thumb", audience="members")


@blueprint.post("/localize")
@map_role("viewer")
@blueprint.input(QuestionIn, location="form_and_files", arg_name="given")
@blueprint.input(KeyIn, location="headers", arg_name="sent")
@blueprint.output(AnswerOut)
def localize(slug: str, *, given: dict[str, Any], sent: dict[str, str | None]) -> dict[str, Any] | Response:
    """Localize a photo, or several photos taken at one spot.

    With `Accept: text/event-stream` the response is server-sent events: `progress` with the number of photos
    that it is compared with, `first` with the answer of the first look, where a second one follows, and then
    `answer`.
    """
    record, key = open_map(slug), sent["key"] if given["keep"] else None
    with library().database.read() as session:
        known = queries.keyed(session, record, key=key, account_id=account().id)
    if known is not None:
        return {"id": known.id, **known.answer}
    options = _options(given["method"], given["features"])
    files = [file for file in given["file"] if isinstance(file, FileStorage)]  # an empty field is not a file
    with ExitStack() as stack:
        stack.enter_context(answers_limit.slot())
        photos = stack.enter_context(received(record, files, again=given.get("query")))
        localize_request = replace(
            _request(photos, options, given), key=key, sequence=_sequence(record, given)
        )
        answer = partial(_answer, record, keep=given["keep"], account_id=account().id)
        return answer_or_events(
            stack, lambda send: answer(replace(localize_request, send=send)), form=AnswerOut()
        )


def _answer(record: MapRecord, request: LocalizeRequest, *, keep: bool, account_id: int) -> dict[str, Any]:
    """Localize the photos of a request, and store the answer if it is to be kept."""
    result = readiness.localize_or_build(map_cache(), record, request=request)
    metrics.count_answer(result.form["seconds"])
    id = None
    if keep:
        id = upload.store_result(
            library(), record.id, result=result, request=request, account_id=account_id, settings=settings()
        )
    extra = {"calibrated": result.opened.calibrated, "not_indexed": result.opened.not_indexed}
    return {"id": id, **result.form, **extra}


@blueprint.get("/coordinates")
@blueprint.input(PixelIn, location="query", arg_name="point")
@blueprint.output(CoordinatesOut)
def coordinates(slug: str, point: dict[str, float]) -> dict[str, Any]:
    """Convert a position on the image to latitude and longitude, UTM and MGRS."""
    found = georeference(open_map(slug))
    position = None if found is None else found.latlon_of(MapPixel(point["x_px"], point["y_px"]))
    if position is None or not abs(position.lat) <= 90:  # NaN where the transformation is undefined
        return dict.fromkeys(CoordinatesOut().fields)
    grid = utm(position)
    return {
        "lat": position.lat,
        "lon": position.lon,
        "decimal": decimal(position),
        "dms": degrees_minutes_seconds(position),
        "utm": None if grid is None else str(grid),
        "mgrs": mgrs(position),
    }


def map_cache() -> MapCache:
    """Return this process's cache of open maps."""
    return cast(MapCache, current_app.extensions[_CACHE])


@contextmanager
def received(
    record: MapRecord, files: list[FileStorage], *, again: int | None
) -> Iterator[tuple[UploadedPhoto, ...]]:
    """Write the uploaded photos to temporary files, which are deleted after the block.

    Raises UsageError, InputError, NotFound, StorageError.
    """
    if bool(files) == (again is not None):
        raise UsageError(
            "send a photo", where="file", hint="one or more files, or the id of an earlier query"
        )
    folder, limits = library().uploads, settings()
    sent: list[UploadedPhoto] = []
    try:
        for file in files:
            check_space(folder, 0, reserve_mb=limits.upload.reserve_mb)
            part = folder / f"{secrets.token_hex(16)}.part"
            sent.append(UploadedPhoto(part, tidy_name(file.filename or "")))
            receive(part, file.stream, max_bytes=int(limits.photo.max_mb * 1e6))
        if again is not None:
            with library().database.read() as session:
                query = queries.find(session, record, again)
            part = folder / f"{secrets.token_hex(16)}.part"
            sent.append(UploadedPhoto(part, query.name))
            link_or_copy(show_query.original(library(), query), part)
        yield tuple(sent)
    finally:
        for one in sent:
            discard(one.path)


def _options(method: Method, features: str) -> OpenOptions:
    """Return the requested method and features; raise UsageError if this server cannot use them together."""
    folder = settings().models
    here = usable_features(folder, method=method)
    if (choose(method).name if features == "auto" else features) in here:
        return OpenOptions(method, features)
    if features == "auto" or not here:
        hint = f"these work: {', '.join(usable_methods(folder))}"
        raise UsageError(f"this server has no models for method {method}", where="method", hint=hint)
    raise UsageError(
        f"features {features} cannot be used with method {method} on this server",
        where="features",
        hint=f"these can: {', '.join(here)}",
    )


def _request(
    photos: tuple[UploadedPhoto, ...], options: OpenOptions, given: dict[str, Any]
) -> LocalizeRequest:
    x, y, radius = (given.get(f"hint_{part}_px") for part in ("x", "y", "radius"))
    near = None
    if x is not None and y is not None and radius is not None:
        near = CirclePrior(x, y, radius)
    elif (x, y, radius) != (None, None, None):
        raise UsageError(
            "the hint is not complete", where="hint_x_px", hint="give hint_x_px, hint_y_px and hint_radius_px"
        )
    return LocalizeRequest(
        photos,
        options,
        top=given["top"],
        fov_deg=given.get("fov"),
        near=near,
        heading_deg=given.get("heading_deg"),
    )


def _sequence(record: MapRecord, given: dict[str, Any]) -> Path | None:
    id = given.get("sequence")
    if id is None:
        return None
    return upload.state_file(library(), account_id=account().id, map_id=record.id, id=id)


find_api = APIBlueprint("api_find", __name__, url_prefix="/api/v1", tag="Localization")
find_api.before_request(limit_photo)

_RANKING = "expmap-map-ranking"


class FindIn(Schema):
    """A photo to search for."""

    file = File(required=True)  # type: ignore[no-untyped-call]
    top = Integer(load_default=1, validate=Range(1, 20), metadata={"description": "Most places on each map."})


class FoundMapOut(Schema):
    """A map that was searched."""

    slug = String()
    name = String()
    probability = Float(metadata={"description": "Probability that the photo was taken on this map."})
    answer = Nested(Located, metadata={"description": "Where on it, as if there were no other map."})


class SkippedMapOut(Schema):
    """A map that was not searched."""

    slug = String()
    name = String()
    reason = String(metadata={"description": "In the caller's language."})
    hint = String(allow_none=True, metadata={"description": "What to do."})


class SearchOut(Schema):
    """Maps, the most probable first; their probabilities and `no_map_probability` add up to 1."""

    query = String(metadata={"description": "The photo, as its file was named."})
    maps = List(Nested(FoundMapOut))
    no_map_probability = Float(
        metadata={
            "description": "That it was taken on none of them: on one that was not searched, or on no map."
        }
    )
    not_searched = List(
        Nested(SkippedMapOut),
        metadata={
            "description": "Maps without an index, those that cannot be opened now, and those that "
            f"{BUDGET_S:.0f} s were not enough for. "
            "That the photo is on one of them is a part of `no_map_probability`."
        },
    )
    less_alike = Integer(
        metadata={
            "description": f"Further maps, not searched: their photos were compared with this one, and those "
            f"of {MOST_MAPS} other maps are more alike."
        }
    )
    seconds = Float()


@find_api.record_once
def _make_ranking(state: BlueprintSetupState) -> None:
    made_with = state.app.extensions[STATE]
    state.app.extensions[_RANKING] = MapRanking(made_with.library, made_with.settings)


@find_api.post("/find")
@authorized_by(account)
@find_api.input(FindIn, location="form_and_files", arg_name="given")
@find_api.output(SearchOut)
def find(given: dict[str, Any]) -> dict[str, Any] | Response:
    """Find out on which of the caller's maps a photo was taken; the photo is not stored.

    With `Accept: text/event-stream` the response is server-sent events: `progress` with the map that is being
    searched, and then `answer`.
    """
    who, file = account(), given["file"]
    with library().database.read() as session:
        records = maps.list_maps(session, who)
    part, name = library().uploads / f"{secrets.token_hex(16)}.part", tidy_name(file.filename or "")
    check_space(library().uploads, 0, reserve_mb=settings().upload.reserve_mb)
    with ExitStack() as held:
        held.enter_context(answers_limit.slot())
        held.callback(discard, part)
        receive(part, file.stream, max_bytes=int(settings().photo.max_mb * 1e6))
        photo, search, top = UploadedPhoto(part, name), _search(), given["top"]

        def answer(send: Send | None) -> dict[str, Any]:
            found = find_map(search, records, photo=photo, top=top, progress=_SentProgress(send))
            return search_json(found, query=name, translate=translate)

        return answer_or_events(held, answer, form=SearchOut())


class _SentProgress(Progress):
    """Sends the name of each map when its search begins."""

    def __init__(self, send: Send | None) -> None:
        self._send = send
        self._done = self._total = 0

    def size(self, total: int) -> None:
        self._total = total

    def advance(self, steps: int = 1) -> None:
        self._done += steps

    def note(self, text: str) -> None:
        if self._send is not None:
            self._send("progress", {"map": text, "done": self._done, "total": self._total})


def _search() -> LibrarySearch:
    ranking = cast(MapRanking, current_app.extensions[_RANKING])
    return LibrarySearch(map_cache(), ranking, settings(), builds=True)
