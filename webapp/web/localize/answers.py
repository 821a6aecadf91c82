"""Answers to queries: their JSON schema, as in `expmap localize --json`, and their colours."""

from __future__ import annotations

import json
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future
from contextlib import ExitStack
from itertools import chain
from queue import SimpleQueue
from threading import Event
from typing import Any, get_args

from apiflask import Schema
from apiflask.fields import Boolean, Float, Function, Integer, List, Nested, String
from flask import Response, request, stream_with_context
from flask_babel import gettext

from webapp.core.hypotheses.jsonform import answer_from_json
from webapp.core.hypotheses.places import MAP_KINDS
from webapp.core.hypotheses.verdict import Verdict, sentence_parts, verdict_of
from webapp.errors import ExpMapError
from webapp.progress import Progress
from webapp.render.colours import INK, INLIER, OUTLIER, RGB, TRUTH, probability_colour, text_on
from webapp.tasks.localize.upload import Send
from webapp.threads import ContextThreads
from webapp.web.concurrency import ConcurrencyLimit
from webapp.web.errors import as_json, status_of
from webapp.web.sending import PiecesWhileAllowed

_STEPS = 100

EVENT_STREAM = "text/event-stream"

answers_limit = ConcurrencyLimit("answers", share=1.0)
"""Of members' questions. With events, a permit is held until the work has ended, even without the client."""


class CameraOut(Schema):
    """Height, pitch and roll of the camera, and the covariance of its pose."""

    height_px = Float(metadata={"description": "Above the camera of the nearest placed photo."})
    height_m = Float(allow_none=True)
    pitch_deg = Float(metadata={"description": "Of the line of sight above the horizon."})
    roll_deg = Float(metadata={"description": "Clockwise, about the line of sight."})
    covariance = List(
        List(Float()),
        metadata={"description": "6 x 6: x, y and height (map pixels), heading, pitch and roll (degrees)."},
    )
    landmarks = Integer(metadata={"description": "Points that agree on it."})


class HypothesisOut(Schema):
    """A place where the photo may have been taken."""

    rank = Integer(metadata={"description": "From 1."})
    kind = String(
        metadata={
            "enum": ["position", "photo", "area"],
            "description": "`photo`: near that photo; `area`: somewhere in the area of its photos.",
        }
    )
    x_px = Float()
    y_px = Float()
    radius_px = Float(allow_none=True, metadata={"description": "Of 68 %, given that the place is right."})
    heading_deg = Float(allow_none=True)
    lat = Float(allow_none=True)
    lon = Float(allow_none=True)
    radius_m = Float(allow_none=True)
    probability = Float(metadata={"description": "That the photo was taken at this place."})
    experiences = List(Integer(), metadata={"description": "Ids of the supporting photos."})
    inliers = Integer(allow_none=True, metadata={"description": "Matches that agree with the geometry."})
    matches = Integer(allow_none=True)
    floor = Integer(metadata={"description": "Id of its floor; missing on a map without floors."})
    floor_name = String()
    floor_height_m = Float(allow_none=True)
    camera = Nested(CameraOut, metadata={"description": "Only if the pose was computed from landmarks."})


class StatisticsOut(Schema):
    """Statistics of the matching."""

    keypoints = Integer()
    matches = Integer()
    matches_pruned = Integer()
    distance_min = Float(allow_none=True)
    distance_max = Float(allow_none=True)
    distance_mean = Float(allow_none=True)
    distance_total = Float(allow_none=True)


class SecondsOut(Schema):
    """Durations of the stages; null for stages that the method lacks."""

    read = Float(allow_none=True)
    extract = Float(allow_none=True)
    retrieve = Float(allow_none=True)
    verify = Float(allow_none=True)
    position = Float(allow_none=True)
    total = Float(allow_none=True)


def _verdict(form: dict[str, Any]) -> Verdict:
    return verdict_of(answer_from_json(form))


def _sentence(form: dict[str, Any]) -> str:
    text, values = sentence_parts(answer_from_json(form))
    return str(gettext(text, **values))


