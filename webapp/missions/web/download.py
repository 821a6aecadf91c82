"""Missions on their way out to pages, programs and visitors."""

from __future__ import annotations

import weakref
from collections.abc import Callable, Iterator
from typing import Any

from apiflask import Schema
from apiflask.fields import Integer
from apiflask.validators import Range
from flask import Response, url_for

from webapp.errors import NotFound, TooMany
from webapp.missions.render import export_file
from webapp.missions.render.export_file import FORMATS
from webapp.missions.tasks import export_kml
from webapp.tasks.exchange.export_source import Download
from webapp.web.context import library, settings
from webapp.web.turns import Turns

turns = Turns("mission exports", share=0.5)
"""Who takes a large file away slowly keeps a thread busy: others are left for everybody else."""

_WAIT_S = 5


class ExportQuery(Schema):
    """How much of a mission is taken away."""

    points = Integer(
        load_default=None,
        validate=Range(2, 1_000_000),
        metadata={"description": "At most so many poses of each track, evenly spread; by default all."},
    )


class LinkQuery(Schema):
    """How often programs fetch a mission again."""

    every = Integer(load_default=10, validate=Range(2, 86_400), metadata={"description": "Seconds."})


def export(mission_id: int, *, ending: str, query: dict[str, Any], photos: bool = False) -> Response:
    """Send a mission as a file of some ending, with previews of photos where it can hold them.

    Raises
    ------
    NotFound
        There is no such format.
    TooMany
    """
    if ending not in FORMATS:
        raise NotFound(f"there is no export {ending!r}", hint=f"there are {', '.join(FORMATS)}")
    place, limits, most = library(), settings(), query["points"]
    return sent(
        lambda: export_file.run(place, mission_id, form=ending, settings=limits, most=most, photos=photos)
    )


def link(name: str, *, token: str, every: int) -> Response:
    """Send a KML that has programs fetch a shared mission again and again."""
    wish: dict[str, Any] = {"token": token, "ending": "kmz", "points": export_kml.LIVE_POSES}
    href = url_for("public_mission_pages.export", _external=True, **wish)
    return sent(lambda: export_kml.run_link(name, href=href, refresh_s=every))


def sent(make: Callable[[], Download]) -> Response:
    """Send a file piece by piece, to be saved under its own name.

    Raises
    ------
    TooMany
        Too many are on their way already.
    """
    free = turns.free()
    if not free.acquire(blocking=False):
        raise TooMany(
            "the server sends other files just now", wait_s=_WAIT_S, hint="try again a little later"
        )
    try:
        download = make()
    except BaseException:
        free.release()
        raise
    response = Response(_Held(download.pieces, free.release), content_type=download.media_type)
    response.headers.set("Content-Disposition", "attachment", filename=download.name)
    response.headers["Cache-Control"] = "private, no-store"
    return response


class _Held(Iterator[bytes]):
    """Pieces on their way; when they are closed, or given up, others have their turn."""

    def __init__(self, pieces: Iterator[bytes], release: Callable[[], None]) -> None:
        self._pieces = pieces
        self._over = weakref.finalize(self, release)

    def __next__(self) -> bytes:
        return next(self._pieces)

    def close(self) -> None:
        close = getattr(self._pieces, "close", None)
        if close is not None:
            close()
        self._over()
