"""Errors, headers, CSRF, and access."""

import re
import stat
import sys
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import pytest

from tests.pages import addresses
from webapp import errors as own_errors
from webapp.app.web import create_app
from webapp.settings import WebSettings
from webapp.store.accounts.secret_key import secret_key
from webapp.store.library import open_library
from webapp.store.maps import maps
from webapp.web.counting import CountingStorage
from webapp.web.errors import status_of
from webapp.web.language import LANGUAGES

PAGES = [one for one in addresses(slug="park", name="photos").values() if one not in ("/public", "/offline")]


def shape(answer):
    """Return the error of a response, checking its form."""
    assert set(answer.json) == {"error"}
    assert set(answer.json["error"]) == {"code", "message", "hint", "where"}
    return answer.json["error"]


def test_health_needs_no_sign_in(stranger):
    answer = stranger.get("/healthz")
    assert answer.status_code in (200, 503)
    assert answer.json["database"] == "ok"


@pytest.mark.parametrize("page", PAGES)
def test_a_page_leads_a_stranger_to_the_sign_in_and_back(stranger, park, page):
    answer = stranger.get(page)
    assert answer.status_code == 302
    assert answer.headers["Location"] == f"/sign-in?next={page}"


def test_the_api_answers_a_stranger_in_json(stranger, park):
    answer = stranger.get("/api/v1/jobs?map=park")
    assert answer.status_code == 401
    assert shape(answer)["code"] == "not_signed_in"
    assert answer.headers["WWW-Authenticate"] == "Bearer"


def test_a_stranger_is_refused_before_the_body_is_looked_at(stranger):
    stranger.csrf = False
    assert stranger.post("/api/v1/maps", data=b"{nonsense").status_code == 401


def test_a_phone_does_not_zoom_out_while_a_page_is_drawn(client, park):
    """... where something is wider than the screen for a moment; people can still zoom in."""
    (viewport,) = re.findall(r'<meta name="viewport" content="([^"]+)"', client.get("/maps/park/image").text)
    assert "minimum-scale=1" in viewport
    assert "maximum-scale" not in viewport and "user-scalable" not in viewport


@pytest.mark.parametrize("page", PAGES)
def test_every_page_shows_in_every_language(client, park, page):
    labels = {}
    for language in LANGUAGES:
        answer = client.get(page, headers={"Accept-Language": language})
        assert answer.status_code == 200
        assert f'<html lang="{language}"' in answer.text
        labels[language] = frozenset(re.findall('<title>(.+)</title>|aria-label="([^"]+)"', answer.text))
    assert len(set(labels.values())) == len(LANGUAGES)


def test_who_came_by_https_comes_by_https_from_then_on(stranger):
    assert (
        stranger.get("/sign-in", base_url="https://maps.example").headers["Strict-Transport-Security"]
        == "max-age=31536000"
    )
    assert "Strict-Transport-Security" not in stranger.get("/sign-in").headers


def test_answers_carry_the_headers_that_protect(client, stranger):
    for answer in (
        client.get("/"),
        stranger.get("/sign-in"),
        client.get("/nothing"),
        client.get("/api/v1/no"),
    ):
        policy = answer.headers["Content-Security-Policy"]
        assert "default-src 'self'" in policy
        assert "object-src 'none'" in policy
        assert "frame-ancestors 'none'" in policy
        assert "base-uri 'none'" in policy
        assert "unsafe" not in policy
        assert answer.headers["X-Content-Type-Options"] == "nosniff"
        assert answer.headers["Referrer-Policy"] == "same-origin"
        assert "camera=(self)" in answer.headers["Permissions-Policy"]


@pytest.mark.parametrize("page", [*PAGES, "/nothing"])
def test_pages_have_nothing_inline_that_the_policy_forbids(client, park, page):
    text = client.get(page).text
    assert " style=" not in text
    assert "<style" not in text
    assert " onclick" not in text
    scripts = [part.split(">")[0] for part in text.split("<script")[1:]]
    # the policy has the hash of the import map
    assert all(re.search(' src=|type="(application/json|importmap)"', script) for script in scripts)


def test_the_cookie_is_out_of_reach_for_scripts_and_other_sites(app, owner, sign_in):
    cookie = sign_in(owner).get("/").headers["Set-Cookie"]
    assert "HttpOnly" in cookie
    assert "SameSite=Lax" in cookie
    assert "Expires=" in cookie
    assert "Secure" not in cookie
    assert "Secure" in sign_in(owner).get("/", base_url="https://localhost").headers["Set-Cookie"]


