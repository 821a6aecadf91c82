"""The page on which an export of a field form is added to a map."""

from __future__ import annotations

import secrets

from flask import Blueprint, flash, render_template, request
from flask_babel import gettext as _
from flask_babel import lazy_gettext
from werkzeug.datastructures import FileStorage
from werkzeug.wrappers import Response

from webapp.errors import ExpMapError, UsageError
from webapp.files.part_file import receive
from webapp.store.maps import maps
from webapp.store.operate import jobs
from webapp.tasks.exchange.import_map import archive_path
from webapp.tasks.maps.add_photo import tidy_name
from webapp.web import errors
from webapp.web.context import account, library, settings
from webapp.web.pages import back, page, text
from webapp.web.state import AccountPage, Parts

pages = Blueprint("form_pages", __name__)

_JOB = "field-form"
_MOST_FILES = 2


@pages.get("/account/forms")
@page(chapter="field-forms")
def show() -> str:
    """Show the form for an export."""
    return _page()


@pages.post("/account/forms")
def add() -> Response | tuple[str, int]:
    """Queue a job that adds the photos of an export to a map."""
    try:
        _queue([file for file in request.files.getlist("files") if file.filename])
    except ExpMapError as error:
        return _page(error), errors.status_of(error)
    flash(_("The export is being read; the menu of jobs shows how far it is."), "success")
    return back("form_pages.show")


def _queue(given: list[FileStorage]) -> None:
    if not 1 <= len(given) <= _MOST_FILES:
        raise UsageError(
            "choose one file, or a table and a zip with the photos", hint="zip other files together"
        )
    with library().database.read() as session:
        record = maps.find(session, text("map"), account=account(), role="editor")
    files = []
    kept = False
    try:
        for one in given:
            token = secrets.token_hex(16)
            files.append({"token": token, "name": tidy_name(one.filename or "")})
            limit = int(settings().web.max_request_mb * 1e6)
            receive(archive_path(library(), token), one.stream, max_bytes=limit)
        arguments = {"files": files, "all_answers": bool(text("all_answers"))}
        with library().database.write() as session:
            jobs.enqueue(
                session,
                _JOB,
                map_id=record.id,
                account_id=account().id,
                arguments=arguments,
                key=files[0]["token"],
            )
        kept = True
    finally:
        for file in files if not kept else ():
            archive_path(library(), file["token"]).unlink(missing_ok=True)


def _page(error: ExpMapError | None = None) -> str:
    with library().database.read() as session:
        own = maps.list_editable(session, account())
    return render_template("accounts/forms.html", error=error, maps=own)


PARTS = Parts(
    blueprints=(pages,),
    public_lists={},
    path_parameters={},
    operations={},
    account_pages=(
        AccountPage(
            "form_pages.show",
            lazy_gettext("Field forms"),
            lazy_gettext("Photos, positions and notes from ODK, KoboToolbox and QField onto a map."),
        ),
    ),
)
