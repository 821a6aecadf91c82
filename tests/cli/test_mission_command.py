"""The command `expmap mission`."""

import json

import pytest

from webapp.missions.store import missions
from webapp.missions.store.schema import Mission
from webapp.store.library import open_library

GPX = (
    '<gpx><wpt lat="50" lon="14"/><trk><trkseg><trkpt lat="50" lon="14"/>'
    '<trkpt lat="51" lon="14"/></trkseg></trk></gpx>'
)


@pytest.fixture
def mission(expmap, tmp_path, monkeypatch):
    """Run `expmap mission` on a library and return exit code, standard output and standard error."""
    monkeypatch.setenv("EXPMAP_LIBRARY", str(tmp_path / "library"))

    def call(*arguments):
        return expmap("mission", *arguments)

    return call


def end_mission(folder, number):
    library = open_library(folder)
    with library.database.write() as session:
        missions.end(session.get_one(Mission, number))
    library.database.close()


def test_from_a_file_to_a_file(mission, tmp_path):
    code, number, _ = mission("new", "Yard", "--start", "50,14,90", "--note", "first")
    assert (code, number) == (0, "1\n")
    good, bad = tmp_path / "walk.gpx", tmp_path / "bad.gpx"
    good.write_text(GPX)
    bad.write_text("<svg/>")
    code, out, err = mission("import", "1", good, bad)
    assert code == 1, "one of two failed"
    assert "walk.gpx: gps 'walk track 1': 2 poses, 0 left out (not moved), 11" in out
    assert "1 sightings of objects" in out
    assert "bad.gpx: the XML is neither GPX, TCX nor KML" in err
    code, out, _ = mission("list")
    assert (code, out.split("\t")[:4]) == (0, ["1", "Yard", "2", "1"])
    code, _, err = mission("import", "1", good)
    assert code == 0
    assert "everything in it was already imported" in err
    code, out, _ = mission("export", "1", tmp_path / "out.geojson")
    assert (code, out) == (0, f"{tmp_path / 'out.geojson'}\n")
    assert (tmp_path / "out.geojson").read_text().startswith("{")
    assert mission("export", "1", tmp_path / "yard-objects.csv")[0] == 0
    assert "waypoint" in (tmp_path / "yard-objects.csv").read_text()
    code, out, err = mission(
        "export", "1", tmp_path / "report.html", "--language", "de", "--zone", "Asia/Tokyo"
    )
    assert (code, out) == (0, f"{tmp_path / 'report.html'}\n"), err
    text = (tmp_path / "report.html").read_text("utf-8")
    assert "Missionsbericht" in text and "Asia/Tokyo" in text and "UTC+09:00" in text
    assert mission("export", "1", tmp_path / "yard.html")[0] == 0
    assert "leaflet" in (tmp_path / "yard.html").read_text("utf-8")
    assert mission("export", "1", tmp_path / "yard-report.pdf")[0] == 0
    assert (tmp_path / "yard-report.pdf").read_bytes().startswith(b"%PDF")


def test_a_trajectory_continues_from_a_start_of_its_own(mission, tmp_path):
    mission("new", "Yard")
    path = tmp_path / "way.txt"
    path.write_text("0 0 0 0 0 0 0 1\n1 5 0 0 0 0 0 1\n")
    code, _, err = mission("import", "1", path)
    assert code == 1
    assert "needs a start position and heading" in err
    code, out, _ = mission("import", "1", path, "--start", "50,14,0", "--source", "visual", "--min-move", "0")
    assert code == 0
    assert "visual 'way': 2 poses, 0 left out (not moved), 5.0 m" in out


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (("export", "7", "out.kml"), "mission not found"),
        (("export", "1", "out.doc"), "the format cannot be inferred from the file name"),
        (("export", "1", "report.pdf", "--zone", "Mars/Base"), "there is no time zone 'Mars/Base'"),
        (("import", "9", "."), "the folder is not a ROS 2 bag"),
        (("new", "Yard", "--start", "50,14"), "write latitude, longitude and heading"),
        (("new", "Yard", "--start", "95,14,0"), "not a valid position"),
        (("import", "1", "x", "--min-move", "1"), "not a distance with a unit"),
        (("import", "1", "x", "--list"), "the file cannot be read"),
    ],
)
def test_errors_are_one_line(mission, arguments, message):
    mission("new", "Yard")
    code, out, err = mission(*arguments)
    assert code != 0
    assert out == ""
    assert message in err.splitlines()[-1]


