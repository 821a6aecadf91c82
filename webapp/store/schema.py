"""The tables. `migrations/` converts older databases."""

from __future__ import annotations

import secrets
from datetime import datetime
from typing import Any, ClassVar

from sqlalchemy import JSON, ForeignKey, Index, MetaData, UniqueConstraint, false, text, true
from sqlalchemy.orm import DeclarativeBase, Mapped, mapped_column, relationship

from webapp.store.clock import UtcDateTime, now


class Base(DeclarativeBase):
    """Base of all tables; constraints have names, so that migrations can change them."""

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
        list[str]: JSON,
        datetime: UtcDateTime,
    }


class ShareColumns:
    """Columns of every kind of share: a view of something that is open without signing in.

    Each kind is a table with a foreign key to what it shows, so that a share is always deleted with that.
    """

    id: Mapped[int] = mapped_column(primary_key=True)
    token_hash: Mapped[str] = mapped_column(unique=True)
    public_token: Mapped[str | None]
    """The end of the URL of a publicly listed share; that of a secret one is not stored."""
    account_id: Mapped[int | None] = mapped_column(ForeignKey("account.id", ondelete="SET NULL"))
    """Account that made it."""
    created_at: Mapped[datetime] = mapped_column(default=now)
    photos: Mapped[bool] = mapped_column(default=False)
    """Whether previews of photos are shown."""


def _first_epoch() -> int:
    """Return a random number: an account of an older library with the same id has most likely had another."""
    return secrets.randbelow(2**30)


IDS_USED_ONCE = {"sqlite_autoincrement": True}
"""For a table whose ids name what belongs to somebody: they are never used again, as always in PostgreSQL."""

WITHOUT_ROWID = {"sqlite_with_rowid": False}
"""For a table of short rows: SQLite stores it as a clustered index of its key, in half the space."""


class Account(Base):
    """An account, with which a person signs in.

    `epoch` is part of every session: raising it ends them all. It begins at random, because older
    versions used the ids of deleted accounts again, whose sessions must not be valid for new ones.
    """

    __tablename__ = "account"
    __table_args__ = IDS_USED_ONCE

    id: Mapped[int] = mapped_column(primary_key=True)
    name: Mapped[str] = mapped_column(unique=True)
    password_hash: Mapped[str | None]
    is_owner: Mapped[bool] = mapped_column(default=False)
    """Whether it owns the whole library, and may do everything."""
    language: Mapped[str | None]
    epoch: Mapped[int] = mapped_column(default=_first_epoch)
    created_at: Mapped[datetime] = mapped_column(default=now)


class SignInLink(Base):
    """A link that signs in once; only its hash is stored."""

    __tablename__ = "sign_in_link"
    __table_args__ = WITHOUT_ROWID

    token_hash: Mapped[str] = mapped_column(primary_key=True)
    account_id: Mapped[int] = mapped_column(ForeignKey("account.id", ondelete="CASCADE"))
    expires_at: Mapped[datetime]
    used_at: Mapped[datetime | None]


class EndedSession(Base):
    """A session that was signed out: all copies of its cookie are invalid."""

    __tablename__ = "ended_session"
    __table_args__ = WITHOUT_ROWID

    id_hash: Mapped[str] = mapped_column(primary_key=True)
    at: Mapped[datetime] = mapped_column(default=now)


class SignedIn(Base):
    """A browser that has signed in to an account; only the hash of its session's id is stored."""

    __tablename__ = "signed_in"
    __table_args__ = IDS_USED_ONCE

    id: Mapped[int] = mapped_column(primary_key=True)
    account_id: Mapped[int] = mapped_column(ForeignKey("account.id", ondelete="CASCADE"), index=True)
    id_hash: Mapped[str] = mapped_column(unique=True)
    epoch: Mapped[int]
    """Of the account then; another one now: it was signed out."""
    device: Mapped[str]
    """Browser and system."""
    begun_at: Mapped[datetime] = mapped_column(default=now)
    used_at: Mapped[datetime] = mapped_column(default=now)


class ApiToken(Base):
    """An API token; only its hash is stored."""

    __tablename__ = "api_token"
    __table_args__ = (UniqueConstraint("account_id", "name"), IDS_USED_ONCE)

    id: Mapped[int] = mapped_column(primary_key=True)
    account_id: Mapped[int] = mapped_column(ForeignKey("account.id", ondelete="CASCADE"))
    name: Mapped[str]
    token_hash: Mapped[str] = mapped_column(unique=True)
    created_at: Mapped[datetime] = mapped_column(default=now)
    used_at: Mapped[datetime | None]


