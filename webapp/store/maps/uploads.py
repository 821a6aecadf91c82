"""Records of uploads in progress; the bytes received are in the uploads folder."""

from __future__ import annotations

import secrets
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime

from sqlalchemy import func, select
from sqlalchemy.orm import Session

from webapp.errors import NotFound
from webapp.store.maps import maps
from webapp.store.schema import MapRecord, Upload


@dataclass(frozen=True, slots=True)
class Announced:
    """A file that its sender is going to upload."""

    name: str  # The sender's
    size_bytes: int  # Of the whole file
    fingerprint: str  # Identifies the file for its sender: made of name, size and time of the file
    beside: Sequence[Mapping[str, str]] = ()  # Files beside the photo: `name` and `content`, as text


def begin_upload(session: Session, record: MapRecord, *, account_id: int, file: Announced) -> Upload:
    """Begin an upload, or return the one that the account has begun with the same fingerprint.

    The photo's id is reserved now, so that photos are numbered in the order in which their uploads began.
    """
    same = select(Upload).where(
        Upload.map_id == record.id, Upload.account_id == account_id, Upload.fingerprint == file.fingerprint
    )
    there = session.scalars(same).first()
    if there is not None and there.size_bytes == file.size_bytes:
        there.beside = [dict(one) for one in file.beside] or None
        return there
    if there is not None:
        session.delete(there)
        session.flush()
    upload = Upload(
        id=secrets.token_hex(16),
        map_id=record.id,
        account_id=account_id,
        fingerprint=file.fingerprint,
        name=file.name,
        size_bytes=file.size_bytes,
        beside=[dict(one) for one in file.beside] or None,
        photo_id=maps.reserve_id(record),
    )
    session.add(upload)
    session.flush()
    return upload


def find_upload(session: Session, id: str, *, map_id: int, account_id: int) -> Upload:
    """Find an upload of an account. Raises NotFound."""
    upload = session.get(Upload, id)
    if upload is None or (upload.map_id, upload.account_id) != (map_id, account_id):
        raise NotFound("upload not found: it is finished or was cancelled", hint="start it again")
    return upload


def finish_upload(session: Session, id: str) -> None:
    """Delete the record of an upload that is complete, refused or abandoned; no error if it is gone."""
    upload = session.get(Upload, id)
    if upload is not None:
        session.delete(upload)


def count_open_uploads(session: Session, *, account_id: int) -> int:
    return session.scalar(select(func.count()).where(Upload.account_id == account_id)) or 0


def uploads_begun_before(session: Session, moment: datetime) -> list[Upload]:
    return list(session.scalars(select(Upload).where(Upload.created_at < moment)))


def upload_ids(session: Session) -> set[str]:
    return set(session.scalars(select(Upload.id)))
