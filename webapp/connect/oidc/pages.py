"""Signing in and out at the provider, and the page of identities and groups."""

from __future__ import annotations

import hmac
import logging
import secrets
import time
from typing import Any, cast

from flask import (
    Blueprint,
    after_this_request,
    current_app,
    flash,
    redirect,
    render_template,
    request,
    url_for,
)
from flask.blueprints import BlueprintSetupState
from flask_babel import gettext as _
from flask_babel import lazy_gettext
from itsdangerous import BadSignature, URLSafeSerializer
from sqlalchemy import select
from sqlalchemy.orm import Session
from werkzeug.wrappers import Response

from webapp.connect.oidc import signing_in
from webapp.connect.oidc.provider import Attempt, Provider, check_settings, is_set_up, shown_name
from webapp.errors import ExpMapError, NotAllowed, NotSignedIn, UsageError
from webapp.store.accounts import accounts, identities
from webapp.store.schema import Account, MapRecord
from webapp.web import errors
from webapp.web.accounts import sessions
from webapp.web.accounts.pages import leading_to, refused, without_cache
from webapp.web.context import account, library, public, settings
from webapp.web.pages import back, own_path, page, site, text
from webapp.web.state import KEY, AccountPage, Parts, SignInWay

pages = Blueprint("oidc", __name__)

_PROVIDER = "expmap_oidc"
_COOKIE, _PATH = "expmap-oidc", "/oidc"
"""Not the session: the answer to another request of the same browser could put an older one back."""

_PATIENCE_S = 900
"""How long somebody may take at the provider."""

_ROLES = {
    "sign-in": lazy_gettext("may sign in"),
    "viewer": lazy_gettext("viewer"),
    "editor": lazy_gettext("editor"),
    "owner": lazy_gettext("owner"),
}

_log = logging.getLogger(__name__)


@pages.record_once
def _set_up(state: BlueprintSetupState) -> None:
    """Keep what all requests share. Wrong settings are no reason not to serve others: robots, visitors."""
    own = state.app.extensions[KEY].settings.oidc
    try:
        check_settings(own)
    except UsageError as error:
        _log.error("nobody can sign in at the provider: %s", error)
    state.app.extensions[_PROVIDER] = Provider(own)


@pages.get("/oidc/start")
@public
def start() -> Response | tuple[str, int]:
    """Go to the provider to sign in."""
    try:
        return redirect(_begin(then=own_path(request.args.get("next")), link=None), code=303)
    except ExpMapError as error:
        return refused(error)


@pages.post("/oidc/link")
def link_own() -> Response | tuple[str, int]:
    """Go to the provider to link an identity with the caller's account."""
    try:
        address = _begin(then=url_for("oidc.show"), link=account().id)
    except ExpMapError as error:
        return _page(error), errors.status_of(error)
    return leading_to(address, _("Going on to the provider."))


@pages.get("/oidc/callback")
@public
def callback() -> Response | tuple[str, int]:
    """Come back from the provider."""
    kept = _kept_attempt()
    try:
        code, attempt = _code(kept)
        assert kept is not None  # `_code` refuses that
        person, id_token = _provider().person(code, attempt, redirect=_redirect())
        if kept["link"] is not None:
            return _linked(person, whose=kept["link"])
        return _signed_in(person, id_token, then=kept["next"])
    except ExpMapError as error:
        _log.info("a sign-in at the provider failed: %s", error)
        if kept is not None and kept["link"] is not None and sessions.signed_in() is not None:
            return _page(error), errors.status_of(error)
        return refused(error)


@pages.get("/account/oidc")
@page(chapter="sign-in#openid-connect")
def show() -> str:
    """Show the caller's identities, and to owners the table of groups and everybody's identities."""
    return _page()


@pages.post("/account/oidc/<id:id>/unlink")
def unlink(id: int) -> Response | tuple[str, int]:
    """Unlink an identity: of the caller, or for owners of anybody."""
    try:
        with library().database.write() as db:
            me, identity = account(), identities.find(db, id)
            if identity.account_id != me.id:
                _check_owner()
            elif settings().oidc.required == "yes" or me.password_hash is None:
                raise UsageError("you could no longer sign in", hint="set a password first")
            identities.unlink(db, identity)
    except ExpMapError as error:
        return _page(error), errors.status_of(error)
    flash(_("Unlinked."), "success")
    return back("oidc.show")


