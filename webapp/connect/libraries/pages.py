"""The page on which an account connects photo libraries, and links their albums with maps."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from typing import NamedTuple

from flask import Blueprint, flash, render_template
from flask_babel import gettext as _
from flask_babel import lazy_gettext
from werkzeug.wrappers import Response

from webapp.connect.libraries import records
from webapp.connect.libraries.protocol import Album, LibraryClient
from webapp.errors import ExpMapError, InputError, NotFound
from webapp.settings import LibrarySettings
from webapp.store.maps import maps
from webapp.web import errors
from webapp.web.concurrency import ConcurrencyLimit
from webapp.web.context import account, library, settings
from webapp.web.pages import back, page, text
from webapp.web.state import AccountPage, Parts

pages = Blueprint("library_pages", __name__)

_limit = ConcurrencyLimit("photo libraries", share=0.25)
pages.record(_limit.set_up)

_PATIENCE_S = 5.0
"""Timeout of a photo library, and longest pause that it may ask for, within a request."""

_LIMIT_S = 20.0
"""Total time of asking it within a request; the last try may take a few seconds more."""

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
    kind, address, key = text("kind"), text("address"), text("key")
    try:
        albums = _ask(
            lambda asked, check: records.open_client(kind, address, key=key, settings=asked, check=check)
        )
        with library().database.write() as session:
            added = records.connect(
                session, account(), kind=kind, address=address, key=key, inner=library().inner
            )
    except ExpMapError as error:
        return _page(error), errors.status_of(error)
    flash(_("The photo library is connected."), "success")
    return _page(choice=_Choice(added.id, albums))


@pages.post("/account/libraries/<id:id>/albums")
def choose(id: int) -> Shown:
    """Show the albums of a photo library."""
    try:
        return _page(choice=_Choice(id, _albums(id)))
    except ExpMapError as error:
        return _page(error), errors.status_of(error)


@pages.post("/account/libraries/<id:id>/link")
def link(id: int) -> Shown:
    """Link an album with a map."""
    try:
        album = next((one for one in _albums(id) if one.id == text("album")), None)
        if album is None:
            raise NotFound("album not found", hint="choose it again")
        with library().database.write() as session:
            record = maps.find(session, text("map"), account=account(), role="editor")
            there = records.find(session, account().id, id=id)
            every_h, back_too = _number("every_h"), bool(text("writes_back"))
            records.link(session, there, record=record, album=album, every_h=every_h, writes_back=back_too)
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


def _albums(id: int) -> list[Album]:
    with library().database.read() as session:
        there = records.find(session, account().id, id=id)
    inner = library().inner
    return _ask(lambda asked, check: records.client_of(there, inner, settings=asked, check=check))


def _ask(make: Callable[[LibrarySettings, Callable[[], None]], LibraryClient]) -> list[Album]:
    """List the albums of a photo library within the time of a request."""
    until = time.monotonic() + _LIMIT_S

    def check() -> None:
        if time.monotonic() > until:
            raise InputError("the photo library takes too long to answer", hint="try again later")

    given = settings().libraries
    asked = replace(
        given,
        timeout_s=min(given.timeout_s, _PATIENCE_S),
        patience_s=min(given.patience_s, _PATIENCE_S),
    )
    with _limit.slot(), _closing(make(asked, check)) as client:
        return client.albums()


@contextmanager
def _closing(client: LibraryClient) -> Iterator[LibraryClient]:
    try:
        yield client
    finally:
        client.http.close()


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
    blueprints=(pages,),
    public_lists={},
    path_parameters={},
    operations={},
    account_pages=(
        AccountPage(
            "library_pages.show",
            lazy_gettext("Photo libraries"),
            lazy_gettext("Albums of Immich and PhotoPrism on maps, and positions back into them."),
        ),
    ),
)
