"""Maps of the library, the roles of accounts on them, and their photos, also by day."""

from __future__ import annotations

import re
import secrets
import unicodedata
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass
from datetime import datetime
from itertools import count, groupby, islice
from typing import Any, Literal, NamedTuple

from sqlalchemy import ColumnElement, Select, func, select
from sqlalchemy.orm import Session
from sqlalchemy.orm.util import identity_key

from webapp.core import texts
from webapp.core.mapmodel.facts import DESCRIPTION
from webapp.errors import NotAllowed, NotFound, UsageError
from webapp.store.clock import now
from webapp.store.list_parts import ListCursor, ListPart, last_changed_first
from webapp.store.maps.blurred import take_over_boxes
from webapp.store.schema import Account, Edit, MapRecord, Member, Photo, Upload

Role = Literal["owner", "editor", "viewer"]
ROLES: tuple[Role, ...] = ("viewer", "editor", "owner")
"""In ascending order: each includes the permissions of those before it."""

_MAX_NAME = 120
_MAX_SLUG = 60
_MOST_PARAMETERS = 5000
"""Maximum parameters of one statement; SQLite allows 32766."""
_LAST_CHANGED_FIRST = last_changed_first(MapRecord.changed_at, MapRecord.id)
_NUMBERED = re.compile(r" \(\d{1,9}\)$")
_HARMLESS = frozenset({"note", "notes", "retime"})
"""Kinds of edits that change no answer."""

RESERVED = frozenset({"new", "import", "bin"})


def create(session: Session, name: str, *, account_id: int, folders: Collection[str] = ()) -> MapRecord:
    """Create an empty map, owned by the account.

    Args:
        folders: Existing folders of the library, whose names cannot become the map's slug.
    """
    record = MapRecord(name=checked_name(name), slug=_free_slug(session, name, folders))
    session.add(record)
    session.flush()
    session.add(Member(map_id=record.id, account_id=account_id, role="owner"))
    return record


def checked_name(name: str) -> str:
    """Check a map's name, and return it as it is stored. Raises UsageError."""
    tidy = texts.tidy_name(name, most=_MAX_NAME)
    if tidy is None:
        raise UsageError(
            "this is not a valid name for a map", hint=f"give 1 to {_MAX_NAME} printable characters"
        )
    return tidy


def rename(record: MapRecord, name: str, *, description: str | None = None) -> None:
    """Rename a map; this is a new revision if something differs, as its files contain the name, too.

    Args:
        description: What the map is, for visitors; empty for none. None keeps it.
    """
    wanted = (
        checked_name(name),
        record.description if description is None else _checked_description(description),
    )
    if wanted == (record.name, record.description):
        return
    record.name, record.description = wanted
    record.revision += 1
    record.changed_at = now()


def _checked_description(text: str) -> str | None:
    tidy = " ".join(text.split())
    if DESCRIPTION.problem(tidy):
        raise UsageError(
            "this is not a valid description of a map",
            hint=f"give one line of at most {DESCRIPTION.most} printable characters",
        )
    return tidy or None


def find(session: Session, slug: str, *, account: Account, role: Role = "viewer") -> MapRecord:
    """Find a map that an account may use in a role; maps in the bin are included.

    Raises:
        NotFound: There is none, or it is not shared with the account.
        NotAllowed: The account may see it, but its role is too low.
    """
    record = session.scalars(select(MapRecord).where(MapRecord.slug == slug)).first()
    own = None if record is None else role_of(session, record, account=account)
    if record is None or own is None:
        raise NotFound("map not found, or it is not shared with you", where=slug)
    if ROLES.index(own) < ROLES.index(role):
        raise NotAllowed(f"this needs the role {role}, and yours is {own}", hint="ask an owner of the map")
    return record


def role_of(session: Session, record: MapRecord, *, account: Account) -> Role | None:
    """Return the role of an account on a map; an owner of the library owns every map."""
    if account.is_owner:
        return "owner"
    member = session.get(Member, (record.id, account.id))
    return None if member is None else _role(member.role)


def roles_of(session: Session, records: Sequence[MapRecord], *, account: Account) -> dict[int, Role]:
    """Return the roles of an account on some maps, by their ids; see `role_of`."""
    if account.is_owner:
        return dict.fromkeys((record.id for record in records), "owner")
    mine = select(Member.map_id, Member.role).where(Member.account_id == account.id)
    rows = [row for some in _blocks(records) for row in session.execute(mine.where(Member.map_id.in_(some)))]
    return {id: role for id, name in rows if (role := _role(name)) is not None}


def _role(name: str) -> Role | None:
    return next((role for role in ROLES if role == name), None)


_ALL = ListPart()


