"""The JSON log has a line for each request, and contains no credentials."""

import io
import json
import logging

import pytest

from webapp.logs import REQUESTS, log_to_stderr, without_secrets
from webapp.store.accounts import accounts, sign_in


@pytest.fixture
def stderr(monkeypatch):
    """Capture standard error, and restore the log afterwards."""
    stream, root = io.StringIO(), logging.getLogger()
    before = root.handlers[:], root.level
    monkeypatch.setattr("sys.stderr", stream)
    root.handlers.clear()
    yield stream
    root.handlers[:] = before[0]
    root.setLevel(before[1])
    for name in ("webapp", REQUESTS):
        logging.getLogger(name).setLevel(logging.NOTSET)


@pytest.fixture
def lines(stderr):
    """Log as JSON, and return the lines so far."""
    log_to_stderr("json")
    return lambda: [json.loads(line) for line in stderr.getvalue().splitlines()]


def test_a_request_is_a_line(client, park, owner, lines):
    client.get(f"/api/v1/maps/{park}?x=y")
    (line,) = lines()
    assert line["event"] == "request" and line["level"] == "info"
    assert (line["method"], line["route"], line["map"]) == ("GET", "/api/v1/maps/<slug>", park)
    assert (line["status"], line["account"]) == (200, owner.id)
    assert line["ms"] >= 0 and line["bytes"] > 0 and line["time"].endswith("+00:00")


def test_what_is_refused_is_a_line_too(stranger, lines):
    stranger.get("/api/v1/maps/park")
    stranger.post("/nowhere/at\nall")
    first, second = lines()
    assert (first["status"], first["account"], first["map"]) == (401, None, None)
    assert (second["status"], second["route"]) == (404, None)


def test_no_secret_is_in_it(app, library, owner, lines):
    with library.database.write() as session:
        account = session.merge(owner)
        link = sign_in.new_link(session, account, hours=1)
        token = accounts.new_token(session, account, name="test")
    client = app.test_client()
    client.get(f"/sign-in/{link}")
    client.post(f"/sign-in/{link}")
    client.get("/api/v1/maps", headers={"Authorization": f"Bearer {token}"})
    client.get(f"/api/v1/shared/{link}")
    client.post("/sign-in", data={"name": "owner", "password": "correct horse battery"})
    log = json.dumps(lines())
    assert "/sign-in/<token>" in log
    for secret in (link, token, "battery"):
        assert secret not in log


def test_a_bug_is_a_line_with_its_traceback(app, library, owner, lines, monkeypatch):
    app.testing = False
    monkeypatch.setattr("webapp.web.accounts.pages.render_template", lambda *_, **__: 1 / 0)
    app.test_client().get("/sign-in/" + "x" * 32)
    result = lines()
    assert [line["level"] for line in result] == ["error", "error"]
    assert "ZeroDivisionError" in result[0]["traceback"]
    assert "x" * 32 not in json.dumps(result)
    assert result[1]["status"] == 500


@pytest.mark.parametrize(
    "text",
    [
        "GET /sign-in/AbC-123_x HTTP/1.1",
        "see https://maps.example/s/AbC-123_x?y=1",
        "/api/v1/shared/AbC-123_x/photos/1/thumb",
        "/embed/AbC-123_x",
        "/m/AbC-123_x-of-a-mission-is-long/export.kml",
        "/api/v1/shared-missions/AbC-123_x-of-a-mission-is-long",
        "/p/AbC-123_x-of-a-phone-is-as-long",
        "GET /api/v1/phones/AbC-123_x-of-a-phone-is-as-long/track?lat=50",
        "Authorization: Bearer AbC-123_x",
        "expmap_AbC-123_x",
    ],
)
def test_secrets_are_blanked_out_of_any_message(text):
    assert "AbC-123_x" not in without_secrets(text)
    assert "..." in without_secrets(text)


def test_other_words_stay():
    text = "job 5 (index) failed: maps/park/s/photo.jpg: the file is damaged"
    assert without_secrets(text.replace("/s/", "/t/")) == text.replace("/s/", "/t/")


def test_people_see_no_requests(client, park, stderr, monkeypatch):
    logging.getLogger().handlers.clear()  # pytest has added its own since
    monkeypatch.setattr("sys.stderr", stderr)
    log_to_stderr("text")
    client.get(f"/api/v1/maps/{park}")
    logging.getLogger("webapp.jobs").info("job 1 (index): done")
    assert stderr.getvalue().endswith("INFO job 1 (index): done\n")
    assert stderr.getvalue().count("\n") == 1
