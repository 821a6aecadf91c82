"""Measures the ROS 2 node `pose_estimator` with images at a constant rate on one map.

    .venv-ros/bin/python -m benchmarks.ros_latency MAP.cfg PHOTOS --hz 5 --minutes 30

Run it after `make ros-test`, which creates `.venv-ros`. The node runs in a separate process. Latency is the
time from the stamp of an image to its answer; the waiting time is the latency minus the time of the
localization, and the newest image never waits longer than the interval between two. The memory is the
resident set of the node: after the warm-up, after each full minute, and its trend over the second half.
Prints one JSON object, and the figures so far on standard error every minute.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np
import rclpy
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from sensor_msgs.msg import CompressedImage
from std_msgs.msg import Header, String

_ROOT = Path(__file__).resolve().parents[1]
_PAGE = os.sysconf("SC_PAGE_SIZE")
_START_S = 3600.0
"""Time limit of the start, which may build the index."""

_MINUTE_S = 60.0
_TRANSFER_S = 0.1
"""Allowance for the transfer of an image and its answer."""


class Camera(Node):
    """Publishes photos one after the other, and times the answers."""

    def __init__(self, photos: list[Path]) -> None:
        super().__init__("benchmark")
        self._photos = [photo.read_bytes() for photo in photos]
        self.sent = 0
        self.latencies_s: list[float] = []
        self.seconds: list[float] = []
        self.stamps_s: list[float] = []
        self._camera = self.create_publisher(CompressedImage, "/gscam/image_raw/compressed", 1)
        self.create_subscription(String, "/pose_estimator/answer", self._hear, 10)

    def publish(self) -> None:
        """Send the next photo, stamped now."""
        header = Header(stamp=self.get_clock().now().to_msg(), frame_id="camera")
        data = self._photos[self.sent % len(self._photos)]
        self._camera.publish(CompressedImage(header=header, format="jpeg", data=data))
        self.sent += 1

    def forget(self) -> None:
        """Reset the figures."""
        self.sent = 0
        del self.stamps_s[:], self.latencies_s[:], self.seconds[:]

    def _hear(self, message: String) -> None:
        answer = json.loads(message.data)
        stamp = answer["stamp"]["sec"] + answer["stamp"]["nanosec"] * 1e-9
        self.stamps_s.append(stamp)
        self.latencies_s.append(time.time() - stamp)
        self.seconds.append(answer["seconds"]["total"])


def main() -> None:
    """Run the node and print the figures."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("map", type=Path)
    parser.add_argument("photos", type=Path, help="folder of photos that are asked about, in turn")
    parser.add_argument("--hz", type=float, default=5.0)
    parser.add_argument("--minutes", type=float, default=5.0)
    parser.add_argument("--warm-up", type=float, default=2.0, help="minutes before the figures begin")
    parser.add_argument("--fov", type=float, default=0.0)
    chosen = parser.parse_args()
    photos = sorted(p for p in chosen.photos.iterdir() if p.suffix.lower() in (".jpg", ".jpeg", ".png"))
    os.environ["ROS_AUTOMATIC_DISCOVERY_RANGE"] = "LOCALHOST"
    words = [f"map_file:={chosen.map}", "image_transport:=compressed", f"fov_deg:={chosen.fov}"]
    command = [sys.executable, "-m", "expmap_ros.pose_estimator", "--ros-args"]
    environ = {**os.environ, "PYTHONPATH": f"{_ROOT / 'ros' / 'expmap_ros'}{os.pathsep}{_ROOT}"}
    node = subprocess.Popen([*command, *(part for w in words for part in ("-p", w))], env=environ)
    try:
        _measure(
            node.pid,
            photos,
            hz=chosen.hz,
            warm_up_s=_MINUTE_S * chosen.warm_up,
            seconds=_MINUTE_S * chosen.minutes,
        )
    finally:
        node.terminate()
        node.wait()


def _measure(pid: int, photos: list[Path], *, hz: float, warm_up_s: float, seconds: float) -> None:
    rclpy.init()
    camera = Camera(photos)
    executor = SingleThreadedExecutor()
    executor.add_node(camera)
    end = time.monotonic() + _START_S
    while not camera.latencies_s:  # the node is opening the map
        if time.monotonic() > end:
            raise SystemExit("the node has not answered")
        camera.publish()
        _spin(executor, time.monotonic() + 1.0)
    _run(camera, executor, hz=hz, seconds=warm_up_s)
    camera.forget()
    memory_mb = [_resident_mb(pid)]
    whole = int(seconds // _MINUTE_S)
    for length in [_MINUTE_S] * whole + [seconds - whole * _MINUTE_S] * (seconds > whole * _MINUTE_S):
        _run(camera, executor, hz=hz, seconds=length)
        memory_mb.append(_resident_mb(pid))
        print(json.dumps(_figures(camera, memory_mb, hz=hz)), file=sys.stderr, flush=True)
    rclpy.shutdown()
    print(json.dumps({"photos": len(photos), **_figures(camera, memory_mb, hz=hz)}, indent=2))


def _run(camera: Camera, executor: SingleThreadedExecutor, *, hz: float, seconds: float) -> None:
    """Publish at a constant rate; a late image does not delay those after it."""
    start = time.monotonic()
    for number in range(round(seconds * hz)):
        _spin(executor, start + number / hz)
        camera.publish()
    _spin(executor, start + seconds)


def _figures(camera: Camera, memory_mb: list[float], *, hz: float) -> dict[str, Any]:
    waited_s = np.subtract(camera.latencies_s, camera.seconds)
    later = memory_mb[len(memory_mb) // 2 :]
    slope = np.polyfit(np.arange(len(later)), later, 1)[0] if len(later) > 1 else np.nan
    return {
        "hz": hz,
        "sent": camera.sent,
        "answered": len(camera.latencies_s),
        "latency_s": _quantiles(camera.latencies_s),
        "localization_s": _quantiles(camera.seconds),
        "waited_s": _quantiles(waited_s),
        "newest": round(float(np.mean(waited_s <= 1.0 / hz + _TRANSFER_S)), 4),
        "stamps_ascend": bool(np.all(np.diff(camera.stamps_s) > 0)),
        "memory_mb": [round(one, 1) for one in memory_mb],
        "memory_mb_per_minute": round(float(slope), 3),
    }


def _quantiles(values: Any) -> dict[str, float]:
    p50, p95 = np.quantile(values, [0.5, 0.95])
    return {"p50": round(float(p50), 3), "p95": round(float(p95), 3), "most": round(float(np.max(values)), 3)}


def _spin(executor: SingleThreadedExecutor, until: float) -> None:
    while (left := until - time.monotonic()) > 0:
        executor.spin_once(timeout_sec=left)


def _resident_mb(pid: int) -> float:
    return int(Path(f"/proc/{pid}/statm").read_text().split()[1]) * _PAGE / 1e6


if __name__ == "__main__":
    main()
