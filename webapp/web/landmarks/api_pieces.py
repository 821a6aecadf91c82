"""API of the check which photos of a map can be joined, and where photos are missing."""

from __future__ import annotations

from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import Integer, List, Nested
from sqlalchemy import select

from webapp.store.maps import maps
from webapp.store.operate import jobs
from webapp.store.operate.jobs import ENDED
from webapp.store.schema import Job, MapRecord
from webapp.tasks.landmarks import photo_pieces
from webapp.web.context import account, library, open_map
from webapp.web.fields import Boolean

pieces_api = APIBlueprint("api_pieces", __name__, url_prefix="/api/v1/maps/<slug>/pieces", tag="Checks")

_JOB = "photo-pieces"


class GapOut(Schema):
    """Two photos between which further ones would join a piece to another."""

    photo = Integer()
    other = Integer(metadata={"description": "The photo that shows most of the same, or was taken next."})
    matches = Integer(metadata={"description": "What they have in common; 0: nothing."})


class PiecesOut(Schema):
    """The pieces into which the photos fall, by ids."""

    revision = Integer(allow_none=True, metadata={"description": "Of the map then; null: not checked yet."})
    current = Boolean(metadata={"description": "Whether nothing was changed since."})
    pieces = List(List(Integer()), metadata={"description": "The largest first."})
    alone = List(Integer(), metadata={"description": "Photos in no piece."})
    bridges = List(Integer(), metadata={"description": "Photos that show the same as one outside."})
    gaps = List(Nested(GapOut))
    place_next = List(Integer(), metadata={"description": "Photos to place by hand first."})
    job = Integer(allow_none=True, metadata={"description": "Id of the job that is checking them now."})


@pieces_api.get("")
@pieces_api.output(PiecesOut)
def show(slug: str) -> dict[str, Any]:
    """Get the latest check of which photos can be joined."""
    return _pieces(open_map(slug))


@pieces_api.post("")
@pieces_api.output(PiecesOut, status_code=202)
def check(slug: str) -> dict[str, Any]:
    """Queue a job that checks which photos can be joined; it takes seconds."""
    record, who = open_map(slug, "editor"), account()
    with library().database.write() as session:
        jobs.enqueue(session, _JOB, map_id=record.id, account_id=who.id)
    return _pieces(record)


def _pieces(record: MapRecord) -> dict[str, Any]:
    found = photo_pieces.read(library().cfg(record.slug))
    with library().database.read() as session:
        running = select(Job.id).where(Job.map_id == record.id, Job.kind == _JOB, Job.state.not_in(ENDED))
        job = session.scalars(running.limit(1)).first()
        there = {photo.id for photo in maps.photos(session, record) if not photo.removed}
    if found is None:
        lists = ("pieces", "alone", "bridges", "gaps", "place_next")
        return {"revision": None, "current": False, **{name: [] for name in lists}, "job": job}
    pieces = [[id for id in piece if id in there] for piece in found["pieces"]]
    return {
        "revision": found["revision"],
        "current": found["revision"] == record.revision,
        "pieces": [piece for piece in pieces if piece],
        **{name: [id for id in found[name] if id in there] for name in ("alone", "bridges", "place_next")},
        "gaps": [gap for gap in found["gaps"] if {gap["photo"], gap["other"]} <= there],
        "job": job,
    }
