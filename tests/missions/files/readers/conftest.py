"""Bags written for the tests."""

from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from rosbags.rosbag1 import Writer as Writer1
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as Writer2
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

DEFINITIONS = {
    "tf2_msgs/msg/TFMessage": "geometry_msgs/TransformStamped[] transforms\n",
    "vision_msgs/msg/Detection3DArray": "std_msgs/Header header\nvision_msgs/Detection3D[] detections\n",
    "vision_msgs/msg/Detection3D": "std_msgs/Header header\nvision_msgs/ObjectHypothesisWithPose[] results\n"
    "vision_msgs/BoundingBox3D bbox\nstring id\n",
    "vision_msgs/msg/ObjectHypothesisWithPose": "vision_msgs/ObjectHypothesis hypothesis\n"
    "geometry_msgs/PoseWithCovariance pose\n",
    "vision_msgs/msg/ObjectHypothesis": "string class_id\nfloat64 score\n",
    "vision_msgs/msg/BoundingBox3D": "geometry_msgs/Pose center\ngeometry_msgs/Vector3 size\n",
}


class Messages:
    """Makes messages of ROS 1 or ROS 2, and bags with them."""

    def __init__(self, *, ros1: bool) -> None:
        self.ros1 = ros1
        self.store = get_typestore(Stores.ROS1_NOETIC if ros1 else Stores.ROS2_HUMBLE)
        for name, text in DEFINITIONS.items():
            self.store.register(get_types_from_msg(text, name))

    def make(self, kind: str, *values: Any, **named: Any) -> Any:
        return self.store.types[kind](*values, **named)

    def header(self, time_s: float, frame: str = "odom") -> Any:
        stamp = self.make("builtin_interfaces/msg/Time", int(time_s), round(time_s % 1 * 1e9))
        values = (0, stamp, frame) if self.ros1 else (stamp, frame)
        return self.make("std_msgs/msg/Header", *values)

    def pose(self, x: float, y: float = 0.0, z: float = 0.0, *, yaw: float = 0.0) -> Any:
        at = self.make("geometry_msgs/msg/Point", x, y, z)
        turn = self.make(
            "geometry_msgs/msg/Quaternion", 0.0, 0.0, float(np.sin(yaw / 2)), float(np.cos(yaw / 2))
        )
        return self.make("geometry_msgs/msg/Pose", at, turn)

    def fix(self, time_s: float, lat: float, lon: float, *, status: int = 0, variance: float = 0.0) -> Any:
        there = self.make("sensor_msgs/msg/NavSatStatus", status, 1)
        covariance = np.diag([variance, 2.0 * variance, 1.0]).ravel()
        return self.make(
            "sensor_msgs/msg/NavSatFix",
            self.header(time_s, "gps"),
            there,
            lat,
            lon,
            200.0,
            covariance,
            2 if variance else 0,
        )

    def odometry(self, time_s: float, pose: Any, *, variance: float = 0.0) -> Any:
        covariance = np.diag([variance] * 6).ravel()
        zero = self.make("geometry_msgs/msg/Vector3", 0.0, 0.0, 0.0)
        twist = self.make("geometry_msgs/msg/Twist", zero, zero)
        return self.make(
            "nav_msgs/msg/Odometry",
            self.header(time_s),
            "base_link",
            self.make("geometry_msgs/msg/PoseWithCovariance", pose, covariance),
            self.make("geometry_msgs/msg/TwistWithCovariance", twist, covariance),
        )

    def stamped(self, time_s: float, pose: Any, frame: str = "odom") -> Any:
        return self.make("geometry_msgs/msg/PoseStamped", self.header(time_s, frame), pose)

    def transforms(self, moves: list[tuple[float, str, str, Any]]) -> Any:
        """Make transforms: time, frame, body, and the pose of the body in the frame."""
        made = []
        for time_s, frame, body, pose in moves:
            at = self.make("geometry_msgs/msg/Vector3", pose.position.x, pose.position.y, pose.position.z)
            turn = self.make("geometry_msgs/msg/Transform", at, pose.orientation)
            header = self.header(time_s, frame)
            made.append(self.make("geometry_msgs/msg/TransformStamped", header, body, turn))
        return self.make("tf2_msgs/msg/TFMessage", made)

    def path(self, poses: list[Any]) -> Any:
        return self.make("nav_msgs/msg/Path", self.header(0.0), poses)

    def detections(self, time_s: float, seen: list[tuple[str, str, float, Any]], frame: str) -> Any:
        header = self.header(time_s, frame)
        size = self.make("geometry_msgs/msg/Vector3", 1.0, 1.0, 1.0)
        found = []
        for name, kind, score, pose in seen:
            sure = self.make("vision_msgs/msg/ObjectHypothesis", kind, score)
            where = self.make("geometry_msgs/msg/PoseWithCovariance", pose, np.zeros(36))
            result = self.make("vision_msgs/msg/ObjectHypothesisWithPose", sure, where)
            box = self.make("vision_msgs/msg/BoundingBox3D", pose, size)
            found.append(self.make("vision_msgs/msg/Detection3D", header, [result], box, name))
        return self.make("vision_msgs/msg/Detection3DArray", header, found)

    def markers(self, time_s: float, seen: list[tuple[str, int, int, Any]], frame: str) -> Any:
        kind = "visualization_msgs/msg/Marker"
        fields = {name: None for name in self.store.types[kind].__dataclass_fields__ if name.islower()}
        zero = self.make("geometry_msgs/msg/Vector3", 1.0, 1.0, 1.0)
        colour = self.make("std_msgs/msg/ColorRGBA", 1.0, 1.0, 1.0, 1.0)
        life = self.make("builtin_interfaces/msg/Duration", 0, 0)
        fields |= {
            "header": self.header(time_s, frame),
            "type": 1,
            "scale": zero,
            "color": colour,
            "lifetime": life,
            "frame_locked": False,
            "points": [],
            "colors": [],
            "text": "",
            "mesh_resource": "",
            "mesh_use_embedded_materials": False,
            "texture_resource": "",
            "uv_coordinates": [],
        }
        fields = {
            name: fields[name] for name in self.store.types[kind].__dataclass_fields__ if name in fields
        }
        fields.pop("__msgtype__", None)
        if "texture" in fields:
            image = self.make("sensor_msgs/msg/CompressedImage", self.header(0.0), "", np.zeros(0, np.uint8))
            fields["texture"] = image
        if "mesh_file" in fields:
            fields["mesh_file"] = self.make("visualization_msgs/msg/MeshFile", "", np.zeros(0, np.uint8))
        made = [
            self.make(kind, **(fields | {"ns": ns, "id": id, "action": action, "pose": pose}))
            for ns, id, action, pose in seen
        ]
        return self.make("visualization_msgs/msg/MarkerArray", made)

    def bag(self, path: Path, messages: Iterable[tuple[str, float, Any]], *, mcap: bool = False) -> Path:
        """Write a bag of (topic, time of recording, message), and return its path."""
        plugin = StoragePlugin.MCAP if mcap else StoragePlugin.SQLITE3
        writer = Writer1(path) if self.ros1 else Writer2(path, version=9, storage_plugin=plugin)
        known = {}
        with writer:
            for topic, time_s, message in messages:
                kind = message.__msgtype__
                if topic not in known:
                    known[topic] = writer.add_connection(topic, kind, typestore=self.store)
                pack = self.store.serialize_ros1 if self.ros1 else self.store.serialize_cdr
                writer.write(known[topic], round(time_s * 1e9), pack(message, kind))
        return path if self.ros1 else next(path.glob("*.mcap" if mcap else "*.db3"))


@pytest.fixture(scope="session")
def ros() -> Callable[[bool], Messages]:
    """Return a maker of messages of ROS 1 (True) or ROS 2 (False)."""
    made = {ros1: Messages(ros1=ros1) for ros1 in (True, False)}
    return lambda ros1: made[ros1]
