"""Files are uploaded, inspected, and imported or dropped; nothing is left behind."""

import os
import time
from contextlib import ExitStack

import pytest

from benchmarks import hostile_files
from webapp.errors import TooSlow
from webapp.files.lock import exclusive
from webapp.missions.files import guarded_reader
from webapp.missions.store import tracks
from webapp.missions.store.schema import Mission
from webapp.missions.tasks import import_file
from webapp.missions.web import api_staged
from webapp.settings import FileLimits
from webapp.tasks.maps.photo_files import sweep_uploads

FILES = "/api/v1/mission-files"
TABLE = (
    b"time,lat,lon,track,source\n"
    b"1700000000,50,14,walk,gps\n1700000010,50.001,14,walk,gps\n"
    b"1700000000,50,14.1,ride,manual\n1700000010,50.002,14.1,ride,manual\n"
)
WAY = b"1700000000 5 5 0 0 0 0 1\n1700000001 8 5 0 0 0 0 1\n1700000002 8 9 0 0 0 0 1\n"
START = {"lat": 50.0, "lon": 14.0, "heading_deg": 90.0}


@pytest.fixture
def stage(client):
    """Send a file and return its address."""

    def send(data, name="log.csv", *, by=client):
        begun = by.post(FILES, json={"name": name, "size_bytes": len(data)})
        assert begun.status_code == 201
        address = f"{FILES}/{begun.json['id']}"
        sent = by.patch(address, data=data, headers={"Upload-Offset": "0"})
        assert sent.json == {"offset": len(data)}
        return address

    return send


@pytest.fixture
def missions_made(library):
    """Return the names of all missions."""

    def names():
        with library.database.read() as session:
            return [mission.name for mission in session.query(Mission)]

    return names


def left(library):
    """Return the staged files in the library, without locks."""
    folders = (library.uploads, library.inner / "imports")
    return [
        path for folder in folders if folder.is_dir() for path in folder.iterdir() if path.suffix != ".lock"
    ]


def test_what_is_in_a_file_is_said_and_nothing_is_stored(client, stage, missions_made):
    answer = client.post(f"{stage(TABLE)}/contents", json={"name": "log.csv"})
    assert answer.status_code == 200
    found = [(one["source"], one["track"], one["poses"], one["frame"]) for one in answer.json["sources"]]
    assert found == [("gps", "walk", 2, "earth"), ("manual", "ride", 2, "earth")]
    walk = answer.json["sources"][0]
    assert walk["line"] == [[50.0, 14.0], [50.001, 14.0]]
    assert (walk["first_time_s"], walk["last_time_s"]) == (1.7e9, 1.7e9 + 10)
    assert walk["extent"] == {"south": 50.0, "west": 14.0, "north": 50.001, "east": 14.0}
    assert answer.json["table"]["columns"] == {"time": 0, "lat": 1, "lon": 2, "track": 3, "source": 4}
    assert answer.json["table"]["units"] == {"time": "s", "lat": "deg", "lon": "deg"}
    assert answer.json["options"] == ["columns"]
    assert missions_made() == []


def test_columns_and_axes_change_what_is_found(client, stage):
    table = stage(b"a;b\n50;14\n50,1;14\n")
    unknown = client.post(f"{table}/contents", json={"name": "log.csv"}).json
    assert "no columns of positions" in unknown["problem"] and unknown["table"]["header"] == ["a", "b"]
    known = client.post(f"{table}/contents", json={"name": "log.csv", "columns": "lat=a, lon=b"}).json
    assert (known["problem"], known["sources"][0]["poses"]) == ("", 2)
    way = stage(WAY, "way.tum")
    lines = [
        client.post(f"{way}/contents", json={"name": "way.tum", "axes": axes}).json["sources"][0]["line"]
        for axes in ("", "ned")
    ]
    assert lines == [[[0, 0], [3, 0], [3, 4]], [[0, 0], [3, 0], [3, -4]]]


def test_a_new_account_gets_nothing_of_a_removed_one(client, stage, sign_in, new_account, app):
    removed = new_account("ana")
    browser = sign_in(removed)
    token = browser.post("/api/v1/account/tokens", json={"name": "robot"}).json["token"]
    address = stage(TABLE, by=browser)
    assert browser.get(address).status_code == 200
    assert client.delete(f"/api/v1/accounts/{removed.id}").status_code == 204
    eva = new_account("eva")
    newcomer = sign_in(eva)
    assert eva.id > removed.id
    assert newcomer.get(address).status_code == 404
    assert newcomer.post(f"{address}/contents", json={"name": "log.csv"}).status_code == 404
    assert newcomer.get("/api/v1/account/tokens").json["tokens"] == []
    asked = app.test_client().get("/api/v1/account", headers={"Authorization": f"Bearer {token}"})
    assert (asked.status_code, browser.get("/api/v1/account").status_code) == (401, 401)


