"""The report of a mission: what it says to members and to visitors, its limits, languages and zones."""

import base64
import io
import json
import re

import numpy as np
import pytest
from PIL import Image

from webapp.core.geo.local import LocalFrame
from webapp.core.geo.types import LatLon
from webapp.errors import NotFound, UsageError
from webapp.missions.core.trajectory.records import make_poses
from webapp.missions.render import report as report_words
from webapp.missions.render.export_file import ExportOptions, export_mission_file
from webapp.missions.store import drawings, missions, objects, tracks
from webapp.missions.store.objects import StateChange
from webapp.missions.store.schema import (
    Mission,
    MissionObject,
    MissionPhone,
    RobotHeard,
    RobotReport,
    RobotSilence,
)
from webapp.missions.tasks import report as gathering
from webapp.missions.tasks.add_photo import PhotoMetadata, add_mission_photo
from webapp.render.language import LANGUAGES, Language
from webapp.settings import Settings
from webapp.tasks.maps import adopt_map

BEGIN = 1_777_629_600.0
"""2026-05-01T10:00:00Z."""

ORIGIN = LatLon(50.0, 14.0)
GEO = {
    "format": "experience-map",
    "version": 1,
    "georeference": {
        "plane": "EPSG:4326",
        "plane_from_pixel": [[1e-5, 0, 14.0], [0, -1e-5, 50.002], [0, 0, 1]],
        "method": "corners",
    },
}


def corners(east, north, width, height):
    """A rectangle, metres from the origin, as latitudes and longitudes."""
    enu = [[east, north], [east + width, north], [east + width, north + height], [east, north + height]]
    return [tuple(at) for at in LocalFrame(ORIGIN).latlon_from_enu(np.array(enu, float)).tolist()]


def walk(east, *, begin_s=0.0):
    """Poses every second, 1 m/s northwards for 100 m."""
    enu = np.column_stack([np.full(101, float(east)), np.arange(101.0)])
    latlon = LocalFrame(ORIGIN).latlon_from_enu(enu)
    return make_poses(BEGIN + begin_s + np.arange(101.0), latlon, travelled_m=np.arange(101.0))


@pytest.fixture
def rescue(library, new_mission):
    """A mission with two robots, areas, objects and people; its id."""
    id = new_mission(0, objects=2, name="Search & <rescue>")
    with library.database.write() as session:
        mission = session.get_one(Mission, id)
        mission.note, mission.silent_after_s = "Fog until noon", 30.0
        for name, east, begin in (("Ant", 10, 0.0), ("Bee", 70, 3600.0)):
            track = tracks.get_or_create(session, id, source="gps", name=name)
            tracks.append(session, track, walk(east, begin_s=begin))
        area = {"name": "Yard", "points": corners(0, 0, 100, 100), "assigned": "Ant", "radius_m": 10.0}
        drawn = drawings.add(session, mission, kind="area", by="zoe", fields={**area, "note": "with dogs"})
        drawings.change(session, mission, id=drawn.id, by="yves", fields={"searched": True}, seen=None)
        far = {"name": "Hill", "points": corners(400, 0, 50, 50)}
        drawings.add(session, mission, kind="area", by="zoe", fields=far)
        drawings.add(
            session,
            mission,
            kind="line",
            by="zoe",
            fields={"name": "Rope", "points": corners(0, 0, 30, 40)[:2]},
        )
        drawings.add(
            session, mission, kind="marker", by="zoe", fields={"name": "Post", "points": [(50.0005, 14.0005)]}
        )
        change = StateChange("confirmed", "yves", note="under a tree")
        objects.change_state(session, mission, object_id="o0", change=change)
        session.add(RobotHeard(mission_id=id, robot="Ant", time_s=BEGIN + 100))
        said = {"battery_percent": 41.0, "link_percent": None, "mode": "AUTO", "text": "returning"}
        session.add(RobotReport(mission_id=id, robot="Ant", time_s=BEGIN + 99, **said))
        session.add(RobotSilence(mission_id=id, robot="Ant", since_s=BEGIN + 20, until_s=BEGIN + 80))
        session.add(MissionPhone(mission_id=id, name="Mia", token_hash="x", positions=7))
    return id


