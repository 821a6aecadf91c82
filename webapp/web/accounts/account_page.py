"""The page where people care for their own account."""

from __future__ import annotations

from flask import Blueprint, flash, redirect, render_template, request, session
from flask_babel import gettext as _
from flask_babel import refresh
from werkzeug.wrappers import Response

from webapp.errors import ExpMapError, NotFound
from webapp.store.accounts import accounts, sign_in
from webapp.store.schema import Account
from webapp.web import errors
from webapp.web.accounts import sessions
from webapp.web.accounts.access import public
from webapp.web.context import account, library, settings
from webapp.web.forms import back, own_path, text
from webapp.web.language import LANGUAGES

blueprint = Blueprint("account_page", __name__)


@blueprint.get("/account")
def show() -> str:
    """Show name, password, sessions and tokens."""
    return _page()


@blueprint.post("/account/name")
def rename() -> Response | tuple[str, int]:
    """Take another name."""
    try:
        with library().database.write() as db:
            accounts.rename(db, db.get_one(Account, account().id), name=text("name"))
    except ExpMapError as error:
        return _page(error), errors.status_of(error)
    flash(_("Your name has been changed."), "success")
    return back("account_page.show")


@blueprint.post("/account/password")
def set_password() -> Response | tuple[str, int]:
    """Set a password, or change it; everywhere else the account is signed out."""
    me = account()
    try:
        if me.password_hash is not None:
            sign_in.by_password(
                library().database,
                me.name,
                password=text("current"),
                address=request.remote_addr or "unknown",
                limits=settings().web,
            )
        hashed = sign_in.password_hash(text("password"), minimum=settings().web.min_password)
    except ExpMapError as error:
        return _page(error), errors.status_of(error)
    with library().database.write() as db:
        me = db.get_one(Account, me.id)
        me.password_hash = hashed
        accounts.end_sessions(me)
    sessions.sign_in(me)
    flash(_("The password has been set; you are signed out everywhere else."), "success")
    return back("account_page.show")


@blueprint.post("/account/end-sessions")
def end_sessions() -> Response:
    """Sign out everywhere else."""
    with library().database.write() as db:
        me = db.get_one(Account, account().id)
        accounts.end_sessions(me)
    sessions.sign_in(me)
    flash(_("You are signed out everywhere else."), "success")
    return back("account_page.show")


@blueprint.post("/account/tokens")
def new_token() -> str | tuple[str, int]:
    """Make a token; the answer is the only place where it is shown."""
    try:
        with library().database.write() as db:
            token = accounts.new_token(db, account(), name=text("name"))
    except ExpMapError as error:
        return _page(error), errors.status_of(error)
    return _page(token=token)


@blueprint.post("/account/tokens/<int:token_id>/revoke")
def revoke_token(token_id: int) -> Response:
    """Make a token worthless."""
    with library().database.write() as db:
        accounts.revoke_token(db, account(), token_id=token_id)
    flash(_("The token has been revoked."), "success")
    return back("account_page.show")


@blueprint.post("/language")
@public
def choose_language() -> Response:
    """Choose the language of the pages: for the account, or for this browser where nobody is signed in."""
    chosen = text("language")
    if chosen not in LANGUAGES:
        raise NotFound(_("the pages are not available in this language"), hint=", ".join(LANGUAGES.values()))
    me = sessions.signed_in()
    if me is None:
        session["language"] = chosen
    else:
        with library().database.write() as db:
            db.get_one(Account, me.id).language = chosen
    refresh()
    return redirect(own_path(request.referrer) or "/", code=303)


def _page(error: ExpMapError | None = None, *, token: str | None = None) -> str:
    with library().database.read() as db:
        tokens = accounts.tokens(db, account())
    minimum = settings().web.min_password
    return render_template("accounts/account.html", error=error, token=token, tokens=tokens, minimum=minimum)
