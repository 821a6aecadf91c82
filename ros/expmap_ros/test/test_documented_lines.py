"""The `ros2 run` lines of the documentation start nodes as they are written; `ros2` itself has no wheel."""

import re
import shlex
import shutil
import signal
import subprocess
import sys

import pytest
from lifecycle_msgs.msg import State
from lifecycle_msgs.srv import GetState

from ros.expmap_ros.test.test_running import ENVIRON
from ros.run_tests import ROOT

PAGE = re.sub(r"\\\n\s*", " ", (ROOT / "docs" / "ros.md").read_text("utf-8"))
LINES = [
    line
    for line in re.findall(r"^ros2 run expmap_ros (\w+ --ros-args .+)$", PAGE, re.M)
    if not line.startswith("pose_estimator --ros-args -p map_file")  # test_pose_estimator builds that index
]


@pytest.fixture
def folder(survey, tmp_path):
    """The files that the lines name."""
    shutil.copytree(survey, tmp_path / "here")
    (tmp_path / "here" / "token").write_text("secret")
    return tmp_path / "here"


def test_each_line_starts_a_node_that_is_active_and_ends_when_it_is_interrupted(bench, folder):
    nodes, states = [], []
    for number, line in enumerate(LINES):
        node, *words = shlex.split(line)
        program = [sys.executable, "-m", f"expmap_ros.{node}", *words, "-r", f"__node:=line_{number}"]
        nodes.append(subprocess.Popen(program, cwd=folder, env=ENVIRON, stderr=subprocess.PIPE, text=True))
    try:
        for number, node in enumerate(nodes):
            client = bench.node.create_client(GetState, f"/line_{number}/get_state")
            bench.until(lambda c=client, n=node: c.service_is_ready() or n.poll() is not None)
            assert node.poll() is None, (LINES[number], node.stderr.read())
            asked = []
            bench.until(
                lambda a=asked: any(one.done() for one in a),
                lambda c=client, a=asked: a.append(c.call_async(GetState.Request())),
            )
            states += [next(one for one in asked if one.done()).result().current_state.id]
    finally:
        for node in nodes:
            node.send_signal(signal.SIGINT)
        ended = [(node.communicate(timeout=60), node.returncode)[1] for node in nodes]
    assert len(LINES) >= 5
    assert states == [State.PRIMARY_STATE_ACTIVE] * len(LINES)
    assert ended == [0] * len(LINES)