def list_maps(session: Session, account: Account, *, part: ListPart = _ALL) -> list[MapRecord]:
    """List maps that an account may see, last changed first."""
    ids = visible(account, binned=part.binned)
    if part.after is not None:
        ids = ids.where(part.after.follow(MapRecord.changed_at, MapRecord.id))
    ids = ids.order_by(*_LAST_CHANGED_FIRST)
    if part.search.strip():
        found = _searched(session, ids, text=part.search, most=part.limit)
        records = {
            record.id: record
            for begin in range(0, len(found), _MOST_PARAMETERS)
            for record in session.scalars(
                select(MapRecord).where(MapRecord.id.in_(found[begin : begin + _MOST_PARAMETERS]))
            )
        }
        return [records[id] for id in found]
    some = select(MapRecord).where(MapRecord.id.in_(ids.limit(part.limit)))
    return list(session.scalars(some.order_by(*_LAST_CHANGED_FIRST)))


def cursor(record: MapRecord) -> ListCursor:
    return ListCursor(record.changed_at, record.id)


def _searched(session: Session, ids: Select[Any], *, text: str, most: int | None) -> list[int]:
    """Return the ids of maps that match a search, in the order of the list.

    Names are compared in Python, as databases differ in which letters they take as equal.
    """
    wanted = texts.folded(text)
    rows = session.execute(ids.add_columns(MapRecord.name))
    return list(islice((id for id, name in rows if wanted in texts.folded(name)), most))


def visible(account: Account, *, binned: bool = False) -> Select[Any]:
    """Select the ids of the maps that an account may see: those in use, or those in the bin."""
    found = select(MapRecord.id).where(MapRecord.binned_at.is_not(None) == binned)
    if not account.is_owner:
        found = found.join(Member).where(Member.account_id == account.id)
    return found


def list_editable(session: Session, account: Account) -> list[MapRecord]:
    """List the maps in use that an account may edit, by name."""
    seen = select(MapRecord).where(MapRecord.id.in_(visible(account))).order_by(MapRecord.name, MapRecord.id)
    found = list(session.scalars(seen))
    roles = roles_of(session, found, account=account)
    return [record for record in found if roles.get(record.id) in ("editor", "owner")]


def count_binned(session: Session, account: Account) -> int:
    """Count the maps in the bin that an account may see."""
    ids = visible(account, binned=True).subquery()
    return session.scalar(select(func.count()).select_from(ids)) or 0


def put_into_bin(record: MapRecord) -> None:
    """Move a map to the bin; nothing is deleted."""
    record.binned_at = now()


def take_from_bin(record: MapRecord) -> None:
    record.binned_at = None


def photos(session: Session, record: MapRecord, *, since: int = -1) -> list[Photo]:
    """List the photos that changed after a revision, including removed ones, sorted by id."""
    found = select(Photo).where(Photo.map_id == record.id, Photo.revision > since)
    return list(session.scalars(found.order_by(Photo.id)))


class Dot(NamedTuple):
    """The data of a photo that are drawn on the image; x and y are None for one in the tray."""

    id: int
    x_px: float | None
    y_px: float | None
    heading_deg: float | None
    fov_deg: float | None
    floor: int = 0


def first_photos(session: Session, record: MapRecord, *, most: int) -> list[Photo]:
    """List the photos that a page shows first: those in the tray, then the others, each by time."""
    found = select(Photo).where(*_present(record, placed=False))
    order = (Photo.x_px.is_not(None), Photo.taken_at.is_(None), Photo.taken_at, Photo.name, Photo.id)
    return list(session.scalars(found.order_by(*order).limit(most)))


def photos_after(
    session: Session, record: MapRecord, id: int, *, most: int, placed: bool = False
) -> list[Photo]:
    """List the photos after an id, except removed ones, sorted by id.

    Args:
        placed: Whether to list only photos with a position.
    """
    found = select(Photo).where(*_present(record, placed=placed), Photo.id > id)
    return list(session.scalars(found.order_by(Photo.id).limit(most)))


def dots(session: Session, record: MapRecord, *, placed: bool = False) -> list[Dot]:
    """List the dots of all photos, except removed ones, sorted by id; `placed` as for `photos_after`."""
    columns = select(Photo.id, Photo.x_px, Photo.y_px, Photo.heading_deg, Photo.fov_deg, Photo.floor)
    rows = session.execute(columns.where(*_present(record, placed=placed)).order_by(Photo.id))
    return [Dot._make(row) for row in rows]