class FailedSignIn(Base):
    """One failed attempt; after too many, further ones are refused for a while."""

    __tablename__ = "failed_sign_in"
    __table_args__ = (Index(None, "who", "at"),)

    id: Mapped[int] = mapped_column(primary_key=True)
    who: Mapped[str]
    """The name that was tried (`name:...`), or the client's address (`address:...`)."""
    at: Mapped[datetime] = mapped_column(default=now)


class MapRecord(Base):
    """A map of the library; its slug is the name of its folder."""

    __tablename__ = "map"
    __table_args__ = IDS_USED_ONCE

    id: Mapped[int] = mapped_column(primary_key=True)
    slug: Mapped[str] = mapped_column(unique=True)
    name: Mapped[str]
    description: Mapped[str | None]
    """A sentence for visitors on what the map is; None if there is none."""
    created_at: Mapped[datetime] = mapped_column(default=now)
    changed_at: Mapped[datetime] = mapped_column(default=now)
    binned_at: Mapped[datetime | None]
    """When it was put into the bin; None for a map in use."""

    revision: Mapped[int] = mapped_column(default=0)
    """Counts the edits."""
    next_id: Mapped[int] = mapped_column(default=0)
    """Id of the next photo; ids are never reused."""

    satellite_path: Mapped[str | None]
    """Relative to the map's folder; None as long as there is no image."""
    satellite_width: Mapped[int | None]
    satellite_height: Mapped[int | None]
    georeference: Mapped[dict[str, Any] | None]
    """As in `map.json`."""
    control_points: Mapped[list[dict[str, Any]] | None]
    """As in `map.json`, sorted by name; None if there are none."""
    notes: Mapped[list[dict[str, Any]] | None]
    """Notes on spots of the map, as in `map.json`, sorted by id; None if there are none."""
    floors: Mapped[list[dict[str, Any]] | None]
    """As in `map.json`, sorted by id; None if there are none."""
    satellite_revision: Mapped[int] = mapped_column(default=0)
    """Revision that last changed the image or its georeference."""
    photos_revision: Mapped[int] = mapped_column(default=0)
    """Revision that last changed the set of placed photos, one of their files, or a panorama."""
    uses_adopted: Mapped[bool] = mapped_column(default=True, server_default=true())
    """Whether photos that were added from answers are real queries when probabilities are calibrated."""

    exported_revision: Mapped[int] = mapped_column(default=-1)
    """Revision of `map.cfg` and `map.json` on disk."""
    exported_sha256: Mapped[str | None]
    """Of the `map.cfg` that was written last, or is being written."""
    previous_sha256: Mapped[str | None]
    """Of the one before, still on disk if a writer was killed. Any other hash means an edit from outside."""

    photos: Mapped[list[Photo]] = relationship(order_by="Photo.id", passive_deletes=True)


class Member(Base):
    """The role of an account on a map."""

    __tablename__ = "member"
    __table_args__ = WITHOUT_ROWID

    map_id: Mapped[int] = mapped_column(ForeignKey("map.id", ondelete="CASCADE"), primary_key=True)
    account_id: Mapped[int] = mapped_column(
        ForeignKey("account.id", ondelete="CASCADE"), primary_key=True, index=True
    )
    role: Mapped[str]
    """`owner`, `editor` or `viewer`."""


class Photo(Base):
    """A photo of a map, placed or not; a placed one is an experience of the map."""

    __tablename__ = "photo"
    __table_args__ = (
        UniqueConstraint("map_id", "sha256"),
        Index(None, "map_id", "revision"),
        Index(
            "ix_photo_blurred_sha256",
            "sha256",
            sqlite_where=text("blurred IS NOT NULL"),
            postgresql_where=text("blurred IS NOT NULL"),
        ),
    )

    map_id: Mapped[int] = mapped_column(ForeignKey("map.id", ondelete="CASCADE"), primary_key=True)
    id: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    name: Mapped[str]
    """Name of the original file."""
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
    """A sentence on why there is no GPS position."""
    file_notes: Mapped[list[str] | None]
    """Sentences about its file: where its position is from, what was left out."""

    x_px: Mapped[float | None]
    y_px: Mapped[float | None]
    radius_px: Mapped[float | None]
    """68 % radius of an accepted suggestion; None for an exact position, or that of the photo's GPS."""
    heading_deg: Mapped[float | None]
    blurred: Mapped[list[dict[str, Any]] | None]
    """Boxes blurred in all pictures of it: `x`, `y`, `width`, `height`, as fractions of its size."""
    source: Mapped[dict[str, Any] | None]
    """For a photo from a service: `service`, `id`, `licence`, `author`, `url`, as in `map.json`."""
    panorama: Mapped[dict[str, Any] | None]
    """For a photo of the whole sphere: the `masked` boxes, as in `map.json`."""
    note: Mapped[str | None]
    """Note of users on it."""
    floor: Mapped[int] = mapped_column(default=0)
    """Id of its floor; 0 is that of the map's own image."""
    removed: Mapped[bool] = mapped_column(default=False)
    """Whether it was removed from the map; the record is kept for undo."""
    revision: Mapped[int] = mapped_column(default=0)
    """Revision of the map in which this photo last changed."""

    @property
    def is_placed(self) -> bool:
        """Whether it is on the map, and thus in the files and the index."""
        return self.x_px is not None and not self.removed


