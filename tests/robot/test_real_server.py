"""The client and the commands with the real application."""

import io
import json
import subprocess
import sys

import pytest

from tests.robot.damage import damage_record
from webapp.app import main as program
from webapp.missions.store import missions
from webapp.missions.store.schema import MissionObject
from webapp.robot import RobotClient
from webapp.robot.content import read_content


@pytest.fixture
def expmap(capsys, monkeypatch, site):
    """Run the command with the token in the environment and return exit code, output, errors."""
    monkeypatch.setenv("EXPMAP_TOKEN", site.token)

    def call(*words, stdin=""):
        monkeypatch.setattr("sys.stdin", io.StringIO(stdin))
        with pytest.raises(SystemExit) as ended:
            program.main(["robot", *map(str, words)])
        printed = capsys.readouterr()
        return ended.value.code, printed.out, printed.err

    return call


def test_poses_objects_and_photos_arrive(site, mission, tmp_path, quick, save_photo):
    save_photo(tmp_path / "car.jpg", 1)
    with RobotClient(site.url, site.token, mission=mission, spool=tmp_path / "s", options=quick()) as robot:
        robot.pose(50, 14, time_s=1, heading_deg=359.5, covariance=[1, 2, 0.5], height_m=3)
        robot.pose(50.001, 14, time_s=2)
        photo = robot.photo(tmp_path / "car.jpg", time_s=2.0, object_id="car 1")
        robot.object("car 1", "car", lat=50, lon=14, time_s=2, photo=photo)
        robot.end()
        assert robot.upload(wait_s=60)
    poses = site.poses()
    assert poses.times_s.tolist() == [1, 2] and poses.heading_deg[0] == 359.5
    assert poses.covariance_m2[0].tolist() == [1, 2, 0.5]
    assert poses.travelled_m[1] == pytest.approx(111.2, abs=0.1)  # by the server
    assert site.state()[2]
    with site.library.database.read() as session:
        (kept,) = missions.photos(session, mission)
        assert (kept.sha256, kept.object_id, kept.time_s) == (photo, "car 1", 2)
        assert session.get(MissionObject, (mission, "car 1")).photo_sha == photo


def test_a_record_that_the_server_rejects_is_set_aside(site, mission, tmp_path, quick, monkeypatch):
    monkeypatch.setattr("webapp.robot.client.object_record", lambda *_, **more: {"type": "walk", **more})
    with RobotClient(
        site.url, site.token, mission=mission, spool=tmp_path / "s", options=quick(every_s=None)
    ) as robot:
        for number in range(20):
            robot.pose(50, 14, time_s=number)
            if number == 7:
                robot.object("", "", lat=1, lon=2, time_s=3)
        assert robot.upload(wait_s=60)
    assert site.poses().times_s.tolist() == list(range(20))
    (entry,) = read_content(tmp_path / "s").aside
    assert entry["first"] == 8 and entry["reason"].startswith("records.0.type ")


def test_damage_that_the_server_has_already_is_found_out_by_asking(site, mission, tmp_path, quick):
    def start(**more):
        options = quick(every_s=None, **more)
        return RobotClient(site.url, site.token, mission=mission, spool=tmp_path / "s", options=options)

    with start() as robot, pytest.MonkeyPatch.context() as patch:
        patch.setattr("webapp.robot.spool.Spool.acknowledge", lambda *_: None)  # killed before recording it
        for number in range(5):
            robot.pose(50, 14, time_s=number)
        assert not robot.upload(wait_s=0.5)
        robot.close(wait_s=0)
    damage_record(tmp_path / "s", 2)
    with start() as robot:
        robot.pose(50, 14, time_s=5)
        assert robot.upload(wait_s=60)
    assert site.poses().times_s.tolist() == list(range(6))
    assert read_content(tmp_path / "s").aside == []


def test_lines_of_another_program_are_sent(site, expmap, mission, tmp_path):
    lines = [json.dumps({"type": "pose", "lat": 50 + n * 1e-3, "lon": 14, "time": n}) for n in range(5)]
    lines[2:2] = ["{", "[]", '{"type": "pose", "lat": 99, "lon": 0}', "", '{"type": "upload"}']
    code, out, err = expmap(
        "send", tmp_path / "s", "--url", site.url, "--mission", mission, "--at-end", stdin="\n".join(lines)
    )
    assert (code, out) == (1, "")
    *refused, last = err.splitlines()
    assert [line.partition(":")[0] for line in refused] == ["line 3", "line 4", "line 5"]
    assert last == f"6 lines sent, 3 refused: {site.url}/missions/{mission}"
    assert site.poses().times_s.tolist() == list(range(5))


