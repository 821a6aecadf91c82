"""Signing in, by a link or by name and password, and out."""

from __future__ import annotations

from flask import Blueprint, flash, redirect, render_template, request
from flask_babel import gettext as _
from werkzeug.wrappers import Response

from webapp.errors import NotSignedIn, TooMany
from webapp.store.accounts import sign_in
from webapp.store.schema import Account
from webapp.web import errors
from webapp.web.accounts import sessions
from webapp.web.accounts.access import public
from webapp.web.context import library, settings
from webapp.web.forms import back, own_path, text

blueprint = Blueprint("sign_in", __name__)


@blueprint.get("/sign-in")
@public
def form() -> Response | str:
    """Ask for name and password."""
    if sessions.signed_in() is not None:
        return back("maps_page.index")
    return render_template("accounts/sign_in.html", next=own_path(request.args.get("next")))


@blueprint.post("/sign-in")
@public
def by_password() -> Response | tuple[str, int, dict[str, str]]:
    """Sign in by name and password."""
    there = own_path(text("next"))
    try:
        account = sign_in.by_password(
            library().database,
            text("name"),
            password=text("password"),
            address=request.remote_addr or "unknown",
            limits=settings().web,
        )
    except (NotSignedIn, TooMany) as error:
        page = render_template("accounts/sign_in.html", next=there, name=text("name"), error=error)
        return page, errors.status_of(error), errors.extra_headers(error)
    sessions.sign_in(account)
    return redirect(there, code=303) if there else back("maps_page.index")


@blueprint.get("/sign-in/<token>")
@public
def link(token: str) -> Response | tuple[str, int]:
    """Show whom a link signs in. Programs that look at links, as chats do, do not use it up."""
    try:
        with library().database.read() as session:
            account = sign_in.link_account(session, token)
    except NotSignedIn as error:  # who is in already loses nothing by a link that was used
        return _refused(error) if sessions.signed_in() is None else back("maps_page.index")
    return render_template("accounts/sign_in_link.html", whose=account, token=token), 200


@blueprint.post("/sign-in/<token>")
@public
def by_link(token: str) -> Response | tuple[str, int]:
    """Sign in by a link, which works this once."""
    try:
        with library().database.write() as session:
            account = sign_in.redeem_link(session, token)
    except NotSignedIn as error:
        return _refused(error)
    sessions.sign_in(account)
    _suggest_a_password(account)
    return back("maps_page.index")


@blueprint.post("/sign-out")
@public
def out() -> Response:
    """End the session of this browser."""
    sessions.sign_out()
    return back("sign_in.form")


def _refused(error: NotSignedIn) -> tuple[str, int]:
    return render_template("accounts/sign_in.html", error=error), errors.status_of(error)


def _suggest_a_password(account: Account) -> None:
    if account.password_hash is None:
        flash(_("Welcome! The link works only once: set a password on the account page to sign in again."))
