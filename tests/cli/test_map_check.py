"""`expmap map check` for people and scripts."""

import json
from pathlib import Path

import pytest
from click.testing import CliRunner
from PIL import Image

from webapp.app.main import root
from webapp.errors import MapError


@pytest.fixture
def cfg(tmp_path: Path) -> Path:
    """A map file with one photo next to it."""
    Image.new("RGB", (40, 30)).save(tmp_path / "s.png")
    Image.new("RGB", (64, 48)).save(tmp_path / "a.jpg")
    path = tmp_path / "map.cfg"
    path.write_bytes(b"s.png;40;30\n0;a.jpg;20;20\n")
    return path


def test_good_map(cfg: Path) -> None:
    result = CliRunner().invoke(root, ["map", "check", str(cfg)])
    assert (result.exit_code, result.stdout) == (0, "")
    summary, kind = result.stderr.splitlines()
    assert summary == f"{cfg}: 1 photo, 0 errors, 0 warnings"
    assert kind == f"{cfg}: by its positions a metric map; an answer is right within 2 px"


def test_bad_map(cfg: Path) -> None:
    cfg.write_bytes(b"s.png;40;30\n0;a.jpg;20,5;20\n")
    result = CliRunner().invoke(root, ["map", "check", str(cfg)])
    assert result.exit_code == 3
    assert result.stdout == (
        f"{cfg}:2:9: error: x = '20,5' has a decimal comma: pixels are whole numbers (decimal-comma)\n"
        "    fix: write 0;a.jpg;21;20\n"
    )
    assert result.stderr == f"{cfg}: 1 photo, 1 error, 0 warnings\n"


def test_warnings_alone_leave_the_map_usable(cfg: Path) -> None:
    for i in range(25):
        Image.new("RGB", (8, 8)).save(cfg.with_name(f"orphan{i:02}.jpg"))
    result = CliRunner().invoke(root, ["map", "check", str(cfg)])
    assert result.exit_code == 0
    assert result.stdout.count("(orphan-photo)") == 5
    assert "20 more of orphan-photo; --json lists all" in result.stderr


def test_json_lists_everything(cfg: Path) -> None:
    cfg.write_bytes(b"s.png;40;30\n" + b"0;a.jpg;1;1\n" * 30)
    result = CliRunner().invoke(root, ["map", "check", str(cfg), "--json"])
    assert result.exit_code == 3
    found = json.loads(result.stdout)
    assert (found["photos"], found["errors"], found["warnings"]) == (30, 29, 29)
    assert found["findings"][1] == {
        "file": str(cfg),
        "line": 3,
        "column": 3,
        "severity": "warning",
        "code": "duplicate-photo",
        "message": "the photo 'a.jpg' is already on line 2",
        "fix": "delete one of the two lines, unless the photo is meant to be in two places",
    }


def test_missing_file_is_an_error_of_the_map(cfg: Path) -> None:
    result = CliRunner().invoke(root, ["map", "check", str(cfg.with_name("none.cfg"))])
    assert isinstance(result.exception, MapError)
