"""The tables of missions: tracks of robots and people, and the objects and photos of the missions.

A mission can have millions of poses: they are written and read in bulk, by columns, never as ORM objects.
"""

from __future__ import annotations

from datetime import datetime
from typing import Any

from sqlalchemy import ForeignKey, Index, LargeBinary, UniqueConstraint
from sqlalchemy.orm import Mapped, mapped_column

from webapp.store.clock import now
from webapp.store.schema import IDS_USED_ONCE, WITHOUT_ROWID, Base, ShareColumns


class Mission(Base):
    """The data that one robot or person recorded in one session, on a map or anywhere on the Earth."""

    __tablename__ = "mission"
    __table_args__ = IDS_USED_ONCE

    id: Mapped[int] = mapped_column(primary_key=True)
    """Never reused, since links and the folder of its photos contain it."""
    name: Mapped[str]
    map_id: Mapped[int | None] = mapped_column(ForeignKey("map.id", ondelete="SET NULL"), index=True)
    """The map whose roles apply to the mission; without a map it belongs to its account alone."""
    account_id: Mapped[int | None] = mapped_column(ForeignKey("account.id", ondelete="SET NULL"), index=True)
    created_at: Mapped[datetime] = mapped_column(default=now)
    changed_at: Mapped[datetime] = mapped_column(default=now)
    binned_at: Mapped[datetime | None]
    """When it was moved to the bin; None for one in use."""
    start: Mapped[dict[str, Any] | None]
    """`lat`, `lon`, `heading_deg` of the origin of the robot's frame."""
    note: Mapped[str] = mapped_column(default="")
    revision: Mapped[int] = mapped_column(default=0)
    """Counts the changes; each accepted batch is one."""
    ended_at: Mapped[datetime | None]
    """When the robot ended the mission."""
    keep: Mapped[bool] = mapped_column(default=False)
    """True: its tracks are never thinned."""
    drawings_revision: Mapped[int] = mapped_column(default=0)
    """Revision in which its drawings last changed."""
    silent_after_s: Mapped[float | None]
    """Seconds after which a robot that is not heard counts as silent; None for no alarm."""


class Track(Base):
    """The poses of a mission from one source, with summary values."""

    __tablename__ = "track"
    __table_args__ = (UniqueConstraint("mission_id", "source", "name"), IDS_USED_ONCE)

    id: Mapped[int] = mapped_column(primary_key=True)
    mission_id: Mapped[int] = mapped_column(ForeignKey("mission.id", ondelete="CASCADE"))
    source: Mapped[str]
    """`gps`, `odometry`, `visual`, `fused` or `manual`."""
    name: Mapped[str] = mapped_column(default="")
    """Distinguishes several tracks of one source."""
    poses: Mapped[int] = mapped_column(default=0)
    """Their numbers are 0 ... poses - 1."""
    skipped: Mapped[int] = mapped_column(default=0)
    """Poses that the sender left out because the robot had hardly moved."""
    removed: Mapped[int] = mapped_column(default=0)
    """Stored poses that thinning has removed."""
    thinned_m: Mapped[float | None]
    """Maximum error of thinning; None if nothing was thinned, or if only both ends are left."""
    thinned_poses: Mapped[int] = mapped_column(default=0)
    """Number of poses at the beginning that thinning has kept; later ones are not thinned yet."""
    distance_m: Mapped[float] = mapped_column(default=0.0)
    """Length along all poses, including those left out or removed."""
    first_time_s: Mapped[float | None]
    last_time_s: Mapped[float | None]
    """Earliest and latest time, Unix seconds."""
    min_lat: Mapped[float | None]
    max_lat: Mapped[float | None]
    min_lon: Mapped[float | None]
    max_lon: Mapped[float | None]
    built_to: Mapped[int] = mapped_column(default=0)
    """Number of poses that are in pieces."""
    timed: Mapped[bool] = mapped_column(default=True)
    """False if the source has no times: `time_s` of the poses then only gives their order."""
    look: Mapped[dict[str, Any] | None]
    """The fields of its `TrackLook` that people have set; None for none."""
    look_revision: Mapped[int] = mapped_column(default=0)
    """Revision of the mission in which its look last changed."""


class Pose(Base):
    """A position, and optionally a heading, at one time."""

    __tablename__ = "pose"
    __table_args__ = WITHOUT_ROWID

    track_id: Mapped[int] = mapped_column(
        ForeignKey("track.id", ondelete="CASCADE"), primary_key=True, autoincrement=False
    )
    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    """In order of arrival, from 0; times need not be monotonic."""
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
    """Along the track from its beginning, including poses that were left out."""


