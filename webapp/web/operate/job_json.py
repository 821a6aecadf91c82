"""Jobs as pages and programs get them: translated, and with what a waiting one waits for."""

from __future__ import annotations

from typing import Any

from sqlalchemy.orm import Session

from webapp.store.database import moment
from webapp.store.maps import maps
from webapp.store.operate import job_views
from webapp.store.schema import Account, Job, MapRecord
from webapp.web.language import translate_job
from webapp.web.state import parts


def job_json(session: Session, job: Job, *, account: Account) -> dict[str, Any]:
    """Return the JSON object of a job for an account."""
    form = job_views.to_json(session, job, account_id=account.id)
    return translate_job(form) | {"behind": _behind(session, job, account=account)}


def _behind(session: Session, job: Job, *, account: Account) -> dict[str, Any] | None:
    """Return what a waiting job waits for; the map is named only to those who may see it."""
    other = job_views.blocker(session, job, short=parts().short_jobs)
    if other is None:
        return None
    record = None if other.map_id is None else session.get(MapRecord, other.map_id)
    if record is not None and maps.role_of(session, record, account=account) is None:
        record = None
    left = job_views.seconds_left(other, at=moment(session))
    return {
        "kind": other.kind,
        "map_name": None if record is None else record.name,
        "seconds_left": None if left is None else round(left, 1),
    }
