"""The page on which an export of a field form is added to a map."""

from __future__ import annotations

from flask import Blueprint, render_template
from flask_babel import lazy_gettext

from webapp.connect.forms.api import blueprint
from webapp.store.maps import maps
from webapp.web.context import account, library
from webapp.web.pages import page
from webapp.web.state import AccountPage, Parts

pages = Blueprint("form_pages", __name__)


@pages.get("/account/forms")
@page(chapter="field-forms")
def show() -> str:
    """Show the form for an export."""
    with library().database.read() as session:
        return render_template("accounts/forms.html", maps=maps.list_editable(session, account()))


PARTS = Parts(
    blueprints=(blueprint, pages),
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
