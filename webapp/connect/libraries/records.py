"""The photo libraries of an account, and the albums of them that are linked with maps."""

from __future__ import annotations

import base64
from collections.abc import Callable, Sequence
from datetime import timedelta
from pathlib import Path
from typing import Any, NamedTuple

from sqlalchemy import func, select
from sqlalchemy.orm import Session
from urllib3.util import parse_url

from webapp.connect.libraries.due import JOB
from webapp.connect.libraries.immich import Immich
from webapp.connect.libraries.photoprism import PhotoPrism
from webapp.connect.libraries.protocol import Album, LibraryClient
from webapp.errors import Conflict, InputError, NotFound, UsageError
from webapp.extras import extra
from webapp.settings import LibrarySettings
from webapp.store.accounts.secret_key import derived_secret
from webapp.store.database import moment
from webapp.store.operate import jobs
from webapp.store.photo_libraries import HERE, KEPT, LinkedAlbum, LinkedPhoto, PhotoLibrary
from webapp.store.schema import Account, Job, MapRecord

KINDS: dict[str, Callable[..., LibraryClient]] = {"immich": Immich, "photoprism": PhotoPrism}
"""The programs, by the name in the database."""

INTERVALS_H = (0, 1, 24, 168)
"""Hours between two updates of an album; 0: only on request."""

MOST = 20
"""Libraries of an account."""

_MAX_ADDRESS = 1000
_MAX_KEY = 500
_PURPOSE = "API keys of photo libraries"


def open_client(
    kind: str,
    address: str,
    *,
    key: str,
    settings: LibrarySettings,
    check: Callable[[], object] = lambda: None,
) -> LibraryClient:
    """Make the client of a photo library. Raises UsageError."""
    if kind not in KINDS:
        raise UsageError("unknown kind of photo library", hint=f"it is one of {', '.join(KINDS)}")
    return KINDS[kind](check_address(address), key=_checked_key(key), settings=settings, check=check)


def check_address(address: str) -> str:
    """Return the address of a photo library as it is stored. Raises UsageError."""
    given = address.strip().rstrip("/")
    plain = given.isascii() and given.isprintable() and not {" ", "\\", "?", "#"} & set(given)
    try:
        parts = parse_url(given) if plain and len(given) <= _MAX_ADDRESS else None
    except ValueError:
        parts = None
    if parts is None or parts.scheme not in ("http", "https") or not parts.host or parts.auth is not None:
        raise UsageError(
            "this is not the address of a photo library",
            hint="write it like https://photos.example.org, without user and password",
        )
    return given


def list_libraries(session: Session, account_id: int) -> list[PhotoLibrary]:
    """List the photo libraries of an account, the oldest first."""
    mine = select(PhotoLibrary).where(PhotoLibrary.account_id == account_id)
    return list(session.scalars(mine.order_by(PhotoLibrary.id)))


def find(session: Session, account_id: int, *, id: int) -> PhotoLibrary:
    """Find a photo library of an account. Raises NotFound."""
    library = session.get(PhotoLibrary, id)
    if library is None or library.account_id != account_id:
        raise NotFound("photo library not found", hint="reload the page")
    return library


def connect(
    session: Session, account: Account, *, kind: str, address: str, key: str, inner: Path
) -> PhotoLibrary:
    """Connect a photo library, or give one that is connected a new key.

    Args:
        inner: The folder with the key of this program's library.
    """
    given, sealed = check_address(address), seal(inner, _checked_key(key))
    there = list_libraries(session, account.id)
    known = next((one for one in there if (one.kind, one.address) == (kind, given)), None)
    if known is not None:
        known.sealed_key = sealed
        return known
    if len(there) >= MOST:
        raise UsageError(f"an account has at most {MOST} photo libraries", hint="remove one first")
    library = PhotoLibrary(account_id=account.id, kind=kind, address=given, sealed_key=sealed)
    session.add(library)
    session.flush()
    return library


def client_of(
    library: PhotoLibrary,
    inner: Path,
    *,
    settings: LibrarySettings,
    check: Callable[[], object] = lambda: None,
) -> LibraryClient:
    """Make the client of a connected photo library."""
    key = unseal(inner, library.sealed_key)
    return open_client(library.kind, library.address, key=key, settings=settings, check=check)


def linked_albums(session: Session, account_id: int) -> list[tuple[LinkedAlbum, MapRecord]]:
    """List the linked albums of an account's photo libraries with their maps."""
    mine = (
        select(LinkedAlbum, MapRecord)
        .join(PhotoLibrary, PhotoLibrary.id == LinkedAlbum.library_id)
        .join(MapRecord, MapRecord.id == LinkedAlbum.map_id)
        .where(PhotoLibrary.account_id == account_id)
    )
    return [(album, record) for album, record in session.execute(mine.order_by(LinkedAlbum.id))]