def some_positions(
    session: Session, records: Sequence[MapRecord], *, most: int
) -> dict[int, list[tuple[float, float]]]:
    """List positions of photos by map, map pixels; an even sample of `most` if a map has more."""
    found: dict[int, list[tuple[float, float]]] = {record.id: [] for record in records}
    number = func.row_number().over(partition_by=Photo.map_id, order_by=Photo.id).label("number")
    count = func.count().over(partition_by=Photo.map_id).label("count")
    there = select(Photo.map_id, Photo.x_px, Photo.y_px, number, count)
    for some in _blocks(records):
        of_all = Photo.map_id.in_(some), ~Photo.removed, Photo.x_px.is_not(None)
        one = there.where(*of_all).subquery().c
        # As in Bresenham's algorithm: true for `most` of the numbers, evenly spread, or for all if fewer.
        is_taken = one.number * most % one.count < most
        rows = select(one.map_id, one.x_px, one.y_px).where(is_taken).order_by(one.map_id, one.number)
        for map_id, x, y in session.execute(rows):
            found[map_id].append((x, y))
    return found


def _present(record: MapRecord, *, placed: bool) -> list[ColumnElement[bool]]:
    there = [Photo.map_id == record.id, ~Photo.removed]
    return [*there, Photo.x_px.is_not(None)] if placed else there


def photos_by_id(session: Session, record: MapRecord, ids: Collection[int]) -> dict[int, Photo]:
    """Fetch many photos in bulk, including removed ones; unknown ids are left out.

    Photos already loaded in the session are not fetched again.
    """
    map_id = record.id
    known = {id: session.identity_map.get(identity_key(Photo, (map_id, id))) for id in ids}
    found: dict[int, Photo] = {id: photo for id, photo in known.items() if photo is not None}
    wanted = sorted(id for id in ids if id not in found)
    for start in range(0, len(wanted), _MOST_PARAMETERS):
        some = wanted[start : start + _MOST_PARAMETERS]
        rows = select(Photo).where(Photo.map_id == map_id, Photo.id.in_(some))
        found |= {photo.id: photo for photo in session.scalars(rows)}
    return found


def present_photos(session: Session, record: MapRecord, ids: Collection[int]) -> dict[int, Photo]:
    """Fetch many photos, none of which may be removed."""
    found = photos_by_id(session, record, ids)
    for id in ids:
        if id not in found or found[id].removed:
            hint = "somebody may have removed it; reload the page"
            raise NotFound(f"the map has no photo {id}", where=f"photo/{id}", hint=hint)
    return found


def photo(session: Session, record: MapRecord, id: int) -> Photo:
    """Fetch a photo, which must not be removed. Raises NotFound."""
    found = session.get(Photo, (record.id, id))
    if found is None or found.removed:
        raise NotFound(f"the map has no photo {id}", hint="reload the page")
    return found


def add_photo(session: Session, record: MapRecord, *, row: Photo) -> Photo:
    """Add a photo, or return the existing one with the same content.

    A removed photo is restored at its old position. The map's revision is increased if anything changes.

    Args:
        row: Without map and revision; if it has no id, it gets the next one.
    """
    same = select(Photo).where(Photo.map_id == record.id, Photo.sha256 == row.sha256)
    there = session.scalars(same).first()
    if there is not None and not there.removed:
        return there
    record.revision += 1
    record.changed_at = now()
    if there is not None:
        there.removed, there.revision = False, record.revision
        _note_placed(record, there)
        return there
    row.map_id, row.revision = record.id, record.revision
    row.id = reserve_id(record) if row.id is None else row.id
    session.add(row)
    take_over_boxes(session, row)
    session.flush()
    _note_placed(record, row)
    return row


def reserve_id(record: MapRecord) -> int:
    record.next_id += 1
    return record.next_id - 1


def _note_placed(record: MapRecord, photo: Photo) -> None:
    if photo.is_placed:
        record.photos_revision = record.revision


def alters_answers(session: Session, record: MapRecord, *, since: int) -> bool:
    """Return whether the map has changed after a revision in more than its tray and its notes.

    False only if each later revision added a photo without a position, or is an edit of notes or times.
    """
    if since >= record.revision:
        return False
    added = select(Photo.revision).where(
        Photo.map_id == record.id, Photo.revision > since, Photo.x_px.is_(None), ~Photo.removed
    )
    later = select(Edit.kind, Edit.revision).where(Edit.map_id == record.id, Edit.revision > since)
    done = session.execute(later).all()
    if any(kind not in _HARMLESS for kind, _ in done):
        return True
    return len({*session.scalars(added), *(revision for _, revision in done)}) < record.revision - since


def free_name(session: Session, name: str, *, account: Account) -> str:
    """Return a name, with a number where the account sees a map of that name already: `Park (2)`."""
    known = session.scalars(select(MapRecord.name).where(MapRecord.id.in_(visible(account))))
    taken = {one.casefold() for one in known}
    plain = _NUMBERED.sub("", name)
    numbers = (f" ({number})" for number in count(2))
    names = (f"{plain[: _MAX_NAME - len(number)].rstrip()}{number}" for number in numbers)
    return name if name.casefold() not in taken else next(one for one in names if one.casefold() not in taken)


