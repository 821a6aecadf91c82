"""Localizing through the API: answers, permissions, and refusals."""

import csv
import io
import json
import math
import shutil
from dataclasses import replace
from threading import BoundedSemaphore, Event

import pytest
from sqlalchemy import func, select, update

from webapp.errors import StorageError
from webapp.files.localize.calibration import FORMAT
from webapp.store import queries as stored
from webapp.store.accounts import accounts
from webapp.store.schema import Job, MapRecord, QueryRecord
from webapp.tasks.landmarks.on_demand import NOT_YET
from webapp.tasks.localize import readiness, upload
from webapp.tasks.localize.pipeline import LocalizationPipeline
from webapp.tasks.localize.plan import OpenOptions
from webapp.tasks.maps import adopt_map
from webapp.threads import permit
from webapp.web.localize import api_localize

KEYS = {
    "query", "method", "features", "fov_deg", "fov_source", "hypotheses", "other_probability",
    "off_map_probability", "statistics", "seconds", "map_revision", "map_kind", "place_radius_px", "looks",
    "verdict", "sentence",
}  # fmt: skip
"""Fields of `expmap localize --json`."""


def jobs_of(library):
    with library.database.read() as session:
        return [(job.kind, job.key) for job in session.scalars(select(Job).where(Job.state == "queued"))]


def truth(queries, name):
    with (queries.parent / "queries.csv").open(encoding="utf-8", newline="") as file:
        rows = {row["path"]: row for row in csv.DictReader(file, delimiter=";")}
    return float(rows[f"queries/{name}"]["x"]), float(rows[f"queries/{name}"]["y"])


def test_a_query_is_found_and_remembered(client, sample, ask, queries):
    answer = ask(client, queries / "query_01.jpg").get_json()
    assert KEYS | {"id", "calibrated", "not_indexed"} == answer.keys()
    assert (answer["query"], answer["calibrated"], answer["not_indexed"]) == ("query_01.jpg", True, 0)
    first = answer["hypotheses"][0]
    assert math.dist((first["x_px"], first["y_px"]), truth(queries, "query_01.jpg")) < 40
    total = sum(h["probability"] for h in answer["hypotheses"])
    assert total + answer["other_probability"] + answer["off_map_probability"] == pytest.approx(1.0)
    reported = client.get(f"/api/v1/maps/sample/queries/{answer['id']}").get_json()
    assert reported["answer"].keys() == KEYS
    assert {key: answer[key] for key in KEYS} == reported["answer"]
    assert (reported["who"], reported["name"], reported["adopted"]) == ("owner", "query_01.jpg", None)


def as_events(client, ask, *photos, **options):
    """Localize photos as a client that accepts events; its response, and (kind, data) of each event."""
    client.environ_base["HTTP_ACCEPT"] = "text/event-stream, application/json;q=0.5"
    response = ask(client, *photos, **options)
    blocks = response.get_data(as_text=True).split("\n\n")[:-1] if response.status_code == 200 else []
    lines = [block.split("\n") for block in blocks]
    return response, [(kind.removeprefix("event: "), json.loads(data[6:])) for kind, data in lines]


def test_the_first_look_is_sent_before_the_answer(client, sample, ask, queries, monkeypatch):
    response, events = as_events(client, ask, queries / "query_01.jpg")
    assert response.mimetype == "text/event-stream"
    assert events[0] == ("progress", {"photos": 60, "done": 0, "total": 1})
    assert [kind for kind, _ in events] == ["progress", "answer"]
    run = LocalizationPipeline.observe

    def twice(pipeline, photo, *, on_first, **options):
        answer = run(pipeline, photo, **options)
        on_first(answer)
        return answer

    monkeypatch.setattr(LocalizationPipeline, "observe", twice)
    _, (_, (first, so_far), (kind, answer)) = as_events(client, ask, queries / "query_01.jpg")
    assert (first, kind, so_far.keys(), answer.keys()) == (
        "first",
        "answer",
        KEYS,
        KEYS | {"id", "calibrated", "not_indexed"},
    )
    assert {key: so_far[key] for key in KEYS} == {key: answer[key] for key in KEYS}
    assert client.get(f"/api/v1/maps/sample/queries/{answer['id']}").get_json()["answer"] == so_far