class Located(Schema):
    """Hypotheses; their probabilities, `other_probability` and `off_map_probability` add up to 1."""

    query = String(metadata={"description": "The photo, as its file was named."})
    method = String()
    features = String()
    looks = List(String(), metadata={"description": "Features used, in order."})
    fov_deg = Float(allow_none=True)
    fov_source = String(allow_none=True, metadata={"enum": ["option", "exif", "guess", None]})
    verdict = Function(
        _verdict,
        metadata={
            "type": "string",
            "enum": [*get_args(Verdict)],
            "description": "What leads, and with `perhaps_` that it is less probable than all else together.",
        },
    )
    sentence = Function(
        _sentence,
        metadata={"type": "string", "description": "The answer in the language of the request."},
    )
    hypotheses = List(Nested(HypothesisOut), metadata={"description": "The most probable first."})
    other_probability = Float(metadata={"description": "Of places that were cut from the list."})
    off_map_probability = Float(
        allow_none=True,
        metadata={"description": "That it was not taken on this map, or at no place found; null: not known."},
    )
    statistics = Nested(StatisticsOut)
    seconds = Nested(SecondsOut)
    map_revision = Integer()
    map_kind = String(metadata={"enum": [*MAP_KINDS], "description": "What the photos' positions are."})
    place_radius_px = Float(metadata={"description": "Largest error of a place that counts as correct."})
    no_pose = String(metadata={"description": "Why there is no place; missing if there is one."})
    note = String(
        metadata={
            "description": "Why there is less than was asked for, or how the file was read; else missing."
        }
    )
    sequence = Boolean(metadata={"description": "True, where the frames before this one count, too."})


class AnswerOut(Located):
    """The answer to a query."""

    id = Integer(allow_none=True, metadata={"description": "Of the answer; null for one that is not kept."})
    calibrated = Boolean(metadata={"description": "False: the probabilities are those of most maps so far."})
    not_indexed = Integer(metadata={"description": "Photos of the map that cannot be found yet."})


def answer_or_events(
    held: ExitStack, find: Callable[[Send | None], dict[str, Any]], *, form: Schema
) -> dict[str, Any] | Response:
    """Answer with JSON; with server-sent events, if the client accepts them and prefers them to JSON.

    Args:
        held: What `find` needs, such as the photos; with events it is held until the last one.
        find: Returns the answer; with events it runs in a thread, and gets a function that sends `progress`,
            or `first` for the answer so far. That raises Cancelled once the client has gone.
        form: Schema of the answer.
    """
    if request.accept_mimetypes.best_match(["application/json", EVENT_STREAM]) != EVENT_STREAM:
        return find(None)
    kept = held.pop_all()

    def find_in_thread(send: Send) -> dict[str, Any]:
        with kept:
            return find(send)

    return _stream(find_in_thread, form)


class _Client(Progress):
    """Stops the work once the client has gone."""

    def __init__(self) -> None:
        self.gone = Event()

    def cancelled(self) -> bool:
        return self.gone.is_set()


def _stream(find: Callable[[Send], dict[str, Any]], form: Schema) -> Response:
    """Send the events of `find`, then `answer` or `error`; an error before the first event is raised."""
    events: SimpleQueue[tuple[str, dict[str, Any]] | Future[dict[str, Any]]] = SimpleQueue()
    client = _Client()

    def send(kind: str, data: dict[str, Any]) -> None:
        client.check()
        events.put((kind, data))

    threads = ContextThreads(1)
    final = threads.submit(find, send)
    final.add_done_callback(events.put)
    threads.shutdown(wait=False)
    begun = events.get()
    if isinstance(begun, Future):
        begun.result()  # raises the error, if it is one
    pieces = stream_with_context(_events(chain([begun], iter(events.get, None)), form))
    response = Response(PiecesWhileAllowed(pieces), mimetype=EVENT_STREAM)
    response.call_on_close(client.gone.set)
    response.headers["X-Accel-Buffering"] = "no"  # prevents nginx from buffering events
    response.headers["Cache-Control"] = "no-store"
    return response


def _events(
    of: Iterable[tuple[str, dict[str, Any]] | Future[dict[str, Any]]], form: Schema
) -> Iterator[bytes]:
    """Encode the events, up to the answer; an error that is a bug is raised."""
    for one in of:
        if not isinstance(one, Future):
            kind, data = one
            yield _event(kind, Located().dump(data) if kind == "first" else data)
            continue
        error = one.exception()
        if isinstance(error, ExpMapError):
            yield _event("error", {"status": status_of(error), "error": as_json(error)})
        else:
            yield _event("answer", form.dump(one.result()))
        return


def _event(kind: str, data: Any) -> bytes:
    return f"event: {kind}\ndata: {json.dumps(data)}\n\n".encode()


def answer_colours() -> dict[str, Any]:
    """Return the colours of pictures for the page, with fill and text for each percent of probability."""
    scale = [probability_colour(step / _STEPS) for step in range(_STEPS + 1)]
    return {
        "scale": [_css(colour) for colour in scale],
        "text": [_css(text_on(colour)) for colour in scale],
        "inlier": _css(INLIER),
        "outlier": _css(OUTLIER),
        "ink": _css(INK),
        "truth": _css(TRUTH),
    }


def _css(colour: RGB) -> str:
    return "#" + bytes(colour).hex()
