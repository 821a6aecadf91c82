"""Node `mission_bridge`: sends positions, detected objects and their images to a mission, through outages.

Each pose or detection becomes a record in the spool of the robots' client, which sends it exactly once, even
through network outages. Messages that publishers repeat after a restart of the bridge are recognised by
their content, and left out.
"""

from __future__ import annotations

import io
import math
from collections import OrderedDict
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import Odometry
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import BatteryState, CameraInfo, CompressedImage, Image, NavSatFix, NavSatStatus
from std_msgs.msg import Header
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from expmap_ros import running
from expmap_ros.client import DiskFull, InputError, RobotClient, RobotOptions, StorageError
from expmap_ros.ground import GroundCamera, Pinhole
from expmap_ros.managed import ManagedNode
from expmap_ros.messages import TF_MESSAGE
from expmap_ros.parameters import SERVER, Parameter, ParameterError, names, numbers, token_of
from expmap_ros.pictures import UnusableImage, photo_of
from expmap_ros.robot_frame import (
    Box,
    LocalPose,
    Place,
    RobotFrame,
    Sighting,
    boxes_of,
    pose_of,
    sightings_of,
)
from expmap_ros.sent import Identity, Numbering, SentMessages, object_identity, pose_identity

try:
    from vision_msgs.msg import Detection2DArray, Detection3DArray
except ModuleNotFoundError:  # optional: markers work without it
    Detection2DArray = Detection3DArray = None

PARAMETERS = (
    *SERVER,
    Parameter("mission", 0, "Number of the mission.", limits=(0, 2**31 - 1)),
    Parameter("spool", "", "Folder for unsent data, of this mission only; the next start sends it."),
    Parameter("start", "", "LAT,LON,HEADING of the origin of odometry; without it odometry is left out."),
    Parameter("tf", "", "FRAME,BODY: the transforms from one to the other are a track; without it none are."),
    Parameter(
        "camera",
        "",
        "FORWARD,LEFT,UP,PITCH,YAW of the camera of /detections_2d: metres, degrees down, left.",
    ),
    Parameter("max_range_m", 50.0, "Leave out 2D detections farther from the camera.", limits=(0, 1e6)),
    Parameter("min_move", "0", "Leave out poses that moved no more: 0.5m, 0.00001deg; 0 keeps all."),
    Parameter("sync_s", 0.5, "Seconds whose records a power cut can cost at most; 0: none.", limits=(0, 60)),
    Parameter("limit_mb", 1000.0, "Megabytes of the spool, at most.", limits=(1, 1e6)),
)

QUEUE = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
"""Queues up to this many messages while the disk is busy."""

RAW_IMAGES = QoSProfile(depth=10, reliability=ReliabilityPolicy.RELIABLE)
"""A short queue, since raw images need much memory."""

_STAMPS = 200
"""Number of stamps for which images and objects are remembered, to be matched."""

_BATTERY_EVERY_S = 60.0
"""Interval at which a battery is reported that has not changed by a percent."""

Track = tuple[str, str]
"""Source and name of a track."""

Take = Callable[[Any, float], None]
"""Callback with a message and the time when it was published, seconds since 1970."""


class Unplaced(Exception):
    """The position of an object cannot be computed; the message says what is missing."""


