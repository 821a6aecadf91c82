"""One-time codes after the password, by an independent implementation of the app (pyotp)."""

import re
import time
from urllib.parse import urlsplit

import pyotp
import pytest

from tests.web.accounts.test_signing_in import PASSWORD, is_in
from webapp.app import main as program
from webapp.store.accounts import accounts, one_time_codes, sign_in
from webapp.store.schema import Account

PAGE = "/account/codes"


@pytest.fixture
def clock(monkeypatch):
    """A time of day that tests move; the app follows it."""

    class Clock:
        at = 1_800_000_000

        def __call__(self):
            return self.at

    moved = Clock()
    monkeypatch.setattr(one_time_codes.time, "time", moved)
    return moved


@pytest.fixture
def jana(library, new_account):
    account = new_account("jana")
    with library.database.write() as session:
        session.get_one(Account, account.id).password_hash = sign_in.password_hash(PASSWORD, minimum=10)
    return account


@pytest.fixture
def phone(jana, sign_in, clock):
    """An app that is set up for the account, as the QR code says, and the recovery codes."""
    browser = sign_in(jana)
    browser.post(PAGE)
    shown = browser.get(PAGE).text
    secret = re.search(r'id="app-secret" value="([A-Z2-7 ]+)"', shown)[1].replace(" ", "")
    app = pyotp.parse_uri(one_time_codes.app_address(secret, name="jana"))
    assert (app.name, app.issuer, app.interval, app.digits) == ("jana", "Experience Map", 30, 6)
    wrong = browser.post(f"{PAGE}/confirm", data={"code": "000000"})
    assert wrong.status_code == 401 and "This code is wrong or was used already" in wrong.text
    page = browser.post(f"{PAGE}/confirm", data={"code": app.at(clock.at)}).text
    recovery = re.findall(r"<li><code>([a-z2-7-]+)</code>", page)
    assert len(set(recovery)) == 10 and all(len(code) == 19 for code in recovery)
    again = browser.get(PAGE).text
    assert recovery[0] not in again and secret not in again.replace(" ", "")
    clock.at += 30
    return app, recovery


def after_password(app):
    browser = app.test_client()
    answer = browser.post("/sign-in", data={"name": "jana", "password": PASSWORD, "next": "/account?x=1"})
    assert (answer.status_code, answer.headers["Location"]) == (303, "/sign-in/code")
    return browser


def test_the_password_alone_does_not_sign_in(app, phone, clock):
    browser = after_password(app)
    assert not is_in(browser)
    assert browser.get("/sign-in/code").status_code == 200
    answer = browser.post("/sign-in/code", data={"code": " ".join(phone[0].at(clock.at))})
    assert (answer.status_code, answer.headers["Location"]) == (303, "/account?x=1")
    assert answer.headers["Clear-Site-Data"] == '"cache"'
    assert is_in(browser)


def test_a_used_code_is_not_accepted_twice(app, phone, clock):
    code = phone[0].at(clock.at)
    assert after_password(app).post("/sign-in/code", data={"code": code}).status_code == 303
    clock.at += 29
    second = after_password(app)
    assert second.post("/sign-in/code", data={"code": code}).status_code == 401
    assert not is_in(second)
    older = phone[0].at(clock.at - 60)
    assert second.post("/sign-in/code", data={"code": older}).status_code == 401, "nor one before it"
    assert second.post("/sign-in/code", data={"code": phone[0].at(clock.at + 30)}).status_code == 303


@pytest.mark.parametrize(("steps", "status"), [(-2, 401), (-1, 303), (0, 303), (1, 303), (2, 401)])
def test_the_clock_of_a_phone_may_be_half_a_minute_wrong(app, phone, clock, steps, status):
    clock.at += 90
    answer = after_password(app).post("/sign-in/code", data={"code": phone[0].at(clock.at + 30 * steps)})
    assert answer.status_code == status


def test_a_recovery_code_works_once(app, phone, library, jana):
    code = phone[1][3]
    assert after_password(app).post("/sign-in/code", data={"code": code.upper()}).status_code == 303
    assert after_password(app).post("/sign-in/code", data={"code": code}).status_code == 401
    with library.database.read() as session:
        assert one_time_codes.recovery_codes_left(session, jana.id) == 9


