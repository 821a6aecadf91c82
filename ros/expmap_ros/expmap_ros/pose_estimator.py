"""Node `pose_estimator`: localizes the newest image, with a map file or a server.

Of the images that arrive while another one is being localized, only the newest is kept. Every message about
an answer has the stamp of its image.
"""

from __future__ import annotations

import json
import math
from collections.abc import Mapping
from typing import Any

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from sensor_msgs.msg import CameraInfo, CompressedImage, Image, NavSatFix, NavSatStatus
from std_msgs.msg import Header, String
from std_srvs.srv import Trigger

from expmap_ros import answers, messages, running
from expmap_ros.answers import AXIS_OF_RADIUS, Form, MapFrame
from expmap_ros.client import Uplink
from expmap_ros.geodesy import Origin
from expmap_ros.localizers import Localized, Localizer, MapLocalizer, NoAnswer, Question, ServerLocalizer
from expmap_ros.managed import ManagedNode
from expmap_ros.parameters import SERVER, Parameter, ParameterError, file_of, numbers, token_of
from expmap_ros.pictures import UnusableImage, image_of, photo_of

PARAMETERS = (
    Parameter("map_file", "", "Map to localize on, a .cfg; in this process. Either this or a server."),
    *SERVER,
    Parameter("map_name", "", "Map of the server: the NAME in the address of its page /maps/NAME/edit."),
    Parameter("timeout_s", 60.0, "Longest wait for an answer of the server, seconds.", limits=(1.0, 600.0)),
    Parameter("image_transport", "raw", "Type of the images.", choices=("raw", "compressed")),
    Parameter("method", "auto", "Method of `expmap localize`, with a map file."),
    Parameter("features", "auto", "Features of `expmap localize`, with a map file."),
    Parameter("top", 5, "Maximum number of hypotheses.", limits=(1, 20)),
    Parameter(
        "fov_deg",
        0.0,
        "Horizontal field of view, degrees; 0: by CameraInfo, EXIF, or a guess.",
        limits=(0, 179),
    ),
    Parameter("sequence", False, "Each image is localized by those before it, too."),
    Parameter("frame_id", "map", "Frame of the poses: x east, y north, metres."),
    Parameter("origin", "", "LAT,LON where x and y are 0; the centre of the map's image with a map file."),
    Parameter(
        "metres_per_pixel", 0.0, "Size of a pixel of a map without georeference; 0: unknown.", limits=(0, 1e6)
    ),
)