@pages.post("/account/oidc/<id:id>/link")
def link(id: int) -> Response | tuple[str, int]:
    """Link an identity that waits with an account, or with a new one."""
    try:
        _check_owner()
        with library().database.write() as db:
            identity = identities.find(db, id)
            if text("account"):
                identities.link(db, identity, account=accounts.named(db, text("account")))
            else:
                identities.new_account(db, identity)
    except ExpMapError as error:
        return _page(error), errors.status_of(error)
    flash(_("Linked."), "success")
    return back("oidc.show")


@pages.post("/account/oidc/groups")
def add_group() -> Response | tuple[str, int]:
    """Add a line to the table of groups; the form sends `ROLE` or `ROLE MAP` as the role."""
    try:
        _check_owner()
        role, _space, map_id = text("role").partition(" ")
        if map_id and not map_id.isdecimal():
            raise UsageError("this is not a map", hint="reload the page")
        with library().database.write() as db:
            identities.add_rule(db, text("group"), role=role, map_id=int(map_id) if map_id else None)
    except ExpMapError as error:
        return _page(error), errors.status_of(error)
    flash(_("Saved."), "success")
    return back("oidc.show")


@pages.post("/account/oidc/groups/<id:id>/remove")
def remove_group(id: int) -> Response | tuple[str, int]:
    """Remove a line from the table of groups."""
    try:
        _check_owner()
        with library().database.write() as db:
            identities.remove_rule(db, id)
    except ExpMapError as error:
        return _page(error), errors.status_of(error)
    flash(_("Removed."), "success")
    return back("oidc.show")


def _provider() -> Provider:
    return cast(Provider, current_app.extensions[_PROVIDER])


def _redirect() -> str:
    return site() + url_for("oidc.callback")


def _begin(*, then: str | None, link: int | None) -> str:
    """Begin a sign-in; returns the address of the provider where it goes on."""
    if not is_set_up(settings().oidc):
        raise NotAllowed("this server has no OpenID Connect provider", hint="sign in by name and password")
    check_settings(settings().oidc)
    attempt = Attempt(*(secrets.token_urlsafe(32) for _part in Attempt.__slots__))
    address = _provider().authorization(attempt, redirect=_redirect())
    kept = {
        "attempt": [attempt.state, attempt.nonce, attempt.verifier],
        "next": then,
        "link": link,
        "at": int(time.time()),
    }
    value = _signer().dumps(kept)

    @after_this_request
    def keep(response: Response) -> Response:
        response.set_cookie(
            _COOKIE,
            value,
            max_age=_PATIENCE_S,
            path=_PATH,
            secure=request.is_secure,
            httponly=True,
            samesite="Lax",
        )
        return response

    return address


def _signer() -> URLSafeSerializer:
    return URLSafeSerializer(current_app.secret_key or "", salt="oidc attempt")


def _kept_attempt() -> dict[str, Any] | None:
    """Return what `_begin` has kept in the browser, and have it forgotten; None if there is nothing."""

    @after_this_request
    def forget(response: Response) -> Response:
        response.delete_cookie(_COOKIE, path=_PATH)
        return response

    try:
        found: dict[str, Any] = _signer().loads(request.cookies.get(_COOKIE, ""))
    except BadSignature:
        return None
    return found


def _code(kept: dict[str, Any] | None) -> tuple[str, Attempt]:
    """Check what the provider sends back with the browser; returns the code. Raises NotSignedIn."""
    if kept is None or abs(time.time() - kept["at"]) > _PATIENCE_S:
        raise NotSignedIn(
            "this sign-in was not begun in this browser, or has taken too long", hint="sign in again"
        )
    attempt = Attempt(*kept["attempt"])
    if not hmac.compare_digest(request.args.get("state", "").encode(), attempt.state.encode()):
        raise NotSignedIn("this answer belongs to another sign-in", hint="sign in again")
    if request.args.get("iss", _provider().issuer) != _provider().issuer:
        raise NotSignedIn("this answer is of another provider", hint="sign in again")
    if "error" in request.args:
        raise _refusal(request.args["error"])
    code = request.args.get("code")
    if not code:
        raise NotSignedIn("the provider sends no code", hint="sign in again")
    return code, attempt


