"""`expmap map cut-panoramas` for people and scripts; the cutting itself is replaced."""

import json

import pytest

from webapp.cli import cut as command
from webapp.tasks.maps.panoramas import CutOptions, CutPhoto


@pytest.fixture
def asked(tmp_path, monkeypatch):
    """What the command requests."""
    found = {}

    def cut(folder, out, *, options, **_):
        found["options"] = options
        return [CutPhoto("a.jpg", ("a_000.jpg", "a_180.jpg")), CutPhoto("b.jpg", problem="it is no panorama")]

    monkeypatch.setattr(command, "cut", cut)
    return found


def test_photos_are_listed_with_what_became_of_them(expmap, tmp_path, asked):
    code, out, err = expmap("map", "cut-panoramas", tmp_path, "--out", "views", "--views", 2, "--lowest", 40)
    assert code == 1
    assert out.splitlines() == ["a.jpg  2 views", "b.jpg  it is no panorama"]
    assert "views: 1 of 2 photos cut" in err
    assert asked["options"] == CutOptions(2, lowest_deg=40.0)


def test_json_has_everything(expmap, tmp_path, asked):
    _, out, _ = expmap("map", "cut-panoramas", tmp_path, "--out", "views", "--json")
    assert json.loads(out) == [
        {"photo": "a.jpg", "views": ["a_000.jpg", "a_180.jpg"], "problem": None},
        {"photo": "b.jpg", "views": [], "problem": "it is no panorama"},
    ]
