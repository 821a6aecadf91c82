"""The tables. `migrations/` holds how an older database becomes this one."""

from __future__ import annotations

import secrets
from datetime import datetime
from typing import Any, ClassVar

from sqlalchemy import JSON, ForeignKey, Index, MetaData, UniqueConstraint, text
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column, relationship

from webapp.store.clock import UtcDateTime, now


class Base(DeclarativeBase):
    """Every table; constraints have names, so that a migration can change them."""

    metadata = MetaData(
        naming_convention={
            "ix": "ix_%(column_0_N_label)s",
            "uq": "uq_%(table_name)s_%(column_0_N_name)s",
            "fk": "fk_%(table_name)s_%(column_0_N_name)s",
            "pk": "pk_%(table_name)s",
        }
    )
    type_annotation_map: ClassVar[dict[Any, Any]] = {
        dict[str, Any]: JSON,
        list[dict[str, Any]]: JSON,
        datetime: UtcDateTime,
    }


class ShareColumns:
    """What every kind of share has: a view of something that is open without a sign-in.

    Each kind is a table with a foreign key to what it shows. So a share goes with what it shows, whoever
    deletes that: a database may give the id of a deleted map to a new one, which nobody has shared.
    """

    id: Mapped[int] = mapped_column(primary_key=True)
    token_hash: Mapped[str] = mapped_column(unique=True)
    public_token: Mapped[str | None]
    """The end of the address, of a share that is listed for everybody; of a secret one nothing is kept."""
    account_id: Mapped[int | None] = mapped_column(ForeignKey("account.id", ondelete="SET NULL"))
    """Who made it."""
    created_at: Mapped[datetime] = mapped_column(default=now)
    photos: Mapped[bool] = mapped_column(default=False)
    """Whether previews of photos are shown."""


def _first_epoch() -> int:
    """Return a number that no deleted account of the same id has had, in the range of every database."""
    return secrets.randbelow(2**30)


WITHOUT_ROWID = {"sqlite_with_rowid": False}
"""For a table of short rows: on SQLite it is the index of its own key, and takes half the space."""


class Account(Base):
    """Someone who signs in.

    `epoch` is part of every session: raising it ends them all. It begins anywhere, because a database may
    give the id of a deleted account to a new one, and the sessions of the old one must not be the new one's.
    """

    __tablename__ = "account"

    id: Mapped[int] = mapped_column(primary_key=True)
    name: Mapped[str] = mapped_column(unique=True)
    password_hash: Mapped[str | None]
    is_owner: Mapped[bool] = mapped_column(default=False)
    """Of the whole library: may do everything."""
    language: Mapped[str | None]
    epoch: Mapped[int] = mapped_column(default=_first_epoch)
    created_at: Mapped[datetime] = mapped_column(default=now)


class SignInLink(Base):
    """A link that signs in once; only its hash is kept."""

    __tablename__ = "sign_in_link"
    __table_args__ = WITHOUT_ROWID

    token_hash: Mapped[str] = mapped_column(primary_key=True)
    account_id: Mapped[int] = mapped_column(ForeignKey("account.id", ondelete="CASCADE"))
    expires_at: Mapped[datetime]
    used_at: Mapped[datetime | None]


class EndedSession(Base):
    """A session that was signed out of: its cookie, wherever a copy of it is, is worth nothing any more."""

    __tablename__ = "ended_session"
    __table_args__ = WITHOUT_ROWID

    id_hash: Mapped[str] = mapped_column(primary_key=True)
    at: Mapped[datetime] = mapped_column(default=now)


class ApiToken(Base):
    """A token for programs; only its hash is kept."""

    __tablename__ = "api_token"
    __table_args__ = (UniqueConstraint("account_id", "name"),)

    id: Mapped[int] = mapped_column(primary_key=True)
    account_id: Mapped[int] = mapped_column(ForeignKey("account.id", ondelete="CASCADE"))
    name: Mapped[str]
    token_hash: Mapped[str] = mapped_column(unique=True)
    created_at: Mapped[datetime] = mapped_column(default=now)
    used_at: Mapped[datetime | None]


