"""Node `mission_bridge`: sends positions, detected objects and their images to a mission, through outages.

Every message becomes one record in the spool of the robots' client, which sends it once, whatever happens to
the network. What a publisher repeats to a bridge that was started again is known by its stamp and left out.
"""

from __future__ import annotations

import io
import math
import time
from collections import OrderedDict
from collections.abc import Callable
from contextlib import ExitStack
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from nav_msgs.msg import Odometry
from rclpy.node import Node
from rclpy.qos import QoSProfile, ReliabilityPolicy
from sensor_msgs.msg import CompressedImage, NavSatFix, NavSatStatus
from std_srvs.srv import Trigger
from visualization_msgs.msg import MarkerArray

from expmap_ros import running
from expmap_ros.client import DiskFull, InputError, RobotClient, RobotOptions, StorageError
from expmap_ros.parameters import SERVER, Parameter, ParameterError, declare, numbers, token_of
from expmap_ros.robot_frame import RobotFrame, Sighting, sightings_of

try:
    from vision_msgs.msg import Detection3DArray
except ModuleNotFoundError:  # not among the usual messages: markers are taken all the same
    Detection3DArray = None

PARAMETERS = (
    *SERVER,
    Parameter("mission", 0, "Number of the mission.", limits=(0, 2**31 - 1)),
    Parameter("spool", "", "Folder for what waits, of this mission alone; the next start continues it."),
    Parameter("start", "", "LAT,LON,HEADING of the origin of odometry; without it odometry is left out."),
    Parameter("min_move", "0", "Leave out poses that moved no more: 0.5m, 0.00001deg; 0 keeps all."),
    Parameter("sync_s", 0.5, "Seconds whose records a power cut can cost at most; 0: none.", limits=(0, 60)),
    Parameter("limit_mb", 1000.0, "Megabytes of the spool, at most.", limits=(1, 1e6)),
)

QUEUE = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
"""So many messages wait while the disk is busy."""

_STAMPS = 200
"""For so many stamps, images and objects find each other."""

_CATCH_UP_S = 10.0
"""After a start, publishers may send again what they keep for so long."""

_BEHIND = "stamps are older than what was sent before this start: was the clock set back?"

Key = tuple[str, str]