def test_the_work_ends_when_its_client_has_gone_and_counts_until_then(
    app, client, sample, ask, queries, library, monkeypatch
):
    may_end, run = Event(), LocalizationPipeline.observe

    def twice(pipeline, photo, *, on_first, **options):
        may_end.wait(20)
        answer = run(pipeline, photo, **options)
        on_first(answer)
        return answer

    monkeypatch.setattr(LocalizationPipeline, "observe", twice)
    free = app.extensions["expmap_concurrency"]["answers"] = BoundedSemaphore(1)
    client.environ_base["HTTP_ACCEPT"] = "text/event-stream, application/json;q=0.5"
    ask(client, queries / "query_01.jpg").close()
    assert ask(client, queries / "query_01.jpg").status_code == 503
    may_end.set()
    with permit(free):
        assert client.get("/api/v1/maps/sample/queries").get_json()["queries"] == []
        assert list(library.uploads.iterdir()) == []


def test_an_error_before_the_first_event_has_its_status(client, sample, ask):
    response, _ = as_events(client, ask, (io.BytesIO(b"no photo"), "a.jpg"))
    assert response.status_code == 422
    assert response.get_json()["error"]["where"] == "a.jpg"


def test_an_error_after_the_first_look_is_an_event(client, sample, ask, queries, monkeypatch):
    run = LocalizationPipeline.observe

    def fail(pipeline, photo, *, on_first, **options):
        on_first(run(pipeline, photo, **options))
        raise StorageError("the disk is full")

    monkeypatch.setattr(LocalizationPipeline, "observe", fail)
    _, (_, (first, _), (kind, data)) = as_events(client, ask, queries / "query_01.jpg")
    assert (first, kind, data["status"]) == ("first", "error", 507)
    assert data["error"]["message"] == "the disk is full"


def test_a_photo_from_elsewhere_is_off_the_map(client, sample, ask, queries):
    answer = ask(client, queries / "off_map.jpg").get_json()
    assert answer["off_map_probability"] > max(h["probability"] for h in answer["hypotheses"])


def test_an_answer_is_said_in_the_language_of_the_request(client, sample, ask, queries):
    words = {
        "off_map": ("Probably not on this map.", "Probablement pas sur cette carte."),
        "perhaps_off_map": (
            "Uncertain, perhaps not on this map.",
            "Incertain, peut-être pas sur cette carte.",
        ),
    }
    answer = ask(client, queries / "off_map.jpg").get_json()
    address = f"/api/v1/maps/sample/queries/{answer['id']}"
    french = client.get(address, headers={"Accept-Language": "fr"}).get_json()["answer"]
    assert french["verdict"] == answer["verdict"]
    assert (answer["sentence"], french["sentence"]) == words[answer["verdict"]]


def test_the_matches_lie_in_the_photos(client, sample, ask, queries):
    id = ask(client, queries / "query_02.jpg", top=2).get_json()["id"]
    reported = client.get(f"/api/v1/maps/sample/queries/{id}").get_json()
    matches = client.get(f"/api/v1/maps/sample/queries/{id}/matches").get_json()["matches"]
    spoken_for = [h["experiences"][0] for h in reported["answer"]["hypotheses"]]
    assert set(spoken_for) <= {m["experience"] for m in matches}
    for match in matches:
        assert len(match["query_xy"]) == len(match["photo_xy"]) == len(match["inlier"]) > 0
        assert all(0 <= x <= reported["width"] and 0 <= y <= reported["height"] for x, y in match["query_xy"])
    assert sum(matches[0]["inlier"]) == reported["answer"]["hypotheses"][0]["inliers"]


def test_pictures_of_a_query(client, sample, ask, queries):
    id = ask(client, queries / "query_00.jpg").get_json()["id"]
    reported = client.get(f"/api/v1/maps/sample/queries/{id}").get_json()
    assert client.get(reported["photo"], buffered=True).data == (queries / "query_00.jpg").read_bytes()
    for kind, mime, magic in (("preview", "image/jpeg", b"\xff\xd8"), ("thumb", "image/webp", b"RIFF")):
        picture = client.get(reported[kind], buffered=True)
        assert picture.mimetype == mime and picture.data.startswith(magic)
        assert b"Exif" not in picture.data


@pytest.mark.parametrize(("method", "features"), [("vote", "auto"), ("vote", "sift"), ("verified", "sift")])
def test_methods_and_features(client, sample, ask, queries, method, features):
    answer = ask(client, queries / "query_01.jpg", method=method, features=features).get_json()
    assert (answer["method"], answer["features"]) == (method, "sift")
    assert (answer["off_map_probability"] is None) == (method == "vote")


