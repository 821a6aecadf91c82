"""`expmap map join-panoramas` for people and scripts; the joining itself is replaced."""

import json

import pytest

from webapp.cli import cut as command
from webapp.tasks.maps.panoramas import JoinedPanorama, JoinOptions


@pytest.fixture
def asked(tmp_path, monkeypatch):
    """What the command requests."""
    found = {}
    (tmp_path / "rig.json").write_text('{"cameras": [{"photos": "a/*.jpg", "yaw_deg": 10}]}')

    def join(folder, out, *, cameras, options, **_):
        found.update(cameras=cameras, options=options)
        return [
            JoinedPanorama("1.jpg", ("a/1.jpg",)),
            JoinedPanorama("2.jpg", ("a/2.jpg",), is_new=False),
            JoinedPanorama("3.jpg", (), problem="no photo"),
        ]

    monkeypatch.setattr(command, "join", join)
    return found


def test_instants_are_listed_with_their_outcome(expmap, tmp_path, asked):
    options = ["--rig", tmp_path / "rig.json", "--out", "out", "--width", 720, "--mask", "m.png"]
    code, out, err = expmap("map", "join-panoramas", tmp_path, *options)
    assert code == 1
    assert out.splitlines() == ["1.jpg  joined", "2.jpg  already there", "3.jpg  no photo"]
    assert "out: 2 of 3 panoramas" in err
    assert asked["cameras"][0].yaw_deg == 10.0
    assert (asked["options"].width, asked["options"].mask.name) == (720, "m.png")


def test_json_has_everything(expmap, tmp_path, asked):
    _, out, _ = expmap(
        "map", "join-panoramas", tmp_path, "--rig", tmp_path / "rig.json", "--out", "out", "--json"
    )
    assert json.loads(out)[1:] == [
        {"panorama": "2.jpg", "photos": ["a/2.jpg"], "is_new": False, "problem": None},
        {"panorama": "3.jpg", "photos": [], "is_new": True, "problem": "no photo"},
    ]
    assert asked["options"] == JoinOptions()


def test_a_rig_that_cannot_be_read_is_refused(expmap, tmp_path):
    (tmp_path / "rig.json").write_text("{}")
    code, _, err = expmap("map", "join-panoramas", tmp_path, "--rig", tmp_path / "rig.json", "--out", "out")
    assert code > 1
    assert "$.cameras is missing" in err
