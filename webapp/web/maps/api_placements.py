"""Further placements of a map through the API."""

from __future__ import annotations

from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import Dict, Float, Integer, List
from apiflask.validators import Length

from webapp.core.geo.types import MapPixel
from webapp.errors import UsageError
from webapp.store.schema import MapRecord
from webapp.tasks.maps import placements
from webapp.web.context import account, library, open_map
from webapp.web.maps import state
from webapp.web.maps.schemas import EditAnswer

blueprint = APIBlueprint(
    "api_placements", __name__, url_prefix="/api/v1/maps/<slug>/placements", tag="Placements"
)


class PlacementIn(Schema):
    """Where the photos are in the placement; without anything, where they are on the map."""

    positions = Dict(
        keys=Integer(),
        values=List(Float(), validate=Length(equal=2)),
        load_default=None,
        metadata={"description": "x and y by the photo's id, pixels."},
    )
    clusters_px = Float(
        load_default=None,
        metadata={"description": "Instead: gather photos within this radius at their centre."},
    )


@blueprint.put("/<string(maxlength=60):name>")
@blueprint.input(PlacementIn, arg_name="wish")
@blueprint.output(EditAnswer)
def put(slug: str, name: str, *, wish: dict[str, Any]) -> dict[str, Any]:
    """Make a placement, or replace it."""
    record, who = open_map(slug, "editor"), account()
    if wish["positions"] is not None and wish["clusters_px"] is not None:
        raise UsageError("positions and clusters_px exclude each other", where="clusters_px")
    positions = None
    if wish["positions"] is not None:
        positions = {id: MapPixel(x, y) for id, (x, y) in wish["positions"].items()}
    revision = placements.put(
        library(),
        record.id,
        name=name,
        account_id=who.id,
        positions=positions,
        clusters_px=wish["clusters_px"],
    )
    return _answer(record, revision)


@blueprint.delete("/<string(maxlength=60):name>")
@blueprint.output(EditAnswer)
def delete(slug: str, name: str) -> dict[str, Any]:
    """Delete a placement; the photos and their places on the map stay."""
    record, who = open_map(slug, "editor"), account()
    return _answer(record, placements.delete(library(), record.id, name=name, account_id=who.id))


def _answer(record: MapRecord, revision: int | None) -> dict[str, Any]:
    who = account()
    with library().database.read() as session:
        row = session.get_one(MapRecord, record.id)
        return state.edited(session, row, account=who, revision=revision)