def test_a_large_file_is_read_by_a_job(client, stage, work, monkeypatch):
    monkeypatch.setattr(api_staged, "_QUICK_BYTES", 10)
    answer = client.post(f"{stage(TABLE)}/contents", json={"name": "log.csv"})
    assert answer.status_code == 202
    assert client.get(f"/api/v1/jobs/{answer.json['job']}").json["kind"] == "mission-inspect"
    assert [one["track"] for one in work()["sources"]] == ["walk", "ride"]


def test_each_reading_of_each_large_file_has_a_job_of_its_own(client, stage, monkeypatch):
    monkeypatch.setattr(api_staged, "_QUICK_BYTES", 10)
    first, second = stage(TABLE), stage(TABLE)
    plain, other = {"name": "log.csv"}, {"name": "log.csv", "columns": "lat=lon, lon=lat"}
    asked = [(first, plain), (first, other), (second, plain), (first, plain)]
    ids = [client.post(f"{address}/contents", json=reading).json["job"] for address, reading in asked]
    assert len(set(ids[:3])) == 3
    assert ids[3] == ids[0], "the same question waits once"


def test_only_the_chosen_tracks_go_into_a_new_mission(client, stage, work, library, missions_made):
    address = stage(TABLE)
    wish = {
        "name": "log.csv",
        "new_mission": {"name": "Morning"},
        "tracks": [{"source": "gps", "track": "walk"}],
    }
    answer = client.post(f"{address}/import", json=wish)
    assert answer.status_code == 202
    assert missions_made() == [], "it is made when the file has been read"
    assert client.post(f"{address}/import", json=wish).status_code == 404, "it is on its way already"
    result = work()
    assert [track["name"] for track in result["tracks"]] == ["log walk"]
    assert missions_made() == ["Morning"]
    assert client.get(f"/api/v1/missions/{result['mission']}").json["poses"] == 2
    assert left(library) == []


def test_a_failed_import_leaves_no_mission(client, stage, work, library, missions_made):
    wish = {"name": "log.csv", "new_mission": {"name": "Morning"}, "columns": "lat=here, lon=there"}
    assert client.post(f"{stage(TABLE)}/import", json=wish).status_code == 202
    with pytest.raises(Exception, match="no column 'here'"):
        work()
    assert missions_made() == [] and left(library) == []


def test_a_killed_import_goes_on_in_the_mission_that_it_made(client, stage, work, missions_made, monkeypatch):
    wish = {"name": "log.csv", "new_mission": {"name": "Morning"}}
    client.post(f"{stage(TABLE)}/import", json=wish)

    def killed(*_args, **_options):
        raise KeyboardInterrupt

    with monkeypatch.context() as patch:
        patch.setattr(import_file, "_store", killed)
        with pytest.raises(KeyboardInterrupt):
            work(seconds=-1)  # its lease expires at once
    assert missions_made() == ["Morning"]
    assert sum(track["poses"] for track in work()["tracks"]) == 4
    assert missions_made() == ["Morning"]


def test_a_start_puts_a_track_where_it_was(client, stage, work, mission, library):
    wish = {"name": "way.tum", "mission": mission, "start": START, "min_move": "0"}
    client.post(f"{stage(WAY, 'way.tum')}/import", json=wish)
    work()
    with library.database.read() as session:
        (track,) = tracks.list_tracks(session, mission)
        latlon = tracks.read(session, track).latlon
        assert session.get_one(Mission, mission).start == START
    assert latlon[0] == pytest.approx([50.0, 14.0], abs=1e-9)
    assert latlon[1] == pytest.approx([50.0, 14.0 + 3 / 71_696], abs=1e-7)
    assert latlon[2][0] == pytest.approx(50.0 + 4 / 111_229, abs=1e-7)


@pytest.mark.parametrize(
    "wrong",
    [
        {"start": {"lat": 50.0, "lon": 14.0}},
        {"start": {"lat": 50.0, "heading_deg": 3.0}},
        {"start": {**START, "lat": 95.0}},
        {"axes": "enu"},
        {"min_move": "far"},
        {"mission": None},
        {"new_mission": {"name": "A second place"}},
        {"mission": None, "new_mission": {"name": " "}},
        {"tracks": [{"source": "sonar", "track": ""}]},
    ],
)
def test_half_a_start_and_other_wrong_wishes_are_refused(client, stage, mission, library, wrong):
    address = stage(WAY, "way.tum")
    answer = client.post(f"{address}/import", json={"name": "way.tum", "mission": mission, **wrong})
    assert answer.status_code in (400, 422)
    assert answer.json["error"].keys() == {"code", "message", "hint", "where"}
    assert client.get(address).json["offset"] == len(WAY), "it can be imported in another way"


