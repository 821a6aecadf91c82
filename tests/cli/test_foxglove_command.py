"""`expmap foxglove` for Foxglove: topics of a server, and MCAP files."""

import json
import os
import re
import signal
import subprocess
import sys
from io import BytesIO
from pathlib import Path
from types import SimpleNamespace

import pytest
from PIL import Image

from tests.foxglove_client import hear, read_mcap
from webapp.api import GeoSource, PlaceOptions, place_photos
from webapp.cli.foxglove import WatchedPhotos, serve_until_interrupted

ROOT = Path(__file__).resolve().parents[2]
TOPICS = {"/image", "/matches", "/map", "/answer", "/hypotheses", "/position"}
GPX = """<gpx xmlns="http://www.topografix.com/GPX/1/1" version="1.1" creator="t"><trk><trkseg>
<trkpt lat="50.0" lon="14.0"><time>2024-05-01T10:00:00Z</time></trkpt>
<trkpt lat="50.0001" lon="14.0"><time>2024-05-01T10:00:01.5Z</time></trkpt>
<trkpt lat="50.0002" lon="14.0"><time>2024-05-01T10:00:03Z</time></trkpt>
</trkseg></trk></gpx>"""
TRACK = "/tracks/gps/track track 1"
FIRST_NS = 1714557600 * 10**9


@pytest.fixture
def mission(expmap, tmp_path, monkeypatch):
    """A library with a mission of three poses."""
    monkeypatch.setenv("EXPMAP_LIBRARY", str(tmp_path / "library"))
    (tmp_path / "track.gpx").write_text(GPX)
    expmap("mission", "new", "Round")
    assert expmap("mission", "import", 1, tmp_path / "track.gpx")[0] == 0
    return 1


class Served:
    """The command as a process, and the port it prints."""

    def __init__(self, *words):
        command = [sys.executable, "-m", "webapp", "foxglove", *map(str, words), "--port", "0"]
        environ = {**os.environ, "PYTHONPATH": str(ROOT), "PYTHONUNBUFFERED": "1"}
        self.process = subprocess.Popen(command, env=environ, stdout=subprocess.PIPE, text=True)
        line = self.process.stdout.readline()
        self.port = int(re.fullmatch(r"listening on ws://127\.0\.0\.1:(\d+)\n", line)[1])

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.process.send_signal(signal.SIGINT)
        self.process.stdout.close()
        self.code = self.process.wait(timeout=60)


@pytest.fixture
def survey(tmp_path, save_photo):
    """A map of five photos in a row with a georeference."""
    rows = ["name;x;y"]
    for number in range(5):
        save_photo(tmp_path / "photos" / f"{number}.jpg", number)
        rows.append(f"{number}.jpg;{100 + 100 * number};100")
    (tmp_path / "positions.csv").write_text("\n".join(rows) + "\n")
    Image.new("RGB", (700, 200), "grey").save(tmp_path / "plan.png")
    corners = {"top_left": {"lat": 50.0, "lon": 14.0}, "bottom_right": {"lat": 49.9998, "lon": 14.001}}
    (tmp_path / "corners.json").write_text(json.dumps(corners))
    options = PlaceOptions(
        tmp_path / "map.cfg",
        tmp_path / "plan.png",
        source=GeoSource("corners", tmp_path / "corners.json"),
        positions=tmp_path / "positions.csv",
    )
    place_photos(tmp_path / "photos", options)
    return tmp_path


def test_answers_are_served_also_to_those_who_come_late(survey):
    photo = survey / "photos" / "2.jpg"
    with Served("localize", survey / "map.cfg", photo, "--features", "sift") as served:
        heard = hear(served.port, TOPICS)
        again = hear(served.port, {"/answer"})
    assert served.code == 0
    assert again["/answer"] == heard["/answer"]
    best = heard["/answer"]["hypotheses"][0]
    position = heard["/position"]
    assert (position.latitude, position.longitude) == pytest.approx((best["lat"], best["lon"]))
    shown = [fix.latitude for fix in heard["/hypotheses"].fixes]
    assert shown == pytest.approx([h["lat"] for h in heard["/answer"]["hypotheses"]])
    assert position.position_covariance[0] == pytest.approx((best["radius_m"] / 1.5096) ** 2, rel=1e-3)
    for topic in ("/image", "/matches", "/map"):
        assert heard[topic].format == "jpeg"
        assert min(Image.open(BytesIO(heard[topic].data)).size) > 100


