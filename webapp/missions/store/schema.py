"""The tables of missions: where robots and people were, and what they saw there.

Poses come by the million: they are written and read in bulk, by columns, and never as objects.
"""

from __future__ import annotations

from datetime import datetime
from typing import Any

from sqlalchemy import ForeignKey, Index, LargeBinary, UniqueConstraint
from sqlalchemy.orm import Mapped, mapped_column

from webapp.store.clock import now
from webapp.store.schema import WITHOUT_ROWID, Base, ShareColumns


class Mission(Base):
    """What one robot or person recorded in one session, on a map or anywhere on the Earth."""

    __tablename__ = "mission"
    __table_args__ = ({"sqlite_autoincrement": True},)

    id: Mapped[int] = mapped_column(primary_key=True)
    """Never used again: links and the folder of its photos name it."""
    name: Mapped[str]
    map_id: Mapped[int | None] = mapped_column(ForeignKey("map.id", ondelete="SET NULL"), index=True)
    """Whose roles hold for the mission; without a map it is its account's alone."""
    account_id: Mapped[int | None] = mapped_column(ForeignKey("account.id", ondelete="SET NULL"), index=True)
    created_at: Mapped[datetime] = mapped_column(default=now)
    changed_at: Mapped[datetime] = mapped_column(default=now)
    binned_at: Mapped[datetime | None]
    """When it was put into the bin; None for one in use."""
    start: Mapped[dict[str, Any] | None]
    """`lat`, `lon`, `heading_deg` of the robot's own frame."""
    note: Mapped[str] = mapped_column(default="")
    revision: Mapped[int] = mapped_column(default=0)
    """Counts the changes; each accepted batch is one."""
    ended_at: Mapped[datetime | None]
    """When the robot said that it was over."""
    keep: Mapped[bool] = mapped_column(default=False)
    """True: its tracks are never thinned, whatever the rules."""


class Track(Base):
    """The poses of a mission from one source, and what is known of all of them together."""

    __tablename__ = "track"
    __table_args__ = (UniqueConstraint("mission_id", "source", "name"), {"sqlite_autoincrement": True})

    id: Mapped[int] = mapped_column(primary_key=True)
    mission_id: Mapped[int] = mapped_column(ForeignKey("mission.id", ondelete="CASCADE"))
    source: Mapped[str]
    """`gps`, `odometry`, `visual`, `fused` or `manual`."""
    name: Mapped[str] = mapped_column(default="")
    """Distinguishes several tracks of one source."""
    poses: Mapped[int] = mapped_column(default=0)
    """Their numbers are 0 ... poses - 1."""
    skipped: Mapped[int] = mapped_column(default=0)
    """Poses that the sender left out because nothing had moved."""
    removed: Mapped[int] = mapped_column(default=0)
    """Poses that were stored, and that thinning has removed."""
    thinned_m: Mapped[float | None]
    """With this error at most; None where nothing was thinned, or where only both ends are left."""
    thinned_poses: Mapped[int] = mapped_column(default=0)
    """So many at the begin are what thinning left; those after them came later."""
    distance_m: Mapped[float] = mapped_column(default=0.0)
    """Along all poses, those that were left out or removed included."""
    first_time_s: Mapped[float | None]
    last_time_s: Mapped[float | None]
    """The earliest and the latest, Unix seconds."""
    min_lat: Mapped[float | None]
    max_lat: Mapped[float | None]
    min_lon: Mapped[float | None]
    max_lon: Mapped[float | None]
    built_to: Mapped[int] = mapped_column(default=0)
    """Number of poses that are in pieces."""
    timed: Mapped[bool] = mapped_column(default=True)
    """False where the source has no times: the poses count as some time apart, for their order alone."""