def test_a_file_without_a_track_is_refused_by_name(client, stage, mission):
    address = stage(b"\x89PNG\r\n\x1a\n\0\0", "x.gpx")
    for action, wish in (("contents", {}), ("import", {"mission": mission})):
        error = client.post(f"{address}/{action}", json={"name": "x.gpx", **wish}).json["error"]
        assert "not a file with a track" in error["message"]


def test_chunks_resume_where_they_stopped(client, mission):
    address = f"{FILES}/{client.post(FILES, json={'name': 'a', 'size_bytes': 10}).json['id']}"
    client.patch(address, data=b"12345", headers={"Upload-Offset": "0"})
    wrong = client.patch(address, data=b"12345", headers={"Upload-Offset": "0"})
    assert (wrong.status_code, wrong.json["offset"]) == (409, 5)
    assert client.get(address).json["offset"] == 5
    for action in ("contents", "import"):
        answer = client.post(
            f"{address}/{action}",
            json={"name": "a", "mission": mission} if action == "import" else {"name": "a"},
        )
        assert answer.status_code == 400 and "5 of 10 bytes" in answer.json["error"]["message"]


def test_what_is_not_wanted_is_deleted(client, stage, library, settings):
    dropped, forgotten = stage(TABLE), stage(WAY)
    assert client.delete(dropped).status_code == 204
    assert client.get(dropped).status_code == 404
    assert sweep_uploads(library, settings=settings) == 0
    (path,) = left(library)
    old = time.time() - settings.upload.keep_hours * 3600 - 60
    os.utime(path, (old, old))
    assert sweep_uploads(library, settings=settings) == 1
    assert client.get(forgotten).status_code == 404


def test_files_of_others_and_their_missions_are_out_of_reach(client, stage, sign_in, new_account, mission):
    address, eve = stage(TABLE), sign_in(new_account("eve"))
    assert eve.get(address).status_code == 404
    own = stage(TABLE, by=eve)
    wish = {"name": "log.csv", "mission": mission}
    assert eve.post(f"{own}/import", json=wish).status_code == 404
    assert client.get(address).status_code == 200


def test_empty_too_large_and_too_many_are_refused(client, settings):
    most = settings.web.max_request_mb * 1e6
    for size in (0, int(most) + 1):
        answer = client.post(FILES, json={"name": "log.csv", "size_bytes": size})
        assert answer.status_code == 422 and answer.json["error"]["where"] == "log.csv"
    for _ in range(settings.upload.open_per_account):
        assert client.post(FILES, json={"name": "a", "size_bytes": 5}).status_code == 201
    assert client.post(FILES, json={"name": "a", "size_bytes": 5}).status_code == 400


def _too_slow(_path, _kind, *, budget, **_options):
    assert budget.wait_s == FileLimits().request_s
    raise TooSlow("it takes more than 10 s to be read")


def test_a_file_that_takes_long_is_read_by_a_job(client, stage, work, monkeypatch):
    monkeypatch.setattr(guarded_reader, "read", _too_slow)
    answer = client.post(f"{stage(TABLE)}/contents", json={"name": "log.csv"})
    monkeypatch.undo()
    assert answer.status_code == 202
    assert [one["track"] for one in work()["sources"]] == ["walk", "ride"]


def test_each_account_and_the_server_read_few_files_at_once(client, stage, library, owner, settings):
    address, form = f"{stage(TABLE)}/contents", {"name": "log.csv"}
    folder = library.inner / "reading"
    own = [folder / f"account-{owner.id}.lock"]
    shared = [folder / f"{number}.lock" for number in range(settings.files.at_once)]
    for held, said in ((own, "another file of yours"), (shared, "other files")):
        with ExitStack() as stack:
            for path in held:
                stack.enter_context(exclusive(path, doing="test"))
            busy = client.post(address, json=form)
        assert (busy.status_code, busy.json["error"]["code"]) == (503, "busy")
        assert said in busy.json["error"]["message"]
        assert int(busy.headers["Retry-After"]) > 0
        assert client.post(address, json=form).status_code == 200, "it is free again"


def test_a_bomb_is_an_error_of_the_file_and_leaves_the_server_as_it_was(client, stage):
    name, data = hostile_files.BOMBS["mcap zstd"](600_000_000)
    answer = client.post(f"{stage(data, name)}/contents", json={"name": name})
    assert answer.status_code == 422
    assert answer.json["error"]["where"] == "a.mcap"
    assert "claims to hold 600 MB" in answer.json["error"]["message"]