def exported(library, mission, form="report.html", *, private=True, **options):
    download = export_mission_file(
        library,
        mission,
        form=form,
        settings=Settings(),
        options=ExportOptions(private=private, **options),
    )
    return b"".join(download.pieces)


def page(library, mission, **options):
    return exported(library, mission, **options).decode()


def rows(text, title):
    """The rows of a table, as texts of its cells."""
    section = text.split(f"<h2>{title}</h2>", 1)[1].split("</table>", 1)[0].split("<tbody>", 1)[1]
    cells = [
        re.findall(r"<(?:td|th scope=row)[^>]*>(.*?)</t[dh]>", row, re.S) for row in section.split("<tr>")
    ]
    plain = [[re.sub(r"\s+", " ", re.sub("<[^>]+>", " ", one)).strip() for one in row] for row in cells]
    return [row for row in plain if row]


def test_it_says_who_searched_what_when_and_how_well(library, rescue):
    yard, hill = rows(page(library, rescue), "Search areas")
    assert yard[0] == "Yard with dogs" and yard[2] == "10\u00a0m".replace("\u00a0", " ")
    assert float(yard[3].removesuffix(" %")) == pytest.approx(40, abs=1.5)
    ant, bee = yard[4].split(" GPS: ")
    assert ant.startswith("GPS: Ant: 20") and "2026-05-01 10:00:00 – 10:01:40" in ant
    assert bee.startswith("Bee: 20") and "2026-05-01 11:00:00 – 11:01:40" in bee
    assert yard[5].startswith("assigned to Ant marked as searched by yves 20")
    assert hill[3:6] == ["0 %", "–", "to do"]


def test_it_says_who_took_part_and_what_happened(library, rescue):
    text = page(library, rescue)
    assert rows(text, "Tracks") == [
        ["GPS: Ant", "GPS", "2026-05-01 10:00:00", "2026-05-01 10:01:40", "0:01:40", "100 m"],
        ["GPS: Bee", "GPS", "2026-05-01 11:00:00", "2026-05-01 11:01:40", "0:01:40", "100 m"],
    ]
    first, second = rows(text, "Objects")
    assert first[:4] == ["o0", "victim", "0 %", "50.000000, 14.000000"]
    assert first[5].startswith("confirmed yves") and second[5] == "found"
    assert rows(text, "Robots, drones and phones") == [
        ["Ant", "2026-05-01 10:01:40", "41 %", "", "AUTO", "returning"]
    ]
    assert rows(text, "Alarms: silences") == [["Ant", "2026-05-01 10:00:20 – 10:01:20", "0:01:00"]]
    (change,) = rows(text, "Log of the objects")
    assert change[1:] == ["o0", "confirmed", "yves", "under a tree"]
    assert rows(text, "Who took part") == [
        ["ana", "made the mission"],
        ["zoe", "drew 4 areas, lines and markers"],
        ["yves", "marked 1 area as searched set the state of an object 1 time"],
        ["Mia", "sent positions from a phone"],
    ]
    assert "Fog until noon" in text and "Alarm when silent for 0:00:30." in text
    assert [row[:3] for row in rows(text, "Lines and markers")] == [
        ["Rope", "line", "30 m"],
        ["Post", "marker", "–"],
    ]


def test_visitors_get_neither_names_nor_notes_nor_robots(library, rescue):
    for form in ("report.html", "report.pdf"):
        assert exported(library, rescue, form, private=False)
    text = re.sub('base64,[^"]*', "", page(library, rescue, private=False))
    for secret in (
        "zoe",
        "yves",
        ">ana<",
        "Mia",
        "Fog",
        "with dogs",
        "under a tree",
        "returning",
        "assigned to",
    ):
        assert secret not in text, secret
    assert rows(text, "Search areas")[0][5].startswith("marked as searched 20")
    assert "Robots, drones" not in text and "Who took part" not in text