def test_the_field_of_view_can_be_given(client, sample, ask, queries):
    answer = ask(client, queries / "query_01.jpg", fov=70).get_json()
    assert (answer["fov_deg"], answer["fov_source"]) == (70.0, "option")


def test_hints_weigh(client, sample, ask, queries):
    name = "query_01.jpg"
    x, y = truth(queries, name)
    alone = ask(client, queries / name).get_json()
    near = {"hint_x_px": x, "hint_y_px": y, "hint_radius_px": 100}
    hinted = ask(client, queries / name, **near).get_json()
    first = hinted["hypotheses"][0]
    assert math.dist((first["x_px"], first["y_px"]), (x, y)) < 40
    assert first["probability"] >= alone["hypotheses"][0]["probability"]
    looked = alone["hypotheses"][0]["heading_deg"]
    right, wrong = (
        ask(client, queries / name, heading_deg=(looked + off) % 360).get_json()["off_map_probability"]
        for off in (0, 180)
    )
    assert right < alone["off_map_probability"] < wrong


def test_a_wrong_circle_is_not_believed(client, sample, ask, queries):
    name = "query_01.jpg"
    x, y = truth(queries, name)
    photos = client.get("/api/v1/maps/sample").get_json()["photos"]
    away = max(photos, key=lambda p: math.dist((p["x_px"], p["y_px"]), (x, y)))
    wrong = {"hint_x_px": away["x_px"], "hint_y_px": away["y_px"], "hint_radius_px": 50}
    answer = ask(client, queries / name, **wrong).get_json()
    reported = [(math.dist((h["x_px"], h["y_px"]), (x, y)), h["probability"]) for h in answer["hypotheses"]]
    assert all(p < 0.5 for off, p in reported if off > 60)
    parts = sum(p for _, p in reported) + answer["other_probability"] + answer["off_map_probability"]
    assert parts == pytest.approx(1.0)


@pytest.mark.parametrize(
    ("fields", "where"),
    [
        ({"hint_x_px": 1, "hint_y_px": 1, "hint_radius_px": 1}, "hint_radius_px"),
        ({"hint_x_px": 1}, "hint_x_px"),
        ({"hint_x_px": 1, "hint_y_px": 1, "hint_radius_px": 1e200}, "hint_radius_px"),
        ({"hint_x_px": 1e200, "hint_y_px": 1, "hint_radius_px": 1}, "hint_x_px"),
        ({"method": "guess"}, "method"),
        ({"features": "../../etc"}, "features"),
        ({"fov": "wide"}, "fov"),
        ({"fov": 200}, "fov"),
        ({"top": 0}, "top"),
    ],
)
def test_what_cannot_be_asked(client, sample, ask, queries, fields, where):
    response = ask(client, queries / "query_01.jpg", **fields)
    assert response.status_code in (400, 422)
    assert where in response.get_json()["error"]["where"]


@pytest.mark.parametrize("fields", [{}, {"file": ""}, {"file": "text"}])
def test_a_question_needs_a_photo(client, sample, ask, fields):
    response = ask(client, **fields)
    assert response.status_code in (400, 422)
    assert "file" in response.get_json()["error"]["where"]


@pytest.mark.parametrize(
    "data", [b"", b"not a photo", b"\xff\xd8\xff\xe0" + b"\0" * 200, b"<svg onload='alert(1)'/>"]
)
def test_hostile_files_leave_nothing(client, library, sample, ask, data):
    response = ask(client, (io.BytesIO(data), "../../evil.jpg"))
    assert response.status_code == 422
    reported = response.get_json()["error"]
    assert reported["code"] == "photo_error" and str(library.folder) not in json.dumps(reported)
    assert list(library.uploads.glob("*.part")) == []
    assert client.get("/api/v1/maps/sample/queries").get_json()["queries"] == []


def test_what_is_not_to_be_kept_is_not(client, library, sample, ask, queries):
    answer = ask(client, queries / "query_01.jpg", keep="false").get_json()
    assert answer["id"] is None and answer["hypotheses"]
    assert client.get("/api/v1/maps/sample/queries").get_json()["queries"] == []
    assert list(library.uploads.glob("*.part")) == [] and not (library.inner / "queries").exists()


