"""Node `fix_bridge`: sure answers as poses of the robot, for robot_localization or another filter.

Answers that are not sure, or not accurate, are left out: a filter cannot take back a wrong fix. The pose is
that of the robot, not of its camera.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from typing import Any

from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.node import Node
from std_msgs.msg import Header, String

from expmap_ros import answers, running
from expmap_ros.answers import AXIS_OF_RADIUS, Form, MapFrame, MapPose
from expmap_ros.geodesy import Origin
from expmap_ros.messages import pose_message
from expmap_ros.parameters import Parameter, ParameterError, declare, numbers

PARAMETERS = (
    Parameter("origin", "", "LAT,LON where x and y are 0: the datum of the filter."),
    Parameter("metres_per_pixel", 0.0, "Instead of origin: size of a pixel of the map.", limits=(0, 1e6)),
    Parameter("frame_id", "map", "Frame of the poses: x east, y north, metres."),
    Parameter("min_probability", 0.8, "Leave out places that are less probable.", limits=(0, 1)),
    Parameter("max_radius_m", 20.0, "Leave out places with a larger 68 % radius.", limits=(0, 1e6)),
    Parameter("covariance_scale", 1.0, "Multiply variances by this.", limits=(0.01, 1e6)),
    Parameter("camera", "0,0,0", "FORWARD,LEFT,YAW of the camera on the robot: metres, degrees to the left."),
)


@dataclass(frozen=True, slots=True)
class CameraMount:
    """Where the camera is on the robot: metres forward and left, radians to the left."""

    forward: float
    left: float
    yaw: float

    def robot_pose(self, camera: MapPose) -> MapPose:
        """Where the robot is; without a direction it is somewhere around the camera."""
        if camera.yaw is None:
            around = self.forward**2 + self.left**2
            return replace(camera, variance=camera.variance + around)
        yaw = camera.yaw - self.yaw
        c, s = math.cos(yaw), math.sin(yaw)
        x = camera.x - (c * self.forward - s * self.left)
        y = camera.y - (s * self.forward + c * self.left)
        return MapPose(x, y, math.remainder(yaw, math.tau), camera.variance)


class FixBridge(Node):
    """Subscribes to answers, publishes poses of the robot."""

    def __init__(self, **options: Any) -> None:
        super().__init__("fix_bridge", **options)
        self._values = declare(self, PARAMETERS)
        origin = numbers("origin", self._values["origin"], ("LAT", "LON"))
        scale = self._values["metres_per_pixel"] or None
        if origin is None and scale is None:
            raise ParameterError("origin: is needed, or metres_per_pixel on a map without georeference")
        self._frame = MapFrame(None if origin is None else Origin(*origin), scale)
        mount = numbers("camera", self._values["camera"], ("FORWARD", "LEFT", "YAW")) or (0.0, 0.0, 0.0)
        self._mount = CameraMount(mount[0], mount[1], math.radians(mount[2]))
        self._poses = self.create_publisher(
            PoseWithCovarianceStamped,
            "/visual_pose",
            running.RESULTS,
            qos_overriding_options=running.overridable(),
        )
        self.create_subscription(
            String,
            "/pose_estimator/answer",
            self._take,
            running.RESULTS,
            qos_overriding_options=running.overridable(),
        )

    def _take(self, message: String) -> None:
        form = json.loads(message.data)
        if (pose := self._sure_pose(form)) is not None:
            header = Header(stamp=Time(**form["stamp"]), frame_id=self._values["frame_id"])
            self._poses.publish(pose_message(pose, header))

    def _sure_pose(self, form: Form) -> MapPose | None:
        if answers.is_off_map(form) or form["hypotheses"][0]["probability"] < self._values["min_probability"]:
            return None
        pose = self._frame.pose(form["hypotheses"][0])
        most = (self._values["max_radius_m"] * AXIS_OF_RADIUS) ** 2
        if pose is None or pose.variance > most:
            return None
        robot = self._mount.robot_pose(pose)
        return replace(robot, variance=robot.variance * self._values["covariance_scale"])


def main() -> None:
    """Run the node."""
    running.main(FixBridge)


if __name__ == "__main__":
    main()
