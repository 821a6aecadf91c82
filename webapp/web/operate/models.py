"""The page *Server > Models* of the owner: networks, what they are for, and their installation."""

from __future__ import annotations

import secrets
from typing import Any

from apiflask import APIBlueprint, Schema
from apiflask.fields import String
from flask import flash, render_template, request
from flask_babel import gettext as _
from werkzeug.wrappers import Response

from webapp.errors import ExpMapError, NotAllowed
from webapp.files.part_file import discard, receive
from webapp.store.operate import jobs
from webapp.tasks.operate import models
from webapp.tasks.operate.models import queue_second_looks
from webapp.web import errors
from webapp.web.context import account, library, settings
from webapp.web.pages import back, page

JOB = "models"

pages = APIBlueprint("model_pages", __name__, url_prefix="/server/models", enable_openapi=False)
api = APIBlueprint("models", __name__, url_prefix="/api/v1/models", tag="Jobs")

OPERATIONS: dict[str, dict[str, Any]] = {
    "models.upload": {
        "requestBody": {
            "content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}}
        },
        "statuses": [403],
    }
}
"""Body and errors, for the OpenAPI document."""


class InstalledModel(Schema):
    """A file with weights that was installed."""

    model = String()
    file = String()


@pages.before_request
@api.before_request
def only_owners() -> None:
    """Allow only owners of the library."""
    if not account().is_owner:
        raise NotAllowed(_("only the owner of the library may do this"))


@pages.get("")
@page(chapter="operating#models")
def show() -> str:
    """List all models."""
    return _page()


@pages.post("/fetch")
def fetch() -> Response | tuple[str, int]:
    """Queue a job that fetches the models named by `model`."""
    names = request.form.getlist("model")
    try:
        wanted = models.missing(names, settings=settings()) if names else []
    except ExpMapError as error:
        return _page(error), errors.status_of(error)
    if wanted:
        with library().database.write() as session:
            arguments = {"models": wanted}
            jobs.enqueue(session, JOB, account_id=account().id, arguments=arguments, key=" ".join(wanted))
        flash(_("The models are being fetched; the list of jobs shows how far it is."), "success")
    return back("model_pages.show")


@api.put("/<name>")
@api.output(InstalledModel)
def upload(name: str) -> dict[str, str]:
    """Install a file with weights, if it is the published one, or a network that can be used."""
    part = library().inner / f"model-{secrets.token_hex(8)}.part"
    try:
        receive(part, request.stream, max_bytes=int(settings().web.max_request_mb * 1e6))
        path = models.accept(name, part, settings=settings())
    finally:
        discard(part)
    queue_second_looks(library(), settings())
    return {"model": name, "file": path.name}


def _page(error: ExpMapError | None = None) -> str:
    states = models.states(settings())
    return render_template(
        "operate/models.html",
        error=error,
        states=states,
        purposes=models.PURPOSES,
        missing=models.missing_second_look(settings()),
        advice=models.advice(settings()),
    )
