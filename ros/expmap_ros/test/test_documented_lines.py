"""The `ros2 run` lines of the documentation, and the launch files, start nodes as written.

`ros2` and `launch` have no wheels: nodes are started here with the arguments that those would pass.
"""

import json
import re
import shlex
import shutil
import signal
import subprocess
import sys
import xml.etree.ElementTree as ET
from collections.abc import Iterator, Mapping, Sequence
from contextlib import contextmanager
from pathlib import Path

import cv2
import pytest
from lifecycle_msgs.msg import State
from lifecycle_msgs.srv import GetState
from sensor_msgs.msg import CompressedImage
from std_msgs.msg import String

from ros.expmap_ros.test.support import PLACES, Bench, header, textured
from ros.expmap_ros.test.test_running import ENVIRON
from ros.run_tests import ROOT

PAGES = [(ROOT / "docs" / name).read_text("utf-8") for name in ("ros.md", "ros-nodes.md")]
PAGE = re.sub(r"\\\n\s*", " ", "\n".join(PAGES))
LINES = [
    line
    for line in re.findall(r"^ros2 run expmap_ros (\w+ --ros-args .+)$", PAGE, re.M)
    if not line.startswith("pose_estimator --ros-args -p map_file")  # a launch file starts that one
]
LAUNCHES = ROOT / "ros" / "expmap_ros" / "launch"
(DOCUMENTED_LAUNCH,) = re.findall(r"^ros2 launch expmap_ros (.+)$", PAGE, re.M)


@pytest.fixture
def folder(survey: Path, tmp_path: Path) -> Path:
    """Copy the files that the lines refer to."""
    shutil.copytree(survey, tmp_path / "here")
    (tmp_path / "here" / "token").write_text("secret")
    return tmp_path / "here"


@contextmanager
def running(
    bench: Bench, programs: Mapping[str, Sequence[str]], folder: Path
) -> Iterator[Mapping[str, subprocess.Popen[str]]]:
    """Start nodes by name, wait until each is active, and interrupt them at the end."""
    nodes = {
        name: subprocess.Popen(
            [sys.executable, "-m", *words], cwd=folder, env=ENVIRON, stderr=subprocess.PIPE, text=True
        )
        for name, words in programs.items()
    }
    try:
        for name, node in nodes.items():
            client = bench.node.create_client(GetState, f"/{name}/get_state")
            bench.until(lambda c=client, n=node: c.service_is_ready() or n.poll() is not None)
            assert node.poll() is None, (name, node.stderr.read())
            asked = []
            bench.until(
                lambda a=asked: any(is_active(one) for one in a),
                lambda c=client, a=asked: a.append(c.call_async(GetState.Request())),
            )
        yield nodes
    finally:
        for node in nodes.values():
            node.send_signal(signal.SIGINT)
        ended = [(node.communicate(timeout=60), node.returncode)[1] for node in nodes.values()]
    assert ended == [0] * len(nodes)


def is_active(asked) -> bool:
    """Return whether the response has arrived and reports an active node."""
    return asked.done() and asked.result().current_state.id == State.PRIMARY_STATE_ACTIVE


def test_each_line_starts_a_node_that_is_active_and_ends_when_it_is_interrupted(bench, folder):
    programs = {}
    for number, line in enumerate(LINES):
        node, *words = shlex.split(line)
        programs[f"line_{number}"] = [f"expmap_ros.{node}", *words, "-r", f"__node:=line_{number}"]
    assert len(programs) >= 5
    with running(bench, programs, folder):
        pass


def launched(path: Path, **arguments: str) -> dict[str, list[str]]:
    """List the nodes that a launch file starts: the words after `python -m`, by node name."""
    root = ET.parse(path).getroot()
    given = {arg.get("name"): arguments.get(arg.get("name"), arg.get("default")) for arg in root.iter("arg")}
    assert set(arguments) <= set(given)
    assert None not in given.values(), "an argument without a default needs a value"

    def filled(text: str) -> str:
        return re.sub(r"\$\(var (\w+)\)", lambda found: given[found[1]], text)

    programs = {}
    for node in root.iter("node"):
        words = [f"{node.get('pkg')}.{node.get('exec')}", "--ros-args"]
        name = node.get("name", node.get("exec"))
        words += ["-r", f"__node:={name}"]
        for param in node.iter("param"):
            value = filled(param.get("value"))
            words += [
                "-p",
                f"{param.get('name')}:=" + (f"'{value}'" if param.get("type") == "str" else value),
            ]
        for remap in node.iter("remap"):
            words += ["-r", f"{remap.get('from')}:={filled(remap.get('to'))}"]
        programs[name] = words
    return programs


def test_the_documented_launch_localizes_images_of_its_topic(bench, folder):
    file, *words = shlex.split(DOCUMENTED_LAUNCH)
    arguments = dict(word.split(":=", 1) for word in words)
    programs = launched(LAUNCHES / file, image_transport="compressed", **arguments)
    answers = bench.listen(String, "/pose_estimator/answer")
    camera = bench.node.create_publisher(CompressedImage, arguments["image"] + "/compressed", 1)
    photo = cv2.imencode(".jpg", textured(2))[1].tobytes()
    image = CompressedImage(header=header(1, "camera"), format="jpeg", data=photo)
    with running(bench, programs, folder):
        bench.until(lambda: answers, lambda: camera.publish(image))
    best = json.loads(answers[0].data)["hypotheses"][0]
    assert [round(best[axis]) for axis in ("x_px", "y_px")] == list(PLACES[2])


def test_the_other_launch_files_start_nodes_that_are_active(bench, folder):
    shutil.copy(folder / "map.cfg", folder / "clusters.cfg")
    two = launched(
        LAUNCHES / "two_placements.launch.xml",
        map_file="map.cfg",
        clusters_file="clusters.cfg",
        photos="photos",
    )
    assert set(two) == {"image_publisher", "pose_estimator", "exact", "clusters"}
    with running(bench, two, folder):
        pass
    robot = launched(
        LAUNCHES / "mission.launch.xml",
        server_url="http://127.0.0.1:9",
        token_file="token",
        map_name="park",
        mission="7",
        spool="spool",
        origin="50.1,14.4",
        start="50.1,14.4,90",
    )
    with running(bench, robot, folder):
        pass
