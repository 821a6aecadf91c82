"""Signing in at a provider: the flow, its checks, and faults of providers."""

import re
import time
from dataclasses import replace
from urllib.parse import parse_qs, urlsplit

import pytest
from sqlalchemy import select

from tests.connect.oidc.conftest import enter, path_of, there
from tests.connect.oidc.provider import CLIENT, key, number_text
from webapp.configuration import load_settings
from webapp.connect.oidc.provider import Provider, check_settings
from webapp.errors import UsageError
from webapp.store.accounts import accounts, sign_in
from webapp.store.accounts.identities import ProviderSession, SignInIdentity
from webapp.store.clock import now
from webapp.store.outbox import EventReceiver

PASSWORD = "correct horse battery"


def is_in(browser):
    return browser.get("/account").status_code == 200


def error_of(answer):
    found = re.search(r'data-testid="error-message">.*?<div>\s*<div>(.*?)</div>', answer.text, re.DOTALL)
    return found[1] if found else None


def test_somebody_signs_in_and_gets_an_account(app, provider, library):
    browser = app.test_client()
    assert "Sign in with Ranger ID" in browser.get("/sign-in").text
    answer = enter(browser, then="/account?x=1")
    assert (answer.status_code, answer.headers["Location"]) == (303, "/account?x=1")
    assert answer.headers["Clear-Site-Data"] == '"cache"'
    assert 'value="Jana"' in browser.get("/account").text
    again = app.test_client()
    provider.user |= {"name": "Jana Nova", "email": "new@example.org"}
    enter(again)
    with library.database.read() as session:
        (identity,) = session.scalars(select(SignInIdentity))
        assert (identity.issuer, identity.subject) == (provider.issuer, "u-17")
        assert (identity.name, identity.email) == ("Jana Nova", "new@example.org")
        assert [one.name for one in accounts.list_accounts(session)] == ["Jana"]


def test_the_request_has_state_nonce_and_a_challenge_that_are_new_each_time(app):
    browser, asked = app.test_client(), []
    for _ in range(2):
        address = browser.get("/oidc/start").headers["Location"]
        asked.append({name: value[0] for name, value in parse_qs(urlsplit(address).query).items()})
    first, second = asked
    assert first["redirect_uri"] == "http://localhost/oidc/callback"
    assert (first["code_challenge_method"], first["response_type"]) == ("S256", "code")
    for name in ("state", "nonce", "code_challenge"):
        assert len(first[name]) >= 32 and first[name] != second[name]


def test_an_answer_is_taken_once_and_only_by_the_browser_that_asked(app):
    browser, other = app.test_client(), app.test_client()
    back = there(browser.get("/oidc/start").headers["Location"])
    assert other.get(back).status_code == 401
    assert not is_in(other)
    assert "was not begun in this browser" in other.get(back).text
    assert browser.get(back).status_code == 303
    assert is_in(browser)
    browser.post("/sign-out")
    assert browser.get(back).status_code == 401


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"state": "wrong"}, "This answer belongs to another sign-in"),
        ({"state": ""}, "This answer belongs to another sign-in"),
        ({"iss": "https://other.example.org"}, "This answer is of another provider"),
        ({"code": ""}, "The provider sends no code"),
        ({"code": "guessed"}, "The provider refuses: invalid_grant"),
    ],
)
def test_a_changed_answer_is_refused(app, changed, message):
    browser = app.test_client()
    back = there(browser.get("/oidc/start").headers["Location"])
    query = {name: value[0] for name, value in parse_qs(urlsplit(back).query).items()}
    answer = browser.get("/oidc/callback", query_string={**query, **changed})
    assert (answer.status_code, error_of(answer)) == (401, message)
    assert not is_in(browser)


def test_an_attempt_ends_after_a_quarter_of_an_hour(app, monkeypatch):
    browser = app.test_client()
    back = there(browser.get("/oidc/start").headers["Location"])
    begun = time.time()
    monkeypatch.setattr("webapp.connect.oidc.pages.time.time", lambda: begun + 902)
    assert "has taken too long" in browser.get(back).text


WRONG_CLAIMS = [
    ({"nonce": "another"}, "nonce"),
    ({"nonce": None}, "nonce"),
    ({"exp": 1_700_000_000}, "exp"),
    ({"exp": None}, "exp"),
    ({"iat": 4_000_000_000}, "future"),
    ({"aud": "somebody else"}, "aud"),
    ({"aud": ["somebody else", "others"]}, "aud"),
    ({"aud": [CLIENT, "others"], "azp": "others"}, "azp"),
    ({"iss": "https://other.example.org"}, "iss"),
    ({"sub": None}, "sub"),
    ({"at_hash": "wrong"}, "at_hash"),
]


def test_an_id_token_that_is_not_for_this_sign_in_is_refused(app, provider):
    for claims, reason in WRONG_CLAIMS:
        provider.claims = claims
        browser = app.test_client()
        answer = enter(browser)
        assert answer.status_code == 401, claims
        assert re.search(rf"The ID token of the provider is not valid \(.*{reason}", error_of(answer)), claims
        assert not is_in(browser)


