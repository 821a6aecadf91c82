"""Passkeys are registered, used, named and removed; answers for another site or moment are refused."""

import json
import re
import threading
from concurrent.futures import ThreadPoolExecutor
from dataclasses import replace

import pytest
from playwright.sync_api import expect, sync_playwright
from sqlalchemy import select
from werkzeug.serving import make_server

from tests.browser.ensure_browser import MISSING, find_browser
from tests.connect.passkeys.authenticator import PRESENT, Authenticator
from tests.quick_apps import remember_templates
from tests.web.conftest import (
    Browser,
    app,
    client,
    library,
    new_account,
    new_map,
    owner,
    settings,
    sign_in,
    stranger,
)
from webapp.app import main as program
from webapp.app.web import create_app
from webapp.connect.passkeys.ceremonies import PasskeySite
from webapp.settings import EventSettings, OidcSettings
from webapp.store.accounts import sign_in as ways_in
from webapp.store.accounts.passkeys import Passkey

__all__ = ["app", "client", "library", "new_account", "new_map", "owner", "settings", "sign_in", "stranger"]
PAGE, ENTER = "/account/passkeys", "/sign-in/passkey"


def options_of(page):
    return json.loads(re.search(r'id="passkey-options">(.*?)</script>', page.text, re.DOTALL)[1])


def register(browser, key, name="Phone"):
    answer = key.create(options_of(browser.get(PAGE)))
    return browser.post(PAGE, data={"name": name, "answer": answer})


def use(browser, key, **fields):
    return browser.post(ENTER, data={"answer": key.get(options_of(browser.get(ENTER))), **fields})


def is_in(browser):
    return browser.get("/account").status_code == 200


def test_a_passkey_is_registered_and_signs_in(client, stranger, library, owner):
    key = Authenticator()
    assert PAGE in client.get("/account").text and ENTER in stranger.get("/sign-in").text
    assert register(client, key).status_code == 303
    asked = options_of(client.get(PAGE))
    assert asked["rp"]["id"] == "localhost" and len(asked["excludeCredentials"]) == 1
    assert asked["authenticatorSelection"]["userVerification"] == "required"
    assert options_of(stranger.get(ENTER))["rpId"] == "localhost"
    answer = use(stranger, key, next="/account?x=1")
    assert (answer.status_code, answer.headers["Location"]) == (303, "/account?x=1")
    assert answer.headers["Clear-Site-Data"] == '"cache"'
    assert f'value="{owner.name}"' in stranger.get("/account").text
    with library.database.read() as session:
        (kept,) = session.scalars(select(Passkey))
        assert (kept.uses, kept.used_at is not None) == (1, True)


def test_passkeys_are_named_and_removed_by_their_account(client, stranger, sign_in, new_account):
    key = Authenticator()
    register(client, key, name="Old phone")
    assert client.post(f"{PAGE}/1/name", data={"name": "New phone"}).status_code == 303
    assert client.post(f"{PAGE}/1/name", data={"name": " "}).status_code == 400
    assert "New phone" in client.get(PAGE).text
    eve = sign_in(new_account("Eve"))
    assert eve.post(f"{PAGE}/1/name", data={"name": "x"}).status_code == 404
    assert eve.post(f"{PAGE}/1/remove").status_code == 404
    assert client.post(f"{PAGE}/1/remove").status_code == 303
    refused = use(stranger, key)
    assert refused.status_code == 401 and "This server does not know the passkey" in refused.text
    assert not is_in(stranger)


def test_answers_that_are_not_for_this_site_or_moment_are_refused(client, app):
    key = Authenticator()
    register(client, key)
    browser = app.test_client()

    def refused(answer):
        got = browser.post(ENTER, data={"answer": answer})
        return got.status_code == 401 and 'data-testid="error-message"' in got.text and not is_in(browser)

    def options():
        return options_of(browser.get(ENTER))

    assert refused(key.get({**options(), "challenge": "AAAA"}))
    right = key.get(options())
    assert browser.post(ENTER, data={"answer": right}).status_code == 303
    browser.post("/sign-out")
    assert refused(right), "used already"
    options()
    assert refused(right), "for another challenge"
    for name, value in [("origin", "http://localhost:81"), ("host", "evil.example"), ("flags", PRESENT)]:
        usual = getattr(key, name)
        setattr(key, name, value)
        assert refused(key.get(options())), name
        setattr(key, name, usual)
    key.count = 0
    assert refused(key.get(options())), "a copy of the authenticator"
    key.count = 50
    changed = json.loads(key.get(options()))
    changed["response"]["signature"] = changed["response"]["authenticatorData"]
    assert refused(json.dumps(changed))
    for nonsense in ("", "[]", "{}", '{"rawId": 1}', '{"rawId": "%"}', "x" * 60_000):
        options()
        assert refused(nonsense)


