"""`expmap mission fuse` of a mission with several odometries from the same time."""

import pytest


def tum(step):
    """Return a trajectory of a minute with steps of this length in metres."""
    return "".join(f"{1_777_629_600 + n} {n * step} 0 0 0 0 0 1\n" for n in range(60))


def gpx():
    points = "".join(
        f'<trkpt lat="50" lon="{14 + n * 1.4e-5}"><time>2026-05-01T10:00:{n:02}Z</time></trkpt>'
        for n in range(60)
    )
    return f'<gpx version="1.1"><trk><trkseg>{points}</trkseg></trk></gpx>'


@pytest.fixture
def mission(expmap, tmp_path, monkeypatch):
    monkeypatch.setenv("EXPMAP_LIBRARY", str(tmp_path / "library"))
    expmap("mission", "new", "Twice")
    for name, text in (("wheels.tum", tum(1.0)), ("visual.tum", tum(1.1)), ("gps.gpx", gpx())):
        (tmp_path / name).write_text(text)
        start = () if name == "gps.gpx" else ("--start", "50,14,90")
        assert expmap("mission", "import", 1, tmp_path / name, "--min-move", "0", *start)[0] == 0
    return 1


def test_it_asks_which_odometry_and_takes_the_answer(expmap, mission):
    code, out, err = expmap("mission", "fuse", mission)
    assert (code, out) == (2, "")
    assert "the mission has several tracks of odometry from the same time" in err
    ids = [word for word in err.replace("(", " ").split() if word.isdecimal()]
    assert "wheels" in err and "visual" in err and "1" in ids and "2" in ids
    code, out, _ = expmap("mission", "fuse", mission, "--odometry", 2)
    assert code == 0
    assert "poses from odometry 2 'visual'" in out
    code, _, err = expmap("mission", "fuse", mission, "--odometry", 9)
    assert code == 2
    assert "no odometry with the id 9" in err