class BlurredFile(Base):
    """What was blurred in a photo of a deleted map, as missions and other maps may have the same file."""

    __tablename__ = "blurred_file"
    __table_args__ = WITHOUT_ROWID

    sha256: Mapped[str] = mapped_column(primary_key=True)
    boxes: Mapped[list[dict[str, Any]]]


class PlacedElsewhere(Base):
    """The position of a photo in a further placement of a map."""

    __tablename__ = "placed_elsewhere"
    __table_args__ = WITHOUT_ROWID

    map_id: Mapped[int] = mapped_column(ForeignKey("map.id", ondelete="CASCADE"), primary_key=True)
    placement: Mapped[str] = mapped_column(primary_key=True)
    photo_id: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    x_px: Mapped[float]
    y_px: Mapped[float]


class Edit(Base):
    """A change that can be undone as one step: the fields before and after."""

    __tablename__ = "edit"
    __table_args__ = (Index(None, "map_id", "account_id", "state", "id"),)

    id: Mapped[int] = mapped_column(primary_key=True)
    map_id: Mapped[int] = mapped_column(ForeignKey("map.id", ondelete="CASCADE"))
    account_id: Mapped[int | None] = mapped_column(ForeignKey("account.id", ondelete="SET NULL"))
    at: Mapped[datetime] = mapped_column(default=now)
    kind: Mapped[str]
    """`place`, `move`, `turn`, `remove`, `satellite` ...: for the label of the undo button."""
    changes: Mapped[list[dict[str, Any]]]
    """Each is `{"target": "photo/3", "before": {...}, "after": {...}}`."""
    state: Mapped[str] = mapped_column(default="done")
    """`done`, `undone`, or `closed`, which can be neither undone nor redone."""
    revision: Mapped[int] = mapped_column("turn")
    """Revision of the map in which it was last done, undone or redone."""


class Upload(Base):
    """An upload in progress; the bytes received are in the uploads folder."""

    __tablename__ = "upload"
    __table_args__ = (UniqueConstraint("map_id", "account_id", "fingerprint"),)

    id: Mapped[str] = mapped_column(primary_key=True)
    map_id: Mapped[int] = mapped_column(ForeignKey("map.id", ondelete="CASCADE"))
    account_id: Mapped[int] = mapped_column(ForeignKey("account.id", ondelete="CASCADE"))
    fingerprint: Mapped[str]
    """Of name, size and time of the file; with it a browser finds its unfinished upload again."""
    name: Mapped[str]
    size_bytes: Mapped[int]
    photo_id: Mapped[int | None]
    """Reserved for the photo; None for an upload that an older version began."""
    beside: Mapped[list[dict[str, Any]] | None]
    """Files beside the photo: `name` and `content`, as text."""
    created_at: Mapped[datetime] = mapped_column(default=now)


class Job(Base):
    """Long work outside a request. Its worker holds a lease and renews it; `fence` counts the leases."""

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
        IDS_USED_ONCE,
    )

    id: Mapped[int] = mapped_column(primary_key=True)
    """Never reused: pages may still request jobs of deleted maps."""
    map_id: Mapped[int | None] = mapped_column(ForeignKey("map.id", ondelete="CASCADE"), index=True)
    account_id: Mapped[int | None] = mapped_column(ForeignKey("account.id", ondelete="SET NULL"))
    kind: Mapped[str]
    key: Mapped[str] = mapped_column(default="")
    """Waiting jobs with the same map, kind and key are merged."""
    arguments: Mapped[dict[str, Any]] = mapped_column(default=dict)
    state: Mapped[str] = mapped_column(default="queued")
    """`queued`, `running`, `done`, `failed` or `cancelled`."""
    done: Mapped[int] = mapped_column(default=0)
    total: Mapped[int] = mapped_column(default=0)
    note: Mapped[str] = mapped_column(default="")
    error: Mapped[dict[str, Any] | None]
    """`message`, `where` and `hint` of the error with which it ended."""
    result: Mapped[dict[str, Any] | None]
    attempts: Mapped[int] = mapped_column(default=0)
    cancel_wanted: Mapped[bool] = mapped_column(default=False)
    fence: Mapped[int] = mapped_column(default=0)
    leased_by: Mapped[str | None]
    leased_until: Mapped[datetime | None]
    not_before: Mapped[datetime | None]
    """Earliest time of the next try, if something was unavailable; by the clock of the database."""
    waits: Mapped[int] = mapped_column(default=0, server_default="0")
    """How often something was unavailable."""
    urgent: Mapped[bool] = mapped_column(default=False, server_default=false())
    """Whether somebody waits for it, so that it comes before work in the background."""
    asked_at: Mapped[datetime | None]
    """When a photo was last sent that cannot be localized before it is done."""
    created_at: Mapped[datetime] = mapped_column(default=now)
    started_at: Mapped[datetime | None]
    ended_at: Mapped[datetime | None] = mapped_column(index=True)


