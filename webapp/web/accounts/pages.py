"""Pages of accounts: the user's own, all accounts for the owner of the library, signing in and out."""

from __future__ import annotations

from apiflask import APIBlueprint
from flask import Blueprint, flash, make_response, redirect, render_template, request, session, url_for
from flask_babel import gettext as _
from flask_babel import ngettext, refresh
from werkzeug.wrappers import Response

from webapp.errors import ExpMapError, NotAllowed, NotFound, NotSignedIn, TooMany
from webapp.store import sharing
from webapp.store.accounts import accounts, sign_in
from webapp.store.schema import Account
from webapp.web import errors
from webapp.web.accounts import codes, sessions, ways
from webapp.web.context import account, library, public, settings
from webapp.web.language import LANGUAGES
from webapp.web.pages import back, own_path, page, text
from webapp.web.state import parts

account_pages = Blueprint("account_pages", __name__)

# APIFlask cannot generate the OpenAPI document if a plain blueprint has a `before_request`.
people_pages = APIBlueprint("people_pages", __name__, url_prefix="/people", enable_openapi=False)

sign_in_pages = Blueprint("sign_in", __name__)


@account_pages.get("/account")
@page(chapter="operating#accounts")
def show() -> str:
    """Show name, password, sessions and tokens."""
    return _page()


@account_pages.post("/account/name")
def rename() -> Response | tuple[str, int]:
    """Change the account's name."""
    try:
        with library().database.write() as db:
            accounts.rename(db, db.get_one(Account, account().id), name=text("name"))
    except ExpMapError as error:
        return _page(error), errors.status_of(error)
    flash(_("Your name has been changed."), "success")
    return back("account_pages.show")


@account_pages.post("/account/password")
def set_password() -> Response | tuple[str, int]:
    """Set or change the password, and sign the account out everywhere else."""
    me = account()
    try:
        ways.check_passwords()
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
    return back("account_pages.show")


@account_pages.post("/account/end-sessions")
def end_sessions() -> Response:
    """Sign out everywhere else."""
    with library().database.write() as db:
        me = db.get_one(Account, account().id)
        accounts.end_sessions(me)
    sessions.sign_in(me)
    flash(_("You are signed out everywhere else."), "success")
    return back("account_pages.show")


@account_pages.post("/account/sessions/<id:signed_in_id>/end")
def end_session(signed_in_id: int) -> Response:
    """Sign one browser out."""
    with library().database.write() as db:
        sign_in.end_device(db, account(), id=signed_in_id)
    flash(_("That browser is signed out."), "success")
    return back("account_pages.show")


@account_pages.post("/account/tokens")
def new_token() -> str | tuple[str, int]:
    """Make a token; it is shown only in this response."""
    try:
        with library().database.write() as db:
            token = accounts.new_token(db, account(), name=text("name"))
    except ExpMapError as error:
        return _page(error), errors.status_of(error)
    return _page(token=token)


@account_pages.post("/account/tokens/<id:token_id>/revoke")
def revoke_token(token_id: int) -> Response:
    """Revoke a token."""
    with library().database.write() as db:
        accounts.revoke_token(db, account(), token_id=token_id)
    flash(_("The token has been revoked."), "success")
    return back("account_pages.show")


@account_pages.post("/language")
@public
def choose_language() -> Response:
    """Set the language of the pages: of the account, or of this browser if no user is signed in."""
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
        browsers = sign_in.signed_in_devices(db, account(), days=settings().web.session_days)
    return render_template(
        "accounts/account.html",
        error=error,
        token=token,
        tokens=tokens,
        browsers=[(row, sessions.is_this_browser(row)) for row in browsers],
        minimum=settings().web.min_password,
        more=[page for page in parts().account_pages if page.is_offered()],
    )


@people_pages.before_request
def only_owners() -> None:
    """Allow only owners of the library."""
    if not account().is_owner:
        raise NotAllowed(_("only the owner of the library may do this"))


@people_pages.get("")
@page(chapter="operating#accounts")
def show_people() -> str:
    """List all accounts."""
    return _people_page()


@people_pages.post("")
def add() -> str | tuple[str, int]:
    """Make an account, and a link to sign in to it."""
    try:
        ways.check_new_links()
        with library().database.write() as db:
            person = accounts.create(db, text("name"))
            token = sign_in.new_link(db, person, hours=settings().web.link_hours)
    except ExpMapError as error:
        return _people_page(error=error), errors.status_of(error)
    return _people_page(person=person, token=token)


@people_pages.post("/<id:account_id>/link")
def new_link(account_id: int) -> str:
    """Make another sign-in link, for a user who can no longer sign in."""
    ways.check_new_links()
    with library().database.write() as db:
        person = _person(db.get(Account, account_id))
        token = sign_in.new_link(db, person, hours=settings().web.link_hours)
    return _people_page(person=person, token=token)


