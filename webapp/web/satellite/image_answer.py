"""What is answered to an edit of a map's image or georeference."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from apiflask.fields import Integer, List, String

from webapp.store.schema import MapRecord
from webapp.tasks.satellite.apply import Applied
from webapp.web.context import account, library
from webapp.web.maps import state
from webapp.web.maps.schemas import EditAnswer


class ImageAnswer(EditAnswer):
    """The map's new image, and the photos that changed with it."""

    to_tray = Integer(metadata={"description": "Photos that went back to the tray."})
    from_tray = Integer(metadata={"description": "Photos that were placed by their GPS."})
    warnings = List(String())


def answer(record: MapRecord, applied: Applied, *, warnings: Sequence[str] = ()) -> dict[str, Any]:
    """Tell what is new.

    Parameters
    ----------
    record : MapRecord
        As it was before.
    """
    who = account()
    with library().database.read() as session:
        row = session.get_one(MapRecord, record.id)
        changed = state.changes(session, row, account=who, since=record.revision)
    told = {"to_tray": applied.to_tray, "from_tray": applied.from_tray, "warnings": list(warnings)}
    return {**changed, **told}