def test_it_needs_no_network_and_no_text_becomes_html(library, rescue):
    with library.database.write() as session:
        session.query(MissionObject).filter_by(object_id="o1").one().kind = "<img src=x onerror=hacked()>"
    text = page(library, rescue)
    for attribute in ('src="http', 'href="http', "url(http", "@import", "<img src=x", "<rescue>", "<script"):
        assert attribute not in text
    assert "<h1>Search &amp; &lt;rescue&gt;</h1>" in text and "@media print" in text
    assert exported(library, rescue, "report.pdf").startswith(b"%PDF")


def map_of(text):
    data = re.search(r'class="map" src="data:image/jpeg;base64,([^"]+)"', text)[1]
    return Image.open(io.BytesIO(base64.b64decode(data))).convert("RGB")


def test_the_map_shows_tracks_and_areas_where_they_are(library, rescue):
    with library.database.write() as session:
        session.query(MissionObject).delete()  # their symbols have similar colours
    image = np.array(map_of(page(library, rescue)), dtype=int)

    def pixels(*colour):
        return np.argwhere(np.abs(image - colour).max(axis=2) < 40)

    blue, green, purple = pixels(0, 114, 178), pixels(27, 120, 55), pixels(106, 61, 154)
    assert len(blue) > 500 and len(green) > 500 and len(purple) > 200
    west, east = (
        green[:, 1].min() + 3,
        green[:, 1].max() - 3,
    )  # middles of the lines: the yard is 100 m wide; the hill begins 300 m farther
    metre = (east - west) / 100
    hill = purple[purple[:, 1] > east + 10 * metre]
    assert len(hill) > 0.9 * len(purple)
    assert hill[:, 1].min() == pytest.approx(west + 400 * metre, abs=3 * metre)
    assert np.abs(blue[:, 1] - (west + 10 * metre)).min() < metre
    assert np.abs(blue[:, 1] - (west + 70 * metre)).min() < metre


def test_the_map_lies_on_the_image_of_its_map(library, rescue, owner, make_map):
    plain = np.array(map_of(page(library, rescue)))
    cfg = make_map(library.map_folder("park"), 1)
    cfg.with_name("map.json").write_text(json.dumps(GEO))
    map_id = adopt_map.adopt_map(library, "park", account_id=owner)
    with library.database.write() as session:
        session.get_one(Mission, rescue).map_id = map_id
    text = page(library, rescue)
    assert (np.abs(np.array(map_of(text)).astype(int) - plain) > 30).mean() > 0.15
    assert "<dt>Map</dt><dd>Park</dd>" in text


def test_pictures_of_objects_are_shown_where_they_may_be(library, rescue, tmp_path, save_photo):
    photo = tmp_path / "found.jpg"
    save_photo(photo, 3)
    about = PhotoMetadata(object_id="o0")
    add_mission_photo(library, rescue, source=photo, name="a.jpg", about=about, settings=Settings())
    with_picture = page(library, rescue, photos=True)
    assert with_picture.count("data:image/webp") == 1
    assert "data:image/webp" not in page(library, rescue)
    pdf = exported(library, rescue, "report.pdf", photos=True)
    assert len(pdf) > len(exported(library, rescue, "report.pdf")) + 500


def test_pictures_and_rows_are_limited_and_the_report_says_so(library, new_mission, monkeypatch):
    mission = new_mission(50, objects=9)
    monkeypatch.setattr(gathering, "MAX_OBJECTS", 4)
    text = page(library, mission)
    assert [row[0] for row in rows(text, "Objects")] == ["o0", "o1", "o2", "o3"]
    assert "The first 4 of 9 objects" in text and "<dt>Objects</dt><dd>9</dd>" in text


def test_of_long_tracks_only_some_poses_are_read(library, new_mission):
    (track,) = gathering.gather(library, new_mission(9000), people=True).mission.tracks
    assert track.count == gathering.MAX_POSES == sum(len(part) for part in track.poses())
    assert track.last_time_s - track.first_time_s == pytest.approx(8999 / 2)