def _refusal(code: str) -> ExpMapError:
    if code == "access_denied":
        return NotAllowed("the provider has not let you in", hint="sign in again, or ask its operator")
    shown = code[:60] if code.isascii() and code.isprintable() else "?"
    return NotSignedIn(f"the provider refuses: {shown}", hint="sign in again")


def _signed_in(person: identities.Person, id_token: str, *, then: str | None) -> Response:
    hidden = signing_in.encrypted(library().inner, id_token)
    with library().database.write() as db:
        found, identity = signing_in.admit(db, person, settings=settings().oidc)
    if found is None:
        raise signing_in.not_admitted(settings().oidc, identity)
    sessions.sign_in(found)
    with library().database.write() as db:
        identities.begin_session(
            db,
            identity,
            id_hash=sessions.session_hash() or "",
            id_token=hidden,
            days=settings().web.session_days,
        )
    return without_cache(redirect(then, code=303) if then else back("map_pages.index"))


def _linked(person: identities.Person, *, whose: int) -> Response:
    me = account()
    if me.id != whose:
        raise NotSignedIn("another account is signed in by now", hint="link it again")
    with library().database.write() as db:
        identity = identities.note(db, person)
        identities.link(db, identity, account=db.get_one(Account, me.id))
        identities.apply_groups(db, identity, groups=person.groups)
    flash(_("Linked."), "success")
    return back("oidc.show")


def _leave() -> str | None:
    """Return where the session ends at the provider; the own one ends, whatever the provider does."""
    id_hash = sessions.session_hash()
    if not is_set_up(settings().oidc) or id_hash is None:
        return None
    with library().database.write() as db:
        hidden = identities.end_session(db, id_hash)
    try:
        id_token = signing_in.decrypted(library().inner, hidden) if hidden else None
        return _provider().end_session(id_token, back=site() + url_for("sign_in.form")) if id_token else None
    except ExpMapError as error:
        _log.warning("nobody could be signed out at the provider: %s", error)
        return None


def _check_owner() -> None:
    if not account().is_owner:
        raise NotAllowed(_("only the owner of the library may do this"))


def _page(error: ExpMapError | None = None) -> str:
    me = account()
    with library().database.read() as db:
        mine = identities.identities_of(db, me)
        for_owners = _of_everybody(db) if me.is_owner else {}
    return render_template(
        "accounts/oidc.html",
        error=error,
        mine=mine,
        provider=shown_name(settings().oidc),
        policy=settings().oidc,
        roles=_ROLES,
        redirect_address=_redirect(),
        out_address=site() + url_for("sign_in.form"),
        **for_owners,
    )


def _of_everybody(db: Session) -> dict[str, Any]:
    found = identities.everybody(db)
    maps = select(MapRecord).where(MapRecord.binned_at.is_(None)).order_by(MapRecord.name, MapRecord.id)
    return {
        "waiting": [one for one, whose in found if whose is None],
        "linked": [(one, whose) for one, whose in found if whose is not None and whose.id != account().id],
        "rules": identities.rules(db),
        "maps": list(db.scalars(maps)),
        "people": accounts.list_accounts(db),
    }


def _label() -> str:
    return str(_("Sign in with %(name)s", name=shown_name(settings().oidc)))


PARTS = Parts(
    blueprints=(pages,),
    public_lists={},
    path_parameters={},
    operations={},
    account_pages=(
        AccountPage(
            "oidc.show",
            lazy_gettext("Sign-in by a provider"),
            lazy_gettext("Who you are at the OpenID Connect provider, and what its groups may do here."),
            lambda: is_set_up(settings().oidc),
        ),
    ),
    sign_in_ways=(
        SignInWay(
            "oidc.start",
            "people",
            label=_label,
            is_first=True,
            is_offered=lambda: is_set_up(settings().oidc),
            is_required=lambda: settings().oidc.required != "no",
            leave=_leave,
        ),
    ),
)