def test_a_registration_that_is_not_right_adds_nothing(client, library):
    key = Authenticator()
    assert client.post(PAGE, data={"name": "x", "answer": "{}"}).status_code == 401, "no challenge"
    options = options_of(client.get(PAGE))
    right = key.create(options)
    for answer in (
        "",
        "[]",
        right.replace("webauthn", "x"),
        Authenticator("http://evil.example").create(options),
    ):
        client.get(PAGE)
        got = client.post(PAGE, data={"name": "x", "answer": answer})
        assert got.status_code == 422 and "The passkey cannot be registered" in got.text
    assert register(client, key, name="").status_code == 400
    assert register(client, key).status_code == 303
    assert register(client, key).status_code == 409
    with library.database.read() as session:
        assert len(session.scalars(select(Passkey)).all()) == 1


def test_attempts_are_limited(client, stranger, settings):
    key, other = Authenticator(), Authenticator()
    register(client, key)
    other.id = key.id
    for _ in range(settings.web.sign_in_failures):
        assert use(stranger, other).status_code == 401
    assert use(stranger, key).status_code == 429


@pytest.mark.parametrize(
    ("origin", "offered"),
    [
        ("https://maps.example.org", True),
        ("http://localhost:8000", True),
        ("http://maps.example.org", False),
        ("https://192.0.2.7", False),
        ("http://127.0.0.1:8000", False),
        ("https://[2001:db8::1]", False),
    ],
)
def test_they_are_offered_where_browsers_have_them(origin, offered):
    assert PasskeySite(origin).has_passkeys is offered


def test_the_public_address_counts_and_a_required_provider_excludes_them(settings, library, owner):
    site = EventSettings(site="https://maps.example.org")
    app = create_app(replace(settings, events=site), library=library)
    assert options_of(app.test_client().get(ENTER))["rpId"] == "maps.example.org"
    required = OidcSettings(issuer="https://id.example.org", client_id="maps", required="yes")
    app = create_app(replace(settings, oidc=required), library=library)
    app.test_client_class = Browser
    browser = app.test_client()
    assert ENTER not in browser.get("/sign-in").text
    assert browser.post(ENTER, data={"answer": "{}"}).status_code == 403


def test_a_missing_package_is_named(stranger, absent):
    absent("connect")
    page = stranger.get(ENTER)
    assert page.status_code == 422 and "experience-map[connect]" in page.text


def test_the_command_lists_and_removes(client, library, owner, database_url, monkeypatch, capsys):
    register(client, Authenticator(), name="Phone")
    if database_url:
        monkeypatch.setenv("EXPMAP_DATABASE", database_url)

    def run(*words):
        with pytest.raises(SystemExit) as ended:
            program.main(["connect", "passkeys", owner.name, "--library", str(library.folder), *words])
        assert ended.value.code == 0
        return capsys.readouterr().out

    assert re.fullmatch(r"Phone\t\d{4}-\d\d-\d\d\tnever\n", run())
    assert run("--remove").endswith("\tremoved\n")
    assert run() == ""


def register_and_sign_in(home, link, path):
    """Register a passkey with the virtual authenticator of Chromium, twice, and sign in with it."""
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=path)
        page = chromium.new_context(service_workers="block").new_page()
        page.set_default_timeout(30_000)
        devtools = page.context.new_cdp_session(page)
        devtools.send("WebAuthn.enable")
        added = {
            "protocol": "ctap2",
            "transport": "internal",
            "hasResidentKey": True,
            "hasUserVerification": True,
            "isUserVerified": True,
            "automaticPresenceSimulation": True,
        }
        devtools.send("WebAuthn.addVirtualAuthenticator", {"options": added})
        page.goto(f"{home}/sign-in/{link}")
        page.get_by_test_id("sign-in").click()
        page.goto(home + PAGE)
        page.get_by_placeholder("Name of the device").fill("Laptop")
        page.get_by_role("button", name="Add", exact=True).click()
        expect(page.get_by_test_id("passkey")).to_contain_text("Laptop", timeout=30_000)
        page.get_by_placeholder("Name of the device").fill("Again")
        page.get_by_role("button", name="Add", exact=True).click()
        expect(page.get_by_test_id("error-message")).to_contain_text("has a passkey", timeout=30_000)
        page.context.clear_cookies()
        page.goto(f"{home}/sign-in?next=/account")
        page.get_by_role("link", name="Sign in with a passkey").click()
        page.wait_for_url(f"{home}/account")
        chromium.close()


@pytest.mark.slow
def test_a_browser_registers_a_passkey_and_signs_in(app, library, owner):
    remember_templates(app)
    with library.database.write() as session:
        link = ways_in.new_link(session, owner, hours=1)
    server = make_server("127.0.0.1", 0, app, threaded=True)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.05})
    thread.start()
    home = f"http://localhost:{server.server_port}"
    path = find_browser() or pytest.fail(MISSING)
    try:
        # in a thread of its own: browser tests of the same process have an event loop in this one
        with ThreadPoolExecutor(1) as own:
            own.submit(register_and_sign_in, home, link, path).result()
    finally:
        server.shutdown()
        server.server_close()
        thread.join()
    with library.database.read() as session:
        (kept,) = session.scalars(select(Passkey))
        assert (kept.name, kept.used_at is not None) == ("Laptop", True)