class Pose(Base):
    """Where something was at one time."""

    __tablename__ = "pose"
    __table_args__ = WITHOUT_ROWID

    track_id: Mapped[int] = mapped_column(
        ForeignKey("track.id", ondelete="CASCADE"), primary_key=True, autoincrement=False
    )
    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    """In the order of arrival, from 0; times need not grow with it."""
    time_s: Mapped[float]
    """Unix seconds."""
    lat: Mapped[float]
    lon: Mapped[float]
    height_m: Mapped[float | None]
    heading_deg: Mapped[float | None]
    """Clockwise from north."""
    var_e: Mapped[float | None]
    var_n: Mapped[float | None]
    cov_en: Mapped[float | None]
    """Covariance of the position to the east and north, square metres."""
    travelled_m: Mapped[float]
    """Along the track from its begin, poses that were left out included."""


class TrackPiece(Base):
    """A part of a track, simplified for display: `level` says how much."""

    __tablename__ = "track_piece"

    track_id: Mapped[int] = mapped_column(
        ForeignKey("track.id", ondelete="CASCADE"), primary_key=True, autoincrement=False
    )
    level: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    chunk: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    first_number: Mapped[int]
    count: Mapped[int]
    """Poses that it stands for."""
    min_lat: Mapped[float]
    max_lat: Mapped[float]
    min_lon: Mapped[float]
    max_lon: Mapped[float]
    first_time_s: Mapped[float]
    last_time_s: Mapped[float]
    points: Mapped[bytes] = mapped_column(LargeBinary)
    """float64 (m, 5), little-endian: number, time_s, lat, lon, heading_deg."""


class TrackProfile(Base):
    """Height, speed and distance of a part of a track, for display."""

    __tablename__ = "track_profile"

    track_id: Mapped[int] = mapped_column(
        ForeignKey("track.id", ondelete="CASCADE"), primary_key=True, autoincrement=False
    )
    chunk: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    points: Mapped[bytes] = mapped_column(LargeBinary)
    """float64 (m, 4), little-endian: time_s, travelled_m, speed_mps, height_m."""


def _covariance(row: MissionObject | ObjectSighting) -> tuple[float, float, float] | None:
    """Return variance east, variance north and covariance of the two; None where they are unknown."""
    if row.var_e is None or row.var_n is None or row.cov_en is None:
        return None
    return row.var_e, row.var_n, row.cov_en


def _size(row: MissionObject | ObjectSighting) -> tuple[float, float, float] | None:
    """Return length, width and height; None where they are unknown."""
    if row.size_x_m is None or row.size_y_m is None or row.size_z_m is None:
        return None
    return row.size_x_m, row.size_y_m, row.size_z_m


class MissionObject(Base):
    """Something that was seen on a mission, as it was seen last."""

    __tablename__ = "mission_object"
    __table_args__ = (Index(None, "mission_id", "kind"), Index(None, "mission_id", "revision"))

    mission_id: Mapped[int] = mapped_column(
        ForeignKey("mission.id", ondelete="CASCADE"), primary_key=True, autoincrement=False
    )
    object_id: Mapped[str] = mapped_column(primary_key=True)
    """The sender's; for an associated one the class and a number."""
    associated: Mapped[bool] = mapped_column(default=False)
    """True where detections without an id were joined: the position is the mean of them all."""
    kind: Mapped[str]
    """Class: `car`, `person` ..."""
    first_time_s: Mapped[float]
    last_time_s: Mapped[float]
    lat: Mapped[float]
    lon: Mapped[float]
    height_m: Mapped[float | None]
    var_e: Mapped[float | None]
    var_n: Mapped[float | None]
    cov_en: Mapped[float | None]
    """Covariance of the position to the east and north, square metres."""
    size_x_m: Mapped[float | None]
    size_y_m: Mapped[float | None]
    size_z_m: Mapped[float | None]
    """Length, width and height."""
    confidence: Mapped[float | None]
    photo_sha: Mapped[str | None]
    """Of a photo of the mission."""
    sightings: Mapped[int] = mapped_column(default=0)
    """Their numbers are 0 ... sightings - 1."""
    revision: Mapped[int] = mapped_column(default=0)
    """Of the mission, when this object last changed."""
    state: Mapped[str] = mapped_column(default="found")
    """`found`, `confirmed`, `cleared` or `dismissed`."""
    state_by: Mapped[str | None]
    state_time_s: Mapped[float | None]
    """Who has set the state, and when; None where nobody has."""

    covariance_m2 = property(_covariance)
    size_m = property(_size)


