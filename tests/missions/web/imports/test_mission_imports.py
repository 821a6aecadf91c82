"""Files sent to the API: refused at once, or imported by a job."""

import io

import pytest

from webapp.errors import UsageError
from webapp.missions.store import tracks
from webapp.missions.store.schema import Mission

TABLE = b"stamp;la;lo\n1000;50,5;14\n2000;50,6;14\n"
COLUMNS = "time=stamp:ms, lat=la, lon=lo"


@pytest.fixture
def upload(client, mission):
    """Send a file, and return the response."""

    def send(data, name="log.csv", *, by=None, **fields):
        form = {"file": (io.BytesIO(data), name), **fields}
        return (by or client).post(f"/api/v1/missions/{mission}/imports", data=form)

    return send


def waiting(library):
    folder = library.inner / "imports"
    return sorted(folder.iterdir()) if folder.is_dir() else []


def test_a_file_is_imported_by_a_job(upload, library, mission, client, work):
    answer = upload(TABLE, "logs/day.csv", columns=COLUMNS, source="manual", min_move="0")
    assert answer.status_code == 202
    assert client.get(f"/api/v1/jobs/{answer.json['job']}").json["kind"] == "mission-import"
    assert [path.read_bytes() for path in waiting(library)] == [TABLE]
    result = work()
    (track,) = result["tracks"]
    assert (track["source"], track["name"], track["poses"]) == ("manual", "day", 2)
    assert (result["kind"], result["mission"], result["skipped"]) == ("table", mission, ())
    assert waiting(library) == [], "it is not needed any more"
    with library.database.read() as session:
        (stored,) = tracks.list_tracks(session, mission)
        assert tracks.read(session, stored).times_s.tolist() == [1.0, 2.0]


def test_what_the_job_refuses_is_not_kept(upload, library, work):
    assert upload(TABLE, columns="lat=here, lon=there").status_code == 202
    with pytest.raises(UsageError, match="no column 'here'"):
        work()
    assert waiting(library) == []


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b"", "empty"),
        (b"\x89PNG\r\n\x1a\n\0\0", "not a file with a track"),
        (b'<!DOCTYPE kml [<!ENTITY a "b">]><kml>&a;</kml>', "document type"),
        (b"PK\x03\x04", "zip is damaged"),
    ],
)
def test_a_file_without_a_track_is_refused_at_once(upload, library, data, message):
    answer = upload(data, "x.gpx")
    assert answer.status_code == 422 or answer.status_code == 400
    assert message in answer.json["error"]["message"]
    assert waiting(library) == []


@pytest.mark.parametrize("fields", [{"source": "sonar"}, {"min_move": "far"}])
def test_wrong_wishes_are_refused(upload, library, fields):
    answer = upload(TABLE, columns=COLUMNS, **fields)
    assert 400 <= answer.status_code < 500
    assert waiting(library) == []


def test_a_request_without_a_file_is_refused(client, mission):
    assert client.post(f"/api/v1/missions/{mission}/imports", data={}).status_code == 422


def test_only_editors_import(upload, sign_in, new_account, stranger):
    assert upload(TABLE, by=sign_in(new_account("eve"))).status_code == 404
    assert upload(TABLE, by=stranger).status_code == 401


GPX = b"""<gpx version="1.1" creator="x" xmlns="http://www.topografix.com/GPX/1/1"><trk><name>old</name><trkseg>
<trkpt lat="50" lon="14"/><trkpt lat="50.001" lon="14"/><trkpt lat="50.002" lon="14"/></trkseg></trk></gpx>"""


def test_no_speed_is_computed_without_times(upload, client, mission, work):
    upload(GPX, "old.gpx")
    assert any("without times" in note for note in work()["notes"])
    address = f"/api/v1/missions/{mission}"
    state = client.get(address).json
    (track,) = state["tracks"]
    assert (track["poses"], track["timed"]) == (3, False)
    assert track["distance_m"] == pytest.approx(222.5, rel=1e-3)
    assert (track["duration_s"], track["first_time_s"], track["last_time_s"]) == (0, None, None)
    assert state["duration_s"] == 0
    profile = client.get(f"{address}/tracks/{track['id']}/profile").json
    assert profile["speed_mps"] == [None] * 3 and profile["travelled_m"][-1] == pytest.approx(222.5, rel=1e-3)


@pytest.mark.parametrize("ending", ["kml", "gpx", "geojson", "csv", "html"])
def test_invented_times_do_not_go_out(upload, client, mission, work, ending):
    upload(GPX, "old.gpx", min_move="0")
    work()
    text = client.get(f"/api/v1/missions/{mission}/export.{ending}").text
    assert "50.002" in text and "1970-01" not in text


def test_tracks_without_times_are_not_fused(upload, client, mission, work):
    upload(GPX, "old.gpx")
    work()
    client.post(f"/api/v1/missions/{mission}/fuse")
    with pytest.raises(UsageError):
        work()


def test_a_start_comes_with_the_file_and_stays(upload, library, mission, work):
    way = b"1e9 0 0 0 0 0 0 1\n1.1e9 5 0 0 0 0 0 1\n"
    answer = upload(way, "way.tum", start="50,14,90", axes="camera", min_move="0")
    assert answer.status_code == 202
    (track,) = work()["tracks"]
    assert track["poses"] == 2
    with library.database.read() as session:
        assert session.get_one(Mission, mission).start == {"lat": 50.0, "lon": 14.0, "heading_deg": 90.0}


@pytest.mark.parametrize(
    ("fields", "status"), [({"start": "50,14"}, 400), ({"start": "95,14,0"}, 400), ({"axes": "enu"}, 422)]
)
def test_a_start_and_axes_have_to_be_valid(upload, fields, status):
    assert upload(b"1 0 0 0 0 0 0 1\n", "way.tum", **fields).status_code == status


def test_the_page_accepts_and_names_the_formats_that_it_can_read(client, monkeypatch):
    page = client.get("/missions").text
    assert '"accept": ".mcap,.bag,.db3,.gpx,' in page
    assert "This server cannot read" not in page
    monkeypatch.setattr("webapp.missions.web.pages.is_installed", lambda name: name != "missions")
    page = client.get("/missions").text
    assert "This server cannot read MCAP, ROS bags, FIT: the extra missions is not installed." in page
    assert "anywhere on this page: GPX, KML, KMZ, TCX, GeoJSON, ULog, " in page
