"""Test pictures, positions, and nodes that run in the process of the test."""

import json
import time
from collections.abc import Callable

import cv2
import numpy as np
import rclpy
from builtin_interfaces.msg import Time
from rclpy.node import Node
from rclpy.parameter import Parameter
from std_msgs.msg import Header

from expmap_ros.running import DrainingExecutor
from tests.robot.stand_in import StandIn

LAT, LON = 50.0755, 14.4378
PLACES = [(100, 100), (200, 100), (300, 100), (400, 100), (500, 100), (600, 100)]
DEADLINE_S = 120.0


def textured(seed: int) -> np.ndarray:
    """Return a picture (240, 320, 3) uint8 with structure at all scales, different for each seed."""
    rng = np.random.default_rng(seed)
    picture = np.zeros((240, 320), np.float32)
    for size in (5, 11, 23, 47):
        coarse = rng.normal(size=(240 // size + 2, 320 // size + 2)).astype(np.float32)
        picture += cv2.resize(coarse, (320, 240), interpolation=cv2.INTER_CUBIC) * size**0.4
    grey = cv2.normalize(picture, None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)
    return cv2.cvtColor(grey, cv2.COLOR_GRAY2BGR)


def ids_and_probabilities(message: object) -> tuple[list[int], list[float]]:
    """Return the content of `/poses_in_map`, for either of its types."""
    if hasattr(message, "poses"):
        return list(message.poses), list(message.probabilities)
    said = json.loads(message.data)
    return said["poses"], said["probabilities"]


def header(number: int, frame: str = "odom") -> Header:
    """Return the header of the message with a number."""
    return Header(stamp=Time(sec=1000 + number), frame_id=frame)


def records(server: StandIn) -> list[dict]:
    """Return the records that a server has received."""
    return [record for stored in server.records.values() for record in stored]


class Bench:
    """The nodes of a test, and one that communicates with them."""

    def __init__(self) -> None:
        self.context = rclpy.Context()
        rclpy.init(context=self.context)
        self.node = Node("bench", context=self.context)
        self.executor = DrainingExecutor(num_threads=4, context=self.context)
        self.executor.add_node(self.node)
        self._nodes = [self.node]

    def start(self, kind: type[Node], **values: object) -> Node:
        """Start a node with these parameters."""
        overrides = [Parameter(name.replace("__", "."), value=value) for name, value in values.items()]
        node = kind(context=self.context, parameter_overrides=overrides)
        self.executor.add_node(node)
        self._nodes.append(node)
        return node

    def listen(self, kind: type, topic: str, qos: object = 10) -> list:
        """Subscribe to a topic; return a list to which messages are appended."""
        heard: list = []
        self.node.create_subscription(kind, topic, heard.append, qos)
        return heard

    def until(self, holds: Callable[[], object], again: Callable[[], None] = lambda: None) -> None:
        """Spin until `holds()`; call `again` every half second, since early messages may be lost."""
        end, next_time = time.monotonic() + DEADLINE_S, 0.0
        while not holds():
            assert time.monotonic() < end, "it never came"
            if time.monotonic() >= next_time:
                again()
                next_time = time.monotonic() + 0.5
            self.executor.spin_once(timeout_sec=0.05)

    def close(self) -> None:
        """Destroy all nodes."""
        self.executor.shutdown()
        for node in self._nodes:
            node.destroy_node()
        rclpy.shutdown(context=self.context)