class TrackPiece(Base):
    """A part of a track, simplified for display to the degree `level`."""

    __tablename__ = "track_piece"

    track_id: Mapped[int] = mapped_column(
        ForeignKey("track.id", ondelete="CASCADE"), primary_key=True, autoincrement=False
    )
    level: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    chunk: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    first_number: Mapped[int]
    count: Mapped[int]
    """Number of poses that it represents."""
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
    """Return variance east, variance north and covariance of the two; None if unknown."""
    if row.var_e is None or row.var_n is None or row.cov_en is None:
        return None
    return row.var_e, row.var_n, row.cov_en


def _size(row: MissionObject | ObjectSighting) -> tuple[float, float, float] | None:
    """Return length, width and height; None if unknown."""
    if row.size_x_m is None or row.size_y_m is None or row.size_z_m is None:
        return None
    return row.size_x_m, row.size_y_m, row.size_z_m


class MissionObject(Base):
    """An object that was seen on a mission, with the values of its last sighting."""

    __tablename__ = "mission_object"
    __table_args__ = (Index(None, "mission_id", "kind"), Index(None, "mission_id", "revision"))

    mission_id: Mapped[int] = mapped_column(
        ForeignKey("mission.id", ondelete="CASCADE"), primary_key=True, autoincrement=False
    )
    object_id: Mapped[str] = mapped_column(primary_key=True)
    """Given by the sender; for an associated object, the class and a number."""
    associated: Mapped[bool] = mapped_column(default=False)
    """True for an object of detections without an id: the position is their weighted mean."""
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
    """SHA-256 of a photo of the mission."""
    sightings: Mapped[int] = mapped_column(default=0)
    """Their numbers are 0 ... sightings - 1."""
    revision: Mapped[int] = mapped_column(default=0)
    """Revision of the mission in which this object last changed."""
    state: Mapped[str] = mapped_column(default="found")
    """`found`, `confirmed`, `cleared` or `dismissed`."""
    state_by: Mapped[str | None]
    state_time_s: Mapped[float | None]
    """Who set the state, and when; None for the initial state."""

    covariance_m2 = property(_covariance)
    size_m = property(_size)


class ObjectSighting(Base):
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
    """A change of the state of an object by a person."""

    __tablename__ = "object_change"

    mission_id: Mapped[int] = mapped_column(
        ForeignKey("mission.id", ondelete="CASCADE"), primary_key=True, autoincrement=False
    )
    object_id: Mapped[str] = mapped_column(primary_key=True)
    number: Mapped[int] = mapped_column(primary_key=True, autoincrement=False)
    state: Mapped[str]
    time_s: Mapped[float]
    by: Mapped[str]
    """Name of the account, which may have been deleted since."""
    note: Mapped[str] = mapped_column(default="")


class MissionDrawing(Base):
    """An area to be searched, a line or a marker that a person drew on the map."""

    __tablename__ = "drawing"
    __table_args__ = IDS_USED_ONCE

    id: Mapped[int] = mapped_column(primary_key=True)
    mission_id: Mapped[int] = mapped_column(ForeignKey("mission.id", ondelete="CASCADE"), index=True)
    kind: Mapped[str]
    """`area`, `line` or `marker`."""
    name: Mapped[str]
    note: Mapped[str] = mapped_column(default="")
    points: Mapped[bytes] = mapped_column(LargeBinary)
    """float64 (n, 2), little-endian: lat, lon; an area is closed without repeating its first point."""
    assigned: Mapped[str] = mapped_column(default="")
    """Assignee of the area: a name, or that of a track; may be empty."""
    radius_m: Mapped[float | None]
    """Distance at which somebody who passes has searched a spot of the area; None for other kinds."""
    searched_by: Mapped[str | None]
    searched_time_s: Mapped[float | None]
    """Who has marked the area as searched, and when; None for one that is not."""
    created_by: Mapped[str]
    created_time_s: Mapped[float]
    changed_by: Mapped[str]
    changed_time_s: Mapped[float]
    """Names of accounts, which may have been deleted since, and Unix seconds."""
    revision: Mapped[int] = mapped_column(default=1)
    """Counts the changes of this drawing."""


