"""Missions are downloaded and queried by those who may see them."""

import csv
import io
import zipfile

import gpxpy
import pytest

from tests.kml_rules import KML, check_kml
from webapp.missions.render.export_file import FORMATS
from webapp.missions.store import query
from webapp.missions.web import api_exports
from webapp.store.backends import sqlite


def test_every_format_comes_as_a_file(client, new_mission):
    mission = new_mission()
    for form in FORMATS:
        name = "objects.csv" if form == "objects.csv" else f"export.{form}"
        answer = client.get(f"/api/v1/missions/{mission}/{name}")
        assert answer.status_code == 200 and answer.data
        assert "attachment; filename=Search" in answer.headers["Content-Disposition"]
        assert answer.headers["Cache-Control"] == "private, no-store"
    assert client.get(f"/api/v1/missions/{mission}/export.exe").status_code == 404
    assert client.get("/api/v1/missions/99/export.kml").status_code == 404


def test_what_was_sent_is_in_them(client, new_mission):
    mission = new_mission(25)
    gpx = gpxpy.parse(client.get(f"/api/v1/missions/{mission}/export.gpx").text)
    points = gpx.tracks[0].segments[0].points
    assert [round((p.longitude - 14) * 1e5) for p in points] == list(range(25))
    check_kml(client.get(f"/api/v1/missions/{mission}/export.kml").data)
    archive = zipfile.ZipFile(io.BytesIO(client.get(f"/api/v1/missions/{mission}/export.kmz").data))
    assert len(archive.namelist()) == 3
    rows = client.get(f"/api/v1/missions/{mission}/export.csv?points=5").text.splitlines()
    assert len(rows) == 6


def test_a_kmz_has_pictures_without_exif(client, new_mission, add_photo):
    mission = new_mission()
    sha = add_photo(mission)
    archive = zipfile.ZipFile(io.BytesIO(client.get(f"/api/v1/missions/{mission}/export.kmz").data))
    picture = archive.read(f"photos/{sha}.jpg")
    assert b"SECRETCAM" not in picture and picture.startswith(b"\xff\xd8")
    root = check_kml(archive.read("doc.kml"))
    shown = [e.text for e in root.iter(f"{KML}description")]
    assert shown == [f'<img src="photos/{sha}.jpg" alt="">']


def test_others_get_nothing(sign_in, new_account, new_mission, stranger):
    mission = new_mission()
    browser = sign_in(new_account("Mallory"))
    for name in ("export.kml", "objects.csv", "link.kml", "query"):
        assert browser.get(f"/api/v1/missions/{mission}/{name}").status_code == 404
        assert stranger.get(f"/api/v1/missions/{mission}/{name}").status_code == 401


def test_questions_are_answered(client, new_mission):
    where = f"/api/v1/missions/{new_mission()}/query"
    wish = {"from": "objects", "select": "id, class", "where": "class like 'c%'"}
    answer = client.get(where, query_string=wish)
    assert answer.json == {"columns": ["id", "class"], "rows": [["c1", "car"]], "complete": True}
    result = client.get(where, query_string={**wish, "format": "csv"})
    assert list(csv.reader(io.StringIO(result.text))) == [["id", "class"], ["c1", "car"]]
    poses = client.get(where, query_string={"where": "number >= 8", "select": "number"})
    assert poses.json["rows"] == [[8], [9]]


@pytest.mark.parametrize(
    ("wish", "status", "where"),
    [
        ({"where": "lat > 'x'"}, 400, "where, character 7"),
        ({"where": "id = 'x'; DROP TABLE mission"}, 400, "where, character 9"),
        ({"select": "*, epoch"}, 400, "select, character 2"),
        ({"order": "(select 1)"}, 400, "order, character 1"),
        ({"from": "account"}, 422, "query.from"),
        ({"limit": "1000000000"}, 422, "query.limit"),
        ({"where": "x" * 3000}, 422, "query.where"),
        ({"format": "xml"}, 422, "query.format"),
    ],
)
def test_an_error_has_its_position(client, new_mission, wish, status, where):
    answer = client.get(f"/api/v1/missions/{new_mission()}/query", query_string=wish)
    assert answer.status_code == status
    assert answer.json["error"]["where"] == where


def test_a_question_that_takes_too_long_is_refused(client, new_mission, monkeypatch):
    monkeypatch.setattr(query, "MAX_SECONDS", 0.0)
    monkeypatch.setattr(sqlite, "_STEPS", 1)
    answer = client.get(f"/api/v1/missions/{new_mission()}/query", query_string={"order": "lat"})
    assert answer.status_code == 400
    assert "seconds" in answer.json["error"]["message"]


def test_a_link_needs_a_public_share(client, new_mission, share):
    mission = new_mission()
    where = f"/api/v1/missions/{mission}/link.kml"
    share(mission)
    assert client.get(where).status_code == 400
    public = share(mission, public=True)
    root = check_kml(client.get(f"{where}?every=5").data)
    assert root.find(f".//{KML}href").text.startswith(public["url"] + "/export.kmz")
    assert root.find(f".//{KML}refreshInterval").text == "5"
    assert client.get(f"{where}?every=0").status_code == 422


def test_slow_readers_leave_threads_for_others(app, client, new_mission):
    where = f"/api/v1/missions/{new_mission()}/export.csv"
    with app.app_context():
        free = api_exports._limit.semaphore()
    taken = 0
    while free.acquire(blocking=False):
        taken += 1
    answer = client.get(where)
    assert taken == 4 and answer.status_code == 429 and answer.headers["Retry-After"]
    free.release()
    for _ in range(3):
        assert client.get(where).status_code == 200


def test_a_report_is_in_the_language_zone_and_notation_of_the_viewer(client, new_mission):
    mission = new_mission()
    address = f"/api/v1/missions/{mission}/export.report.html?zone=Europe/Prague&positions=mgrs"
    text = client.get(address, headers={"Accept-Language": "cs"}).text
    for expected in ('<html lang="cs">', "Zpráva o misi", "2026-05-01 12:00:00", "33U VR", "SECRETNOTE"):
        assert expected in text, expected
    for wrong, where in (("zone=Mars/Base", "zone"), ("positions=words", "positions")):
        answer = client.get(f"/api/v1/missions/{mission}/export.report.pdf?{wrong}")
        assert answer.status_code in (400, 422) and where in answer.json["error"]["where"]


def test_a_report_has_pictures_only_where_photos_are_shared(client, stranger, new_mission, add_photo, share):
    mission = new_mission()
    add_photo(mission)
    report = client.get(f"/api/v1/missions/{mission}/export.report.html").text
    assert report.count("data:image/webp") == 1 and "SECRETCAM" not in report
    for photos in (False, True):
        page = share(mission, photos=photos)["url"]
        shown = stranger.get(f"{page}/export.report.html").text
        assert shown.count("data:image/webp") == photos
        assert "SECRETNOTE" not in shown and "v1" in shown
