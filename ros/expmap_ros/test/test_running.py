"""Nodes as programs: they end when interrupted, and report errors in one line."""

import os
import signal
import subprocess
import sys

import pytest
import rclpy
from geometry_msgs.msg import PoseWithCovarianceStamped
from rclpy.executors import MultiThreadedExecutor
from std_msgs.msg import String

from expmap_ros.running import DrainingExecutor
from ros.run_tests import ROOT

ENVIRON = {**os.environ, "PYTHONPATH": f"{ROOT / 'ros' / 'expmap_ros'}{os.pathsep}{ROOT}"}


def command(node, *parameters):
    words = [part for parameter in parameters for part in ("-p", parameter)]
    return [sys.executable, "-m", f"expmap_ros.{node}", "--ros-args", *words]


def _without_options(self, timeout_sec=None):
    return SHUTDOWN(self, timeout_sec)


def _with_threads(self, timeout_sec=None, *, wait_for_threads=True):
    return SHUTDOWN(self, timeout_sec)


SHUTDOWN = MultiThreadedExecutor.shutdown
SIGNATURES = {
    "humble": _without_options,
    "jazzy": _without_options,
    "kilted": SHUTDOWN,
    "rolling": _with_threads,
}


@pytest.mark.parametrize("distribution", SIGNATURES)
def test_the_executor_stops_with_the_signature_of_each_distribution(monkeypatch, distribution):
    monkeypatch.setattr(MultiThreadedExecutor, "shutdown", SIGNATURES[distribution])
    context = rclpy.Context()
    rclpy.init(context=context)
    executor = DrainingExecutor(num_threads=2, context=context)
    done = executor.create_task(lambda: "done")
    executor.spin_once(timeout_sec=1.0)
    assert executor.shutdown()
    assert done.result() == "done"
    rclpy.shutdown(context=context)


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM])
def test_an_interrupted_node_ends_without_a_word(bench, number):
    topic = f"/pose_before_signal_{int(number)}"  # unique: once it exists, the node has been created
    words = [*command("fix_bridge", "origin:=50.0,14.0"), "-r", f"/visual_pose:={topic}"]
    node = subprocess.Popen(words, env=ENVIRON, stderr=subprocess.PIPE, text=True)
    bench.node.create_publisher(String, "/pose_estimator/answer", 10)
    bench.listen(PoseWithCovarianceStamped, topic)
    bench.until(lambda: bench.node.count_publishers(topic))
    node.send_signal(number)
    _, error = node.communicate(timeout=60)
    assert (node.returncode, error) == (0, "")


def test_a_wrong_parameter_is_one_line(bench):
    words = command("fix_bridge", "origin:=nowhere")
    done = subprocess.run(words, env=ENVIRON, capture_output=True, text=True, timeout=60)
    assert done.returncode == 2
    assert done.stderr == "expmap_ros: origin: write LAT,LON, not 'nowhere'\n"


def test_an_error_of_the_program_is_one_line(bench, tmp_path):
    (tmp_path / "map.cfg").write_text("no map")
    words = command("pose_estimator", f"map_file:={tmp_path / 'map.cfg'}")
    done = subprocess.run(words, env=ENVIRON, capture_output=True, text=True, timeout=60)
    assert done.returncode == 1
    assert done.stderr.startswith("expmap_ros: ") and "map.cfg" in done.stderr
    assert len(done.stderr.splitlines()) == 1
