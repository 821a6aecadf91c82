"""The clock is set back by an hour while the server runs: nobody is signed out, nobody waits an hour more."""

import time
from datetime import timedelta

import pytest
from itsdangerous import TimestampSigner

from webapp.store.accounts import accounts
from webapp.store.accounts import sign_in as signin
from webapp.store.clock import now
from webapp.store.schema import FailedSignIn

HOUR_S = 3600
DAY_S = 24 * HOUR_S
PASSWORD = "correct horse battery"


@pytest.fixture
def shift(monkeypatch):
    """Shift the clock that signs cookies by seconds."""

    def by(seconds):
        monkeypatch.setattr(TimestampSigner, "get_timestamp", lambda _: int(time.time()) + seconds)

    return by


def is_in(client):
    """Return whether a browser is signed in; its cookie is renewed."""
    return client.get("/account").status_code == 200


@pytest.mark.parametrize("back_s", [2, HOUR_S, 13 * DAY_S])
def test_a_session_outlives_a_clock_that_is_set_back(client, shift, back_s):
    assert is_in(client)
    shift(-back_s)
    assert is_in(client)
    shift(0)
    assert is_in(client)


@pytest.mark.parametrize("at_s", [15 * DAY_S, -15 * DAY_S])
def test_a_session_still_ends_after_its_time(client, shift, at_s):
    assert is_in(client)
    shift(at_s)
    assert not is_in(client)


def test_a_session_that_has_ended_stays_ended(app, client, shift):
    assert is_in(client)
    copied = client.get_cookie("expmap").value
    client.post("/sign-out")
    shift(-HOUR_S)
    thief = app.test_client()
    thief.set_cookie("expmap", copied)
    assert not is_in(thief)


def test_failures_before_the_clock_was_set_back_do_not_lock_out_for_an_hour(library, stranger):
    with library.database.write() as session:
        account = accounts.create(session, "Jana")
        account.password_hash = signin.password_hash(PASSWORD, minimum=10)
        session.add_all(
            FailedSignIn(who="name:jana", at=now() + timedelta(seconds=HOUR_S)) for _ in range(20)
        )
    data = {"name": "Jana", "password": PASSWORD}
    assert stranger.post("/sign-in", data=data).status_code == 303