def test_the_same_photo_is_asked_again_without_sending_it(client, sample, ask, queries):
    first = ask(client, queries / "query_01.jpg").get_json()
    again = ask(client, query=first["id"], method="vote").get_json()
    assert (again["method"], again["query"]) == ("vote", "query_01.jpg") and again["id"] != first["id"]
    ask(client, query=first["id"])
    client.delete(f"/api/v1/maps/sample/queries/{first['id']}")
    photo = client.get(f"/api/v1/maps/sample/queries/{again['id']}/photo", buffered=True)
    assert photo.data == (queries / "query_01.jpg").read_bytes()


def test_photos_of_one_spot_are_one_question(client, sample, ask, queries):
    photos = sorted((queries.parent / "photos").glob("*.jpg"))
    answer = ask(client, photos[20], photos[21]).get_json()
    assert answer["query"] == f"{photos[20].name}, {photos[21].name}"
    total = sum(h["probability"] for h in answer["hypotheses"])
    assert total + answer["other_probability"] + answer["off_map_probability"] == pytest.approx(1.0)
    (reported,) = client.get("/api/v1/maps/sample/queries").get_json()["queries"]
    assert reported["name"] in {photos[20].name, photos[21].name} and reported["options"]["photos"] == 2


def test_who_may_ask(library, sample, ask, queries, new_account, sign_in, stranger, owner):
    viewer, nobody = new_account("vera"), new_account("nora")
    with library.database.write() as session:
        accounts.set_member_role(session, session.get_one(MapRecord, sample), account=viewer, role="viewer")
    assert ask(stranger, queries / "query_01.jpg").status_code == 401
    assert ask(sign_in(nobody), queries / "query_01.jpg").status_code == 404
    response = ask(sign_in(viewer), queries / "query_01.jpg")
    assert response.status_code == 200
    id = response.get_json()["id"]
    assert sign_in(nobody).get(f"/api/v1/maps/sample/queries/{id}/photo").status_code == 404
    assert sign_in(viewer).post(f"/api/v1/maps/sample/queries/{id}/adopt", json={}).status_code == 403
    theirs = ask(sign_in(owner), queries / "query_02.jpg").get_json()["id"]
    assert sign_in(viewer).delete(f"/api/v1/maps/sample/queries/{theirs}").status_code == 403
    assert sign_in(viewer).delete(f"/api/v1/maps/sample/queries/{id}").status_code == 204


def test_an_answer_belongs_to_its_map(client, sample, ask, queries, park):
    id = ask(client, queries / "query_01.jpg").get_json()["id"]
    assert client.get(f"/api/v1/maps/{park}/queries/{id}").status_code == 404
    assert client.get("/api/v1/maps/sample/queries/99999999999").status_code == 404


def test_a_map_that_is_not_ready_says_so_and_is_made_ready(
    client, library, owner, ready_sample, ask, queries
):
    folder = library.map_folder("sample")
    shutil.copytree(ready_sample, folder, ignore=shutil.ignore_patterns("derived"))
    adopt_map.adopt_map(library, "sample", account_id=owner.id)
    for _ in range(2):
        response = ask(client, queries / "query_01.jpg")
        error = response.get_json()["error"]
        assert (response.status_code, error["code"]) == (409, "not_ready") and error["hint"]
    assert [job for job in jobs_of(library) if job[0] == "index"] == [("index", "")]
    with library.database.read() as session:
        (job,) = session.scalars(select(Job).where(Job.kind == "index"))
        assert job.urgent and job.asked_at is not None, "before other long work"
    response = ask(client, queries / "query_01.jpg", features="orb")
    assert response.status_code == 409 and ("index", "orb") in jobs_of(library)


@pytest.mark.parametrize(
    ("fields", "where"),
    [
        ({"method": "thorough"}, "method"),
        ({"method": "thorough", "features": "xfeat"}, "method"),
        ({"method": "thorough", "features": "sift"}, "method"),
        ({"features": "aliked"}, "features"),
        ({"method": "vote", "features": "disk"}, "features"),
    ],
)
def test_methods_without_models_are_refused_and_reported(client, sample, ask, queries, fields, where):
    response = ask(client, queries / "query_01.jpg", **fields)
    error = response.get_json()["error"]
    assert (response.status_code, error["where"]) == (400, where)
    assert ("vote, verified" if where == "method" else "sift, ") in error["hint"]
    assert fields[where] in error["message"]


