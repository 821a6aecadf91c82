"""Clocks of robot and server jump back and ahead: acknowledged data is stored, once, in order."""

import json
import os
import subprocess
import sys
import time
import urllib.request
from pathlib import Path

import pytest

from tests.browser.app import App
from webapp.missions.store import missions, tracks
from webapp.missions.store.schema import Mission
from webapp.store.accounts import accounts
from webapp.store.library import open_library
from webapp.store.maps import maps

SOURCE = Path(__file__).with_name("shifted_clock.c")
DAY_S = 86_400
EACH = 20
"""Poses between two jumps."""

JUMPS = [(0, 0), (-3650, 0), (0, 400), (400, -3650), (-1, -3650), (0, 0)]
"""Shifts of the robot's and of the server's clock, days."""

ROBOT = """
import sys
from tests.robot.quick import QUICK
from webapp.robot import RobotClient

url, token, mission, spool = sys.argv[1:]
with RobotClient(url, token, mission=int(mission), spool=spool, options=QUICK) as robot:
    for line in sys.stdin:
        for number in range(int(line), int(line) + 20):
            robot.pose(50 + number * 1e-6, 14)  # dated by its own clock
        print(robot.upload(wait_s=60), flush=True)
    robot.end()
    print(robot.upload(wait_s=60), flush=True)
"""


@pytest.fixture(scope="module")
def library_of_shift(tmp_path_factory):
    """The preloaded library that shifts the clock."""
    built = tmp_path_factory.mktemp("clock") / "shifted_clock.so"
    command = ["cc", "-shared", "-fPIC", "-O1", "-o", str(built), str(SOURCE)]
    try:
        subprocess.run(command, check=True, capture_output=True, text=True)
    except (OSError, subprocess.CalledProcessError) as error:
        pytest.skip(f"NOT TESTED, clocks that jump: there is no compiler here ({error})")
    shifted = subprocess.run(
        [sys.executable, "-c", "import time; print(time.time())"],
        env={**os.environ, **preloading(built, clock_file(built.parent / "try", -3650))},
        capture_output=True, text=True, check=True,
    )  # fmt: skip
    if abs(float(shifted.stdout) - (time.time() - 3650 * DAY_S)) > 3600:
        pytest.skip("NOT TESTED, clocks that jump: nothing can be preloaded here")
    return built


def preloading(library, shift):
    return {"LD_PRELOAD": str(library), "CLOCK_SHIFT": str(shift)}


def clock_file(path, days):
    """Set a clock atomically."""
    new = path.with_name(f"{path.name}.new")
    new.write_text(str(days * DAY_S))
    new.replace(path)
    return path


def post(url, token, body, *, key):
    headers = {
        "Authorization": f"Bearer {token}",
        "Content-Type": "application/json",
        "Idempotency-Key": key,
    }
    request = urllib.request.Request(url, json.dumps(body).encode(), headers, method="POST")
    with urllib.request.urlopen(request, timeout=60) as answer:
        return json.load(answer)


@pytest.fixture
def made(tmp_path):
    """A library with a token and two missions."""
    library = open_library(tmp_path / "maps")
    with library.database.write() as session:
        owner = accounts.ensure_owner(session)
        maps.create(session, "Another", account_id=owner.id)  # so that the start makes no sample
        token = accounts.new_token(session, owner, name="robot")
        walked, keyed = (missions.create(session, name, account_id=owner.id).id for name in ("a", "b"))
    library.database.close()
    return token, walked, keyed


@pytest.mark.slow
def test_clocks_that_jump_lose_and_double_nothing(tmp_path, library_of_shift, made):
    token, walked, keyed = made
    robots, servers = (clock_file(tmp_path / name, 0) for name in ("robots-clock", "servers-clock"))
    pose = {"records": [{"type": "pose", "time": 1.0, "lat": 50, "lon": 14}]}
    with App(tmp_path / "maps", environ=preloading(library_of_shift, servers)) as app:
        command = [sys.executable, "-c", ROBOT, app.url, token, str(walked), str(tmp_path / "spool")]
        environ = {**os.environ, **preloading(library_of_shift, robots)}
        begun = time.time()
        with subprocess.Popen(
            command, env=environ, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
        ) as robot:
            for number, (own, remote) in enumerate(JUMPS):
                clock_file(robots, own)
                clock_file(servers, remote)
                robot.stdin.write(f"{number * EACH}\n")
                robot.stdin.flush()
                assert robot.stdout.readline() == "True\n", "it was not acknowledged"
            robot.stdin.close()
            assert robot.stdout.readline() == "True\n"
        address = f"{app.url}/api/v1/missions/{keyed}/batches"
        assert post(address, token, pose, key="first")["stored"] == 1
        clock_file(servers, -3650)
        assert post(address, token, pose, key="first")["already"] == 1
    library = open_library(tmp_path / "maps")
    with library.database.read() as session:
        (track,) = tracks.list_tracks(session, walked)
        poses = tracks.read(session, track)
        assert session.get_one(Mission, walked).ended_at is not None
        assert [t.poses for t in tracks.list_tracks(session, keyed)] == [1]
    library.database.close()
    assert poses.latlon[:, 0].tolist() == [50 + n * 1e-6 for n in range(EACH * len(JUMPS))]
    lasted = time.time() - begun
    for number, (own, _) in enumerate(JUMPS):
        dated = poses.times_s[number * EACH : (number + 1) * EACH] - own * DAY_S
        assert begun - 1 <= dated.min() and dated.max() <= begun + lasted + 1