def test_a_mission_that_is_not_there_takes_nothing(mission, tmp_path):
    path = tmp_path / "walk.gpx"
    path.write_text(GPX)
    code, _, err = mission("import", "9", path)
    assert code == 1
    assert "mission 9: the mission was not found, or is in the bin" in err


def test_topics_are_listed(mission, shared_data):
    code, out, _ = mission("import", "1", "--list", shared_data / "robot" / "test1.bag")
    assert code == 0
    assert "/fix\tsensor_msgs/msg/NavSatFix\t989\n" in out
    assert "/imu/data\tsensor_msgs/msg/Imu\t11865\tnot used\n" in out


def test_inspect_says_what_is_in_files(mission, tmp_path):
    good, bad = tmp_path / "walk.gpx", tmp_path / "bad.csv"
    good.write_text(GPX)
    bad.write_text("a,b\n1,2\n")
    code, out, err = mission("inspect", good, bad)
    assert code == 1, "one of two cannot be imported"
    assert "walk.gpx: GPX\n  gps 'track 1': 2 poses, no times, 50.000000 to 51.000000 north" in out
    assert "1 sightings of objects" in out
    assert "no columns of positions are recognised" in err
    code, out, _ = mission("inspect", "--json", good, tmp_path / "none.gpx")
    first, second = map(json.loads, out.splitlines())
    assert code == 1
    assert first["sources"][0]["poses"] == 2
    assert "line" not in first["sources"][0]
    assert "cannot be read" in second["problem"]


def test_inspect_needs_no_start(mission, tmp_path):
    path = tmp_path / "way.tum"
    path.write_text("# axes\n0 0 0 0 0 0 0 1\n1 3 4 0 0 0 0 1\n")
    code, out, _ = mission("inspect", path)
    assert code == 0
    assert "odometry: 2 poses, 1970-01-01T00:00:00Z to 1970-01-01T00:00:01Z, 3.0 m x 4.0 m x 0.0 m" in out
    assert "odd: poses dated before 1980" in out and "(2), first: line 1" in out
    code, out, _ = mission("inspect", path, "--axes", "camera")
    assert "0.0 m x 3.0 m x 4.0 m" in out


def test_old_missions_are_thinned_pruned_and_kept(mission, tmp_path):
    points = "".join(
        f'<trkpt lat="{50 + n * 1e-5}" lon="14"><time>2020-01-01T00:00:{n:02}Z</time></trkpt>'
        for n in range(60)
    )
    path = tmp_path / "walk.gpx"
    path.write_text(f"<gpx><trk><trkseg>{points}</trkseg></trk></gpx>")
    mission("new", "Yard")
    mission("import", "1", path, "--min-move", "0")
    code, _, err = mission("thin")
    assert code == 2
    assert "--older-than DAYS" in err
    code, out, err = mission("thin", "1", "9")
    assert (code, out) == (1, "0 poses of 0 tracks removed\n")
    assert "mission 1: the mission may still be under way" in err
    assert "mission 9: mission not found" in err
    end_mission(tmp_path / "library", 1)
    assert mission("keep", "1")[0] == 0
    code, _, err = mission("prune", "1")
    assert code == 1
    assert "expmap mission keep 1 --off" in err
    assert mission("keep", "1", "--off")[0] == 0
    code, out, _ = mission("prune", "1", "--older-than", "365")
    assert (code, out.splitlines()) == (
        0,
        ["mission 1 is skipped: it changed less than 365 days ago", "0 poses of 0 tracks removed"],
    )
    code, out, _ = mission("thin", "1", "--to", "0.5", "--dry-run")
    assert (code, out.splitlines()[-1]) == (0, "58 poses of 1 tracks would be removed")
    assert "mission 1: gps 'walk track 1' would have 2 of 60 poses" in out
    assert "has 2 of 60 poses" in mission("thin", "1", "--to", "0.5")[1]
    assert mission("prune", "1")[1] == "0 poses of 0 tracks removed\n"
    assert mission("prune", "--older-than", "1")[1] == "0 poses of 0 tracks removed\n"