@pytest.mark.parametrize("path", ["/account/name", "/people", "/sign-out", "/language"])
def test_a_form_without_its_token_is_refused(client, path):
    client.csrf = False
    answer = client.post(path, data={"name": "mallory", "language": "cs"})
    assert answer.status_code == 400
    assert "text/html" in answer.content_type


def test_json_without_the_token_is_refused(client, owner):
    client.csrf = False
    answer = client.post("/api/v1/jobs/1/cancel", json={})
    assert answer.status_code == 400
    assert shape(answer)["code"] == "csrf"


def test_unknown_addresses_are_answered_as_html_or_json(client):
    assert shape(client.get("/api/v1/nothing"))["code"] == "not_found"
    page = client.get("/nothing")
    assert page.status_code == 404
    assert 'data-testid="error-message"' in page.text


def test_a_wrong_method_is_answered_in_json_too(client):
    answer = client.delete("/api/v1/jobs/1")
    assert answer.status_code == 405
    assert shape(answer)["code"] == "method_not_allowed"
    assert "GET" in answer.headers["Allow"]


def test_a_field_that_is_missing_is_named(client):
    answer = client.get("/api/v1/places")
    assert answer.status_code == 422
    assert shape(answer)["where"] == "query.q"


def test_an_unexpected_exception_is_logged_and_reported(app, client, caplog):
    app.add_url_rule("/api/v1/broken", view_func=lambda: 1 // 0)
    app.testing = False
    answer = client.get("/api/v1/broken")
    assert answer.status_code == 500
    assert shape(answer)["code"] == "internal_server_error"
    assert "ZeroDivisionError" in caplog.text
    assert "ZeroDivision" not in answer.text


def test_every_error_has_a_status_of_its_own(app):
    kinds = [
        kind
        for kind in vars(own_errors).values()
        if isinstance(kind, type) and issubclass(kind, own_errors.ExpMapError)
    ]
    with app.test_request_context():
        result = {kind: status_of(kind.__new__(kind)) for kind in kinds}
    assert [kind for kind, status in result.items() if status == 500] == [own_errors.ExpMapError]
    assert result[own_errors.PhotoError] == 422
    assert result[own_errors.StorageError] == 507


def without_token(page):
    """Return a page without its CSRF tokens, which contain their time."""
    return re.sub(r'(name="csrf[-_]token" (?:value|content)=)"[^"]+"', r"\1", page)


def test_a_conflict_is_412_for_who_sent_a_revision(app):
    conflict = own_errors.Conflict("changed")
    with app.test_request_context():
        assert status_of(conflict) == 409
    with app.test_request_context(headers={"If-Match": "3"}):
        assert status_of(conflict) == 412


def test_a_map_of_others_is_as_unknown_as_none(new_account, sign_in, park):
    client = sign_in(new_account("eve"))
    for path in ("/maps/{}/settings", "/maps/{}/jobs", "/api/v1/jobs?map={}"):
        foreign, missing = (client.get(path.format(slug)) for slug in (park, "none"))
        assert foreign.status_code == missing.status_code == 404
        assert without_token(foreign.text).replace(park, "none") == without_token(missing.text)


def test_a_map_in_the_bin_has_no_pages(client, library, owner, park):
    with library.database.write() as session:
        maps.put_into_bin(maps.find(session, park, account=owner))
    answer = client.get(f"/maps/{park}/settings")
    assert answer.status_code == 404
    assert "This map is in the bin" in answer.text
    assert "Park" in client.get("/bin").text
    assert "Park" not in client.get("/").text


@pytest.mark.skipif(sys.platform == "win32", reason="Windows has no such permissions")
def test_the_secret_key_is_made_once_and_for_nobody_else(library):
    key = secret_key(library.inner)
    assert len(key) == 64
    assert secret_key(library.inner) == key
    assert stat.S_IMODE((library.inner / "secret-key").stat().st_mode) == 0o600


def test_a_damaged_secret_key_is_reported(library):
    secret_key(library.inner)
    (library.inner / "secret-key").write_text("short")
    with pytest.raises(own_errors.StorageError, match="not a valid secret key"):
        secret_key(library.inner)


def test_too_many_requests_have_to_wait(settings, library):
    few = replace(settings, web=WebSettings(requests_per_minute=2))
    client = create_app(few, library=library).test_client()
    codes = [client.get("/api/v1/jobs").status_code for _ in range(3)]
    assert codes == [401, 401, 429]
    answer = client.get("/api/v1/jobs")
    assert shape(answer)["code"] == "too_many"
    assert int(answer.headers["Retry-After"]) > 0
    assert client.get("/healthz").json["database"] == "ok"


def test_what_a_proxy_says_is_believed_only_when_there_is_one(settings, library):
    said = {"X-Forwarded-Proto": "https", "X-Forwarded-For": "203.0.113.9"}
    for proxies, secure in ((0, False), (1, True)):
        app = create_app(replace(settings, web=WebSettings(proxies=proxies)), library=library)
        answer = app.test_client().get("/sign-in", headers=said)
        assert ("Secure" in answer.headers["Set-Cookie"]) is secure


@pytest.mark.parametrize("path", ["/sign-in", "/api/v1/maps", "/static/js/sw.js", "/nowhere"])
def test_below_a_path_of_a_proxy_every_request_says_that_it_is_not_supported(client, path):
    answer = client.get(path, headers={"X-Forwarded-Prefix": "/maps"})
    assert answer.status_code == 400
    assert "cannot be served below a path (/maps)" in answer.text
    assert client.get("/sign-in", headers={"X-Forwarded-Prefix": "/"}).status_code < 400


def test_a_library_is_opened_where_none_is_given(settings):
    app = create_app(settings)
    assert app.test_client().get("/healthz").json["database"] == "ok"
    app.extensions["expmap"].library.database.close()
    open_library(settings.library).database.close()


@pytest.mark.parametrize("theme", ["dark", "light"])
def test_the_chosen_colours_are_there_from_the_start(client, theme):
    client.set_cookie("expmap-theme", theme)
    assert f'data-theme="{theme}"' in client.get("/").text


def test_a_cookie_cannot_write_into_the_page(client):
    client.set_cookie("expmap-theme", '"><script>')
    assert "data-theme=" not in client.get("/").text.split("<head")[0]


def test_who_is_not_signed_in_sends_to_half_of_the_threads(app, client, stranger):
    permits = app.extensions["expmap_concurrency"]["unauthenticated"]
    taken = 0
    while permits.acquire(blocking=False):
        taken += 1
    answer = stranger.post("/sign-in", data={"name": "jana", "password": "guess"})
    assert (answer.status_code, answer.headers["Retry-After"]) == (503, "1")
    assert stranger.get("/sign-in").status_code == 200
    assert client.post("/api/v1/maps", json={"name": "Park"}).status_code == 201
    permits.release(taken)
    assert taken == 4, "of 8 threads"
    for _ in range(5):
        assert stranger.post("/sign-in", data={"name": "jana", "password": "guess"}).status_code == 401


def test_requests_are_counted_one_by_one_and_without_a_thread(monkeypatch):
    monkeypatch.setattr(threading.Timer, "start", lambda _: pytest.fail("a thread"))
    storage = CountingStorage()
    usual = sys.getswitchinterval()
    sys.setswitchinterval(1e-6)
    try:
        with ThreadPoolExecutor(8) as pool:
            counted = list(pool.map(lambda _: storage.incr("eva", 60.0), range(8000)))
    finally:
        sys.setswitchinterval(usual)
    assert sorted(counted) == list(range(1, 8001))


def test_a_clock_that_is_set_back_does_not_keep_a_limit_reached(monkeypatch):
    clock = [1000.0]
    monkeypatch.setattr("webapp.web.counting.time.monotonic", lambda: clock[0])
    storage = CountingStorage()
    assert [storage.incr("eva", 60.0) for _ in range(3)] == [1, 2, 3]
    monkeypatch.setattr("webapp.web.counting.time.time", lambda: 1.0)
    assert (storage.get("eva"), storage.get_expiry("eva")) == (3, 61.0)
    clock[0] += 61.0
    assert storage.get("eva") == 0
    assert storage.incr("eva", 60.0) == 1
    storage.incr("ben", 60.0)
    storage.clear("ben")
    assert (storage.get("ben"), storage.reset(), storage.get("eva")) == (0, 1, 0)
