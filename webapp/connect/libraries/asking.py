"""What a request about photo libraries does, for page and API: it asks them, within the time of a request."""

from __future__ import annotations

import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace

from webapp.connect.libraries import records
from webapp.connect.libraries.protocol import Album, LibraryClient
from webapp.errors import InputError, NotFound
from webapp.settings import LibrarySettings
from webapp.store.maps import maps
from webapp.store.photo_libraries import LinkedAlbum, PhotoLibrary
from webapp.web.concurrency import ConcurrencyLimit
from webapp.web.context import account, library, settings

limit = ConcurrencyLimit("photo libraries", share=0.25)
"""Of requests that wait for photo libraries."""

_PATIENCE_S = 5.0
"""Timeout of a photo library, and longest pause that it may ask for, within a request."""

_LIMIT_S = 20.0
"""Total time of asking it within a request; the last try may take a few seconds more."""


def connect(kind: str, address: str, *, key: str) -> tuple[PhotoLibrary, list[Album]]:
    """Connect a photo library of the caller if it accepts the key; return its albums, too."""
    albums = _ask(
        lambda asked, check: records.open_client(kind, address, key=key, settings=asked, check=check)
    )
    with library().database.write() as session:
        added = records.connect(
            session, account(), kind=kind, address=address, key=key, inner=library().inner
        )
    return added, albums


def list_albums(id: int) -> list[Album]:
    """List the albums of a photo library of the caller. Raises NotFound."""
    with library().database.read() as session:
        there = records.find(session, account().id, id=id)
    inner = library().inner
    return _ask(lambda asked, check: records.client_of(there, inner, settings=asked, check=check))


def link(id: int, album_id: str, *, slug: str, every_h: int, writes_back: bool) -> LinkedAlbum:
    """Link an album with a map that the caller may edit. Raises NotFound, NotAllowed, Conflict."""
    album = next((one for one in list_albums(id) if one.id == album_id), None)
    if album is None:
        raise NotFound("album not found", where="album", hint="choose it again")
    with library().database.write() as session:
        record = maps.find(session, slug, account=account(), role="editor")
        there = records.find(session, account().id, id=id)
        return records.link(
            session, there, record=record, album=album, every_h=every_h, writes_back=writes_back
        )


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
    with limit.slot(), _closing(make(asked, check)) as client:
        return client.albums()


@contextmanager
def _closing(client: LibraryClient) -> Iterator[LibraryClient]:
    try:
        yield client
    finally:
        client.http.close()
