"""Measures the ROS 2 node `pose_estimator`: images at an even rate on one map.

    .venv-ros/bin/python -m benchmarks.ros_latency MAP.cfg PHOTOS --hz 5 --minutes 5

Run it after `make ros-test`, which makes `.venv-ros`. The node runs as a process of its own. Latency is from
the stamp of an image to its answer.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path

import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import CompressedImage
from std_msgs.msg import Header, String

_ROOT = Path(__file__).resolve().parents[1]
_PAGE = os.sysconf("SC_PAGE_SIZE")
_START_S = 3600.0
"""The first start may build the index."""


class Camera(Node):
    """Publishes photos in turn, and times the answers."""

    def __init__(self, photos: list[Path]) -> None:
        super().__init__("benchmark")
        self._photos = [photo.read_bytes() for photo in photos]
        self.sent = 0
        self.latencies_s: list[float] = []
        self.seconds: list[float] = []
        self._camera = self.create_publisher(CompressedImage, "/gscam/image_raw/compressed", 1)
        self.create_subscription(String, "/pose_estimator/answer", self._hear, 10)

    def publish(self) -> None:
        """Send the next photo, stamped now."""
        header = Header(stamp=self.get_clock().now().to_msg(), frame_id="camera")
        data = self._photos[self.sent % len(self._photos)]
        self._camera.publish(CompressedImage(header=header, format="jpeg", data=data))
        self.sent += 1

    def _hear(self, message: String) -> None:
        answer = json.loads(message.data)
        stamp = answer["stamp"]["sec"] + answer["stamp"]["nanosec"] * 1e-9
        self.latencies_s.append(time.time() - stamp)
        self.seconds.append(answer["seconds"]["total"])


def main() -> None:
    """Measure, and print the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("map", type=Path)
    parser.add_argument("photos", type=Path, help="folder of photos that are asked about, in turn")
    parser.add_argument("--hz", type=float, default=5.0)
    parser.add_argument("--minutes", type=float, default=5.0)
    parser.add_argument("--fov", type=float, default=0.0)
    chosen = parser.parse_args()
    photos = sorted(p for p in chosen.photos.iterdir() if p.suffix.lower() in (".jpg", ".jpeg", ".png"))
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    words = [f"map_file:={chosen.map}", "image_transport:=compressed", f"fov_deg:={chosen.fov}"]
    command = [sys.executable, "-m", "expmap_ros.pose_estimator", "--ros-args"]
    environ = {**os.environ, "PYTHONPATH": f"{_ROOT / 'ros' / 'expmap_ros'}{os.pathsep}{_ROOT}"}
    node = subprocess.Popen([*command, *(part for w in words for part in ("-p", w))], env=environ)
    try:
        _measure(node.pid, photos, hz=chosen.hz, seconds=60 * chosen.minutes)
    finally:
        node.terminate()
        node.wait()


def _measure(pid: int, photos: list[Path], *, hz: float, seconds: float) -> None:
    rclpy.init()
    camera = Camera(photos)
    executor = SingleThreadedExecutor()
    executor.add_node(camera)
    end = time.monotonic() + _START_S
    while not camera.latencies_s:  # it is opening the map
        if time.monotonic() > end:
            raise SystemExit("the node has not answered")
        camera.publish()
        _spin(executor, time.monotonic() + 1.0)
    del camera.latencies_s[:], camera.seconds[:]
    camera.sent, memory = 0, []
    start = time.monotonic()
    while (now := time.monotonic()) < start + seconds:
        camera.publish()
        memory.append(_resident_mb(pid))
        _spin(executor, now + 1.0 / hz)
    rclpy.shutdown()
    p50, p95 = np.percentile(camera.latencies_s, [50, 95])
    warm = memory[len(memory) // 5 :]
    slope = np.polyfit(np.arange(len(warm)) / hz / 60.0, warm, 1)[0]
    sys.stdout.write(
        f"{len(photos)} photos, {camera.sent} images in {seconds:.0f} s, {len(camera.latencies_s)} answered\n"
        f"latency p50 {p50:.2f} s, p95 {p95:.2f} s; of localization p50 {np.median(camera.seconds):.2f} s\n"
        f"memory {memory[0]:.0f} MB at the start, {memory[-1]:.0f} MB at the end, "
        f"{slope:+.1f} MB a minute after the first fifth\n"
    )


def _spin(executor: SingleThreadedExecutor, until: float) -> None:
    while (left := until - time.monotonic()) > 0:
        executor.spin_once(timeout_sec=left)


def _resident_mb(pid: int) -> float:
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * _PAGE / 1e6


if __name__ == "__main__":
    main()
