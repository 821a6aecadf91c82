"""The page on which an account chooses what it hears of, and where."""

from __future__ import annotations

from flask import Blueprint, flash, render_template, request
from flask_babel import gettext as _
from flask_babel import lazy_gettext
from werkzeug.wrappers import Response

from webapp.connect.events import api, mail, receivers
from webapp.connect.events.messages import CONFIRM, TEST
from webapp.errors import ExpMapError
from webapp.store.outbox import EVENTS, JOB_FAILED, ROBOT_HEARD, ROBOT_SILENT, SHARE_INVITED, SHARE_MADE
from webapp.web import errors
from webapp.web.context import account, library, settings
from webapp.web.pages import back, page, text
from webapp.web.state import AccountPage, Parts

pages = Blueprint("event_pages", __name__)

_LABELS = {
    ROBOT_SILENT: lazy_gettext("A robot is silent"),
    ROBOT_HEARD: lazy_gettext("A robot is heard again"),
    JOB_FAILED: lazy_gettext("A job failed"),
    SHARE_MADE: lazy_gettext("Somebody made a link to a map or mission of mine"),
    SHARE_INVITED: lazy_gettext("A map was shared with me"),
    TEST: lazy_gettext("Test"),
    CONFIRM: lazy_gettext("Code for this address"),
}
_STATES = {
    "waiting": ("", lazy_gettext("waiting")),
    "sent": ("badge--success", lazy_gettext("sent")),
    "given up": ("badge--danger", lazy_gettext("given up")),
}


@pages.get("/account/events")
@page(chapter="events")
def show() -> str:
    """Show the receivers of the account and its last messages."""
    return _page()


@pages.post("/account/events")
def add() -> str | tuple[str, int]:
    """Add a receiver; the secret of a webhook is shown only in this response."""
    kind = receivers.MAIL if text("kind") == receivers.MAIL else receivers.WEBHOOK
    try:
        _receiver, secret = api.add_receiver(kind, text("address"), events=request.form.getlist("events"))
    except ExpMapError as error:
        return _page(error), errors.status_of(error)
    return _page(secret=secret, added=kind)


@pages.post("/account/events/<id:id>/choose")
def choose(id: int) -> Response | tuple[str, int]:
    """Choose which events a receiver gets."""
    try:
        with library().database.write() as session:
            receivers.choose(receivers.find(session, account().id, id=id), request.form.getlist("events"))
    except ExpMapError as error:
        return _page(error), errors.status_of(error)
    flash(_("Saved."), "success")
    return back("event_pages.show")


@pages.post("/account/events/<id:id>/confirm")
def confirm(id: int) -> Response | tuple[str, int]:
    """Confirm an e-mail address."""
    try:
        with library().database.write() as session:
            receivers.confirm(
                library().inner, receivers.find(session, account().id, id=id), code=text("code")
            )
    except ExpMapError as error:
        return _page(error), errors.status_of(error)
    flash(_("The address is confirmed."), "success")
    return back("event_pages.show")


@pages.post("/account/events/<id:id>/test")
def test(id: int) -> Response | tuple[str, int]:
    """Send a test message, or the code again."""
    try:
        api.send_test(id)
    except ExpMapError as error:
        return _page(error), errors.status_of(error)
    flash(_("A message is on its way; reload this page to see how it went."), "success")
    return back("event_pages.show")


@pages.post("/account/events/<id:id>/remove")
def remove(id: int) -> Response:
    """Remove a receiver."""
    with library().database.write() as session:
        session.delete(receivers.find(session, account().id, id=id))
    flash(_("Removed."), "success")
    return back("event_pages.show")


def _page(error: ExpMapError | None = None, *, secret: str | None = None, added: str | None = None) -> str:
    with library().database.read() as session:
        there = receivers.list_receivers(session, account().id)
        messages = receivers.last_messages(session, account().id)
    return render_template(
        "accounts/events.html",
        error=error,
        secret_text=secret,
        added=added,
        receivers=there,
        messages=messages,
        events=EVENTS,
        labels=_LABELS,
        states=_STATES,
        sends_mail=mail.is_set_up(settings().mail),
    )


PARTS = Parts(
    blueprints=(api.blueprint, pages),
    public_lists={},
    path_parameters={},
    operations={},
    account_pages=(
        AccountPage(
            "event_pages.show",
            lazy_gettext("Notifications"),
            lazy_gettext("Webhooks and e-mail when a robot is silent, a job fails, or something is shared."),
        ),
    ),
)
