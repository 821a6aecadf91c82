"""Pages of passkeys: those of the account, and signing in with one."""

from __future__ import annotations

from typing import Any

from flask import Blueprint, flash, redirect, render_template, request, session
from flask_babel import gettext as _
from flask_babel import lazy_gettext
from werkzeug.wrappers import Response

from webapp.connect.passkeys import ceremonies
from webapp.connect.passkeys.ceremonies import PasskeySite
from webapp.errors import ExpMapError, NotSignedIn
from webapp.extras import is_installed
from webapp.store.accounts import passkeys, sign_in
from webapp.store.accounts.secret_key import derived_secret
from webapp.store.clock import now
from webapp.web import errors
from webapp.web.accounts import sessions, ways
from webapp.web.accounts.pages import without_cache
from webapp.web.context import account, library, public, settings
from webapp.web.pages import back, own_path, page, site, text
from webapp.web.state import AccountPage, Parts, SignInWay

pages = Blueprint("passkeys", __name__)

_CHALLENGE = "passkey_challenge"


@pages.get("/sign-in/passkey")
@public
def start() -> str | Response | tuple[str, int]:
    """Show the page that asks the browser for a passkey."""
    if sessions.signed_in() is not None:
        return back("map_pages.index")
    return _sign_in_page(None, then=own_path(request.args.get("next")))


@pages.post("/sign-in/passkey")
@public
def enter() -> Response | tuple[str, int] | tuple[str, int, dict[str, str]]:
    """Sign in by what the browser sends."""
    then = own_path(text("next"))
    try:
        ways.check_passwords()
        who = _account_of(text("answer"), challenge=session.pop(_CHALLENGE, None))
    except ExpMapError as error:
        return _sign_in_page(error, then=then), errors.status_of(error), errors.extra_headers(error)
    sessions.sign_in(who)
    return without_cache(redirect(then, code=303) if then else back("map_pages.index"))


@pages.get("/account/passkeys")
@page(chapter="sign-in#passkeys")
def show() -> str:
    """List the passkeys of the account."""
    return _page()


@pages.post("/account/passkeys")
def add() -> Response | tuple[str, int]:
    """Add the passkey that the browser has made."""
    try:
        ways.check_passwords()
        challenge = session.pop(_CHALLENGE, None)
        if challenge is None:
            raise NotSignedIn("this page has expired", hint="try again")
        made = ceremonies.registered(_site(), text("answer"), challenge=challenge)
        made.account_id, made.name = account().id, passkeys.checked_name(text("name"))
        with library().database.write() as db:
            passkeys.add(db, made)
    except ExpMapError as error:
        return _page(error), errors.status_of(error)
    flash(_("The passkey has been added."), "success")
    return back("passkeys.show")


@pages.post("/account/passkeys/<id:id>/name")
def rename(id: int) -> Response | tuple[str, int]:
    """Rename a passkey."""
    try:
        with library().database.write() as db:
            passkeys.find(db, account().id, id=id).name = passkeys.checked_name(text("name"))
    except ExpMapError as error:
        return _page(error), errors.status_of(error)
    flash(_("Saved."), "success")
    return back("passkeys.show")


@pages.post("/account/passkeys/<id:id>/remove")
def remove(id: int) -> Response:
    """Remove a passkey."""
    with library().database.write() as db:
        db.delete(passkeys.find(db, account().id, id=id))
    flash(_("The passkey has been removed; delete it on the device, too."), "success")
    return back("passkeys.show")


def _site() -> PasskeySite:
    return PasskeySite(site())


def _account_of(answer: str, *, challenge: str | None) -> Any:
    """Verify an answer, and count the use of its passkey; returns the account. Raises NotSignedIn."""
    if challenge is None:
        raise NotSignedIn("this page has expired", hint="try again")
    credential = ceremonies.credential_of(answer)
    limited = sign_in.counted(
        library().database,
        f"passkey:{credential}",
        address=request.remote_addr or "unknown",
        limits=settings().web,
    )
    with limited, library().database.write() as db:
        found = passkeys.by_credential(db, credential)
        if found is None:
            raise NotSignedIn("this server does not know the passkey", hint="sign in otherwise, and add it")
        passkey, who = found
        passkey.uses = ceremonies.used(_site(), answer, challenge=challenge, passkey=passkey)
        passkey.used_at = now()
    return who


def _sign_in_page(error: ExpMapError | None, *, then: str | None) -> str:
    options = ceremonies.sign_in_options(_site())
    session[_CHALLENGE] = options["challenge"]
    return render_template("accounts/sign_in_passkey.html", error=error, next=then, options=options)


def _page(error: ExpMapError | None = None) -> str:
    me = account()
    with library().database.read() as db:
        mine = passkeys.of_account(db, me.id)
    handle = derived_secret(library().inner, f"passkeys of {me.id}")
    options = ceremonies.registration_options(_site(), me, handle=handle, known=mine)
    session[_CHALLENGE] = options["challenge"]
    return render_template("accounts/passkeys.html", error=error, passkeys=mine, options=options)


def _is_offered() -> bool:
    return _site().has_passkeys and ways.required() is None and is_installed("connect")


PARTS = Parts(
    blueprints=(pages,),
    public_lists={},
    path_parameters={},
    operations={},
    account_pages=(
        AccountPage(
            "passkeys.show",
            lazy_gettext("Passkeys"),
            lazy_gettext("Sign in with the lock of your phone or computer, or a security key."),
            _is_offered,
        ),
    ),
    sign_in_ways=(
        SignInWay(
            "passkeys.start",
            "key",
            label=lambda: str(_("Sign in with a passkey")),
            is_offered=_is_offered,
        ),
    ),
)
