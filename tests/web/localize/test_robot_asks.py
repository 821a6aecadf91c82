"""A robot's own code localizes itself on a map."""

import io
import re
import subprocess
import sys
import threading
from pathlib import Path

import pytest
from werkzeug.serving import make_server

from webapp.errors import ExpMapError, InputError, NotFound, NotReady, NotSignedIn
from webapp.robot import Near, RobotClient, RobotOptions
from webapp.store.accounts import accounts

ROOT = Path(__file__).resolve().parents[3]
NUMBER = r"-?\d+\.\d+(?:e-?\d+)?"


@pytest.fixture
def url(app):
    """Serve the application."""
    http = make_server("127.0.0.1", 0, app, threaded=True)
    thread = threading.Thread(target=http.serve_forever, args=(0.05,))
    thread.start()
    yield f"http://127.0.0.1:{http.port}"
    http.shutdown()
    thread.join()
    http.server_close()


@pytest.fixture
def token(library, owner):
    with library.database.write() as session:
        return accounts.new_token(session, owner, name="rover")


@pytest.fixture
def new_mission(client, sample):
    """Make a mission, and return its number."""
    return lambda **more: client.post("/api/v1/missions", json={"name": "Round", **more}).json["id"]


@pytest.fixture
def robot(url, token, new_mission, tmp_path):
    """The client of a mission on the sample map."""
    quiet = RobotOptions(every_s=None)
    with RobotClient(
        url, token, mission=new_mission(map="sample"), spool=tmp_path / "spool", options=quiet
    ) as client:
        yield client


def test_the_answer_is_what_the_server_keeps(robot, client, queries):
    result = robot.fix(queries / "query_01.jpg", time_s=1000.5)
    (photo,) = client.get("/api/v1/missions/1/photos").json["photos"]
    assert (result.photo, result.lat, result.lon) == (
        photo["sha256"],
        photo["fix"]["lat"],
        photo["fix"]["lon"],
    )
    assert (result.time_s, result.no_pose, result.map_revision) == (
        1000.5,
        None,
        result.answer["map_revision"],
    )
    (east, both), (_, north) = result.answer["position_covariance_m2"]
    assert result.covariance_m2 == (east, north, both)
    (track,) = client.get("/api/v1/missions/1").json["tracks"]
    assert (track["source"], track["poses"], track["last"]["lat"]) == ("visual", 1, result.lat)


def test_a_photo_in_memory_and_what_is_known_of_it(robot, queries):
    photo = (queries / "query_01.jpg").read_bytes()
    first = robot.fix(io.BytesIO(photo))
    near = Near(first.lat, first.lon, 60)
    result = robot.fix(io.BytesIO(photo), near=near, heading_deg=first.heading_deg, fov_deg=60)
    assert (result.no_pose, result.answer["fov_deg"], result.answer["fov_source"]) == (None, 60, "option")
    with pytest.raises(ExpMapError, match="make the circle larger") as raised:
        robot.fix(io.BytesIO(photo), near=near._replace(lat=near.lat + 0.5))
    assert raised.value.where == "hint_radius_m"


def test_a_photo_from_elsewhere_has_no_position(robot, queries):
    result = robot.fix(queries / "off_map.jpg")
    assert result.lat is result.lon is result.covariance_m2 is None
    assert "not taken on this map" in result.no_pose


def test_refusals_are_raised(robot, url, new_mission, token, tmp_path, queries):
    with pytest.raises(InputError):
        robot.fix(io.BytesIO(b"no photo"))
    with (
        RobotClient(url, token, mission=new_mission(), spool=tmp_path / "globe") as other,
        pytest.raises(NotFound, match="not on a map"),
    ):
        other.fix(queries / "query_01.jpg")
    with (
        RobotClient(url, "wrong", mission=1, spool=tmp_path / "wrong") as other,
        pytest.raises(NotSignedIn),
    ):
        other.fix(queries / "query_01.jpg")


def test_without_a_network_there_is_no_answer(tmp_path):
    with (
        RobotClient("http://127.0.0.1:9", "token", mission=1, spool=tmp_path) as robot,
        pytest.raises(NotReady, match="does not answer"),
    ):
        robot.fix(io.BytesIO(b"photo"))
    assert robot.status().photos == 0


def test_the_example_of_the_guide(url, token, new_mission, tmp_path, queries):
    page = (ROOT / "docs" / "robots.md").read_text("utf-8")
    _, program = re.findall(r"^```python\n(.*?)^```", page, re.M | re.S)
    (tmp_path / "example.py").write_text(program)
    environ = {"PYTHONPATH": str(ROOT), "PATH": ""}

    def run(photo):
        words = [sys.executable, "example.py", url, token, str(mission), "spool", photo]
        done = subprocess.run(words, cwd=tmp_path, env=environ, capture_output=True, text=True, timeout=300)
        assert (done.returncode, done.stderr) == (0, "")
        return done.stdout

    mission = new_mission(map="sample")
    covariance = rf"\({NUMBER}, {NUMBER}, {NUMBER}\)"
    assert re.fullmatch(
        rf"{NUMBER} {NUMBER} {NUMBER} {NUMBER} {covariance} \d+\n", run(queries / "query_01.jpg")
    )
    assert run(queries / "off_map.jpg").startswith("not found: ")
    assert run(Path(__file__)).startswith("no answer: ")