def counts(session: Session, record: MapRecord) -> tuple[int, int]:
    """Count the photos of a map, and how many of them are placed."""
    return counts_of(session, [record])[record.id]


def counts_of(session: Session, records: Sequence[MapRecord]) -> dict[int, tuple[int, int]]:
    """Count the photos of some maps, and how many of them are placed, by map id."""
    found = dict.fromkeys((record.id for record in records), (0, 0))
    numbers = select(Photo.map_id, func.count(), func.count(Photo.x_px)).where(~Photo.removed)
    for some in _blocks(records):
        rows = session.execute(numbers.where(Photo.map_id.in_(some)).group_by(Photo.map_id))
        found |= {id: (int(photos_), int(placed)) for id, photos_, placed in rows}
    return found


def _blocks(records: Sequence[MapRecord]) -> Iterator[list[int]]:
    """Yield the ids of maps in blocks that fit into one statement."""
    for start in range(0, len(records), _MOST_PARAMETERS):
        yield [record.id for record in records[start : start + _MOST_PARAMETERS]]


def _free_slug(session: Session, name: str, folders: Collection[str]) -> str:
    plain = unicodedata.normalize("NFKD", name).encode("ascii", "ignore").decode().lower()
    base = re.sub(r"[^a-z0-9]+", "-", plain).strip("-")[:_MAX_SLUG].strip("-") or "map"
    taken = set(session.scalars(select(MapRecord.slug).where(MapRecord.slug.startswith(base))))
    taken |= RESERVED.union(folders)
    slugs = (base if n == 1 else f"{base}-{n}" for n in range(1, len(taken) + 3))
    return next(slug for slug in slugs if slug not in taken)


_day = func.substr(Photo.taken_at, 1, 10)


@dataclass(frozen=True, slots=True)
class DayOfMap:
    map: MapRecord
    count: int
    first: tuple[Photo, ...]  # The first of them


@dataclass(frozen=True, slots=True)
class Day:
    date: str  # YYYY-MM-DD, by the cameras' clocks
    maps: tuple[DayOfMap, ...]


def days_with_photos(
    session: Session, account: Account, *, before: str | None, most: int, photos: int
) -> list[Day]:
    """List days with placed photos on maps that an account may see, the last day first.

    Args:
        before: Only days before this one; None for all.
        photos: Maximum number of photos of a map and day.
    """
    shown = _placed(account)
    known = select(_day).where(*shown, Photo.taken_at.is_not(None)).distinct()
    if before is not None:
        known = known.where(_day < before)
    dates = list(session.scalars(known.order_by(_day.desc()).limit(most)))
    same = (Photo.map_id, _day)
    number = func.row_number().over(partition_by=same, order_by=(Photo.taken_at, Photo.id)).label("number")
    count = func.count().over(partition_by=same).label("count")
    found = select(Photo.map_id, Photo.id, number, count).where(*shown, _day.in_(dates)).subquery()
    wanted = (
        select(Photo, MapRecord, found.c.count)
        .join(found, (found.c.map_id == Photo.map_id) & (found.c.id == Photo.id))
        .join(MapRecord, MapRecord.id == Photo.map_id)
        .where(found.c.number <= photos)
        .order_by(_day.desc(), MapRecord.name, MapRecord.id, Photo.taken_at, Photo.id)
    )
    rows = [(photo, record, in_all) for photo, record, in_all in session.execute(wanted)]
    grouped = groupby(rows, key=lambda row: (row[0].taken_at or "")[:10])
    return [Day(date, _by_map(list(of_day))) for date, of_day in grouped]


def count_without_time(session: Session, account: Account) -> int:
    """Count the placed photos, on maps that an account may see, that no day has."""
    found = select(func.count()).select_from(Photo).where(*_placed(account), Photo.taken_at.is_(None))
    return session.scalar(found) or 0


def _placed(account: Account) -> tuple[ColumnElement[bool], ...]:
    return (Photo.map_id.in_(visible(account)), ~Photo.removed, Photo.x_px.is_not(None))


def _by_map(rows: Sequence[tuple[Photo, MapRecord, int]]) -> tuple[DayOfMap, ...]:
    return tuple(
        DayOfMap(of_map[0][1], of_map[0][2], tuple(photo for photo, _, _ in of_map))
        for of_map in (list(group) for _, group in groupby(rows, key=lambda row: row[1].id))
    )


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
        photo_id=reserve_id(record),
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