def test_what_is_left_is_seen_and_recovered(site, expmap, mission, tmp_path):
    site.wire.cut()
    line = '{"type": "pose", "lat": 50, "lon": 14, "time": 1}'
    words = ("--url", site.wire.url, "--mission", mission, "--at-end")
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("webapp.robot.client._PATIENCE_S", 0.1)
        patch.setattr(RobotClient.close, "__kwdefaults__", {"wait_s": 0.1})
        code, _, err = expmap("send", tmp_path / "s", *words, stdin=line)
    assert code == 1 and "1 records and 0 photos are still waiting" in err
    assert json.loads(expmap("status", tmp_path / "s", "--json")[1])["waiting"] == 1
    code, _, err = expmap("recover", tmp_path / "s", "--patience", "0")
    assert code == 1 and "later" in err
    site.wire.mend()
    assert expmap("recover", tmp_path / "s")[0] == 0
    assert site.poses().times_s.tolist() == [1]
    assert expmap("recover", tmp_path / "s")[0] == 0
    assert "1 records, 0 of them waiting" in expmap("status", tmp_path / "s")[1]


def test_a_recorded_mission_is_replayed_into_a_new_one(site, expmap, tmp_path):
    file = tmp_path / "walk.csv"
    rows = [f"{1000 + n * 0.1},{50 + n * 4e-6},14" for n in range(50)]
    file.write_text("\n".join(["time,lat,lon", *rows]))
    words = ("replay", file, "--speed", "50", "--spool", tmp_path / "s", "--url", site.url)
    code, out, _ = expmap(*words, "--new", "Walk", "--start", "50,14,90")
    assert code == 0 and out.startswith(f"{site.url}/missions/")
    number = int(out.rpartition("/")[2])
    assert site.state(number) == ("Walk", {"lat": 50, "lon": 14, "heading_deg": 90}, True)
    poses = site.poses(number)
    assert poses.latlon[:, 0] == pytest.approx([50 + n * 4e-6 for n in range(0, 50, 3)])
    assert poses.travelled_m[-1] == pytest.approx(48 * 4e-6 * 111_229, rel=1e-3)
    before = site.poses(number).times_s.tolist()
    code, _, err = expmap(*words, "--new", "Walk", "--start", "50,14,90")  # repeated: all is stored
    assert code == 0 and f"continuing mission {number}" in err
    assert site.poses(number).times_s.tolist() == before
    code, _, err = expmap(*words, "--min-move", "0", "--start", "50,14,90")
    assert code == 2 and "something else" in err


@pytest.mark.parametrize(
    ("words", "message"),
    [
        (("send", "SPOOL"), "either --mission N or --new NAME"),
        (("send", "SPOOL", "--mission", "99"), None),
        (("send", "SPOOL", "--new", "x", "--start", "here"), "is not a start position and heading"),
        (("send", "SPOOL", "--new", "x", "--map", "nowhere"), "map not found"),
        (("send", "SPOOL", "--new", "x", "--token", "wrong"), "unknown token"),
        (("status", "SPOOL"), "no spool"),
        (("recover", "SPOOL"), "no spool"),
    ],
)
def test_usage_errors(site, expmap, tmp_path, words, message):
    words = [tmp_path / "s" if word == "SPOOL" else word for word in words]
    words += ["--url", site.url] if words[0] == "send" else []
    code, _, err = expmap(*words)
    if message is None:
        assert code == 0  # nothing was sent
    else:
        assert code in (1, 2) and message in err


def test_a_missing_mission_is_reported_at_once(site, expmap, tmp_path):
    file = tmp_path / "walk.csv"
    file.write_text("time,lat,lon\n1000,50,14\n1001,50.1,14\n")
    code, _, err = expmap("replay", file, "--spool", tmp_path / "s", "--url", site.url, "--mission", "99")
    assert code == 1 and "mission not found" in err


def test_the_client_is_the_standard_library_and_one_module():
    program = (
        "import sys; import webapp.robot; print([m for m in sys.modules if m.partition('.')[0] == 'webapp'])"
    )
    printed = subprocess.run(
        [sys.executable, "-c", program], capture_output=True, text=True, check=True
    ).stdout
    loaded = set(eval(printed))
    assert {m for m in loaded if not m.startswith("webapp.robot")} == {"webapp", "webapp.errors"}