class FailedSignIn(Base):
    """One failed attempt; many of them make the next ones wait."""

    __tablename__ = "failed_sign_in"
    __table_args__ = (Index(None, "who", "at"),)

    id: Mapped[int] = mapped_column(primary_key=True)
    who: Mapped[str]
    """The name or the address that was tried."""
    at: Mapped[datetime] = mapped_column(default=now)


class MapRecord(Base):
    """A map of the library; its folder has its slug as name."""

    __tablename__ = "map"

    id: Mapped[int] = mapped_column(primary_key=True)
    slug: Mapped[str] = mapped_column(unique=True)
    name: Mapped[str]
    created_at: Mapped[datetime] = mapped_column(default=now)
    changed_at: Mapped[datetime] = mapped_column(default=now)
    binned_at: Mapped[datetime | None]
    """When it was put into the bin; None for a map in use."""

    revision: Mapped[int] = mapped_column(default=0)
    """Counts the edits."""
    next_id: Mapped[int] = mapped_column(default=0)
    """Of the next photo; ids are never used again."""

    satellite_path: Mapped[str | None]
    """Relative to the map's folder; None as long as there is no image."""
    satellite_width: Mapped[int | None]
    satellite_height: Mapped[int | None]
    georeference: Mapped[dict[str, Any] | None]
    """As in `map.json`."""
    control_points: Mapped[list[dict[str, Any]] | None]
    """As in `map.json`, by name; None where there are none."""
    notes: Mapped[list[dict[str, Any]] | None]
    """On spots of the map, as in `map.json`, by id; None where there are none."""
    floors: Mapped[list[dict[str, Any]] | None]
    """Several images of the map, as in `map.json`, by id; None where there is only its own."""
    satellite_revision: Mapped[int] = mapped_column(default=0)
    """Revision that last changed the image or its georeference."""
    photos_revision: Mapped[int] = mapped_column(default=0)
    """Revision that last changed which photos are placed on the map, one of their files, or a panorama."""

    exported_revision: Mapped[int] = mapped_column(default=-1)
    """That `map.cfg` and `map.json` on disk hold."""
    exported_sha256: Mapped[str | None]
    """Of the `map.cfg` that was written last, or is just being written."""
    previous_sha256: Mapped[str | None]
    """Of the one before: still on disk when a writer was killed. Any other one is an edit from outside."""

    photos: Mapped[list[Photo]] = relationship(order_by="Photo.id", passive_deletes=True)


class Member(Base):
    """What an account may do with a map."""

    __tablename__ = "member"
    __table_args__ = WITHOUT_ROWID

    map_id: Mapped[int] = mapped_column(ForeignKey("map.id", ondelete="CASCADE"), primary_key=True)
    account_id: Mapped[int] = mapped_column(
        ForeignKey("account.id", ondelete="CASCADE"), primary_key=True, index=True
    )
    role: Mapped[str]
    """`owner`, `editor` or `viewer`."""


