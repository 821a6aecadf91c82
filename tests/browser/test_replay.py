"""A recorded mission is replayed into the running program, and its page follows."""

import csv
import io
import os
import re
import subprocess
import sys
import time
from itertools import pairwise

import pytest
from playwright.sync_api import expect
from pyproj import Geod
from rosbags.highlevel import AnyReader

from tests.browser.app import expmap
from tests.browser.drawn import DRAWN

pytestmark = pytest.mark.slow

QUICK = 20
"""Replay speed: 395 s take 20."""
ENDS_WITHIN_S = 240
SEEN = """time,id,class,lat,lon,confidence
1432235500,barrel 1,barrel,42.37600,-71.14745,0.9
1432235600,car 7,car,42.37650,-71.14750,0.8
1432235700,car 7,car,42.37655,-71.14750,0.7
"""


@pytest.fixture
def bag(shared_data):
    path = shared_data / "robot" / "test1.bag"
    if not path.is_file():
        pytest.skip(f"the recorded mission is not here: {path}")
    return path


@pytest.fixture
def replay(app, request, tmp_path):
    """Start a replay as users do, and return the process."""
    token = expmap("account", "token", "--name", request.node.name, library=app.library).strip()
    begun = []

    def begin(path, mission, *words):
        spool = tmp_path / f"spool {len(begun)}"
        command = [sys.executable, "-m", "webapp", "robot", "replay", path, "--mission", mission]
        command += ["--spool", spool, "--url", app.url, *words]
        environ = {**os.environ, "EXPMAP_TOKEN": token}
        pipe = {"stdout": subprocess.PIPE, "stderr": subprocess.STDOUT, "text": True}
        begun.append(subprocess.Popen([*map(str, command)], env=environ, **pipe))
        return begun[-1]

    yield begin
    for process in begun:
        process.kill()
        process.communicate()


@pytest.fixture
def new(api):
    """Make a mission and return its id."""
    return lambda name: api.ask("POST", "/missions", data={"name": name})["id"]


@pytest.fixture
def imported(app, new, bag):
    """Import the bag and return the id of the mission."""

    def read(*words):
        id = new("Imported")
        expmap("mission", "import", id, bag, *words, library=app.library)
        return id

    return read


def ended(process):
    result, _ = process.communicate(timeout=ENDS_WITHIN_S)
    assert process.returncode == 0, result
    return result


def facts(api, mission):
    """Return the API's facts of the only track, without those specific to this mission."""
    (track,) = api.ask("GET", f"/missions/{mission}")["tracks"]
    return {name: value for name, value in track.items() if name != "id"}


def rows(api, mission):
    text = api.request.get(f"/api/v1/missions/{mission}/export.csv").text()
    return list(csv.DictReader(io.StringIO(text)))


def distance_m(bag):
    """Return the sum of the geodesics between the fixes, computed without the program's code."""
    with AnyReader([bag]) as reader:
        wanted = [c for c in reader.connections if c.topic == "/fix"]
        fixes = [reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages(wanted)]
    return Geod(ellps="WGS84").line_length([f.longitude for f in fixes], [f.latitude for f in fixes])


def test_a_track_appears_and_grows_while_it_is_replayed(page, api, bag, new, replay, imported, tmp_path):
    mission = new("Live")
    page.goto(f"/missions/{mission}")
    expect(page.get_by_text("No positions yet", exact=True)).to_be_visible()
    process = replay(bag, mission, "--speed", QUICK, "--min-move", "0")
    track, live = page.get_by_test_id("track"), page.get_by_test_id("live-state")
    expect(track).to_have_count(1)
    expect(live).to_have_text("Live")
    poses, ink = [], []
    until = time.monotonic() + ENDS_WITHIN_S
    while live.inner_text() == "Live" and time.monotonic() < until:
        (shown,) = re.findall(r"Positions\s*([\d,]+)", track.inner_text())
        poses.append(int(shown.replace(",", "")))
        ink.append(page.evaluate(DRAWN))
        page.wait_for_timeout(500)
    expect(live).to_have_text("Ended")
    assert poses == sorted(poses) and len(set(poses)) >= 3, poses
    assert max(b - a for a, b in pairwise(poses)) < 989 * 3 / 4, poses
    assert 0 < ink[0] < max(ink), ink
    assert "/missions/" in ended(process)
    expect(track).to_contain_text("989")

    by_file = imported("--min-move", "0")
    result = facts(api, mission)
    assert result == facts(api, by_file)
    assert (result["poses"], result["skipped"], result["closing"] is None) == (989, 0, False)
    assert rows(api, mission) == rows(api, by_file) and len(rows(api, mission)) == 989
    assert result["distance_m"] == pytest.approx(distance_m(bag), rel=0.01)

    seen = tmp_path / "seen.csv"
    seen.write_text(SEEN)
    ended(replay(seen, mission, "--speed", "1000"))
    page.get_by_test_id("tab-objects").click()
    expect(page.get_by_test_id("object")).to_have_count(2)
    expect(page.get_by_test_id("object").filter(has_text="car 7")).to_contain_text("car")


def test_what_hardly_moved_is_left_out_as_by_an_import(api, bag, new, replay, imported):
    mission = new("Thinned")
    ended(replay(bag, mission, "--speed", "1000"))
    by_file = imported()
    result = facts(api, mission)
    assert result == facts(api, by_file) and result["poses"] + result["skipped"] == 989 > result["poses"]
    assert rows(api, mission) == rows(api, by_file)
    assert result["distance_m"] == pytest.approx(distance_m(bag), rel=0.01)
