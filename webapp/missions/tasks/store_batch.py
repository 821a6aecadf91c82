"""Stores a batch of records of a robot in a mission: atomically, and each record exactly once."""

from __future__ import annotations

import hashlib
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from datetime import timedelta
from typing import Any

from sqlalchemy.orm import Session

from webapp.errors import Conflict
from webapp.missions.core.trajectory.batch import parse
from webapp.missions.store import batches
from webapp.store.library import Library

_KEEP_KEYS = timedelta(days=30)

Also = Callable[[Session, int], None]
"""Called with the number of new records, in the transaction that stores them."""


@dataclass(frozen=True, slots=True)
class Numbered:
    """Sender of a batch, and the number of its first record."""

    sender: str  # Name of the client; no other client may use it in this mission
    first: int  # Counted from 0


def store_batch(
    library: Library, mission_id: int, *, records: Sequence[object], place: Numbered, also: Also | None = None
) -> dict[str, Any]:
    """Store records that their sender has numbered; when this returns, they are on the disk.

    Args:
        records: In the format of `batch.parse`; may be empty, to query the next number.

    Returns:
        `next`, `stored`, `already` and `revision`.

    Raises:
        InputError: A record is invalid; none was stored.
        OutOfOrder: Records before these are missing.
        NotFound: The mission was deleted in the meantime.
        StorageError, DiskFull: Writing failed.
    """
    batch = parse(records)
    # flush only once, at the end
    with library.database.write(locks_rows=True) as session, session.no_autoflush:
        mission = batches.locked(session, mission_id)
        first, count = place.first, len(records)
        already, next_seq = batches.advance(session, mission_id, place.sender, first=first, count=count)
        if already < count:
            batches.store(session, mission, parse(records[already:]) if already else batch)
            if also is not None:
                also(session, count - already)
        return {
            "next": next_seq,
            "stored": count - already,
            "already": already,
            "revision": mission.revision,
        }


def store_keyed_batch(
    library: Library,
    mission_id: int,
    *,
    records: Sequence[object],
    key: str,
    keep: timedelta = _KEEP_KEYS,
    also: Also | None = None,
) -> dict[str, Any]:
    """Store records with an idempotency key instead of numbers; when this returns, they are on the disk.

    Args:
        records: As for `store_batch`.
        key: Unique for each batch of the mission; a batch that is sent again is not stored again.
        keep: How long keys are remembered.

    Returns:
        As for `store_batch`; `next` is None.

    Raises:
        Conflict: The key was used for other records.
        InputError, NotFound, StorageError, DiskFull: As for `store_batch`.
    """
    batch, digest = parse(records), _digest(records)
    with library.database.write(locks_rows=True) as session:
        mission = batches.locked(session, mission_id)
        before = batches.answered(session, mission_id, key)
        if before is not None and before["digest"] != digest:
            raise Conflict(
                "this key was used for other records",
                where="Idempotency-Key",
                hint="use a new key for each batch",
            )
        if before is None and records:
            batches.store(session, mission, batch)
            if also is not None:
                also(session, len(records))
        answer = {"next": None, "stored": len(records), "already": 0, "revision": mission.revision}
        if before is None:
            batches.remember(session, mission_id, key, answer={**answer, "digest": digest}, keep=keep)
            return answer
        return {**answer, "stored": 0, "already": before["stored"], "revision": before["revision"]}


def _digest(records: Sequence[object]) -> str:
    return hashlib.sha256(json.dumps(records, sort_keys=True).encode()).hexdigest()