class QueryRecord(Base):
    """A photo to be localized on a map, and the answer."""

    __tablename__ = "query"
    __table_args__ = (
        Index(None, "map_id", "id"),
        Index("uq_query_key", "map_id", "account_id", "key", unique=True),
        IDS_USED_ONCE,
    )

    id: Mapped[int] = mapped_column(primary_key=True)
    """Never reused, as links contain it."""
    map_id: Mapped[int] = mapped_column(ForeignKey("map.id", ondelete="CASCADE"))
    account_id: Mapped[int | None] = mapped_column(ForeignKey("account.id", ondelete="SET NULL"))
    at: Mapped[datetime] = mapped_column(default=now)
    name: Mapped[str]
    """Name of the original file."""
    file: Mapped[str]
    """Name in the folder of the map's queries, chosen by the server."""
    sha256: Mapped[str | None]
    """Of the file; None for an answer of an older version."""
    width: Mapped[int]
    """Of the upright photo."""
    height: Mapped[int]
    options: Mapped[dict[str, Any]]
    """Options of the request."""
    answer: Mapped[dict[str, Any]]
    """As from `localize --json`."""
    evidence: Mapped[list[dict[str, Any]]] = mapped_column(deferred=True)
    """Matches with photos of the map: `experience`, `query_xy`, `photo_xy` and `inlier` each."""
    adopted_id: Mapped[int | None]
    """Id of the map photo that it has become."""
    key: Mapped[str | None]
    """Idempotency key of the client: a repeated request with it gets this answer."""


class Share(ShareColumns, Base):
    """A view of a map, or of one answer, that is open without signing in."""

    __tablename__ = "share"
    __table_args__ = IDS_USED_ONCE

    map_id: Mapped[int] = mapped_column(ForeignKey("map.id", ondelete="CASCADE"), index=True)
    query_id: Mapped[int | None] = mapped_column(ForeignKey("query.id", ondelete="CASCADE"))
    """Id of the only answer that is shown; None for the whole map."""
    localize: Mapped[bool] = mapped_column(default=False)
    """Whether visitors may localize their own photos."""
    originals: Mapped[bool] = mapped_column(default=False)
    """Whether original files, with their EXIF, can be downloaded."""
    notes: Mapped[bool] = mapped_column(default=False)
    """Whether notes are shown."""
    landmarks: Mapped[bool] = mapped_column(default=False)
    """Whether the map is shown in 3D: landmarks and cameras."""
    contribute: Mapped[bool] = mapped_column(default=False)
    """Whether visitors may give photos, which wait for a decision."""


class Contribution(Base):
    """A photo that a visitor has given to a map.

    It is in the tray until somebody places it, which accepts it, or removes it, which refuses it.
    """

    __tablename__ = "contribution"
    __table_args__ = WITHOUT_ROWID

    map_id: Mapped[int] = mapped_column(ForeignKey("map.id", ondelete="CASCADE"), primary_key=True)
    photo_id: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    share_id: Mapped[int | None] = mapped_column(ForeignKey("share.id", ondelete="SET NULL"), index=True)
    visitor: Mapped[str] = mapped_column(index=True)
    """Hash of share, day and IP address, by which photos of a day are counted."""
    sent_at: Mapped[datetime] = mapped_column(default=now)
    size_bytes: Mapped[int]
    x_px: Mapped[float | None]
    y_px: Mapped[float | None]
    radius_px: Mapped[float | None]
    heading_deg: Mapped[float | None]
    probability: Mapped[float | None]
    """Of the place that localization suggests; None where it has found none."""
    floor: Mapped[int] = mapped_column(default=0)
    """Id of the floor of that place."""
    to_find: Mapped[bool] = mapped_column(default=False, server_default=false())
    """Whether that place is looked for when the map has an index."""
