"""Faces and plates that are blurred in all pictures of a photo."""

from __future__ import annotations

from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import List, Nested
from apiflask.validators import Length

from webapp.core.blur import Box
from webapp.store.schema import MapRecord
from webapp.tasks.sharing import blur_photo
from webapp.web.context import account, library, open_map, settings
from webapp.web.maps import state
from webapp.web.maps.schemas import BoxOut, EditAnswer

blueprint = APIBlueprint("api_blur", __name__, url_prefix="/api/v1/maps/<slug>/photos", tag="Photos")


class BlurIn(Schema):
    """All that is to be blurred; nothing for the photo as it is."""

    boxes = List(Nested(BoxOut), required=True, validate=Length(max=blur_photo.MOST_BOXES))


@blueprint.put("/<int(max=2147483647):id>/blur")
@blueprint.input(BlurIn, arg_name="wish")
@blueprint.output(EditAnswer)
def blur(slug: str, id: int, wish: dict[str, list[dict[str, float]]]) -> dict[str, Any]:
    """Blur parts of a photo in every picture of it; its file stays as it came, and visitors never get it."""
    record = open_map(slug, "editor")
    boxes = [Box(**box) for box in wish["boxes"]]
    revision = blur_photo.blur_photo(library(), record.id, photo_id=id, boxes=boxes, settings=settings())
    with library().database.read() as session:
        row = session.get_one(MapRecord, record.id)
        return state.edited(session, row, account=account(), revision=revision)
