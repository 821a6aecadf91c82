"""Two web servers on one database: work begun at one continues at the other."""

import re
import shutil
from dataclasses import replace

import pytest
from sqlalchemy import inspect, text

from tests.quick_apps import remember_templates
from webapp.app.web import create_app
from webapp.files import contents
from webapp.files.object_storage import storage
from webapp.settings import ServeSettings, WebSettings
from webapp.store.accounts import accounts, sign_in
from webapp.store.backends.request_counts import TABLE
from webapp.store.library import open_library
from webapp.store.moving.copying import _tables as records

pytestmark = pytest.mark.slow

PASSWORD = "correct horse battery"


@pytest.fixture
def start(postgresql, tmp_path):
    """Make applications of one library, with separate connections, as on separate machines."""
    url = postgresql.new_database(empty=True)
    opened = []

    def make(settings):
        library = open_library(tmp_path / "library", url=url)
        opened.append(library)
        app = create_app(replace(settings, library=library.folder, database=url), library=library)
        remember_templates(app)
        return app

    yield make
    contents.use(None)
    for library in opened:
        library.database.close()
    postgresql.drop(url)


@pytest.fixture
def nodes(start, settings):
    return start(settings), start(settings)


def carry(client, app):
    """Return the same browser at the other node."""
    other = app.test_client()
    cookie = client.get_cookie("expmap")
    other.set_cookie("expmap", cookie.value)
    return other


def library_of(app):
    return app.extensions["expmap"].library


@pytest.fixture
def browser(nodes):
    """A browser signed in at the first node, by its page."""
    database = library_of(nodes[0]).database
    with database.write() as session:
        link = sign_in.new_link(session, accounts.ensure_owner(session), hours=1)
    client = nodes[0].test_client()
    page = client.get(f"/sign-in/{link}").text
    token = re.search(r'name="csrf_token"[^>]*value="([^"]+)"', page)[1]
    assert client.post(f"/sign-in/{link}", data={"csrf_token": token}).status_code == 303
    return client


def test_a_session_and_its_csrf_token_hold_on_the_other(nodes, browser):
    page = browser.get("/").text
    token = re.search(r'name="csrf-token"[^>]*content="([^"]+)"', page)[1]
    other = carry(browser, nodes[1])
    assert other.get("/account").status_code == 200
    refused = other.post("/api/v1/maps", json={"name": "Park"})
    assert (refused.status_code, refused.json["error"]["code"]) == (400, "csrf")
    made = other.post("/api/v1/maps", json={"name": "Park"}, headers={"X-CSRFToken": token})
    assert made.status_code == 201
    assert browser.get(f"/maps/{made.json['slug']}/edit").status_code == 200


def test_who_signs_out_at_one_is_out_at_the_other(nodes, browser):
    other = carry(browser, nodes[1])
    token = re.search(r'name="csrf-token"[^>]*content="([^"]+)"', browser.get("/").text)[1]
    assert browser.post("/sign-out", data={"csrf_token": token}).status_code == 303
    assert other.get("/account").status_code == 302


def test_failed_sign_ins_count_together(start, settings):
    strict = replace(settings, web=WebSettings(sign_in_failures=2))
    nodes = start(strict), start(strict)
    codes = []
    for app in (*nodes, *nodes):
        client = app.test_client()
        token = re.search(r'name="csrf_token"[^>]*value="([^"]+)"', client.get("/sign-in").text)[1]
        given = {"name": "jana", "password": PASSWORD, "csrf_token": token}
        codes.append(client.post("/sign-in", data=given).status_code)
    assert codes == [401, 401, 429, 429]


def test_requests_count_together(start, settings):
    few = replace(settings, web=WebSettings(requests_per_minute=3))
    one, other = (start(few).test_client() for _ in range(2))
    assert [client.get("/api/v1/jobs").status_code for client in (one, other, one, other)] == [
        *(401, 401, 401),
        429,
    ]
    assert one.get("/api/v1/jobs").json["error"]["code"] == "too_many"


def test_a_window_ends_and_is_tidied_away(nodes):
    here, there = (library_of(app).database for app in nodes)
    assert here.request_counts.hit("a", seconds=0.001) == 1
    with here.engine.begin() as connection:
        connection.execute(text(f"UPDATE {TABLE} SET ends_at = clock_timestamp()"))
    assert there.request_counts.count_of("a") == (0, 0.0)
    assert there.request_counts.hit("a", seconds=60.0, amount=2) == 2
    assert here.request_counts.hit("a", seconds=60.0) == 3
    assert here.request_counts.hit("gone", seconds=0.0) == 1
    here.request_counts._tidy_at = 0.0
    here.request_counts.hit("b", seconds=60.0)
    with here.engine.connect() as connection:
        assert set(connection.execute(text(f"SELECT key FROM {TABLE}")).scalars()) == {"a", "b"}
    assert there.request_counts.forget() == 2


def test_counts_are_no_records(nodes):
    database = library_of(nodes[0]).database
    database.request_counts.hit("a", seconds=60.0)
    with database.engine.connect() as connection:
        assert TABLE in inspect(connection).get_table_names()
        assert TABLE not in {table.name for table in records(connection)}


def test_without_the_database_a_request_has_to_wait(nodes, postgresql):
    client = nodes[0].test_client()
    assert client.get("/api/v1/jobs").status_code == 401
    postgresql.stop()
    try:
        answer = client.get("/api/v1/jobs")
    finally:
        postgresql.start()
    assert answer.status_code == 503
    assert answer.json["error"]["code"] == "database_unavailable"
    assert int(answer.headers["Retry-After"]) > 0
    assert client.get("/api/v1/jobs").status_code == 401


def test_a_node_is_ready_with_the_folder_and_the_objects(start, settings, s3, tmp_path, monkeypatch):
    monkeypatch.setattr(storage, "_PROBE_S", 0.0)
    bucket = s3.new_bucket()
    own = replace(
        settings,
        storage=f"s3://{bucket}/lib",
        cache_folder=tmp_path / "cache",
        serve=ServeSettings(job_workers=0),
    )
    client = start(own).test_client()
    well = dict.fromkeys(("status", "web", "database", "disk", "folder", "storage"), "ok")
    assert client.get("/healthz").json == well
    s3.refuse = (503, "SlowDown")
    answer = client.get("/healthz")
    assert (answer.status_code, answer.json) == (503, well | {"status": "failing", "storage": "failing"})
    assert client.get("/readyz").status_code == 200, "no other node would do better"
    s3.reset()
    shutil.move(tmp_path / "library", tmp_path / "unmounted")
    (tmp_path / "library").mkdir()
    assert client.get("/healthz").json == well | {"status": "failing", "folder": "failing"}
    assert client.get("/readyz").status_code == 503
