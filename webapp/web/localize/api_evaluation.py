"""How good a map is, by its own photos: started here, worked out by a job, told in the job's result."""

from __future__ import annotations

from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import Integer
from apiflask.validators import Range

from webapp.store.operate import jobs
from webapp.web.context import account, library, open_map
from webapp.web.maps.schemas import JobSchema

blueprint = APIBlueprint("api_evaluation", __name__, url_prefix="/api/v1/maps/<slug>", tag="Checks")

_KIND = "evaluate"
_MOST = 10_000


class EvaluationRequest(Schema):
    """How much work it may be."""

    limit = Integer(
        load_default=None,
        allow_none=True,
        validate=Range(1, _MOST),
        metadata={"description": "So many photos, evenly spread over the map; null for all."},
    )


@blueprint.post("/evaluation")
@blueprint.input(EvaluationRequest, arg_name="wish")
@blueprint.output(JobSchema, status_code=202)
def evaluate(slug: str, wish: dict[str, Any]) -> dict[str, Any]:
    """Have every photo of the map localized as if it were not on it; the job's result has the figures."""
    record, who = open_map(slug, "editor"), account()
    with library().database.write() as session:
        job = jobs.enqueue(session, _KIND, map_id=record.id, account_id=who.id, arguments=wish)
        session.flush()
        return jobs.to_json(session, job, account_id=who.id)
