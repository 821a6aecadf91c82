"""The documentation for robots is correct, and its examples run."""

import dataclasses
import json
import re
import subprocess
import sys
from pathlib import Path

from webapp.robot import RobotClient, RobotOptions
from webapp.robot.fields import RECORDS, SOURCES
from webapp.robot.records import parse_record

ROOT = Path(__file__).resolve().parents[2]
PAGE = "".join((ROOT / "docs" / f"{name}.md").read_text("utf-8") for name in ("robots", "robot-client"))


def blocks(language):
    return re.findall(rf"^```{language}\n(.*?)^```", PAGE, re.M | re.S)


def test_the_example_in_python_sends_what_it_says(site, mission, tmp_path, save_photo):
    program, _ = blocks("python")  # the other one queries a map: tests/web/localize
    (tmp_path / "example.py").write_text(program)
    save_photo(tmp_path / "door.jpg", 3)
    words = [sys.executable, "example.py", site.url, site.token, str(mission), "spool"]
    environ = {"PYTHONPATH": str(ROOT), "PATH": ""}
    done = subprocess.run(words, cwd=tmp_path, env=environ, capture_output=True, text=True, timeout=300)
    assert (done.returncode, done.stderr) == (0, "")
    assert site.summary(mission) == {
        "tracks": [("gps", 1), ("odometry", 1)],
        "objects": ["door 1"],
        "photos": 1,
    }


def test_the_lines_for_other_languages_are_records():
    (lines,) = blocks("json")
    records = [json.loads(line) for line in lines.splitlines()]
    assert [record["type"] for record in records] == ["pose", "object", "upload", "end"]
    for record in records:
        if record["type"] != "upload":
            assert parse_record(record, now_s=0) == record


def test_every_field_is_explained():
    rows = re.findall(r"^\| (`[a-z_`, ]+) \| (both|pose|object|status|end) \|", PAGE, re.M)
    explained = {(of, name) for cell, of in rows for name in re.findall(r"[a-z_0-9]+", cell)}
    both = RECORDS["pose"].keys() & RECORDS["object"].keys()
    known = {("both" if name in both else of, name) for of, fields in RECORDS.items() for name in fields}
    assert explained == known
    assert all(f"`{source}`" in PAGE for source in SOURCES)


def test_every_option_is_explained_with_its_default():
    explained = dict(re.findall(r"^\| `([a-z_]+)` \| ([\d.]+) \|", PAGE, re.M))
    assert explained == {field.name: str(field.default) for field in dataclasses.fields(RobotOptions)}


def test_every_call_is_explained():
    explained = set(re.findall(r"^\| `([a-z_]+)\(", PAGE, re.M))
    assert explained == {name for name in vars(RobotClient) if not name.startswith("_")}
