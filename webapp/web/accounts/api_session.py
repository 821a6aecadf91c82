"""Who is signed in, for pages that were kept while there was no network."""

from __future__ import annotations

from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import Integer, String
from flask_wtf.csrf import generate_csrf

from webapp.web.context import account

blueprint = APIBlueprint("api_session", __name__, url_prefix="/api/v1/session", tag="Session")


class SessionOut(Schema):
    """Who asks."""

    account = Integer(metadata={"description": "Id."})
    name = String()
    csrf = String(metadata={"description": "Pages send it as `X-CSRFToken` with all that changes something."})


@blueprint.get("")
@blueprint.output(SessionOut)
def show() -> dict[str, Any]:
    """Tell who is signed in, and what a page has to send with its requests."""
    who = account()
    return {"account": who.id, "name": who.name, "csrf": generate_csrf()}