def test_an_id_token_signed_by_nobody_or_by_a_stranger_is_refused(app, provider, monkeypatch):
    browser = app.test_client()
    assert enter(browser).status_code == 303
    provider.alg = "none"
    assert enter(app.test_client()).status_code == 401
    provider.alg = "RS256"
    provider.kid, provider.key = "first", 1  # its own key has this id
    provider.answers["/keys"] = (200, b'{"keys": [%s]}' % jwk(0, "first"))
    assert "not valid" in error_of(enter(app.test_client()))


def jwk(number, kid):
    public = key(number).public_key().public_numbers()
    text = '{"kty": "RSA", "kid": "%s", "n": "%s", "e": "%s"}'
    return (text % (kid, number_text(public.n), number_text(public.e))).encode()


def test_changed_keys_are_read_again_once_for_each_unknown_id(app, provider):
    assert enter(app.test_client()).status_code == 303
    provider.key, provider.kid = 1, "second"
    assert enter(app.test_client()).status_code == 303
    assert provider.asked.count("/keys") == 2
    assert enter(app.test_client()).status_code == 303
    assert provider.asked.count("/keys") == 2
    provider.answers["/keys"] = (200, b'{"keys": [%s]}' % jwk(1, "second"))
    provider.kid = "third"  # signs by a key that it does not publish
    for _ in range(3):
        assert enter(app.test_client()).status_code == 401
    assert provider.asked.count("/keys") == 3


HALF_ANSWERS = [
    ((200, b'{"issuer": "http://127'), "The provider&#39;s answer cannot be understood"),
    ((200, b"[]"), "The provider&#39;s answer cannot be understood"),
    ((200, b"\xff\xfe"), "The provider&#39;s answer cannot be understood"),
    ((503, b"<html>"), "The provider "),
]


@pytest.mark.parametrize("path", ["/.well-known/openid-configuration", "/keys", "/token", "/userinfo"])
def test_half_an_answer_is_an_error_with_a_hint(app, provider, path):
    for answer, message in HALF_ANSWERS:
        app.extensions["expmap_oidc"] = Provider(app.extensions["expmap"].settings.oidc)  # nothing kept
        provider.answers[path] = answer
        browser = app.test_client()
        given = browser.get("/oidc/start")
        if given.status_code == 303:
            given = browser.get(there(given.headers["Location"]))
        assert given.status_code in (409, 422)
        assert error_of(given).startswith(message)
        assert "expmap connect oidc" in given.text
        assert not is_in(browser)


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"issuer": "https://other.example.org"}, "The provider calls itself"),
        ({"token_endpoint": None}, "The provider names no usable token_endpoint"),
        ({"jwks_uri": "http://169.254.169.254/keys"}, "The provider names no usable jwks_uri"),
        ({"id_token_signing_alg_values_supported": ["HS256", "none"]}, "The provider signs by none of"),
    ],
)
def test_metadata_that_cannot_be_right_is_refused(app, provider, changed, message):
    provider.metadata = changed
    answer = app.test_client().get("/oidc/start")
    assert answer.status_code == 422
    assert error_of(answer).startswith(message)


def test_a_dead_provider_is_said_so_and_not_asked_by_each_request(app_with):
    app = app_with(issuer="http://127.0.0.1:9")
    answers = [app.test_client().get("/oidc/start") for _ in range(2)]
    assert [answer.status_code for answer in answers] == [409, 409]
    assert error_of(answers[0]).startswith("The provider cannot be reached (")
    assert 'name="password"' in answers[0].text, "the other ways are still there"


@pytest.mark.parametrize(
    ("error", "status", "message"),
    [
        ("access_denied", 403, "The provider has not let you in"),
        ("server_error", 401, "The provider refuses: server_error"),
        ("<b>", 401, "The provider refuses: &lt;b&gt;"),
    ],
)
def test_a_refusal_of_the_provider_is_shown(app, provider, error, status, message):
    provider.denies = error
    answer = enter(app.test_client())
    assert (answer.status_code, error_of(answer)) == (status, message)


def test_signing_out_ends_the_session_at_the_provider_too(app, provider, library):
    browser = app.test_client()
    enter(browser)
    with library.database.read() as session:
        stored = session.scalars(select(ProviderSession.id_token)).one()
    left = browser.post("/sign-out")
    assert left.status_code == 200 and left.headers["Clear-Site-Data"] == '"cache"'
    address = re.search(r'http-equiv="refresh" content="0; url=([^"]+)"', left.text)[1].replace("&amp;", "&")
    assert path_of(there(address)) == "/sign-in"
    (asked,) = provider.outs
    assert asked["client_id"] == CLIENT
    assert asked["post_logout_redirect_uri"] == "http://localhost/sign-in"
    assert asked["id_token_hint"].count(".") == 2 and asked["id_token_hint"] not in stored
    assert stored.startswith("gAAAA"), "encrypted"
    assert not is_in(browser)
    with library.database.read() as session:
        assert session.scalars(select(ProviderSession)).all() == []


