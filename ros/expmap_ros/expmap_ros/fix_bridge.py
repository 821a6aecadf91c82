"""Node `fix_bridge`: reliable answers as poses of the robot, for robot_localization or another filter.

Improbable or inaccurate answers are left out, since a filter cannot undo a wrong fix. The pose is that of the
robot, not of its camera. Without a filter, the node can publish the transform from map to odometry.
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from typing import Any

from builtin_interfaces.msg import Time
from geometry_msgs.msg import PoseWithCovarianceStamped, TransformStamped
from rclpy.qos import QoSProfile, ReliabilityPolicy
from std_msgs.msg import Header, String

from expmap_ros import answers, running
from expmap_ros.answers import AXIS_OF_RADIUS, Form, MapFrame, MapPose
from expmap_ros.geodesy import Origin
from expmap_ros.managed import ManagedNode
from expmap_ros.messages import TF_MESSAGE, pose_message, rotation, yaw_of
from expmap_ros.odometry_frame import Planar, PoseHistory, map_to_odometry
from expmap_ros.parameters import Parameter, ParameterError, names, numbers

PARAMETERS = (
    Parameter("origin", "", "LAT,LON where x and y are 0: the datum of the filter."),
    Parameter("metres_per_pixel", 0.0, "Instead of origin: size of a pixel of the map.", limits=(0, 1e6)),
    Parameter("frame_id", "map", "Frame of the poses: x east, y north, metres."),
    Parameter("min_probability", 0.8, "Leave out places that are less probable.", limits=(0, 1)),
    Parameter("max_radius_m", 20.0, "Leave out places with a larger 68 % radius.", limits=(0, 1e6)),
    Parameter("covariance_scale", 1.0, "Multiply variances by this.", limits=(0.01, 1e6)),
    Parameter("camera", "0,0,0", "FORWARD,LEFT,YAW of the camera on the robot: metres, degrees to the left."),
    Parameter("tf", "", "ODOMETRY,ROBOT: publish the transform from map to odometry, by that to the robot."),
    Parameter("tf_age_s", 30.0, "Longest time for which an answer keeps that transform.", limits=(0.1, 1e6)),
)

_TRANSFORMS = QoSProfile(depth=100, reliability=ReliabilityPolicy.RELIABLE)
_PERIOD_S = 0.1
"""Interval at which the transform is published."""


@dataclass(frozen=True, slots=True)
class CameraMount:
    """Mounting of the camera on the robot: metres forward and left, radians to the left."""

    forward: float
    left: float
    yaw: float

    def robot_pose(self, camera: MapPose) -> MapPose:
        """Return the pose of the robot; without a yaw, that of the camera with a larger variance."""
        if camera.yaw is None:
            around = self.forward**2 + self.left**2
            return replace(camera, variance=camera.variance + around)
        yaw = camera.yaw - self.yaw
        c, s = math.cos(yaw), math.sin(yaw)
        x = camera.x - (c * self.forward - s * self.left)
        y = camera.y - (s * self.forward + c * self.left)
        return MapPose(x, y, math.remainder(yaw, math.tau), camera.variance)


class FixBridge(ManagedNode):
    """Subscribes to answers, publishes poses of the robot, and optionally the transform map to odometry."""

    def __init__(self, **options: Any) -> None:
        super().__init__("fix_bridge", PARAMETERS, **options)
        self.start()

    def configure(self) -> None:
        """Read the parameters. Raises ParameterError."""
        origin = numbers("origin", self._values["origin"], ("LAT", "LON"))
        scale = self._values["metres_per_pixel"] or None
        if origin is None and scale is None:
            raise ParameterError("origin: is needed, or metres_per_pixel on a map without georeference")
        self._frame = MapFrame(None if origin is None else Origin(*origin), scale)
        mount = numbers("camera", self._values["camera"], ("FORWARD", "LEFT", "YAW")) or (0.0, 0.0, 0.0)
        self._mount = CameraMount(mount[0], mount[1], math.radians(mount[2]))
        self._poses = self.advertise(PoseWithCovarianceStamped, "/visual_pose", running.RESULTS)
        self._tf = names("tf", self._values["tf"], ("ODOMETRY", "ROBOT"))
        if self._tf:
            if TF_MESSAGE is None:
                raise ParameterError("tf: tf2_msgs is not installed")
            self._transforms = self.advertise(TF_MESSAGE, "/tf", _TRANSFORMS)
        self._history = PoseHistory()
        self._waiting: tuple[float, Planar] | None = None
        self._newest: tuple[float, Planar] | None = None

    def activate(self) -> None:
        """Subscribe to answers."""
        self.listen(String, "/pose_estimator/answer", self._take, quality=running.RESULTS)
        if self._tf:
            self.listen(TF_MESSAGE, "/tf", self._follow, quality=_TRANSFORMS)
            self.repeat(_PERIOD_S, self._broadcast)

    def _take(self, message: String, _: object) -> None:
        form = json.loads(message.data)
        if (pose := self._sure_pose(form)) is None:
            return
        header = Header(stamp=Time(**form["stamp"]), frame_id=self._values["frame_id"])
        self._poses.publish(pose_message(pose, header))
        if pose.yaw is not None:
            self._waiting = (running.seconds(header.stamp), Planar(pose.x, pose.y, pose.yaw))
            self._fit()

    def _follow(self, message: Any, _: object) -> None:
        """Store the pose of the robot from odometry."""
        for one in message.transforms:
            if (one.header.frame_id, one.child_frame_id) == self._tf:
                at, yaw = one.transform.translation, yaw_of(one.transform.rotation)
                self._history.add(running.seconds(one.header.stamp), Planar(at.x, at.y, yaw or 0.0))
                self._fit()

    def _fit(self) -> None:
        """Compute the transform, once odometry is available for the time of the newest reliable answer."""
        if self._waiting is None or (odometry := self._history.at(self._waiting[0])) is None:
            return
        self._newest = (self._waiting[0], map_to_odometry(self._waiting[1], odometry))
        self._waiting = None

    def _broadcast(self) -> None:
        """Publish the transform, unless the answer that it is based on is too old."""
        if self._newest is None or self._tf is None:
            return
        now = self.get_clock().now()
        if abs(now.nanoseconds * 1e-9 - self._newest[0]) > self._values["tf_age_s"]:
            return
        message = TransformStamped(child_frame_id=self._tf[0])
        message.header = Header(stamp=now.to_msg(), frame_id=self._values["frame_id"])
        place = self._newest[1]
        message.transform.translation.x, message.transform.translation.y = place.x, place.y
        message.transform.rotation = rotation(place.yaw)
        self._transforms.publish(TF_MESSAGE(transforms=[message]))

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
