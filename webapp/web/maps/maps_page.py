"""The list of maps, and the bin."""

from __future__ import annotations

from dataclasses import dataclass

from flask import Blueprint, render_template
from sqlalchemy.orm import Session

from webapp.store.maps import maps
from webapp.store.maps.maps import Role
from webapp.store.schema import Account, MapRecord
from webapp.web.context import account, library

blueprint = Blueprint("maps_page", __name__)


@dataclass(frozen=True, slots=True)
class MapCard:
    """What the list shows of a map.

    Attributes
    ----------
    role : str or None
        Of who looks at it.
    """

    map: MapRecord
    role: Role | None
    photos: int
    placed: int


@blueprint.get("/")
def index() -> str:
    """List the maps that are shared with who asks."""
    with library().database.read() as session:
        cards = _cards(session, account(), binned=False)
        binned = len(maps.listed(session, account(), binned=True))
    return render_template("maps/index.html", cards=cards, binned=binned)


@blueprint.get("/bin")
def trash() -> str:
    """List the maps in the bin."""
    with library().database.read() as session:
        cards = _cards(session, account(), binned=True)
    return render_template("maps/bin.html", cards=cards)


def _cards(session: Session, who: Account, *, binned: bool) -> list[MapCard]:
    return [
        MapCard(record, maps.role_of(session, record, account=who), *maps.counts(session, record))
        for record in maps.listed(session, who, binned=binned)
    ]