class MissionBridge(ManagedNode):
    """Subscribes to topics of a robot, and stores the data in a spool for the server."""

    def __init__(self, **options: Any) -> None:
        super().__init__("mission_bridge", PARAMETERS, **options)
        self._counts = dict.fromkeys(("received", "written", "hardly moved", "repeated", "unusable"), 0)
        self._refused = ""
        self._lens: Pinhole | None = None
        self._battery = (math.nan, -math.inf)
        self._photos: OrderedDict[float, str] = OrderedDict()
        self._objects: OrderedDict[float, str] = OrderedDict()
        self.start()

    def configure(self) -> None:
        """Open the spool, and start to send its content. Raises ParameterError."""
        start = numbers("start", self._values["start"], ("LAT", "LON", "HEADING"))
        self._robot = None if start is None else RobotFrame(*start)
        self._tf = names("tf", self._values["tf"], ("FRAME", "BODY"))
        if self._tf and TF_MESSAGE is None:
            raise ParameterError("tf: tf2_msgs is not installed")
        self._camera = _camera(self._values["camera"])
        self._client = _client(self._values)
        self.holds(lambda: self._client.close(wait_s=0.0))
        self._sent = SentMessages(self._client.recent_records())
        self._diagnostics = self.advertise(DiagnosticArray, "/diagnostics", running.RESULTS)

    def activate(self) -> None:
        """Subscribe to the topics of the robot."""
        self._hear(NavSatFix, "/fix", self._take_fix)
        self._hear(Odometry, "/odom", self._take_odometry)
        self._hear(BatteryState, "/battery_state", self._take_battery)
        if self._tf:
            self._hear(TF_MESSAGE, "/tf", self._take_transforms)
        self._hear(MarkerArray, "/objects", self._take_objects)
        if Detection3DArray is not None:
            self._hear(Detection3DArray, "/detections", self._take_objects)
            self._hear(Detection2DArray, "/detections_2d", self._take_boxes)
            self._hear(CameraInfo, "/detections_2d/camera_info", self._take_lens)
        self._hear(CompressedImage, "/objects/image/compressed", self._take_photo)
        self._hear(Image, "/objects/image", self._take_photo)
        self.repeat(1.0, self._report)
        self.serve(Trigger, "~/end", self._end)

    def _hear(self, kind: type, topic: str, take: Take) -> None:
        def guarded(message: Any, info: Mapping[str, Any]) -> None:
            self._counts["received"] += 1
            with self._reporting():
                take(message, self._published_s(info))

        self.listen(kind, topic, guarded, quality=RAW_IMAGES if kind is Image else QUEUE)

    @contextmanager
    def _reporting(self) -> Iterator[None]:
        """Report unusable messages instead of raising errors."""
        try:
            yield
        except (InputError, DiskFull, StorageError, UnusableImage, Unplaced) as error:
            self._counts["unusable"] += 1
            self._refused = str(error)
            self.get_logger().error(str(error), throttle_duration_sec=10.0)

    def _published_s(self, info: Mapping[str, Any]) -> float:
        """Return the time when a message was published, which is the same when it is repeated."""
        clock = self.get_clock()
        known: int = 0 if clock.ros_time_is_active else info["source_timestamp"]
        return float(known or clock.now().nanoseconds) * 1e-9

    def _is_new(self, identity: Identity) -> bool:
        if identity in self._sent:
            self._counts["repeated"] += 1
            return False
        return True

    def _written(self, identity: Identity) -> None:
        self._counts["written"] += 1
        self._sent.add(identity)

    def _take_fix(self, fix: NavSatFix, at_s: float) -> None:
        if fix.status.status == NavSatStatus.STATUS_NO_FIX:
            return
        c = fix.position_covariance
        known = fix.position_covariance_type != NavSatFix.COVARIANCE_TYPE_UNKNOWN and c[0] > 0 and c[4] > 0
        fields = {
            "lat": fix.latitude,
            "lon": fix.longitude,
            "height_m": fix.altitude if math.isfinite(fix.altitude) else None,
            "covariance": [c[0], c[4], c[1]] if known else None,
        }
        self._send_pose(("gps", ""), _stamp_s(fix.header, at_s), fields)

    def _take_battery(self, battery: BatteryState, at_s: float) -> None:
        if math.isnan(battery.percentage):  # not measured
            return
        if not 0.0 <= battery.percentage <= 1.0:
            raise InputError("the percentage of a BatteryState is not from 0 to 1")
        percent, time_s = round(battery.percentage * 100.0), _stamp_s(battery.header, at_s)
        known, reported_s = self._battery
        if percent != known or time_s - reported_s >= _BATTERY_EVERY_S:
            self._client.report(time_s=time_s, battery_percent=percent)
            self._battery = (percent, time_s)
            self._counts["written"] += 1

    def _take_odometry(self, odometry: Odometry, at_s: float) -> None:
        self._send_local(pose_of(odometry), "", _stamp_s(odometry.header, at_s))

    def _take_transforms(self, message: Any, at_s: float) -> None:
        for transform in message.transforms:
            if (transform.header.frame_id, transform.child_frame_id) == self._tf:
                self._send_local(pose_of(transform), "tf", _stamp_s(transform.header, at_s))

    def _send_local(self, pose: LocalPose, track: str, time_s: float) -> None:
        if self._robot is None:
            self.get_logger().warning("odometry is left out: set start", once=True)
            return
        self._robot.follow(pose)
        self._send_pose(("odometry", track), time_s, self._robot.fields(pose))

    def _send_pose(self, track: Track, time_s: float, fields: Mapping[str, Any]) -> None:
        given = {name: value for name, value in fields.items() if value is not None}
        lat, lon = given.pop("lat"), given.pop("lon")
        identity = pose_identity(*track, time_s, lat=lat, lon=lon)
        if not self._is_new(identity):
            return
        if self._client.pose(lat, lon, time_s=time_s, source=track[0], track=track[1], **given):
            self._written(identity)
        else:
            self._counts["hardly moved"] += 1

    def _take_objects(self, message: Any, at_s: float) -> None:
        numbering = Numbering()
        for sighting in sightings_of(message):
            with self._reporting():
                self._send_object(sighting, _stamp_s(sighting.header, at_s), numbering)

    def _take_boxes(self, message: Any, at_s: float) -> None:
        numbering = Numbering()
        for box in boxes_of(message):
            with self._reporting():
                self._send_object(box, _stamp_s(box.header, at_s), numbering)

    def _take_lens(self, info: CameraInfo, _: float) -> None:
        if info.k[0] > 0 and info.k[4] > 0:
            self._lens = Pinhole(info.k[0], info.k[4], info.k[2], info.k[5])

    def _place(self, seen: Sighting) -> Place:
        found = self._moving_robot().place(seen)
        if found is None:
            raise Unplaced(f"{_name(seen)}: where the robot is in {seen.header.frame_id!r} is not known")
        return found

    def _project(self, box: Box) -> Place:
        if self._camera is None or self._lens is None:
            raise Unplaced("2D detections need the parameter camera, and a CameraInfo")
        farthest = self._values["max_range_m"]
        found = self._camera.on_ground(*box.foot, lens=self._lens, farthest_m=farthest)
        if found is None:
            raise Unplaced(f"{_name(box)} does not stand on the ground within {farthest:g} m")
        return self._moving_robot().on_ground(*found)

    def _moving_robot(self) -> RobotFrame:
        if self._robot is None or not self._robot.is_known:
            raise Unplaced("objects need odometry, and the parameter start")
        return self._robot

    def _send_object(self, seen: Sighting | Box, time_s: float, numbering: Numbering) -> None:
        if seen.id:
            _remember(self._objects, time_s, seen.id)
            identity = object_identity(seen.id, time_s)
        else:
            identity = numbering.identity(
                seen.kind,
                time_s,
                confidence=seen.confidence,
                size_m=seen.size_m,
                in_image=isinstance(seen, Box),
            )
        if not self._is_new(identity):
            return
        place = self._project(seen) if isinstance(seen, Box) else self._place(seen)
        more = {
            "height_m": place.height_m,
            "confidence": seen.confidence,
            "size_m": seen.size_m,
            "photo": self._photos.get(time_s),
        }
        given = {name: value for name, value in more.items() if value is not None}
        self._client.object(seen.id or None, seen.kind, lat=place.lat, lon=place.lon, time_s=time_s, **given)
        self._written(identity)

    def _take_photo(self, image: Image | CompressedImage, at_s: float) -> None:
        """Store an image of detections, which belongs to the objects with the same stamp.

        An image repeated after a restart is recognised by the server, which identifies photos by content.
        """
        time_s = _stamp_s(image.header, at_s)
        identity = ("photo", time_s)
        if not self._is_new(identity):
            return
        data, ending = photo_of(image)
        sha256 = self._client.photo(
            io.BytesIO(data),
            name=f"{time_s:.2f}{ending}",
            time_s=time_s,
            object_id=self._objects.get(time_s),
        )
        self._written(identity)
        _remember(self._photos, time_s, sha256)

    def _end(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        self._client.end()
        response.success = True
        response.message = "the mission is over"
        return response

    def _report(self) -> None:
        status = self._client.status()
        values = {**self._counts, "records waiting": status.waiting, "photos waiting": status.photos}
        level, text = DiagnosticStatus.OK, "everything is sent" if not status.waiting else "sending"
        if status.problem:
            level, text = DiagnosticStatus.WARN, status.problem
        if status.refused is not None or self._refused:
            level, text = DiagnosticStatus.ERROR, self._refused or str(status.refused)
        self._refused = ""
        self._diagnostics.publish(running.diagnostics(self, level, text, values=values.items()))


def _name(seen: Sighting | Box) -> str:
    return f"object {seen.id}" if seen.id else f"a detection of class {seen.kind}"


def _stamp_s(header: Header, published_s: float) -> float:
    """Return the time in a header; if that is zero, the time of publication."""
    return running.seconds(header.stamp) or published_s


def _camera(text: str) -> GroundCamera | None:
    mount = numbers("camera", text, ("FORWARD", "LEFT", "UP", "PITCH", "YAW"))
    if mount is None:
        return None
    forward, left, up, pitch, yaw = mount
    if up <= 0.0:
        raise ParameterError("camera: UP has to be above the ground")
    return GroundCamera(forward, left, up, math.radians(pitch), math.radians(yaw))


def _client(values: Any) -> RobotClient:
    for name in ("mission", "spool", "server_url"):
        if not values[name]:
            raise ParameterError(f"{name}: is needed")
    options = RobotOptions(sync_s=values["sync_s"], min_move=values["min_move"], limit_mb=values["limit_mb"])
    return RobotClient(
        values["server_url"],
        token_of(values["token_file"]),
        mission=values["mission"],
        spool=values["spool"],
        options=options,
        about="mission_bridge",
    )


def _remember(kept: OrderedDict[float, str], time_s: float, value: str) -> None:
    kept[time_s] = value
    while len(kept) > _STAMPS:
        kept.popitem(last=False)


def main() -> None:
    """Run the node."""
    running.main(MissionBridge)


if __name__ == "__main__":
    main()