class ObjectSighting(Base):
    """One time that an object was seen."""

    __tablename__ = "sighting"
    __table_args__ = (Index(None, "mission_id", "time_s"),)

    mission_id: Mapped[int] = mapped_column(
        ForeignKey("mission.id", ondelete="CASCADE"), primary_key=True, autoincrement=False
    )
    object_id: Mapped[str] = mapped_column(primary_key=True)
    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    time_s: Mapped[float]
    lat: Mapped[float]
    lon: Mapped[float]
    height_m: Mapped[float | None]
    var_e: Mapped[float | None]
    var_n: Mapped[float | None]
    cov_en: Mapped[float | None]
    size_x_m: Mapped[float | None]
    size_y_m: Mapped[float | None]
    size_z_m: Mapped[float | None]
    confidence: Mapped[float | None]
    photo_sha: Mapped[str | None]

    covariance_m2 = property(_covariance)
    size_m = property(_size)


class ObjectChange(Base):
    """Somebody has set the state of an object."""

    __tablename__ = "object_change"

    mission_id: Mapped[int] = mapped_column(
        ForeignKey("mission.id", ondelete="CASCADE"), primary_key=True, autoincrement=False
    )
    object_id: Mapped[str] = mapped_column(primary_key=True)
    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    state: Mapped[str]
    time_s: Mapped[float]
    by: Mapped[str]
    """Name of the account, which may be deleted since."""
    note: Mapped[str] = mapped_column(default="")


class MissionSender(Base):
    """How far a program that numbers its records has come."""

    __tablename__ = "mission_sender"

    mission_id: Mapped[int] = mapped_column(
        ForeignKey("mission.id", ondelete="CASCADE"), primary_key=True, autoincrement=False
    )
    sender: Mapped[str] = mapped_column(primary_key=True)
    next_seq: Mapped[int] = mapped_column(default=0)
    """All records before it are stored."""
    seen_at: Mapped[datetime] = mapped_column(default=now)


class MissionBatch(Base):
    """The answer to a batch of a program that numbers nothing, for when it sends it again."""

    __tablename__ = "mission_batch"
    __table_args__ = (Index(None, "mission_id", "at"),)

    mission_id: Mapped[int] = mapped_column(
        ForeignKey("mission.id", ondelete="CASCADE"), primary_key=True, autoincrement=False
    )
    key: Mapped[str] = mapped_column(primary_key=True)
    answer: Mapped[dict[str, Any]]
    at: Mapped[datetime] = mapped_column(default=now)


class MissionPhoto(Base):
    """A photo that was taken on a mission."""

    __tablename__ = "mission_photo"

    mission_id: Mapped[int] = mapped_column(
        ForeignKey("mission.id", ondelete="CASCADE"), primary_key=True, autoincrement=False
    )
    sha256: Mapped[str] = mapped_column(primary_key=True)
    name: Mapped[str]
    """Of the original file."""
    path: Mapped[str]
    """Relative to the mission's folder, with forward slashes."""
    width: Mapped[int]
    """Of the upright photo."""
    height: Mapped[int]
    size_bytes: Mapped[int]
    time_s: Mapped[float | None]
    """When it was taken, Unix seconds."""
    object_id: Mapped[str | None]
    """What it shows."""
    fix: Mapped[dict[str, Any] | None]
    """Where it was taken, as `localize --json` says it."""
    fix_state: Mapped[str | None]
    """`queued`, `done` or `failed`; None where nobody asked."""


class MissionShare(ShareColumns, Base):
    """A view of a mission that is open without a sign-in."""

    __tablename__ = "mission_share"

    mission_id: Mapped[int] = mapped_column(ForeignKey("mission.id", ondelete="CASCADE"), index=True)
