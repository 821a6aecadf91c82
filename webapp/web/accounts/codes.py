"""Pages of one-time codes: setting them up, and entering one after the password."""

from __future__ import annotations

import time
from typing import Any

from flask import Blueprint, flash, redirect, render_template, request, session
from flask_babel import gettext as _
from werkzeug.wrappers import Response

from webapp.errors import ExpMapError, NotSignedIn
from webapp.render.qr import qr_path
from webapp.store.accounts import one_time_codes, sign_in
from webapp.store.schema import Account
from webapp.web import errors
from webapp.web.accounts import sessions, ways
from webapp.web.context import account, library, public, settings
from webapp.web.pages import back, page, text

code_pages = Blueprint("code_pages", __name__)

_COOKIE = "second_factor"
_PATIENCE_S = 300
"""How long after the password a code may be entered."""


def ask_for_code(who: Account, *, then: str | None) -> Response | None:
    """Go on to the form for a code, after the password; None if the account has no one-time codes."""
    with library().database.read() as db:
        if not one_time_codes.are_asked_for(db, who.id):
            return None
    session[_COOKIE] = {"account": who.id, "epoch": who.epoch, "at": int(time.time()), "next": then}
    return back("code_pages.form")


@code_pages.get("/sign-in/code")
@public
def form() -> str | Response:
    """Show the form for a code, if the password was right."""
    if sessions.signed_in() is not None:
        return back("map_pages.index")
    if _COOKIE not in session:
        return back("sign_in.form")
    return render_template("accounts/sign_in_code.html")


@code_pages.post("/sign-in/code")
@public
def enter() -> Response | tuple[str, int, dict[str, str]]:
    """Sign in by a code, after the password."""
    try:
        who, then = _after_password()
        _use(who, code=text("code"))
    except ExpMapError as error:
        shown = render_template("accounts/sign_in_code.html", error=error)
        return shown, errors.status_of(error), errors.extra_headers(error)
    sessions.sign_in(who)
    response = redirect(then, code=303) if then else back("map_pages.index")
    response.headers["Clear-Site-Data"] = '"cache"'
    return response


@code_pages.get("/account/codes")
@page(chapter="sign-in#one-time-codes")
def show() -> str:
    """Show whether one-time codes are on, or what the app has to know."""
    return _page()


@code_pages.post("/account/codes")
def begin() -> Response | tuple[str, int]:
    """Begin to set one-time codes up."""
    try:
        ways.check_passwords()
        with library().database.write() as db:
            one_time_codes.begin(db, account())
    except ExpMapError as error:
        return _page(error), errors.status_of(error)
    return back("code_pages.show")


@code_pages.post("/account/codes/confirm")
def confirm() -> str | tuple[str, int]:
    """Turn one-time codes on; the recovery codes are shown only in this response."""
    me = account()
    try:
        with _counted(me), library().database.write() as db:
            made = one_time_codes.confirm(db, library().inner, account_id=me.id, code=text("code"))
    except ExpMapError as error:
        return _page(error), errors.status_of(error)
    return _page(recovery=made)


@code_pages.post("/account/codes/recovery")
def renew() -> str | tuple[str, int]:
    """Make new recovery codes, for a code."""
    me = account()
    try:
        _use(me, code=text("code"))
        with library().database.write() as db:
            made = one_time_codes.new_recovery_codes(db, me.id)
    except ExpMapError as error:
        return _page(error), errors.status_of(error)
    return _page(recovery=made)


@code_pages.post("/account/codes/off")
def turn_off() -> Response | tuple[str, int]:
    """Turn one-time codes off, for a code; or stop setting them up."""
    me = account()
    try:
        with library().database.read() as db:
            asked_for = one_time_codes.are_asked_for(db, me.id)
        if asked_for:
            _use(me, code=text("code"))
        with library().database.write() as db:
            one_time_codes.turn_off(db, me.id)
    except ExpMapError as error:
        return _page(error), errors.status_of(error)
    flash(_("One-time codes are off."), "success")
    return back("code_pages.show")


def _after_password() -> tuple[Account, str | None]:
    """Return the account whose password was entered, and the page that was asked for. Raises NotSignedIn."""
    kept = session.get(_COOKIE)
    expired = NotSignedIn("the password was entered too long ago", hint="sign in again")
    if kept is None or abs(time.time() - kept["at"]) > _PATIENCE_S:
        raise expired
    with library().database.read() as db:
        who = db.get(Account, kept["account"])
    if who is None or who.epoch != kept["epoch"]:
        raise expired
    return who, kept["next"]


def _use(who: Account, *, code: str) -> None:
    with _counted(who), library().database.write() as db:
        one_time_codes.use(db, library().inner, account_id=who.id, code=code)


def _counted(who: Account) -> Any:
    """Limit wrong codes as wrong passwords are limited."""
    return sign_in.counted(
        library().database,
        f"code:{who.id}",
        address=request.remote_addr or "unknown",
        limits=settings().web,
    )


def _page(error: ExpMapError | None = None, *, recovery: list[str] | None = None) -> str:
    me = account()
    with library().database.read() as db:
        codes = one_time_codes.of_account(db, me.id)
        left = one_time_codes.recovery_codes_left(db, me.id)
    setup: dict[str, Any] = {}
    if codes is not None and codes.confirmed_at is None:
        secret = one_time_codes.secret_of(library().inner, codes)
        setup = {
            "qr": qr_path(one_time_codes.app_address(secret, name=me.name)),
            "secret_text": " ".join(secret[i : i + 4] for i in range(0, len(secret), 4)),
        }
    return render_template(
        "accounts/codes.html", error=error, codes=codes, left=left, recovery=recovery, **setup
    )
