"""Bags of ROS 1 and ROS 2 (SQLite and MCAP), read without ROS.

Each topic with poses is a track; objects come from detections and markers. Transforms to the robot are read
as a track only if no other topic has poses in the robot's frame, or if requested. Topics of other types are
left out. Frames are identified by name (`header.frame_id`, `child_frame_id`); objects in one without poses,
such as a camera's, get into one that has some, by the chain of transforms.

Definitions of messages come from the bag itself and can differ: the fields of `vision_msgs` have changed
between versions, so they are looked up by name.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Collection, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, field, replace
from itertools import islice
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from webapp.errors import ExpMapError, TrackError
from webapp.extras import extra
from webapp.files.exchange.tum import yaw_of
from webapp.missions.core.trajectory.planned import is_planned
from webapp.missions.core.trajectory.records import make_poses
from webapp.missions.core.trajectory.robotframe import LocalPoses
from webapp.missions.files.readers.bag_frames import FrameTree, in_known_frame
from webapp.missions.files.readers.bag_limits import (
    Stamp,
    TopicClock,
    clock_of,
    limited_reader1,
    limited_reader2,
)
from webapp.missions.files.track_chunks import (
    CHUNK,
    Findings,
    LocalSighting,
    Piece,
    RobotObjects,
    RobotPiece,
    WorldPiece,
)
from webapp.missions.files.track_format import Beginning, FormatAbout, Reader, Selection, TrackFormat

if TYPE_CHECKING:
    from rosbags.highlevel import AnyReader
    from rosbags.interfaces import Connection


_NAN = math.nan
_UNKNOWN = (_NAN, _NAN, _NAN)
_SHAPES = (
    "arrow",
    "cube",
    "sphere",
    "cylinder",
    "line",
    "lines",
    "cubes",
    "spheres",
    "points",
    "text",
    "mesh",
)
_WORLDS = ("map", "odom")
_BODIES = ("base_link", "base_footprint")
_NO_FIX = -1
_SAMPLED = 50
"""Number of messages of a topic by which its time stamps are compared with the recording."""

_ADD = 0

PLANNED = "messages with planned poses, which were not driven (name the topic to import them)"


@dataclass(frozen=True, slots=True)
class _RosPose:
    # Seconds since 1970; latitude, longitude and height, or x, y and z in the robot's frame; yaw, radians;
    # variances of east and north, or of x and y, and their covariance, square metres.
    values: tuple[float, ...]
    frame: str = ""
    body: str = ""
    # The time is from the header of the pose, not that at which the message was recorded.
    stamped: bool = True


@dataclass(frozen=True, slots=True)
class _DetectedObject:
    frame: str  # Of its position
    sighting: LocalSighting


def _fix(message: Any, at_s: float) -> list[_RosPose]:
    if message.status.status <= _NO_FIX:
        return []
    known = message.position_covariance_type != 0
    covariance = _covariance(message.position_covariance, side=3) if known else _UNKNOWN
    place = map(float, (message.latitude, message.longitude, message.altitude))
    return [_stamped(message, (*place, _NAN, *covariance), at_s)]


def _odometry(message: Any, at_s: float) -> list[_RosPose]:
    covariance = _covariance(message.pose.covariance, side=6)
    values = (*_place(message.pose.pose), *covariance)
    return [_stamped(message, values, at_s, body=message.child_frame_id)]


def _pose(message: Any, at_s: float) -> list[_RosPose]:
    return [_RosPose((at_s, *_place(message), *_UNKNOWN), stamped=False)]


def _pose_stamped(message: Any, at_s: float) -> list[_RosPose]:
    return [_stamped(message, (*_place(message.pose), *_UNKNOWN), at_s)]


def _pose_with_covariance(message: Any, at_s: float) -> list[_RosPose]:
    covariance = _covariance(message.pose.covariance, side=6)
    return [_stamped(message, (*_place(message.pose.pose), *covariance), at_s)]


def _path(message: Any, at_s: float) -> list[_RosPose]:
    rows = [row for pose in message.poses for row in _pose_stamped(pose, at_s)]
    frame = message.header.frame_id
    return [replace(row, frame=row.frame or frame) for row in rows]


def _transforms(message: Any, at_s: float) -> list[_RosPose]:
    """Read the transforms from a world frame to the robot, found by the usual frame names (REP 105)."""
    rows = []
    for one in message.transforms:
        frame, body = one.header.frame_id, one.child_frame_id
        if frame.rpartition("/")[2] in _WORLDS and body.rpartition("/")[2] in _BODIES:
            place = _point(one.transform.translation, one.transform.rotation)
            rows.append(_stamped(one, (*place, *_UNKNOWN), at_s, body=body))
    return rows


def _detections(message: Any, at_s: float) -> Iterator[_DetectedObject]:
    for detection in message.detections:
        frame = detection.header.frame_id or message.header.frame_id
        name = getattr(detection, "id", "") or getattr(detection, "tracking_id", "")
        best = max(detection.results, key=_score, default=None)
        kind = (
            "object" if best is None else str(getattr(_hypothesis(best), "class_id", getattr(best, "id", "")))
        )
        time_s = _time(detection, _time(message, at_s))
        xyz = _xyz(detection.bbox.center.position)
        score = None if best is None else _score(best)
        seen = LocalSighting(str(name) or None, kind or "object", time_s, xyz, score, size_m=_size(detection))
        yield _DetectedObject(frame, seen)


def _markers(message: Any, at_s: float) -> Iterator[_DetectedObject]:
    for marker in message.markers:
        if marker.action != _ADD:
            continue
        shape = _SHAPES[marker.type] if 0 <= marker.type < len(_SHAPES) else "marker"
        name = f"{marker.ns}/{marker.id}" if marker.ns else str(marker.id)
        kind = marker.ns or marker.text or shape
        seen = LocalSighting(name, kind, _time(marker, at_s), _xyz(marker.pose.position))
        yield _DetectedObject(marker.header.frame_id, seen)


_POSES: dict[str, Callable[[Any, float], list[_RosPose]]] = {
    "sensor_msgs/msg/NavSatFix": _fix,
    "nav_msgs/msg/Odometry": _odometry,
    "nav_msgs/msg/Path": _path,
    "geometry_msgs/msg/Pose": _pose,
    "geometry_msgs/msg/PoseStamped": _pose_stamped,
    "geometry_msgs/msg/PoseWithCovarianceStamped": _pose_with_covariance,
    "tf2_msgs/msg/TFMessage": _transforms,
}
"""Parser of each message type: (message, time of recording in seconds) -> its poses."""

_OBJECTS: dict[str, Callable[[Any, float], Iterator[_DetectedObject]]] = {
    "vision_msgs/msg/Detection3DArray": _detections,
    "visualization_msgs/msg/MarkerArray": _markers,
}
"""Parser of each message type: (message, time of recording in seconds) -> its objects."""

_WORLD = "sensor_msgs/msg/NavSatFix"
"""The type whose poses are on the Earth."""

_TRANSFORMS = "tf2_msgs/msg/TFMessage"
"""The type that usually duplicates odometry."""

_PLANS = {
    "nav_msgs/msg/Path",
    "geometry_msgs/msg/Pose",
    "geometry_msgs/msg/PoseStamped",
    "geometry_msgs/msg/PoseWithCovarianceStamped",
}
"""The types that also planners send."""

_POSE = "geometry_msgs/msg/Pose"
"""The type without a header."""

_PATH = "nav_msgs/msg/Path"
"""The type whose messages repeat the poses of earlier ones."""


def _stamped(message: Any, values: tuple[float, ...], at_s: float, *, body: str = "") -> _RosPose:
    """Make a pose from all of its values except the time, which is in the header of its message."""
    time_s = _time(message, _NAN)
    stamped = not math.isnan(time_s)
    return _RosPose((time_s if stamped else at_s, *values), message.header.frame_id, body, stamped)


def _time(message: Any, otherwise_s: float) -> float:
    """Return the time in the header; a zero stamp means unknown."""
    stamp = message.header.stamp
    return stamp.sec + stamp.nanosec * 1e-9 if stamp.sec or stamp.nanosec else otherwise_s


def _place(pose: Any) -> tuple[float, float, float, float]:
    return _point(pose.position, pose.orientation)


def _point(at: Any, turn: Any) -> tuple[float, float, float, float]:
    yaw = float(yaw_of(np.array([[turn.x, turn.y, turn.z, turn.w]]))[0])
    return float(at.x), float(at.y), float(at.z), yaw


def _covariance(matrix: Any, *, side: int) -> tuple[float, float, float]:
    """Return the part of the first two axes; non-positive or infinite variances mean unknown."""
    var_x, var_y, cov = float(matrix[0]), float(matrix[side + 1]), float(matrix[1])
    good = 0.0 < var_x < math.inf and 0.0 < var_y < math.inf and cov * cov <= var_x * var_y
    return (var_x, var_y, cov) if good else _UNKNOWN


def _size(detection: Any) -> tuple[float, float, float] | None:
    """Return the size of the bounding box; zeros mean unknown."""
    size = detection.bbox.size
    sides = (float(size.x), float(size.y), float(size.z))
    return sides if all(0.0 < side < math.inf for side in sides) else None


def _xyz(at: Any) -> tuple[float, float, float]:
    return float(at.x), float(at.y), float(at.z)


def _hypothesis(result: Any) -> Any:
    """Return the message with class and score, which is nested since ROS 2 Galactic."""
    return getattr(result, "hypothesis", result)


def _score(result: Any) -> float:
    return float(_hypothesis(result).score)


@dataclass(frozen=True, slots=True)
class Topic:
    name: str
    type: str  # Type of its messages: `nav_msgs/msg/Odometry`
    messages: int
    readable: bool  # Whether poses or objects can be read from it


def topics(path: Path, *, suffix: str) -> list[Topic]:
    """List the topics of a bag; parameters and errors as `read`."""
    with _opened(path, suffix) as bag:
        found = sorted({(c.topic, c.msgtype, c.msgcount) for c in bag.connections})
    return [Topic(name, kind, count, kind in _POSES or kind in _OBJECTS) for name, kind, count in found]


def read(path: Path, *, suffix: str, wanted: Collection[str] = (), findings: Findings) -> Iterator[Piece]:
    """Read the poses and objects of a bag in the order of its messages.

    Args:
        path: A file, or the folder of a ROS 2 bag.
        suffix: ".bag", ".db3", ".mcap" or "". Format, which may differ from the suffix of `path`; empty for a
            folder.
        wanted: Topics; empty for all that can be read.

    Raises:
        TrackError: The bag is damaged or unfinished, a wanted topic is missing, or no topic can be read.
        MissingPart: rosbags is not installed.
    """
    with _opened(path, suffix) as bag:
        chosen = _chosen(bag.connections, wanted, findings=findings)
        several = _several(bag, chosen)
        clocks = _clocks(bag, chosen, findings=findings)
        logs: dict[str, _Log] = {}
        tree = _frame_tree(bag, chosen)
        for topic, kind, at_ns, message in _messages(bag, chosen):
            at_s = at_ns * 1e-9
            if kind in _OBJECTS:
                for log in logs.values():  # first the poses from which the objects were seen
                    yield from log.pieces()
                pairs = [pair for log in logs.values() for pair in log.pairs]
                fixed, bodies = ({pair[side] for pair in pairs} - {""} for side in (0, 1))
                for piece in _objects(message, kind, at_s, clock=clocks[topic], findings=findings):
                    yield from in_known_frame(piece, tree, fixed=fixed, bodies=bodies, findings=findings)
            else:
                log = logs.setdefault(topic, _Log(topic, kind, clocks[topic], topic in several))
                yield from log.add(message, at_s, findings=findings)
        for log in logs.values():
            yield from log.pieces()


Pair = tuple[str, str]
"""Frames of the poses and of the moving body."""


@dataclass(slots=True)
class _Log:
    """Buffers the poses of a topic until they are yielded as pieces; each pair of frames is a track."""

    topic: str
    kind: str
    clock: TopicClock
    several: bool = False  # Whether the topic has several pairs of frames for sure
    pairs: dict[Pair, list[_RosPose]] = field(default_factory=dict)
    last_s: float = -math.inf
    count: int = 0

    def add(self, message: Any, at_s: float, *, findings: Findings) -> Iterator[Piece]:
        with _reading():
            rows = _POSES[self.kind](message, at_s)
        if not rows and self.kind == _WORLD:
            findings.skip("fixes marked invalid by the receiver", where=self.topic)
        if self.kind == _PATH:
            rows = self.fresh(rows, at_s)
        if self.kind != _POSE:
            rows = [self.timed(row, at_s, findings=findings) for row in rows]
        for row in rows:
            if not all(map(math.isfinite, row.values[:4])):
                findings.skip("poses with a time or a position that is not a number", where=self.topic)
                continue
            pair = ("", "") if self.kind == _WORLD else (row.frame.strip("/"), row.body.strip("/"))
            buffer = self.pairs.setdefault(pair, [])
            if len(self.pairs) == 2:
                findings.note(f"{self.topic} has poses in several frames: each is a track of its own")
            buffer.append(row)
            if len(buffer) == CHUNK:
                yield self.piece(pair)

    def timed(self, row: _RosPose, at_s: float, *, findings: Findings) -> _RosPose:
        """Replace the time of the header if it cannot be right."""
        stamp_s = row.values[0] if row.stamped else None
        frames = (row.frame, row.body)
        time_s = self.clock.time(stamp_s, at_s, frames=frames, findings=findings)
        return row if time_s == stamp_s else replace(row, values=(time_s, *row.values[1:]), stamped=False)

    def fresh(self, rows: list[_RosPose], at_s: float) -> list[_RosPose]:
        """Leave out poses that earlier paths had: found by their times, or without times by their number."""
        stamped = bool(rows) and all(row.stamped and self.clock.trusts(row.values[0], at_s) for row in rows)
        new = [row for row in rows if row.values[0] > self.last_s] if stamped else rows[self.count :]
        self.last_s = max([self.last_s, *(row.values[0] for row in new if stamped)])
        self.count = max(self.count, len(rows))
        return new

    def pieces(self) -> Iterator[Piece]:
        for pair, rows in self.pairs.items():
            if rows:
                yield self.piece(pair)

    def piece(self, pair: Pair) -> Piece:
        rows = self.pairs[pair]
        table = np.array([row.values for row in rows])
        self.pairs[pair] = []
        times, place, yaw, covariance = table[:, 0], table[:, 1:4], table[:, 4], table[:, 5:8]
        if self.kind == _WORLD:
            poses = make_poses(times, place[:, :2], height_m=place[:, 2], covariance_m2=covariance)
            return WorldPiece(self.topic, "gps", poses)
        is_first = not self.several and pair == next(iter(self.pairs))
        track = self.topic if is_first else " ".join(filter(None, (self.topic, *pair)))
        return RobotPiece(track, "odometry", *pair, LocalPoses(times, place, yaw, covariance))


def _frame_tree(bag: AnyReader, chosen: list[Connection]) -> FrameTree:
    """Read the transforms of a bag, if it has objects that may need them."""
    tree = FrameTree()
    if not any(one.msgtype in _OBJECTS for one in chosen):
        return tree
    found = [one for one in bag.connections if one.msgtype == _TRANSFORMS]
    for topic, _, at_ns, message in _messages(bag, found) if found else ():
        with _reading():
            tree.add(message, recorded_s=at_ns * 1e-9, static=topic.endswith("tf_static"))
    return tree


def _several(bag: AnyReader, chosen: list[Connection]) -> set[str]:
    """Find the topics whose transforms have several pairs of frames, such as those of several robots."""
    transforms = [connection for connection in chosen if connection.msgtype == _TRANSFORMS]
    pairs: dict[str, set[Pair]] = {}
    for topic, kind, _, message in _messages(bag, transforms) if transforms else ():
        with _reading():
            rows = _POSES[kind](message, 0.0)
        pairs.setdefault(topic, set()).update((row.frame.strip("/"), row.body.strip("/")) for row in rows)
    return {topic for topic, found in pairs.items() if len(found) > 1}


def _clocks(bag: AnyReader, chosen: list[Connection], *, findings: Findings) -> dict[str, TopicClock]:
    """Look at the first time stamps of each topic."""
    clocks: dict[str, TopicClock] = {}
    for name in sorted({connection.topic for connection in chosen}):
        headed = [one for one in chosen if one.topic == name and one.msgtype != _POSE]
        stamps: dict[Pair, list[Stamp]] = {}
        for _, kind, at_ns, message in islice(_messages(bag, headed), _SAMPLED) if headed else ():
            for frames, time_s in _stamps(message, kind, at_ns * 1e-9).items():
                stamps.setdefault(frames, []).append((time_s, at_ns * 1e-9))
        clocks[name] = clock_of(name, list(stamps.values()), findings=findings)
    return clocks


def _stamps(message: Any, kind: str, at_s: float) -> dict[Pair, float]:
    """Return the last time stamp of each pair of frames in a message."""
    with _reading():
        if kind in _OBJECTS:
            times = {one.frame: one.sighting.time_s for one in _OBJECTS[kind](message, at_s)}
            return {(frame, ""): time_s for frame, time_s in times.items() if time_s != at_s}
        rows = [row for row in _POSES[kind](message, at_s) if row.stamped]
        return {(row.frame, row.body): row.values[0] for row in rows}


def _objects(
    message: Any, kind: str, at_s: float, *, clock: TopicClock, findings: Findings
) -> Iterator[RobotObjects]:
    topic = clock.topic
    with _reading():
        seen = [_timed(one, at_s, clock=clock, findings=findings) for one in _OBJECTS[kind](message, at_s)]
    by_frame: dict[str, list[LocalSighting]] = {}
    for one in seen:
        if not all(map(math.isfinite, (one.sighting.time_s, *one.sighting.xyz_m))):
            findings.skip("objects with a time or a position that is not a number", where=topic)
        else:
            by_frame.setdefault(one.frame.strip("/"), []).append(one.sighting)
    for frame, sightings in by_frame.items():
        yield RobotObjects(frame, tuple(sightings))


def _timed(one: _DetectedObject, at_s: float, *, clock: TopicClock, findings: Findings) -> _DetectedObject:
    """Replace the time of the header if it cannot be right."""
    stamp_s = one.sighting.time_s
    if stamp_s == at_s or not math.isfinite(stamp_s):
        return one
    time_s = clock.time(stamp_s, at_s, frames=(one.frame, ""), findings=findings)
    return replace(one, sighting=replace(one.sighting, time_s=time_s))


def _chosen(
    connections: list[Connection], wanted: Collection[str], *, findings: Findings
) -> list[Connection]:
    there = {c.topic for c in connections}
    unknown = [name for name in wanted if name not in there]
    if unknown:
        raise TrackError(
            f"the bag has no topic {unknown[0]!r}", hint=f"it has {', '.join(sorted(there))[:300]}"
        )
    driven = [c for c in connections if not _is_plan(c)]
    moving = any(c.msgtype in _POSES and c.msgtype not in {_WORLD, _TRANSFORMS} for c in driven)
    chosen = []
    for c in connections:
        if _is_plan(c) and not wanted:
            findings.skip(PLANNED, where=c.topic, count=c.msgcount)
            continue
        if c.msgtype == _TRANSFORMS and moving and not wanted:
            reason = "transforms: other topics have the robot's poses"
            findings.skip(reason, where=c.topic, count=c.msgcount)
            continue
        readable = c.msgtype in _POSES or c.msgtype in _OBJECTS
        if readable and (not wanted or c.topic in wanted):
            chosen.append(c)
        elif c.topic in wanted:
            raise TrackError(f"messages of {c.msgtype} hold no known poses", where=c.topic)
        else:
            reason = "that was not asked for" if readable else f"of type {c.msgtype}, which is not used"
            findings.skip(f"messages of a topic {reason}", where=c.topic, count=c.msgcount)
    if not chosen:
        planned = [c.topic for c in connections if _is_plan(c)]
        supported = f"supported: {', '.join([*_POSES, *_OBJECTS])}"
        hint = f"planned poses have to be asked for by topic: {planned[0]}" if planned else supported
        raise TrackError("the bag has no topic with poses or objects", hint=hint)
    return chosen


def _is_plan(connection: Connection) -> bool:
    """Return whether poses of a topic were only planned: by its name, of types that plans have."""
    return connection.msgtype in _PLANS and is_planned(connection.topic)


def _messages(bag: AnyReader, chosen: list[Connection]) -> Iterator[tuple[str, str, int, Any]]:
    with _reading():
        messages = bag.messages(connections=chosen)
    while True:
        with _reading():
            found = next(messages, None)
            if found is None:
                return
            connection, at_ns, raw = found
            message = bag.deserialize(raw, connection.msgtype)
        yield connection.topic, connection.msgtype, at_ns, message


@contextmanager
def _opened(path: Path, suffix: str) -> Iterator[AnyReader]:
    with extra("missions"):
        from rosbags.highlevel import AnyReader
        from rosbags.typesys import Stores, get_typestore
    with _reading():
        # message definitions are in the bag, except in ROS 2 bags in SQLite from before 2023
        named = _called(path, suffix)
        bag = AnyReader([named], default_typestore=get_typestore(Stores.ROS2_HUMBLE))
        used = {*_POSES, *_OBJECTS}
        bag.readers = [limited_reader2(named, used=used)] if bag.is2 else [limited_reader1(named, used=used)]
        bag.open()
    try:
        yield bag
    finally:
        bag.close()


@contextmanager
def _reading() -> Iterator[None]:
    """Convert exceptions of the library to `TrackError`."""
    try:
        yield
    except (ExpMapError, MemoryError):
        raise
    except Exception as error:  # its parsers raise arbitrary exceptions for damaged bags
        said = " ".join(str(error).split())[:200] or type(error).__name__
        hint = "was its recording cut off? Then reindex it with ROS's own tools"
        raise TrackError(f"the bag cannot be read: {said}", hint=hint) from error


def _called(path: Path, suffix: str) -> Path:
    """Return the path with its `suffix` overridden, since the library infers the format from it."""
    if path.suffix == suffix or not suffix:
        return path
    named: Path = type("Named", (type(path),), {"suffix": suffix})(path)
    return named


def folder_kind(path: Path) -> TrackFormat:
    """Return the format of a folder; raises TrackError if it is no bag."""
    if (path / "metadata.yaml").is_file():
        return _FOLDER
    raise TrackError("the folder is not a ROS 2 bag", hint="it needs a metadata.yaml")


def _starts(magic: bytes) -> Callable[[Beginning], bool]:
    return lambda beginning: beginning.head.startswith(magic)


def _reader(suffix: str) -> Reader:
    def reader(path: Path, selection: Selection, findings: Findings) -> Iterator[Piece]:
        yield from read(path, suffix=suffix, wanted=selection.topics, findings=findings)

    return reader


def _bag(name: str, title: str, *, suffix: str, magic: bytes, **rest: Any) -> TrackFormat:
    return replace(
        _FOLDER,
        name=name,
        title=title,
        suffix=suffix,
        endings=(suffix,),
        is_one=_starts(magic),
        read=_reader(suffix),
        **{"about": _ROS2, "scratch": 0.0, **rest},
    )


_ROS1 = FormatAbout(
    tracks="topics of `NavSatFix`, `Odometry`, `Pose`, `PoseStamped`, `PoseWithCovarianceStamped`, `Path`, "
    "`TFMessage` ([which transforms](robot-client.md#frames-and-topics)); ROS is not needed",
    objects="`Detection3DArray`, `MarkerArray`",
    left_out="topics of other types; plans and goals (`/plan`, `/goal_pose` ...), unless named",
    written_by="`rosbag record`",
)
_ROS2 = FormatAbout("as of a ROS 1 bag", objects="as of a ROS 1 bag", written_by="`ros2 bag record`")
_FOLDER = TrackFormat(
    "ros2-folder",
    "ROS 2 bag",
    "ROS bags",
    endings=(),
    read=_reader(""),
    about=replace(_ROS2, tracks="a folder with `metadata.yaml` (command only), as of a ROS 1 bag"),
    needs="missions",
    preload=("rosbags.highlevel", "rosbags.typesys", "rosbags.typesys.stores.ros2_humble"),
    suffix="",
    scratch=None,  # its files may be compressed
)
FORMATS = (
    _bag("ros1", "ROS 1 bag", suffix=".bag", magic=b"#ROSBAG V", about=_ROS1),
    # SQLite sorts in a temporary file, of at most twice the size
    _bag("ros2-sqlite", "ROS 2 bag (SQLite)", suffix=".db3", magic=b"SQLite format 3\0", scratch=2.0),
    _bag("ros2-mcap", "ROS 2 bag (MCAP)", suffix=".mcap", magic=b"\x89MCAP0\r\n", called="MCAP"),
    _FOLDER,
)