def test_areas_that_take_too_long_have_no_share(library, rescue, monkeypatch):
    monkeypatch.setattr(gathering, "_COVERAGE_S", 0.0)
    text = page(library, rescue)
    assert "–" in [row[3] for row in rows(text, "Search areas")]
    assert "computing it took too long" in text


def test_times_are_in_the_zone_that_it_names(library, rescue):
    assert "All times are in UTC." in page(library, rescue)
    text = page(library, rescue, zone="Europe/Prague")
    assert "All times are those of Europe/Prague, at the start UTC+02:00." in text
    assert rows(text, "Tracks")[0][2] == "2026-05-01 12:00:00"
    with pytest.raises(UsageError, match="there is no time zone 'Mars/Base'"):
        page(library, rescue, zone="Mars/Base")


@pytest.mark.parametrize("zone", ["../../etc/passwd", "", "\0", "Europe"])
def test_what_is_no_zone_is_refused(zone):
    with pytest.raises(UsageError, match="there is no time zone"):
        Language("en", zone=zone)


def test_positions_have_the_notation_that_is_chosen(library, rescue):
    assert rows(page(library, rescue, positions="mgrs"), "Objects")[0][3] == (
        "50.000000, 14.000000 33U VR 28333 39109"
    )
    with pytest.raises(UsageError, match="no notation 'what3words'"):
        page(library, rescue, positions="what3words")


@pytest.mark.parametrize("language", LANGUAGES)
def test_it_is_there_in_every_language(library, rescue, language):
    text = page(library, rescue, language=language, zone="Europe/Prague", positions="utm")
    assert f'<html lang="{language}">' in text
    assert ("Search areas" in text) == (language == "en")
    assert exported(library, rescue, "report.pdf", language=language).startswith(b"%PDF")


def test_an_empty_mission_has_a_report(library, new_mission):
    mission = new_mission(0, objects=0)
    text = page(library, mission)
    assert "<h1>Search</h1>" in text and "<table>" in text and 'class="map"' not in text
    assert exported(library, mission, "report.pdf", private=False).startswith(b"%PDF")
    with pytest.raises(NotFound):
        exported(library, 99)


def test_tracks_without_times_have_none(library, new_mission):
    mission = new_mission(20)
    with library.database.write() as session:
        (track,) = tracks.list_tracks(session, mission)
        track.timed = False
    assert rows(page(library, mission), "Tracks")[0][2:5] == ["", "", "–"]


def test_a_pdf_with_many_rows_and_long_notes(library, rescue, monkeypatch):
    with library.database.write() as session:
        mission = session.get_one(Mission, rescue)
        mission.note = "long words " * 180
        for number in range(300):
            at = {"lat": 50 + number / 1e5, "lon": 14.0, "first_time_s": BEGIN, "last_time_s": BEGIN}
            kind = "an uncommonly long name of a class " * 3
            session.add(MissionObject(mission_id=rescue, object_id=f"x{number}" * 20, kind=kind, **at))
        shape = [(50 + n / 1e4, 14.0) for n in range(40)]
        fields = {"name": "L" * 120, "points": shape, "note": "N" * 2000}
        drawings.add(session, mission, kind="line", by="zoe", fields=fields)
    pdf = exported(library, rescue, "report.pdf")
    assert len(re.findall(rb"/Type /Page\b", pdf)) >= 10
    monkeypatch.setattr(report_words, "_MOST_POINTS", 3)
    assert "and 37 points more" in page(library, rescue)


def test_missions_need_not_be_on_the_northern_half(library, new_mission):
    mission = new_mission(0, objects=0)
    with library.database.write() as session:
        track = tracks.get_or_create(session, mission, source="gps")
        latlon = np.column_stack([np.full(9, -89.0), np.linspace(179.0, 179.9, 9)])
        tracks.append(session, track, make_poses(BEGIN + np.arange(9.0), latlon, travelled_m=np.arange(9.0)))
        assert missions.counts(session, mission)[0] == 9
    assert 'class="map"' in page(library, mission, positions="mgrs")