def test_codes_are_limited_like_passwords(app, phone, settings, clock):
    browser = after_password(app)
    for number in range(settings.web.sign_in_failures):
        origin = {"REMOTE_ADDR": f"10.0.0.{number}"}
        wrong = browser.post("/sign-in/code", data={"code": "12345"}, environ_overrides=origin)
        assert wrong.status_code == 401
    right = browser.post("/sign-in/code", data={"code": phone[0].at(clock.at)})
    assert right.status_code == 429 and right.headers["Retry-After"]
    assert after_password(app).post("/sign-in/code", data={"code": "12345"}).status_code == 429


def test_the_step_between_password_and_code_ends(app, phone, clock, library, jana):
    browser = after_password(app)
    with browser.session_transaction() as session:
        session["second_factor"] = {**session["second_factor"], "at": time.time() - 301}
    late = browser.post("/sign-in/code", data={"code": phone[0].at(clock.at)})
    assert late.status_code == 401 and "too long ago" in late.text
    browser = after_password(app)
    with library.database.write() as session:
        accounts.end_sessions(session.get_one(Account, jana.id))
    assert browser.post("/sign-in/code", data={"code": phone[0].at(clock.at)}).status_code == 401
    stranger = app.test_client()
    assert stranger.get("/sign-in/code").headers["Location"] == "/sign-in"
    assert stranger.post("/sign-in/code", data={"code": phone[0].at(clock.at)}).status_code == 401


def test_new_recovery_codes_and_turning_off_ask_for_a_code(app, phone, clock, sign_in, jana):
    browser = sign_in(jana)
    for path in ("recovery", "off"):
        assert browser.post(f"{PAGE}/{path}", data={"code": "000000"}).status_code == 401
    page = browser.post(f"{PAGE}/recovery", data={"code": phone[0].at(clock.at)}).text
    new = re.findall(r"<li><code>([a-z2-7-]+)</code>", page)
    assert len(new) == 10 and not set(new) & set(phone[1])
    assert after_password(app).post("/sign-in/code", data={"code": phone[1][0]}).status_code == 401
    assert browser.post(PAGE).status_code == 409
    assert browser.post(f"{PAGE}/off", data={"code": new[0]}).status_code == 303
    answer = app.test_client().post("/sign-in", data={"name": "jana", "password": PASSWORD})
    assert answer.headers["Location"] == "/"


def test_codes_that_are_not_confirmed_are_not_asked_for(app, jana, sign_in):
    browser = sign_in(jana)
    assert browser.post(f"{PAGE}/confirm", data={"code": "1"}).status_code == 409
    browser.post(PAGE)
    first = browser.get(PAGE).text
    browser.post(PAGE)
    assert re.search('value="[A-Z2-7 ]{39}"', first)[0] not in browser.get(PAGE).text, "a new secret"
    answer = app.test_client().post("/sign-in", data={"name": "jana", "password": PASSWORD})
    assert answer.headers["Location"] == "/"
    assert browser.post(f"{PAGE}/off").status_code == 303
    assert "They are off" in browser.get(PAGE).text


def test_no_secret_is_in_the_database(phone, library, database_url):
    secret, recovery = phone[0].secret, phone[1]
    with library.database.read() as session:
        tables = ("one_time_codes", "recovery_code", "account")
        connection = session.connection()
        rows = [connection.exec_driver_sql(f"SELECT * FROM {name}").all() for name in tables]
    assert secret not in str(rows)
    assert not any(code in str(rows) or code.replace("-", "") in str(rows) for code in recovery)


def test_the_codes_are_those_of_the_rfc():
    """The last six digits of the test vectors of RFC 6238, appendix B."""
    for at, code in [(59, "287082"), (1111111109, "081804"), (1234567890, "005924"), (2000000000, "279037")]:
        assert one_time_codes._code(b"12345678901234567890", at // 30) == code


def test_a_link_of_the_command_line_rescues_from_a_lost_phone(
    phone, library, app, database_url, monkeypatch, capsys
):
    if database_url:
        monkeypatch.setenv("EXPMAP_DATABASE", database_url)
    with pytest.raises(SystemExit) as ended:
        program.main(["account", "link", "--account", "jana", "--no-codes", "--library", str(library.folder)])
    assert ended.value.code == 0
    browser = app.test_client()
    assert browser.post(urlsplit(capsys.readouterr().out.strip()).path).status_code == 303
    assert is_in(browser)
    answer = app.test_client().post("/sign-in", data={"name": "jana", "password": PASSWORD})
    assert answer.headers["Location"] == "/", "no code is asked for"