class MissionBridge(Node):
    """Subscribes to what a robot publishes, and keeps it for the server."""

    def __init__(self, **options: Any) -> None:
        self._resources = ExitStack()  # a node that could not be made is destroyed, too
        super().__init__("mission_bridge", **options)
        values = declare(self, PARAMETERS)
        start = numbers("start", values["start"], ("LAT", "LON", "HEADING"))
        self._robot = None if start is None else RobotFrame(*start)
        self._client = _client(values)
        self._resources.callback(self._client.close, wait_s=0.0)
        self._sent_before_s: dict[Key, float] = self._client.last_times_s()
        self._last_s: dict[Key, float] = {}
        self._caught_up_s = time.monotonic() + _CATCH_UP_S
        self._is_behind = False
        self._counts = {"received": 0, "written": 0, "hardly moved": 0, "repeated": 0, "unusable": 0}
        self._refused = ""
        self._photos: OrderedDict[float, str] = OrderedDict()
        self._objects: OrderedDict[float, str] = OrderedDict()
        self._subscribe(NavSatFix, "/fix", self._take_fix)
        self._subscribe(Odometry, "/odom", self._take_odometry)
        self._subscribe(MarkerArray, "/objects", self._take_objects)
        if Detection3DArray is not None:
            self._subscribe(Detection3DArray, "/detections", self._take_objects)
        self._subscribe(CompressedImage, "/objects/image/compressed", self._take_photo)
        self._diagnostics = self.create_publisher(DiagnosticArray, "/diagnostics", 10)
        self.create_timer(1.0, self._report)
        self.create_service(Trigger, "~/end", self._end)

    def destroy_node(self) -> None:
        """End the node; what has not been sent stays in the spool."""
        super().destroy_node()
        self._resources.close()

    def _subscribe(self, kind: type, topic: str, take: Callable[[Any], None]) -> None:
        def guarded(message: Any) -> None:
            self._counts["received"] += 1
            try:
                take(message)
            except (InputError, DiskFull, StorageError) as error:
                self._counts["unusable"] += 1
                self._refused = str(error)
                self.get_logger().error(f"{topic}: {error}", throttle_duration_sec=10.0)

        self.create_subscription(kind, topic, guarded, QUEUE, qos_overriding_options=running.overridable())

    def _stamp_s(self, header: Any) -> float:
        """When something was; now, where nobody knew."""
        return running.seconds(header.stamp) or self.get_clock().now().nanoseconds * 1e-9

    def _is_new(self, key: Key, time_s: float) -> bool:
        """Return whether a message has not been sent yet: before this start it was, up to a time.

        In this run only a stamp that comes again is a repetition; a clock may be set back.
        """
        before = time_s <= self._sent_before_s.get(key, -math.inf)
        self._is_behind |= before and time.monotonic() > self._caught_up_s
        if before or time_s == self._last_s.get(key):
            self._counts["repeated"] += 1
            return False
        return True

    def _written(self, key: Key, time_s: float) -> None:
        self._counts["written"] += 1
        self._last_s[key] = time_s

    def _take_fix(self, fix: NavSatFix) -> None:
        time_s = self._stamp_s(fix.header)
        if fix.status.status == NavSatStatus.STATUS_NO_FIX or not self._is_new(("gps", ""), time_s):
            return
        c = fix.position_covariance
        known = fix.position_covariance_type != NavSatFix.COVARIANCE_TYPE_UNKNOWN and c[0] > 0 and c[4] > 0
        height = fix.altitude if math.isfinite(fix.altitude) else None
        self._send_pose(
            ("gps", ""),
            time_s,
            {
                "lat": fix.latitude,
                "lon": fix.longitude,
                "height_m": height,
                "covariance": [c[0], c[4], c[1]] if known else None,
            },
        )

    def _take_odometry(self, odometry: Odometry) -> None:
        if self._robot is None:
            self.get_logger().warning("odometry is left out: set start", once=True)
            return
        time_s = self._stamp_s(odometry.header)
        self._robot.follow(odometry)
        if self._is_new(("odometry", ""), time_s):
            self._send_pose(("odometry", ""), time_s, self._robot.pose(odometry))

    def _send_pose(self, key: Key, time_s: float, fields: dict[str, Any]) -> None:
        given = {name: value for name, value in fields.items() if value is not None}
        lat, lon = given.pop("lat"), given.pop("lon")
        if self._client.pose(lat, lon, time_s=time_s, source=key[0], **given):
            self._written(key, time_s)
        else:
            self._counts["hardly moved"] += 1

    def _take_objects(self, message: Any) -> None:
        if self._robot is None:
            self.get_logger().warning("objects are left out: set start", once=True)
            return
        for sighting in sightings_of(message):
            self._send_object(self._robot, sighting)

    def _send_object(self, robot: RobotFrame, sighting: Sighting) -> None:
        time_s = self._stamp_s(sighting.header)
        key = ("object", sighting.id)
        lat_lon = robot.place(sighting)
        if lat_lon is None:
            self._counts["unusable"] += 1
            self._refused = (
                f"object {sighting.id}: where the robot is in {sighting.header.frame_id!r} is not known"
            )
            return
        if not self._is_new(key, time_s):
            return
        more = {"confidence": sighting.confidence, "photo": self._photos.get(time_s)}
        given = {name: value for name, value in more.items() if value is not None}
        self._client.object(
            sighting.id, sighting.kind, lat=lat_lon[0], lon=lat_lon[1], time_s=time_s, **given
        )
        self._written(key, time_s)
        _remember(self._objects, time_s, sighting.id)

    def _take_photo(self, image: CompressedImage) -> None:
        """Keep an image of detections: it belongs to the objects with the same stamp."""
        time_s = self._stamp_s(image.header)
        if not self._is_new(("photo", ""), time_s):
            return
        ending = "png" if "png" in image.format else "jpg"
        sha256 = self._client.photo(
            io.BytesIO(bytes(image.data)),
            name=f"{time_s:.2f}.{ending}",
            time_s=time_s,
            object_id=self._objects.get(time_s),
        )
        self._written(("photo", ""), time_s)
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
        if self._is_behind:
            level, text = DiagnosticStatus.WARN, _BEHIND
        if status.problem:
            level, text = DiagnosticStatus.WARN, status.problem
        if status.refused is not None or self._refused:
            level, text = DiagnosticStatus.ERROR, self._refused or str(status.refused)
        self._refused, self._is_behind = "", False
        self._diagnostics.publish(running.diagnostics(self, level, text, values=values.items()))


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