def find_album(session: Session, account_id: int, *, id: int) -> LinkedAlbum:
    """Find a linked album of an account. Raises NotFound."""
    album = session.get(LinkedAlbum, id)
    if album is None:
        raise NotFound("album not found", hint="reload the page")
    find(session, account_id, id=album.library_id)
    return album


def link(
    session: Session,
    library: PhotoLibrary,
    *,
    record: MapRecord,
    album: Album,
    every_h: int,
    writes_back: bool,
) -> LinkedAlbum:
    """Link an album with a map, and queue its first update. Raises Conflict, UsageError."""
    if every_h not in INTERVALS_H:
        raise UsageError("unknown interval", hint="choose one of the list")
    same = select(LinkedAlbum).where(
        LinkedAlbum.library_id == library.id,
        LinkedAlbum.album == album.id,
        LinkedAlbum.map_id == record.id,
    )
    if session.scalars(same).first() is not None:
        raise Conflict("this album is on this map already", hint="update it")
    linked = LinkedAlbum(
        library_id=library.id,
        map_id=record.id,
        album=album.id,
        name=album.name,
        every_h=every_h,
        writes_back=writes_back,
        due_at=moment(session) + timedelta(hours=every_h) if every_h else None,
    )
    session.add(linked)
    session.flush()
    queue(session, linked, account_id=library.account_id)
    return linked


def change(session: Session, album: LinkedAlbum, *, every_h: int, writes_back: bool) -> None:
    """Change when an album is updated, and whether positions are written back. Raises UsageError."""
    if every_h not in INTERVALS_H:
        raise UsageError("unknown interval", hint="choose one of the list")
    if every_h != album.every_h:
        album.due_at = moment(session) + timedelta(hours=every_h) if every_h else None
    album.every_h, album.writes_back = every_h, writes_back


class AlbumCounts(NamedTuple):
    """How many photos of a linked album are on the map, and how many are not, and why."""

    here: int = 0
    kept: int = 0  # On the map, but no longer in the album
    unusable: int = 0


def counts(session: Session, albums: Sequence[LinkedAlbum]) -> dict[int, AlbumCounts]:
    """Count the photos of linked albums, by the albums' ids."""
    number = func.count()
    there = select(LinkedPhoto.album_id, LinkedPhoto.state, LinkedPhoto.problem.is_not(None), number)
    mine = there.where(LinkedPhoto.album_id.in_([album.id for album in albums]))
    found = {album.id: AlbumCounts() for album in albums}
    groups = mine.group_by(LinkedPhoto.album_id, LinkedPhoto.state, LinkedPhoto.problem.is_not(None))
    for id, state, is_bad, several in session.execute(groups):
        name = "unusable" if is_bad else {HERE: "here", KEPT: "kept"}.get(state)
        if name is not None:
            found[id] = found[id]._replace(**{name: getattr(found[id], name) + several})
    return found


def linked_photos(session: Session, album: LinkedAlbum) -> list[LinkedPhoto]:
    """List the photos of a linked album, by asset."""
    mine = select(LinkedPhoto).where(LinkedPhoto.album_id == album.id)
    return list(session.scalars(mine.order_by(LinkedPhoto.asset)))


def queue(session: Session, album: LinkedAlbum, *, account_id: int | None) -> Job:
    """Queue an update of an album."""
    return jobs.enqueue(
        session,
        JOB,
        map_id=album.map_id,
        account_id=account_id,
        arguments={"album": album.id},
        key=str(album.id),
    )


def _checked_key(key: str) -> str:
    given = key.strip()
    if not given or len(given) > _MAX_KEY or not given.isascii() or not given.isprintable() or " " in given:
        raise UsageError("this is not an API key", hint="copy it as the photo library shows it")
    return given


def seal(inner: Path, key: str) -> str:
    """Encrypt an API key, for the database.

    Args:
        inner: The library's folder with its key.
    """
    return str(_cipher(inner).encrypt(key.encode()).decode("ascii"))


def unseal(inner: Path, sealed: str) -> str:
    """Decrypt an API key. Raises InputError if the library's key is another one now."""
    cipher = _cipher(inner)
    with extra("connect"):
        from cryptography.fernet import InvalidToken
    try:
        return str(cipher.decrypt(sealed.encode("ascii")).decode())
    except InvalidToken as error:
        raise InputError(
            "the stored API key cannot be read: this server has another secret key now",
            hint="connect the photo library again",
        ) from error


def _cipher(inner: Path) -> Any:
    with extra("connect"):
        from cryptography.fernet import Fernet
    return Fernet(base64.urlsafe_b64encode(derived_secret(inner, _PURPOSE)))
