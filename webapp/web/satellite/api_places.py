"""API that searches places by name, for choosing the area of an image."""

from __future__ import annotations

from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import Float, List, Nested, String
from apiflask.validators import Length

from webapp.tasks.satellite.geocode import geocode
from webapp.web import language
from webapp.web.context import account, library, settings

blueprint = APIBlueprint("api_places", __name__, url_prefix="/api/v1", tag="Satellite image")


class PlaceQuery(Schema):
    """The name of a place."""

    q = String(required=True, validate=Length(min=1, max=200), metadata={"example": "Lund, Sweden"})


class PlaceOut(Schema):
    """A place, and its extent in degrees."""

    name = String()
    lat = Float()
    lon = Float()
    north = Float()
    south = Float()
    west = Float()
    east = Float()


class PlacesOut(Schema):
    """Places, the best match first."""

    places = List(Nested(PlaceOut))
    attribution = String(metadata={"description": "to be shown with them"})


@blueprint.get("/places")
@blueprint.input(PlaceQuery, location="query", arg_name="query")
@blueprint.output(PlacesOut)
def search(query: dict[str, str]) -> dict[str, Any]:
    """Search places by name; 404 if the setting `geocoder.address` is not given."""
    account()
    chosen = settings().geocoder
    found = geocode(
        query["q"], language=language.current(), cache=library().inner / "places", settings=chosen
    )
    return {
        "places": [{"name": p.name, **p.position._asdict(), **p.box._asdict()} for p in found],
        "attribution": chosen.attribution,
    }
