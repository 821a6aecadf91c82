"""The page on which an account connects photo libraries, and links their albums with maps."""

from __future__ import annotations

from typing import NamedTuple

from flask import Blueprint, flash, render_template
from flask_babel import gettext as _
from flask_babel import lazy_gettext
from werkzeug.wrappers import Response

from webapp.connect.libraries import asking, records
from webapp.connect.libraries.api import blueprint
from webapp.connect.libraries.protocol import Album
from webapp.errors import ExpMapError
from webapp.store.maps import maps
from webapp.web import errors
from webapp.web.context import account, library
from webapp.web.pages import back, page, text
from webapp.web.state import AccountPage, Parts

pages = Blueprint("library_pages", __name__)

pages.record(asking.limit.set_up)

_NAMES = {"immich": "Immich", "photoprism": "PhotoPrism"}
_INTERVALS = {
    0: lazy_gettext("only on request"),
    1: lazy_gettext("every hour"),
    24: lazy_gettext("every day"),
    168: lazy_gettext("every week"),
}

Shown = Response | str | tuple[str, int]


class _Choice(NamedTuple):
    """Albums of a photo library, to choose one."""

    library: int
    albums: list[Album]


@pages.get("/account/libraries")
@page(chapter="photo-libraries")
def show() -> str:
    """Show the photo libraries of the account, and the albums that maps have of them."""
    return _page()


@pages.post("/account/libraries")
def connect() -> Shown:
    """Connect a photo library if the address and the key are right; show its albums."""
    try:
        added, albums = asking.connect(text("kind"), text("address"), key=text("key"))
    except ExpMapError as error:
        return _page(error), errors.status_of(error)
    flash(_("The photo library is connected."), "success")
    return _page(choice=_Choice(added.id, albums))


@pages.post("/account/libraries/<id:id>/albums")
def choose(id: int) -> Shown:
    """Show the albums of a photo library."""
    try:
        return _page(choice=_Choice(id, asking.list_albums(id)))
    except ExpMapError as error:
        return _page(error), errors.status_of(error)


@pages.post("/account/libraries/<id:id>/link")
def link(id: int) -> Shown:
    """Link an album with a map."""
    try:
        every_h, back_too = _number("every_h"), bool(text("writes_back"))
        asking.link(id, text("album"), slug=text("map"), every_h=every_h, writes_back=back_too)
    except ExpMapError as error:
        return _page(error), errors.status_of(error)
    flash(_("The photos are being fetched; the menu of jobs shows how far it is."), "success")
    return back("library_pages.show")


@pages.post("/account/libraries/<id:id>/remove")
def remove(id: int) -> Response:
    """Remove a photo library; its photos stay on the maps."""
    with library().database.write() as session:
        session.delete(records.find(session, account().id, id=id))
    flash(_("Removed."), "success")
    return back("library_pages.show")


@pages.post("/account/libraries/albums/<id:id>/update")
def update(id: int) -> Response:
    """Queue an update of an album."""
    with library().database.write() as session:
        records.queue(session, records.find_album(session, account().id, id=id), account_id=account().id)
    flash(_("The album is being updated; the menu of jobs shows how far it is."), "success")
    return back("library_pages.show")


@pages.post("/account/libraries/albums/<id:id>/change")
def change(id: int) -> Shown:
    """Change when an album is updated, and whether positions are written back."""
    try:
        with library().database.write() as session:
            album = records.find_album(session, account().id, id=id)
            records.change(session, album, every_h=_number("every_h"), writes_back=bool(text("writes_back")))
    except ExpMapError as error:
        return _page(error), errors.status_of(error)
    flash(_("Saved."), "success")
    return back("library_pages.show")


@pages.post("/account/libraries/albums/<id:id>/unlink")
def unlink(id: int) -> Response:
    """Unlink an album; its photos stay on the map."""
    with library().database.write() as session:
        session.delete(records.find_album(session, account().id, id=id))
    flash(_("Removed."), "success")
    return back("library_pages.show")


def _number(name: str) -> int:
    given = text(name)
    return int(given) if given.isdecimal() and len(given) < 6 else -1


def _page(error: ExpMapError | None = None, *, choice: _Choice | None = None) -> str:
    with library().database.read() as session:
        libraries = records.list_libraries(session, account().id)
        linked = records.linked_albums(session, account().id)
        counts = records.counts(session, [album for album, _record in linked])
        own = maps.list_editable(session, account()) if choice else []
    return render_template(
        "accounts/libraries.html",
        error=error,
        libraries=libraries,
        linked=linked,
        counts=counts,
        choice=choice,
        maps=own,
        kinds=[kind for kind in _NAMES if kind in records.KINDS],
        names=_NAMES,
        intervals=_INTERVALS,
    )


PARTS = Parts(
    blueprints=(blueprint, pages),
    public_lists={},
    path_parameters={},
    operations={"api_photo_libraries.list_albums": {"statuses": [400, 422]}},
    account_pages=(
        AccountPage(
            "library_pages.show",
            lazy_gettext("Photo libraries"),
            lazy_gettext("Albums of Immich and PhotoPrism on maps, and positions back into them."),
        ),
    ),
)