class Photo(Base):
    """A photo of a map, placed or not; with a place it is an experience of the map."""

    __tablename__ = "photo"
    __table_args__ = (UniqueConstraint("map_id", "sha256"), Index(None, "map_id", "revision"))

    map_id: Mapped[int] = mapped_column(ForeignKey("map.id", ondelete="CASCADE"), primary_key=True)
    id: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    name: Mapped[str]
    """Of the original file."""
    path: Mapped[str]
    """Relative to the map's folder, with forward slashes."""
    sha256: Mapped[str]
    size_bytes: Mapped[int]
    width: Mapped[int]
    """Of the upright photo."""
    height: Mapped[int]
    uploaded_at: Mapped[datetime] = mapped_column(default=now)
    taken_at: Mapped[str | None]
    """ISO 8601, as in `map.json`."""
    camera: Mapped[str | None]
    """Maker and model, from EXIF."""
    fov_deg: Mapped[float | None]
    gps_lat: Mapped[float | None]
    gps_lon: Mapped[float | None]
    gps_accuracy_m: Mapped[float | None]
    gps_problem: Mapped[str | None]
    """Why there is no GPS position, for people."""

    x_px: Mapped[float | None]
    y_px: Mapped[float | None]
    radius_px: Mapped[float | None]
    """68 % radius of a position that was suggested and accepted; None: it is exact, or that of its GPS."""
    heading_deg: Mapped[float | None]
    blurred: Mapped[list[dict[str, Any]] | None]
    """Boxes that are blurred in every picture of it: `x`, `y`, `width`, `height`, shares of its size."""
    source: Mapped[dict[str, Any] | None]
    """Of a photo that is from a service: `service`, `id`, `licence`, `author`, `url`, as in `map.json`."""
    panorama: Mapped[dict[str, Any] | None]
    """Of a photo that shows the whole sphere: the boxes that are `masked`, as in `map.json`."""
    note: Mapped[str | None]
    """What people have written on it."""
    floor: Mapped[int] = mapped_column(default=0)
    """Id of the floor that it is on; 0 is that of the map's own image."""
    removed: Mapped[bool] = mapped_column(default=False)
    """Taken out of the map; kept, so that it can be undone."""
    revision: Mapped[int] = mapped_column(default=0)
    """Of the map, when this photo last changed."""

    @property
    def is_placed(self) -> bool:
        """Whether it is on the map: the files and the index hold it."""
        return self.x_px is not None and not self.removed


class PlacedElsewhere(Base):
    """Where a further placement of a map has one of its photos."""

    __tablename__ = "placed_elsewhere"
    __table_args__ = WITHOUT_ROWID

    map_id: Mapped[int] = mapped_column(ForeignKey("map.id", ondelete="CASCADE"), primary_key=True)
    placement: Mapped[str] = mapped_column(primary_key=True)
    photo_id: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    x_px: Mapped[float]
    y_px: Mapped[float]


class Edit(Base):
    """One step that can be undone: the fields it changed, before and after."""

    __tablename__ = "edit"
    __table_args__ = (Index(None, "map_id", "account_id", "state", "id"),)

    id: Mapped[int] = mapped_column(primary_key=True)
    map_id: Mapped[int] = mapped_column(ForeignKey("map.id", ondelete="CASCADE"))
    account_id: Mapped[int | None] = mapped_column(ForeignKey("account.id", ondelete="SET NULL"))
    at: Mapped[datetime] = mapped_column(default=now)
    kind: Mapped[str]
    """`place`, `move`, `turn`, `remove`, `satellite` ...: for the words on the undo button."""
    changes: Mapped[list[dict[str, Any]]]
    """`{"target": "photo/3", "before": {...}, "after": {...}}` each."""
    state: Mapped[str] = mapped_column(default="done")
    """`done`, `undone`, or `closed`: can be neither undone nor redone any more."""
    revision: Mapped[int] = mapped_column("turn")
    """Of the map, by which it was done, undone or redone last: orders the redo."""


class Upload(Base):
    """A file on its way in; what has arrived is in the uploads folder."""

    __tablename__ = "upload"
    __table_args__ = (UniqueConstraint("map_id", "account_id", "fingerprint"),)

    id: Mapped[str] = mapped_column(primary_key=True)
    map_id: Mapped[int] = mapped_column(ForeignKey("map.id", ondelete="CASCADE"))
    account_id: Mapped[int] = mapped_column(ForeignKey("account.id", ondelete="CASCADE"))
    fingerprint: Mapped[str]
    """Name, size and time of the file, by which a browser finds its half-done upload again."""
    name: Mapped[str]
    size_bytes: Mapped[int]
    photo_id: Mapped[int | None]
    """Reserved for the photo; None for an upload that was begun by an older version."""
    created_at: Mapped[datetime] = mapped_column(default=now)