def test_signing_out_works_without_the_provider(app, app_with, provider):
    browser = app.test_client()
    enter(browser)
    app.extensions["expmap_oidc"]._metadata = None
    provider.answers["/.well-known/openid-configuration"] = (500, b"")
    assert browser.post("/sign-out").headers["Location"] == "/sign-in"
    assert not is_in(browser)


def test_who_signed_in_by_a_password_is_not_sent_to_the_provider(app, library, new_account):
    with library.database.write() as session:
        session.get_one(type(jana := new_account("Jana")), jana.id).password_hash = sign_in.password_hash(
            PASSWORD, minimum=10
        )
    browser = app.test_client()
    assert browser.post("/sign-in", data={"name": "Jana", "password": PASSWORD}).status_code == 303
    assert browser.post("/sign-out").headers["Location"] == "/sign-in"


def test_secrets_are_not_in_the_log(app, provider, caplog):
    caplog.set_level("DEBUG", "webapp")
    provider.claims = {"nonce": "another"}
    enter(app.test_client())
    assert "a sign-in at the provider failed" in caplog.text
    assert "eyJ" not in caplog.text and "s3cret" not in caplog.text


def test_names_and_mail_addresses_match_nobody(app, provider, library, new_account):
    new_account("Jana")
    confirmed(library, "Jana", "jana@example.org")
    browser = app.test_client()
    enter(browser)
    assert 'value="Jana 2"' in browser.get("/account").text


def confirmed(library, name, address, *, at=None):
    with library.database.write() as session:
        receiver = EventReceiver(account_id=accounts.named(session, name).id, kind="mail", address=address)
        receiver.events, receiver.salt, receiver.confirmed_at = [], "", at or now()
        session.add(receiver)


@pytest.mark.parametrize(
    ("user", "others", "name"),
    [
        ({}, (), "Petr"),
        ({"email": "JANA@example.org"}, (), "Petr"),
        ({"email_verified": False}, (), "Jana"),
        ({"email_verified": "true"}, (), "Jana"),
        ({"email": "other@example.org"}, (), "Jana"),
        ({}, ("Karel",), "Jana"),
    ],
)
def test_a_verified_address_matches_if_the_setting_allows(
    app_with, provider, library, new_account, user, others, name
):
    for one in ("Petr", *others):
        new_account(one)
        confirmed(library, one, "jana@example.org")
    provider.user |= user
    browser = app_with(accounts="everybody", match_email="verified").test_client()
    enter(browser)
    assert f'value="{name}"' in browser.get("/account").text


def test_an_address_that_changed_hands_does_not_open_the_account(app_with, provider, library, new_account):
    new_account("Petr")
    confirmed(library, "Petr", "jana@example.org")
    app = app_with(accounts="everybody", match_email="verified")
    enter(app.test_client())
    provider.user["sub"] = "u-18"
    browser = app.test_client()
    enter(browser)
    assert 'value="Petr"' not in browser.get("/account").text


@pytest.mark.parametrize(
    ("changed", "where"),
    [
        ({"issuer": "http://id.example.org"}, "oidc.issuer"),
        ({"issuer": "https://me:pw@id.example.org"}, "oidc.issuer"),
        ({"client_id": None}, "oidc.client_id"),
        ({"scopes": "profile"}, "oidc.scopes"),
        ({"issuer": None, "required": "yes"}, "oidc.required"),
    ],
)
def test_settings_that_cannot_work_are_refused(settings, changed, where):
    with pytest.raises(UsageError) as refused:
        check_settings(replace(settings.oidc, **changed))
    assert refused.value.where == where and refused.value.hint


def test_wrong_ones_are_in_the_log_and_on_the_page_and_others_are_served(app_with, caplog):
    app = app_with(client_id=None, required="yes")
    assert "nobody can sign in at the provider: oidc.client_id: this is missing" in caplog.text
    answer = app.test_client().get("/oidc/start")
    assert (answer.status_code, error_of(answer)) == (400, "This is missing")
    assert 'name="password"' not in answer.text


def test_choices_are_checked_when_settings_are_read():
    for name, value in [("REQUIRED", "true"), ("ACCOUNTS", "all"), ("MATCH_EMAIL", "yes")]:
        with pytest.raises(UsageError, match="is not allowed") as refused:
            load_settings({f"EXPMAP_OIDC_{name}": value})
        assert refused.value.hint.startswith("write one of ")


def test_without_a_provider_nothing_is_offered(app_with, owner, sign_in):
    app = app_with(issuer=None, client_id=None)
    browser = app.test_client()
    assert "/oidc/start" not in browser.get("/sign-in").text
    assert browser.get("/oidc/start").status_code == 403


def test_a_missing_package_is_named(app, absent):
    absent("connect")
    answer = app.test_client().get("/oidc/start")
    assert answer.status_code == 422
    assert "is not installed" in answer.text and "experience-map[connect]" in answer.text
