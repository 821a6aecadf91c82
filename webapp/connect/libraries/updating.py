"""Updates a linked album: photos come in, changes there are followed, positions set here are written back.

Each photo is committed by itself together with the record of its asset, so that a run that was killed goes on
without a second copy. What a person has set here is never changed.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass, field
from datetime import timedelta
from functools import partial
from typing import Any

from sqlalchemy import select
from sqlalchemy.orm import Session

from webapp.connect.libraries.following import REMARK, follow, is_same, needs_writing
from webapp.connect.libraries.protocol import Album, Asset, LibraryClient, list_assets
from webapp.connect.libraries.records import client_of
from webapp.errors import (
    Cancelled,
    ExpMapError,
    InputError,
    NotFound,
    PhotoError,
    StorageError,
    TooMany,
    UsageError,
)
from webapp.files.atomic import write_bytes
from webapp.files.part_file import discard, sha256_of
from webapp.jobs.context import Context
from webapp.store.clock import now
from webapp.store.database import moment
from webapp.store.maps import maps
from webapp.store.maps.changing import MapChange
from webapp.store.photo_libraries import HERE, LinkedAlbum, LinkedPhoto, PhotoLibrary
from webapp.store.schema import Account, MapRecord, Photo
from webapp.tasks.maps.add_photo import IncomingPhoto, StatedMetadata, add_photo

_FAILURES_IN_A_ROW = 3
_NAMED = 100
"""Failed photos that a result names."""


@dataclass(slots=True)
class Report:
    """What an update has done, in photos."""

    found: int = 0
    added: int = 0
    removed: int = 0
    moved: int = 0
    written: int = 0
    failed: list[dict[str, str]] = field(default_factory=list)

    def to_json(self) -> dict[str, Any]:
        return {
            "found": self.found,
            "added": self.added,
            "removed": self.removed,
            "moved": self.moved,
            "written": self.written,
            "failed": self.failed[:_NAMED],
        }


def update_album(context: Context) -> Mapping[str, Any]:
    """Update the album of the argument `album`, and note how that ended."""
    id = int(context.arguments["album"])
    try:
        report = _update(context, id)
    except (Cancelled, StorageError):
        raise  # the job is continued, or failed for a reason that has nothing to do with the album
    except ExpMapError as error:
        _note_end(context, id, error=error)
        raise
    _note_end(context, id, error=None)
    return report.to_json()


def _update(context: Context, id: int) -> Report:
    with context.library.database.read() as session:
        album, library = _find(session, id)
        _check_rights(session, library, map_id=album.map_id)
    client = client_of(
        library,
        context.library.inner,
        settings=context.settings.libraries,
        check=context.progress.check,
    )
    try:
        return _Update(context, album, client).run()
    finally:
        client.http.close()


def _find(session: Session, id: int) -> tuple[LinkedAlbum, PhotoLibrary]:
    album = session.get(LinkedAlbum, id)
    if album is None:
        raise NotFound("the album is no longer linked with the map")
    return album, session.get_one(PhotoLibrary, album.library_id)


def _check_rights(session: Session, library: PhotoLibrary, *, map_id: int) -> None:
    """Check that the account may still edit the map. Raises UsageError."""
    account = session.get_one(Account, library.account_id)
    record = session.get(MapRecord, map_id)
    if record is None or maps.role_of(session, record, account=account) not in ("editor", "owner"):
        raise UsageError(
            "whoever has connected the photo library may no longer edit this map",
            hint="have an owner of the map share it again",
        )


def _note_end(context: Context, id: int, *, error: ExpMapError | None) -> None:
    with context.write() as session:
        album = session.get(LinkedAlbum, id)
        if album is None:
            return
        pause = timedelta(hours=album.every_h)
        if isinstance(error, TooMany):
            pause = max(pause, timedelta(seconds=min(error.wait_s, 86_400)))
        album.due_at = moment(session) + pause if album.every_h else None
        if error is None:
            album.updated_at, album.error = now(), None
        else:
            album.error = error.message if error.hint is None else f"{error.message} ({error.hint})"


class _Update:
    """One update of one album."""

    def __init__(self, context: Context, album: LinkedAlbum, client: LibraryClient) -> None:
        self._context, self._album, self._client = context, album, client
        self._report = Report()

    def run(self) -> Report:
        progress = self._context.progress
        progress.note("listing photos")
        assets = self._list()
        self._report.found = len(assets)
        self._follow(assets)
        with self._context.library.database.read() as session:
            known = self._rows(session)
        new = [asset for asset in assets.values() if _is_new(asset, known.get(asset.id))]
        progress.size(len(new))
        progress.note(self._client.http.name)
        self._add_all(new)
        if self._album.writes_back:
            self._write_back(assets)
        return self._report

    def _list(self) -> dict[str, Asset]:
        """List the photos; an answer that cannot be right is refused, as photos would be removed."""
        album = next((one for one in self._client.albums() if one.id == self._album.album), None)
        if album is None:
            raise InputError(
                f"{self._client.http.name} no longer shows this album to the API key",
                hint="share the album with the account of the key, or unlink it",
            )
        self._rename(album)
        assets = list_assets(self._client, album, most=self._context.settings.libraries.max_photos)
        if album.items and not assets:
            with self._context.library.database.read() as session:
                if self._rows(session):
                    raise self._client.http.error("lists no photos, although the album is not empty")
        return assets

    def _rename(self, album: Album) -> None:
        if album.name != self._album.name:
            with self._context.write() as session:
                session.get_one(LinkedAlbum, self._album.id).name = album.name

    def _rows(self, session: Session) -> dict[str, LinkedPhoto]:
        mine = select(LinkedPhoto).where(LinkedPhoto.album_id == self._album.id)
        return {row.asset: row for row in session.scalars(mine)}

    def _follow(self, assets: Mapping[str, Asset]) -> None:
        """Take over removals, returns and moves in one step."""
        with self._context.changing(self._album.map_id) as change:
            followed = follow(
                change, self._rows(change.session), assets=assets, account_id=self._context.account_id
            )
        self._report.removed, self._report.moved = followed.removed, followed.moved

    def _add_all(self, assets: Sequence[Asset]) -> None:
        in_a_row = 0
        for asset in assets:
            self._context.progress.check()
            try:
                self._add(asset)
                in_a_row = 0
            except PhotoError as error:
                self._refuse(asset, error)
                in_a_row = 0
            except InputError as error:
                in_a_row += 1
                if in_a_row == _FAILURES_IN_A_ROW:
                    raise
                self._report.failed.append({"name": asset.name, "reason": error.message})
            self._context.progress.advance()

    def _add(self, asset: Asset) -> None:
        """Fetch a preview and add it in the same transaction as the record of its asset."""
        file = self._context.library.uploads / f"album-{self._album.id}-{asset.id}.part"
        most = int(self._context.settings.photo.max_mb * 1e6)
        write_bytes(file, self._client.preview(asset, most_bytes=most))
        stated = StatedMetadata(
            True,
            asset.position,
            taken_at=asset.taken_at,
            camera=asset.camera,
            remarks=(REMARK, self._client.page(asset.id)),
        )
        try:
            added = add_photo(
                self._context.library,
                self._album.map_id,
                photo=IncomingPhoto(file, asset.name, stated=stated),
                settings=self._context.settings,
                changing=partial(self._changing, asset, sha256_of(file)),
            )
        finally:
            discard(file)
        self._report.added += not added.duplicate

    @contextmanager
    def _changing(self, asset: Asset, sha256: str, map_id: int) -> Iterator[MapChange]:
        with self._context.changing(map_id) as change:
            yield change
            same = select(Photo.id).where(Photo.map_id == map_id, Photo.sha256 == sha256)
            self._record(change.session, asset, photo_id=change.session.scalars(same).one())

    def _refuse(self, asset: Asset, error: PhotoError) -> None:
        """Note that a file cannot be used, so that it is not fetched again unless it changes."""
        with self._context.write() as session:
            self._record(session, asset, photo_id=None, problem=error.message)
        self._report.failed.append({"name": asset.name, "reason": error.message})

    def _record(
        self, session: Session, asset: Asset, *, photo_id: int | None, problem: str | None = None
    ) -> None:
        row = session.get(LinkedPhoto, (self._album.id, asset.id))
        if row is None:
            row = LinkedPhoto(album_id=self._album.id, asset=asset.id)
            session.add(row)
        row.checksum, row.photo_id, row.problem = asset.checksum, photo_id, problem
        row.state, row.written = HERE, False
        row.lat, row.lon = asset.position or (None, None)

    def _write_back(self, assets: Mapping[str, Asset]) -> None:
        """Write positions that people have set here, where the photo has none there but ours."""
        with self._context.library.database.read() as session:
            record = session.get_one(MapRecord, self._album.map_id)
            wanted = needs_writing(session, record, rows=self._rows(session), assets=assets)
        self._context.progress.size(len(wanted))
        for id, position in wanted.items():
            self._context.progress.check()
            there = assets[id].position
            if there is None or not is_same(there, position):
                # first what is about to be written: otherwise, if the run is killed in between, the next one
                # would take the position for one that somebody has set there
                self._note(id, sent_lat=position.lat, sent_lon=position.lon)
                self._client.set_position(id, position)
                self._report.written += 1
            arrived = {"lat": position.lat, "lon": position.lon, "written": True}
            self._note(id, **arrived, sent_lat=None, sent_lon=None)
            self._context.progress.advance()

    def _note(self, asset: str, **fields: Any) -> None:
        with self._context.write() as session:
            row = session.get(LinkedPhoto, (self._album.id, asset))
            if row is not None:
                for name, value in fields.items():
                    setattr(row, name, value)


def _is_new(asset: Asset, row: LinkedPhoto | None) -> bool:
    return row is None or row.checksum != asset.checksum