class Job(Base):
    """Long work outside a request. Who works on it holds a lease and renews it; `fence` counts the leases."""

    __tablename__ = "job"
    __table_args__ = (
        Index(None, "state", "created_at"),
        Index(
            "uq_job_waiting",
            "map_id",
            "kind",
            "key",
            unique=True,
            sqlite_where=text("state = 'queued'"),
            postgresql_where=text("state = 'queued'"),
        ),
        {"sqlite_autoincrement": True},
    )

    id: Mapped[int] = mapped_column(primary_key=True)
    """Never used again: pages keep asking for jobs of maps that are deleted."""
    map_id: Mapped[int | None] = mapped_column(ForeignKey("map.id", ondelete="CASCADE"), index=True)
    account_id: Mapped[int | None] = mapped_column(ForeignKey("account.id", ondelete="SET NULL"))
    kind: Mapped[str]
    key: Mapped[str] = mapped_column(default="")
    """Two waiting jobs of one map, kind and key are one."""
    arguments: Mapped[dict[str, Any]] = mapped_column(default=dict)
    state: Mapped[str] = mapped_column(default="queued")
    """`queued`, `running`, `done`, `failed` or `cancelled`."""
    done: Mapped[int] = mapped_column(default=0)
    total: Mapped[int] = mapped_column(default=0)
    note: Mapped[str] = mapped_column(default="")
    error: Mapped[dict[str, Any] | None]
    """`message`, `where` and `hint` of the error it ended with."""
    result: Mapped[dict[str, Any] | None]
    attempts: Mapped[int] = mapped_column(default=0)
    cancel_wanted: Mapped[bool] = mapped_column(default=False)
    fence: Mapped[int] = mapped_column(default=0)
    leased_by: Mapped[str | None]
    leased_until: Mapped[datetime | None]
    not_before: Mapped[datetime | None]
    """When it may be tried again, of a job for which something was away; by the clock of the database."""
    waits: Mapped[int] = mapped_column(default=0, server_default="0")
    """How often something was away."""
    created_at: Mapped[datetime] = mapped_column(default=now)
    started_at: Mapped[datetime | None]
    ended_at: Mapped[datetime | None] = mapped_column(index=True)


class QueryRecord(Base):
    """A photo that somebody asked about: where on a map was it taken? With the answer."""

    __tablename__ = "query"
    __table_args__ = (
        Index(None, "map_id", "id"),
        Index("uq_query_key", "map_id", "account_id", "key", unique=True),
        {"sqlite_autoincrement": True},
    )

    id: Mapped[int] = mapped_column(primary_key=True)
    """Never used again: links name it."""
    map_id: Mapped[int] = mapped_column(ForeignKey("map.id", ondelete="CASCADE"))
    account_id: Mapped[int | None] = mapped_column(ForeignKey("account.id", ondelete="SET NULL"))
    at: Mapped[datetime] = mapped_column(default=now)
    name: Mapped[str]
    """Of the original file."""
    file: Mapped[str]
    """Its name in the folder of the map's queries; the server chose it."""
    width: Mapped[int]
    """Of the upright photo."""
    height: Mapped[int]
    options: Mapped[dict[str, Any]]
    """What was asked for besides the photo."""
    answer: Mapped[dict[str, Any]]
    """As `localize --json` gives it."""
    evidence: Mapped[list[dict[str, Any]]] = mapped_column(deferred=True)
    """Matches with photos of the map: `experience`, `query_xy`, `photo_xy` and `inlier` each."""
    adopted_id: Mapped[int | None]
    """Id of the photo of the map that it has become."""
    key: Mapped[str | None]
    """That the sender chose: sent once more with it, the photo is not asked about again."""


class Share(ShareColumns, Base):
    """A view of a map, or of one answer, that is open without a sign-in."""

    __tablename__ = "share"

    map_id: Mapped[int] = mapped_column(ForeignKey("map.id", ondelete="CASCADE"), index=True)
    query_id: Mapped[int | None] = mapped_column(ForeignKey("query.id", ondelete="CASCADE"))
    """Of the only answer that is shown; None for the whole map."""
    localize: Mapped[bool] = mapped_column(default=False)
    """Whether visitors may ask about photos of their own."""
    originals: Mapped[bool] = mapped_column(default=False)
    """Whether original files, with their EXIF, are given out."""
    notes: Mapped[bool] = mapped_column(default=False)
    """Whether notes are shown."""
    landmarks: Mapped[bool] = mapped_column(default=False)
    """Whether the map is shown in 3D: landmarks and cameras."""
