"""The packages are consistent: versions, programs, the message, and the tables of the documentation."""

import ast
import importlib
import re
import xml.etree.ElementTree as ET

import pytest
from rosidl_adapter.parser import parse_message_file

from ros.run_tests import ROOT
from webapp import __version__

PACKAGE = ROOT / "ros" / "expmap_ros"
PAGE = (ROOT / "docs" / "ros-nodes.md").read_text("utf-8")
GUIDE = (ROOT / "docs" / "ros.md").read_text("utf-8")
SETUP = (PACKAGE / "setup.py").read_text("utf-8")
NODES = ast.literal_eval(re.search(r"^NODES = (\(.*?\))", SETUP, re.M | re.S)[1])


@pytest.mark.parametrize("name", ["expmap_ros", "expmap_msgs"])
def test_packages_have_the_version_of_the_program(name):
    root = ET.parse(ROOT / "ros" / name / "package.xml").getroot()
    assert (root.findtext("name"), root.findtext("version"), root.findtext("license")) == (
        name,
        __version__,
        "MIT",
    )


def test_the_setup_has_that_version_too():
    assert re.search(r'version="([^"]+)"', SETUP)[1] == __version__


def test_the_message_is_that_of_2013():
    message = parse_message_file("expmap_msgs", ROOT / "ros" / "expmap_msgs" / "msg" / "PosesInMap.msg")
    fields = [(str(field.type), field.name) for field in message.fields]
    assert fields == [("std_msgs/Header", "header"), ("int32[]", "poses"), ("float32[]", "probabilities")]


@pytest.mark.parametrize("node", NODES)
def test_parameters_are_those_of_the_documentation(node):
    module = importlib.import_module(f"expmap_ros.{node}")
    (table,) = re.findall(rf"^\| parameter of `{node}` .*\n\|.*\n((?:\|.*\n)+)", PAGE, re.M)
    rows = [[cell.strip() for cell in row.strip("|").split("|")] for row in table.splitlines()]
    assert rows == [[f"`{p.name}`", f"`{p.default!r}`", p.description] for p in module.PARAMETERS]
    assert callable(module.main)


def test_packages_that_are_imported_are_declared():
    declared = {e.text for e in ET.parse(PACKAGE / "package.xml").getroot().iter("depend")}
    optional = {"expmap_msgs", "vision_msgs"}
    imported = set()
    for path in (PACKAGE / "expmap_ros").glob("*.py"):
        for tree in ast.walk(ast.parse(path.read_text("utf-8"))):
            if isinstance(tree, ast.ImportFrom):
                imported.add(tree.module.partition(".")[0])
    needed = {name for name in imported if name.endswith(("_msgs", "_srvs", "_interfaces", "rclpy"))}
    assert needed - optional == declared


@pytest.mark.parametrize(
    "path", sorted((PACKAGE / "launch").glob("*.launch.xml")), ids=lambda path: path.name
)
def test_launch_files_start_nodes_with_parameters_they_have(path):
    root = ET.parse(path).getroot()
    given = {arg.get("name") for arg in root.iter("arg")}
    assert set(re.findall(r"\$\(var (\w+)\)", path.read_text("utf-8"))) == given
    assert path.name in GUIDE
    for node in root.iter("node"):
        assert node.get("pkg") == "expmap_ros" and node.get("exec") in NODES
        known = {p.name for p in importlib.import_module(f"expmap_ros.{node.get('exec')}").PARAMETERS}
        assert {param.get("name") for param in node.iter("param")} <= known


def test_nodes_in_the_documentation_can_be_started_as_written():
    """Each `ros2 run` and `python -m` line names an existing node, with its parameters and topics."""
    text = re.sub(r"\\\n\s*", " ", PAGE)
    lines = re.findall(
        r"^(?:ros2 run expmap_ros |\S*python -m expmap_ros\.)(\w+) --ros-args (.+)$", text, re.M
    )
    assert {node for node, _ in lines} == set(NODES)
    for node, rest in lines:
        known = {p.name for p in importlib.import_module(f"expmap_ros.{node}").PARAMETERS}
        names = re.findall(r"-p (\w+):=", rest)
        assert names and set(names) <= known, (node, rest)
        source = (PACKAGE / "expmap_ros" / f"{node}.py").read_text("utf-8")
        assert all(topic in source for topic in re.findall(r"-r (\S+):=", rest)), (node, rest)