@people_pages.post("/<id:account_id>/remove")
def remove(account_id: int) -> Response | tuple[str, int]:
    """Delete an account; its maps stay."""
    try:
        with library().database.write() as db:
            accounts.remove(db, _person(db.get(Account, account_id)))
    except ExpMapError as error:
        return _people_page(error=error), errors.status_of(error)
    flash(_("The account has been removed; its maps and links are still here."), "success")
    return back("people_pages.show_people")


@people_pages.post("/removed/revoke-shares")
def revoke_shares_of_removed() -> Response:
    """Revoke the links made by removed accounts."""
    with library().database.write() as db:
        count = sharing.revoke_of_removed_accounts(db)
    flash(ngettext("%(num)s link has been revoked.", "%(num)s links have been revoked.", count), "success")
    return back("people_pages.show_people")


def _person(found: Account | None) -> Account:
    if found is None:
        raise NotFound(_("account not found"), hint=_("reload the page"))
    return found


def _people_page(
    *, error: ExpMapError | None = None, person: Account | None = None, token: str | None = None
) -> str:
    with library().database.read() as db:
        people = accounts.list_accounts(db)
        abandoned = len(sharing.shares_of_removed_accounts(db))
    address = url_for("sign_in.link", token=token, _external=True) if token else None
    hours = settings().web.link_hours
    return render_template(
        "accounts/people.html",
        error=error,
        people=people,
        abandoned=abandoned,
        person=person,
        address=address,
        hours=hours,
    )


@sign_in_pages.get("/sign-in")
@public
def form() -> Response | str:
    """Show the form for name and password."""
    if sessions.signed_in() is not None:
        return back("map_pages.index")
    return render_template("accounts/sign_in.html", next=own_path(request.args.get("next")))


@sign_in_pages.post("/sign-in")
@public
def by_password() -> Response | tuple[str, int, dict[str, str]]:
    """Sign in by name and password."""
    there = own_path(text("next"))
    try:
        ways.check_passwords()
        account = sign_in.by_password(
            library().database,
            text("name"),
            password=text("password"),
            address=request.remote_addr or "unknown",
            limits=settings().web,
        )
    except (NotAllowed, NotSignedIn, TooMany) as error:
        page = render_template("accounts/sign_in.html", next=there, name=text("name"), error=error)
        return page, errors.status_of(error), errors.extra_headers(error)
    if (asked := codes.ask_for_code(account, then=there)) is not None:
        return asked
    sessions.sign_in(account)
    return without_cache(redirect(there, code=303) if there else back("map_pages.index"))


@sign_in_pages.get("/sign-in/<token>")
@public
def link(token: str) -> Response | tuple[str, int]:
    """Show which account a link signs in. GET does not redeem it, as chat programs preview links."""
    try:
        with library().database.read() as session:
            account = sign_in.link_account(session, token)
        ways.check_link(account)
    except (NotAllowed, NotSignedIn) as error:  # a used link is no error for a user who is signed in
        return refused(error) if sessions.signed_in() is None else back("map_pages.index")
    return render_template("accounts/sign_in_link.html", whose=account, token=token), 200


@sign_in_pages.post("/sign-in/<token>")
@public
def by_link(token: str) -> Response | tuple[str, int]:
    """Sign in by a one-time link."""
    try:
        with library().database.write() as session:
            account = sign_in.redeem_link(session, token)
            ways.check_link(account)
    except (NotAllowed, NotSignedIn) as error:
        return refused(error)
    sessions.sign_in(account)
    _suggest_a_password(account)
    return without_cache(back("map_pages.index"))


@sign_in_pages.post("/sign-out")
@public
def out() -> Response:
    """End the session of this browser, and that of the provider where it began."""
    elsewhere = ways.leave()
    sessions.sign_out()
    if elsewhere is not None:
        return without_cache(leading_to(elsewhere, _("You are signed out here.")))
    return without_cache(back("sign_in.form"))


def leading_to(address: str, message: str) -> Response:
    """Make a page that goes on to another site: a redirect would count as a form sent there."""
    return make_response(render_template("accounts/leading.html", address=address, message=message))


def without_cache(response: Response) -> Response:
    """Have the browser drop its cache: pictures stay for a year, and are not for the next account."""
    response.headers["Clear-Site-Data"] = '"cache"'
    return response


def refused(error: ExpMapError) -> tuple[str, int]:
    """Make the sign-in page with an error."""
    return render_template("accounts/sign_in.html", error=error), errors.status_of(error)


def _suggest_a_password(account: Account) -> None:
    if account.password_hash is None:
        flash(
            _("Welcome! The link works only once: set a password on the account page to sign in again."),
            "password",
        )
