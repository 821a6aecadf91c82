"""The program in the guide to the API works as described, against a real server."""

import csv
import json
import os
import re
import signal
import subprocess
import sys
import zipfile
from pathlib import Path

import cv2
import numpy as np
import pytest

from webapp.files.maps.cfg import read_cfg
from webapp.store.accounts import accounts
from webapp.store.library import open_library
from webapp.store.maps import maps

ROOT = Path(__file__).resolve().parents[2]
PLACES = {
    "gate.jpg": (60, 150, 90),
    "oak.jpg": (160, 40, 180),
    "pond.jpg": (260, 120, 270),
    "bench.jpg": (330, 60, 0),
}

pytestmark = pytest.mark.skipif(os.name == "nt", reason="the server does not run natively on Windows")


@pytest.fixture
def survey(tmp_path, save_photo):
    """The folder described in the guide; the query shows the pond."""
    folder = tmp_path / "survey"
    for seed, name in enumerate(PLACES):
        save_photo(folder / "photos" / name, seed)
    cv2.imwrite(str(folder / "plan.png"), np.full((200, 400, 3), 200, np.uint8))
    with (folder / "places.csv").open("w", newline="") as file:
        csv.writer(file, delimiter=";").writerows([name, *place] for name, place in PLACES.items())
    pond = cv2.imread(str(folder / "photos" / "pond.jpg"))
    height, width = pond.shape[:2]
    turned = cv2.getRotationMatrix2D((width / 2, height / 2), 2.0, 1.05)
    cv2.imwrite(str(folder / "query.jpg"), cv2.warpAffine(pond, turned, (width, height)))
    (folder / "photos" / "notes.jpg").write_text("no photo at all")
    return folder


@pytest.fixture(scope="module")
def server(tmp_path_factory):
    """Address and token of a server with a separate library."""
    library = open_library(tmp_path_factory.mktemp("served") / "library")
    with library.database.write() as session:
        owner = accounts.ensure_owner(session)
        maps.create(session, "Another", account_id=owner.id)  # so that no sample map is made
        token = accounts.new_token(session, owner, name="example")
    library.database.close()
    words = ["serve", "--library", str(library.folder), "--port", "0", "--workers", "1", "--log", "json"]
    with (
        (library.folder.parent / "log").open("w") as log,
        subprocess.Popen(
            [sys.executable, "-m", "webapp", *words], cwd=ROOT, stdout=subprocess.PIPE, stderr=log, text=True
        ) as process,
    ):
        try:
            url = re.fullmatch(r"listening on (http://\S+)\n", process.stdout.readline())[1]
            yield url, token, Path(log.name)
        finally:
            process.send_signal(signal.SIGTERM)
            process.wait(60)


@pytest.fixture
def example(tmp_path):
    """The program, as a file."""
    programs = re.findall(
        r"^```python\n(.*?)^```", (ROOT / "docs" / "api.md").read_text("utf-8"), re.M | re.S
    )
    assert len(programs) == 1
    file = tmp_path / "example.py"
    file.write_text(programs[0])
    return file


def test_the_example_makes_a_map_localizes_and_takes_the_map_away(example, server, survey):
    url, token, log = server
    done = subprocess.run(
        [sys.executable, example, url, token, survey], capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    assert done.stderr.startswith("notes.jpg: ") and done.stderr.count("\n") == 1
    *places, off_map = done.stdout.splitlines()
    share, x, y = re.fullmatch(r"(\d+)% at (\d+), (\d+)", places[0]).groups()
    assert np.hypot(int(x) - 260, int(y) - 120) < 30
    assert int(share) > int(re.fullmatch(r"(\d+)% not on this map", off_map)[1])
    map_ = read_cfg(survey / "map.cfg").map
    assert sorted(tuple(e.position) for e in map_.experiences) == sorted(p[:2] for p in PLACES.values())
    with zipfile.ZipFile(survey / "map.zip") as archive:
        assert sum(name.endswith(".jpg") for name in archive.namelist()) == len(PLACES)
    check_log(log, token)


def check_log(log, token):
    """Check the server's log with `--log json`: a line for each request and each job, and no secrets."""
    lines = [json.loads(line) for line in log.read_text("utf-8").splitlines()]
    requests = [line for line in lines if line.get("event") == "request"]
    assert {"POST", "PUT", "PATCH", "GET"} <= {line["method"] for line in requests}
    assert any(line["route"] == "/api/v1/maps/<slug>/localize" and line["ms"] > 0 for line in requests)
    jobs = [line for line in lines if line.get("event") == "job"]
    assert {"index"} <= {line["kind"] for line in jobs} and {line["state"] for line in jobs} == {"done"}
    assert all(line["time"] and line["level"] == "info" and line["message"] for line in lines)
    assert token not in log.read_text("utf-8") and "sign-in/" not in log.read_text("utf-8")


def test_the_example_prints_an_error(example, server, survey):
    done = subprocess.run(
        [sys.executable, example, server[0], "wrong", survey], capture_output=True, text=True
    )
    assert done.returncode == 1
    hint = "make a new one on the account page, or with expmap account token"
    assert done.stderr == f"unknown token ({hint})\n"