class PoseEstimator(ManagedNode):
    """Subscribes to images, publishes answers."""

    def __init__(self, **options: Any) -> None:
        super().__init__("pose_estimator", PARAMETERS, **options)
        self._fov_deg: float | None = self._values["fov_deg"] or None
        self._counts = {"images": 0, "answers": 0, "not on this map": 0, "failed": 0}
        self._state: tuple[bytes, str] = (DiagnosticStatus.WARN, "no image received yet")
        self._seconds = 0.0
        self._newest: str | None = None
        self.start()

    def configure(self) -> None:
        """Open the map or the connection to the server. Raises ParameterError."""
        chosen = numbers("origin", self._values["origin"], ("LAT", "LON"))
        self._localizer = _open(self._values)
        self.holds(self._localizer.close)
        origin = self._localizer.origin if chosen is None else Origin(*chosen)
        self._frame = MapFrame(origin, self._values["metres_per_pixel"] or None)
        self._poses = self.advertise(messages.POSES_IN_MAP, "/poses_in_map", running.RESULTS)
        self._answers = self.advertise(String, "~/answer", running.RESULTS)
        self._pose = self.advertise(PoseWithCovarianceStamped, "~/pose", running.RESULTS)
        self._fix = self.advertise(NavSatFix, "~/fix", running.RESULTS)
        self._matches = self.advertise(Image, "/keypoint_matches", running.RESULTS)
        self._diagnostics = self.advertise(DiagnosticArray, "/diagnostics", running.RESULTS)
        if self._frame.origin is None and self._frame.metres_per_pixel is None:
            self.get_logger().warning(
                "no poses in metres: set origin, or metres_per_pixel without georeference"
            )

    def activate(self) -> None:
        """Subscribe to the camera."""
        own = MutuallyExclusiveCallbackGroup()
        self.serve(Trigger, "~/where_am_i", self._where_am_i, group=own)
        self.repeat(1.0, self._report, group=own)
        kind, ending = (CompressedImage, "/compressed") if self._is_compressed else (Image, "")
        topic, group = f"/gscam/image_raw{ending}", MutuallyExclusiveCallbackGroup()
        self.listen(kind, topic, self._take, quality=running.IMAGES, group=group)
        if not self._values["fov_deg"]:
            topic, group = "/gscam/camera_info", MutuallyExclusiveCallbackGroup()
            self.listen(CameraInfo, topic, self._learn_fov, quality=running.IMAGES, group=group)

    @property
    def _is_compressed(self) -> bool:
        return bool(self._values["image_transport"] == "compressed")

    def _learn_fov(self, info: CameraInfo, _: object) -> None:
        """Compute the field of view from the calibration; a driver without one sends zeros."""
        if info.k[0] > 0 and info.width:
            self._fov_deg = math.degrees(2.0 * math.atan(info.width / (2.0 * info.k[0])))

    def _take(self, message: Image | CompressedImage, _: object) -> None:
        self._counts["images"] += 1
        started = self.get_clock().now()
        try:
            localized = self._localize(message)
        except (UnusableImage, NoAnswer) as error:
            self._counts["failed"] += 1
            self._state = (DiagnosticStatus.ERROR, str(error))
            self.get_logger().error(str(error), throttle_duration_sec=10.0)
            return
        self._seconds = (self.get_clock().now() - started).nanoseconds * 1e-9
        self._counts["answers"] += 1
        self._publish(localized, message.header)

    def _localize(self, message: Image | CompressedImage) -> Localized:
        photo, ending = photo_of(message)
        return self._localizer.localize(
            Question(
                photo,
                ending,
                fov_deg=self._fov_deg,
                time_s=running.seconds(message.header.stamp),
                with_matches=self._matches.get_subscription_count() > 0,
            )
        )

    def _publish(self, localized: Localized, image: Header) -> None:
        form = localized.form
        header = Header(stamp=image.stamp, frame_id=self._values["frame_id"])
        stamp = {"sec": image.stamp.sec, "nanosec": image.stamp.nanosec}
        self._newest = json.dumps({"stamp": stamp, "frame_id": image.frame_id, **form})
        self._poses.publish(messages.poses_in_map(*answers.poses_in_map(form), header=header))
        self._answers.publish(String(data=self._newest))
        if localized.matches is not None:
            self._matches.publish(image_of(localized.matches, image))
        if answers.is_off_map(form):
            self._counts["not on this map"] += 1
            self._state = (DiagnosticStatus.WARN, answers.headline(form))
            return
        self._state = (DiagnosticStatus.OK, answers.headline(form))
        best = form["hypotheses"][0]
        if (pose := self._frame.pose(best)) is not None:
            self._pose.publish(messages.pose_message(pose, header))
        if best["lat"] is not None:
            self._fix.publish(_fix_message(best, Header(stamp=image.stamp, frame_id=image.frame_id)))

    def _where_am_i(self, _: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
        response.success = self._newest is not None
        response.message = self._newest or "no image has been answered"
        return response

    def _report(self) -> None:
        level, text = self._state
        values = {**self._counts, "seconds of the newest answer": f"{self._seconds:.2f}"}
        self._diagnostics.publish(running.diagnostics(self, level, text, values=values.items()))


def _open(values: Mapping[str, Any]) -> Localizer:
    by_file, by_server = bool(values["map_file"]), bool(values["server_url"])
    if by_file == by_server:
        raise ParameterError("map_file, server_url: set one of the two")
    if by_file:
        cfg = file_of("map_file", values["map_file"])
        return MapLocalizer(
            cfg,
            method=values["method"],
            features=values["features"],
            top=values["top"],
            sequence=values["sequence"],
        )
    if not values["map_name"]:
        raise ParameterError("map_name: name the map of the server")
    uplink = Uplink(values["server_url"], token_of(values["token_file"]), timeout_s=values["timeout_s"])
    return ServerLocalizer(uplink, slug=values["map_name"], top=values["top"], sequence=values["sequence"])


def _fix_message(hypothesis: Form, header: Header) -> NavSatFix:
    message = NavSatFix(header=header, latitude=hypothesis["lat"], longitude=hypothesis["lon"])
    message.altitude = math.nan
    message.status.status = NavSatStatus.STATUS_FIX
    if (radius := hypothesis["radius_m"]) is not None:
        variance = (radius * AXIS_OF_RADIUS) ** 2
        message.position_covariance[0] = message.position_covariance[4] = variance
        message.position_covariance_type = NavSatFix.COVARIANCE_TYPE_APPROXIMATED
    return message


def main() -> None:
    """Run the node."""
    running.main(PoseEstimator)


if __name__ == "__main__":
    main()
