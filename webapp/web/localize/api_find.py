"""API that searches all maps of the caller for a photo."""

from __future__ import annotations

import secrets
from contextlib import ExitStack
from typing import Any, cast

from apiflask import APIBlueprint, Schema
from apiflask.fields import File, Float, Integer, List, Nested, String
from apiflask.validators import Range
from flask import Response, current_app
from flask.blueprints import BlueprintSetupState

from webapp.files.part_file import check_space, discard, receive
from webapp.progress import Progress
from webapp.store.maps import maps
from webapp.tasks.find.find_map import BUDGET_S, MOST_MAPS, LibrarySearch, MapRanking, find_map, search_json
from webapp.tasks.localize.upload import Send, UploadedPhoto
from webapp.tasks.maps.add_photo import tidy_name
from webapp.web.body_limits import limit_photo
from webapp.web.context import account, authorized_by, library, settings
from webapp.web.language import translate
from webapp.web.localize.answers import Located, answer_or_events, answers_limit
from webapp.web.localize.api_localize import map_cache
from webapp.web.state import KEY as STATE

blueprint = APIBlueprint("api_find", __name__, url_prefix="/api/v1", tag="Localization")
blueprint.before_request(limit_photo)

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


@blueprint.record_once
def _make_ranking(state: BlueprintSetupState) -> None:
    made_with = state.app.extensions[STATE]
    state.app.extensions[_RANKING] = MapRanking(made_with.library, made_with.settings)


@blueprint.post("/find")
@authorized_by(account)
@blueprint.input(FindIn, location="form_and_files", arg_name="given")
@blueprint.output(SearchOut)
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
    return LibrarySearch(map_cache(), cast(MapRanking, current_app.extensions[_RANKING]), settings())