def test_a_photo_is_taken_once_when_it_is_copied(tmp_path):
    watched, photo = WatchedPhotos([tmp_path]), tmp_path / "a.jpg"
    taken = []
    for content in (b"ha", b"half", b"half", b"half"):
        photo.write_bytes(content)
        os.utime(photo, ns=(0, 0))
        taken.append(list(watched.new(settled=False)))
    assert taken == [[], [], [photo], []]


def test_a_file_without_some_photos_has_an_exit_code_of_its_own(expmap, survey):
    (survey / "broken.jpg").write_bytes(b"no photo")
    photos = (survey / "broken.jpg", survey / "photos" / "2.jpg")
    code, _, error = expmap(
        "foxglove", "localize", survey / "map.cfg", *photos, "--features", "sift", "--out", survey / "a.mcap"
    )
    assert code == 1 and "broken.jpg" in error
    assert "/answer" in {topic for topic, _, _ in read_mcap(survey / "a.mcap")}


def test_a_mission_is_served(mission):
    with Served("mission", mission) as served:
        heard = hear(served.port, {"/mission", TRACK})
    assert served.code == 0
    assert heard[TRACK].latitude == pytest.approx(50.0002)
    assert "50.0001" in heard["/mission"].geojson


def test_a_mission_becomes_an_mcap_file_with_every_pose_at_its_time(expmap, mission, tmp_path):
    out = tmp_path / "round.mcap"
    assert expmap("foxglove", "mission", mission, "--out", out)[0] == 0
    found = read_mcap(out)
    fixes = [(time, message.latitude) for topic, time, message in found if topic == TRACK]
    times = [FIRST_NS, FIRST_NS + 1_500_000_000, FIRST_NS + 3_000_000_000]
    assert [time for time, _ in fixes] == times
    assert [latitude for _, latitude in fixes] == pytest.approx([50.0, 50.0001, 50.0002])
    assert [time for topic, time, _ in found if topic == "/mission"] == [times[-1]]
    code, _, error = expmap("foxglove", "mission", mission, "--out", out)
    assert code == 2 and "already exists" in error


def test_a_mission_that_is_not_there_and_a_port_that_is_taken_are_told(expmap, mission):
    code, _, error = expmap("foxglove", "mission", 99)
    assert code == 1 and "no mission 99" in error
    with Served("mission", mission) as served:
        code, _, error = expmap("foxglove", "mission", mission, "--port", served.port)
    assert code == 2 and f"cannot listen on 127.0.0.1:{served.port}" in error


class Interrupting:
    """Receives Ctrl-C in its destructor, where Python ignores exceptions."""

    def __del__(self):
        signal.raise_signal(signal.SIGINT)
        len("")  # the handler runs between two operations


@pytest.mark.filterwarnings("ignore::pytest.PytestUnraisableExceptionWarning")
def test_ctrl_c_is_not_lost_in_a_destructor(capsys):
    looks = []

    def poll():
        looks.append(1)
        assert len(looks) < 3, "it goes on"
        Interrupting()

    serve_until_interrupted(SimpleNamespace(port=1), "127.0.0.1", poll=poll)
    assert len(looks) == 1 and "stopped" in capsys.readouterr().err


def test_the_file_of_a_mission_is_imported_again(expmap, mission, tmp_path):
    out = tmp_path / "round.mcap"
    assert expmap("foxglove", "mission", mission, "--out", out)[0] == 0
    expmap("mission", "new", "Again")
    assert expmap("mission", "import", 2, out, "--min-move", "0")[0] == 0
    first, again = (
        json.loads(expmap("mission", "export", number, "-", "--format", "geojson")[1]) for number in (1, 2)
    )
    assert [f["geometry"] for f in again["features"]] == [f["geometry"] for f in first["features"]]
    times = [f["properties"]["coordinateProperties"]["times"] for f in first["features"]]
    assert [f["properties"]["coordinateProperties"]["times"] for f in again["features"]] == times