class RobotHeard(Base):
    """When a robot was last heard, by the server's clock."""

    __tablename__ = "robot_heard"

    mission_id: Mapped[int] = mapped_column(
        ForeignKey("mission.id", ondelete="CASCADE"), primary_key=True, autoincrement=False
    )
    robot: Mapped[str] = mapped_column(primary_key=True)
    """Name of its tracks, perhaps empty."""
    time_s: Mapped[float]
    silence_noted_s: Mapped[float | None]
    """The `time_s` since which it is silent, once that is noted; None, or an earlier time: it is not."""


class RobotReport(Base):
    """What a robot said of itself."""

    __tablename__ = "robot_status"
    __table_args__ = (Index("ix_robot_status_time_s", "mission_id", "robot", "time_s"),)

    id: Mapped[int] = mapped_column(primary_key=True)
    mission_id: Mapped[int] = mapped_column(ForeignKey("mission.id", ondelete="CASCADE"))
    robot: Mapped[str]
    time_s: Mapped[float]
    """By the robot's clock, Unix seconds."""
    battery_percent: Mapped[float | None]
    link_percent: Mapped[float | None]
    mode: Mapped[str | None]
    text: Mapped[str | None]


class RobotSilence(Base):
    """A time in which a robot was not heard for longer than its mission allowed, and which is over."""

    __tablename__ = "robot_silence"

    id: Mapped[int] = mapped_column(primary_key=True)
    mission_id: Mapped[int] = mapped_column(ForeignKey("mission.id", ondelete="CASCADE"), index=True)
    robot: Mapped[str]
    since_s: Mapped[float]
    until_s: Mapped[float]


class MissionSender(Base):
    """Progress of a client that numbers its records."""

    __tablename__ = "mission_sender"

    mission_id: Mapped[int] = mapped_column(
        ForeignKey("mission.id", ondelete="CASCADE"), primary_key=True, autoincrement=False
    )
    sender: Mapped[str] = mapped_column(primary_key=True)
    next_seq: Mapped[int] = mapped_column(default=0)
    """All records before it are stored."""
    seen_at: Mapped[datetime] = mapped_column(default=now)


class MissionBatch(Base):
    """The answer to a batch with an idempotency key, in case it is sent again."""

    __tablename__ = "mission_batch"
    __table_args__ = (Index(None, "mission_id", "at"),)

    mission_id: Mapped[int] = mapped_column(
        ForeignKey("mission.id", ondelete="CASCADE"), primary_key=True, autoincrement=False
    )
    key: Mapped[str] = mapped_column(primary_key=True)
    answer: Mapped[dict[str, Any]]
    at: Mapped[datetime] = mapped_column(default=now)


class MissionPhoto(Base):
    __tablename__ = "mission_photo"

    mission_id: Mapped[int] = mapped_column(
        ForeignKey("mission.id", ondelete="CASCADE"), primary_key=True, autoincrement=False
    )
    sha256: Mapped[str] = mapped_column(primary_key=True)
    name: Mapped[str]
    """Name of the original file."""
    path: Mapped[str]
    """Relative to the mission's folder, with forward slashes."""
    width: Mapped[int]
    """Of the upright photo."""
    height: Mapped[int]
    size_bytes: Mapped[int]
    time_s: Mapped[float | None]
    """When it was taken, Unix seconds."""
    object_id: Mapped[str | None]
    """The object that it shows."""
    fix: Mapped[dict[str, Any] | None]
    """Result of its localization, in the format of `localize --json`."""
    fix_state: Mapped[str | None]
    """`queued`, `done` or `failed`; None if localization was not requested."""


class MissionShare(ShareColumns, Base):
    """A view of a mission that needs no sign-in."""

    __tablename__ = "mission_share"
    __table_args__ = IDS_USED_ONCE

    mission_id: Mapped[int] = mapped_column(ForeignKey("mission.id", ondelete="CASCADE"), index=True)


class MissionPhone(Base):
    """A phone that sends its positions to a mission, by a link and without an account."""

    __tablename__ = "mission_phone"
    __table_args__ = (UniqueConstraint("mission_id", "name"), IDS_USED_ONCE)

    id: Mapped[int] = mapped_column(primary_key=True)
    mission_id: Mapped[int] = mapped_column(ForeignKey("mission.id", ondelete="CASCADE"))
    name: Mapped[str]
    """Also the name of its track."""
    token_hash: Mapped[str] = mapped_column(unique=True)
    account_id: Mapped[int | None] = mapped_column(ForeignKey("account.id", ondelete="SET NULL"))
    """Account that made the link."""
    created_at: Mapped[datetime] = mapped_column(default=now)
    heard_at: Mapped[datetime | None]
    positions: Mapped[int] = mapped_column(default=0)
    """How many it has sent."""