def test_features_that_do_not_fit_a_method_are_refused_by_their_field(
    client, sample, ask, queries, monkeypatch
):
    monkeypatch.setattr(api_localize, "usable_features", lambda *_, method: ["xfeat"])
    response = ask(client, queries / "query_01.jpg", method="thorough", features="sift")
    error = response.get_json()["error"]
    assert (response.status_code, error["where"]) == (400, "features")
    assert "xfeat" in error["hint"] and "--" not in error["hint"]


def test_the_first_thorough_answer_has_its_calibration_made_once(
    client, library, sample, ask, queries, monkeypatch
):
    run = upload.localize_uploads
    monkeypatch.setattr(api_localize, "usable_features", lambda *_, method: ["xfeat"])

    def uncalibrated(cache, map_id, *, request):
        result = run(cache, map_id, request=replace(request, options=OpenOptions()))
        return replace(result, opened=replace(result.opened, to_calibrate=True))

    monkeypatch.setattr(upload, "localize_uploads", uncalibrated)
    for _ in range(2):
        assert ask(client, queries / "query_01.jpg", method="thorough").status_code == 200
    assert [job for job in jobs_of(library) if job[1]] == [("index", "xfeat thorough")]


@pytest.mark.parametrize("before", ["done", "failed"])
def test_a_calibration_of_an_older_program_is_made_again(client, library, sample, ask, queries, before):
    with library.database.write() as session:
        session.execute(update(Job).values(state=before, ended_at=func.now()))
    (kept,) = library.map_folder("sample").glob("derived/**/calibration-verified-ivf.json")
    kept.write_text(kept.read_text().replace(f'"format": {FORMAT}', f'"format": {FORMAT - 1}'))
    assert ask(client, queries / "query_01.jpg").get_json()["calibrated"] is False
    assert jobs_of(library) == ([("index", "")] if before == "done" else [])


def test_a_map_without_photos_cannot_answer(client, park, ask, queries):
    response = ask(client, queries / "query_01.jpg", slug=park)
    assert response.status_code == 422 and response.get_json()["error"]["hint"]


def test_the_oldest_answers_are_forgotten(library, sample, record):
    with library.database.write() as session:
        for number in range(4):
            row = QueryRecord(
                name=f"{number}.jpg",
                file=f"{number}.jpg",
                width=1,
                height=1,
                options={},
                answer={"hypotheses": []},
                evidence=[],
            )
            gone = stored.add(session, record(), row=row, most=3)
        assert [old.name for old in gone] == ["0.jpg"]
    with library.database.read() as session:
        assert [row.name for row in stored.list_queries(session, record())] == ["3.jpg", "2.jpg", "1.jpg"]


def test_coordinates(client, sample):
    reported = client.get("/api/v1/maps/sample/coordinates?x_px=300&y_px=200").get_json()
    assert reported["mgrs"].startswith("33U WR ") and reported["utm"].startswith("33U ")
    assert reported["decimal"].startswith("50.21") and "°" in reported["dms"]
    assert client.get("/api/v1/maps/sample/coordinates?x_px=nan&y_px=1").status_code < 500


def test_coordinates_of_a_map_without_georeference(client, park):
    reported = client.get(f"/api/v1/maps/{park}/coordinates?x_px=1&y_px=1").get_json()
    assert set(reported.values()) == {None}


def test_the_page_opens_also_without_an_image(client, sample, park):
    for slug in ("sample", park):
        page = client.get(f"/maps/{slug}/localize")
        assert page.status_code == 200 and b'data-testid="query-input"' in page.data


def test_where_a_map_has_no_landmarks_those_around_are_queued_once(client, library, sample, ask, queries):
    for _ in range(2):
        answer = ask(client, queries / "query_01.jpg", method="landmarks").get_json()
        assert answer["method"] == "landmarks"
        assert answer["note"] == NOT_YET
        assert "camera" not in answer["hypotheses"][0]
    best = answer["hypotheses"][0]["experiences"][0]
    with library.database.read() as session:
        (job,) = session.scalars(select(Job).where(Job.kind == "landmarks"))
    assert job.key == f"around {best}"
    assert job.arguments["photos"][0] == best
    assert len(job.arguments["photos"]) <= 40


def test_on_a_full_disk_the_answer_comes_without_that_job(client, library, sample, ask, queries, monkeypatch):
    def full(*_args, **_options):
        raise StorageError("no space left")

    monkeypatch.setattr(readiness.jobs, "enqueue", full)
    answer = ask(client, queries / "query_01.jpg", method="landmarks")
    assert answer.status_code == 200
    assert answer.get_json()["note"] == NOT_YET
