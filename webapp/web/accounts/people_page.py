"""The page where the owner of the library gives accounts to others."""

from __future__ import annotations

from apiflask import APIBlueprint
from flask import flash, render_template, url_for
from flask_babel import gettext as _
from werkzeug.wrappers import Response

from webapp.errors import ExpMapError, NotAllowed, NotFound
from webapp.store.accounts import accounts, sign_in
from webapp.store.schema import Account
from webapp.web import errors
from webapp.web.context import account, library, settings
from webapp.web.forms import back, text

# A plain blueprint with a `before_request` has APIFlask fail while it writes the OpenAPI document.
blueprint = APIBlueprint("people_page", __name__, url_prefix="/people", enable_openapi=False)


@blueprint.before_request
def only_owners() -> None:
    """Let in who owns the library."""
    if not account().is_owner:
        raise NotAllowed(_("this is for the owner of the library"))


@blueprint.get("")
def show() -> str:
    """List all accounts."""
    return _page()


@blueprint.post("")
def add() -> str | tuple[str, int]:
    """Make an account, and a link to sign in to it."""
    try:
        with library().database.write() as db:
            person = accounts.create(db, text("name"))
            token = sign_in.new_link(db, person, hours=settings().web.link_hours)
    except ExpMapError as error:
        return _page(error=error), errors.status_of(error)
    return _page(person=person, token=token)


@blueprint.post("/<int:account_id>/link")
def new_link(account_id: int) -> str:
    """Make another link: for a person who cannot sign in any more."""
    with library().database.write() as db:
        person = _person(db.get(Account, account_id))
        token = sign_in.new_link(db, person, hours=settings().web.link_hours)
    return _page(person=person, token=token)


@blueprint.post("/<int:account_id>/remove")
def remove(account_id: int) -> Response | tuple[str, int]:
    """Delete an account; its maps stay."""
    try:
        with library().database.write() as db:
            accounts.remove(db, _person(db.get(Account, account_id)))
    except ExpMapError as error:
        return _page(error=error), errors.status_of(error)
    flash(_("The account has been removed; its maps are still here."), "success")
    return back("people_page.show")


def _person(found: Account | None) -> Account:
    if found is None:
        raise NotFound(_("there is no such account"), hint=_("reload the page"))
    return found


def _page(
    *, error: ExpMapError | None = None, person: Account | None = None, token: str | None = None
) -> str:
    with library().database.read() as db:
        people = accounts.listed(db)
    address = url_for("sign_in.link", token=token, _external=True) if token else None
    hours = settings().web.link_hours
    return render_template(
        "accounts/people.html", error=error, people=people, person=person, address=address, hours=hours
    )
