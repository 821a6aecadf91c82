"""Sign-in links, passwords, sessions, tokens, and their pages."""

import re
from concurrent.futures import ThreadPoolExecutor
from datetime import timedelta
from time import sleep

import pytest
from sqlalchemy import select, update

from webapp.errors import Conflict, NotFound, NotSignedIn, TooMany
from webapp.settings import WebSettings
from webapp.store.accounts import accounts
from webapp.store.accounts import sign_in as signin
from webapp.store.clock import now
from webapp.store.schema import Account, EndedSession, FailedSignIn, SignInLink

PASSWORD = "correct horse battery"


@pytest.fixture
def link(library, owner):
    """Return the path of a sign-in link of the owner."""
    with library.database.write() as session:
        return f"/sign-in/{signin.new_link(session, owner, hours=1)}"


@pytest.fixture
def jana(library):
    """An account with a password."""
    with library.database.write() as session:
        account = accounts.create(session, "Jana")
        account.password_hash = signin.password_hash(PASSWORD, minimum=10)
    return account


def enter(client, *, name="Jana", password=PASSWORD, **more):
    """Send the sign-in form."""
    return client.post("/sign-in", data={"name": name, "password": password, **more})


def is_in(client):
    """Return whether a browser is signed in."""
    return client.get("/account").status_code == 200


def test_a_link_signs_in_once(app, stranger, link):
    assert "Welcome, owner" in stranger.get(link).text
    assert "Welcome, owner" in stranger.get(link).text, "looking at it does not use it up"
    assert not is_in(stranger)
    assert stranger.post(link).headers["Location"] == "/"
    first, again = stranger.get("/").text, stranger.get("/").text
    assert first.count('href="/account"') == again.count('href="/account"') + 1, "where a password is set"
    assert is_in(stranger)
    other = app.test_client()
    assert other.post(link).status_code == other.get(link).status_code == 401
    assert not is_in(other)
    assert stranger.get(link).headers["Location"] == "/", "who is signed in is not asked to sign in"


def test_a_link_that_is_too_old_does_nothing(library, stranger, link):
    with library.database.write() as session:
        session.execute(update(SignInLink).values(expires_at=now() - timedelta(seconds=1)))
    assert stranger.post(link).status_code == 401
    assert not is_in(stranger)


def test_only_the_hash_of_a_link_is_kept(library, link):
    with library.database.read() as session:
        kept = session.query(SignInLink).one().token_hash
    assert kept not in link


def test_name_and_password_sign_in_and_lead_on(stranger, jana):
    answer = enter(stranger, name=" jana ", next="/maps/park/jobs?x=1")
    assert answer.headers["Location"] == "/maps/park/jobs?x=1"
    assert is_in(stranger)


@pytest.mark.parametrize(
    "there", ["https://evil.example/", "//evil.example", "/\\evil.example", "javascript:1"]
)
def test_a_sign_in_leads_to_no_other_site(stranger, jana, there):
    assert enter(stranger, next=there).headers["Location"] == "/"


@pytest.mark.parametrize(
    "given", [{"password": "wrong"}, {"name": "nobody"}, {"name": "owner"}, {"password": ""}]
)
def test_the_error_does_not_say_which_is_wrong(stranger, owner, jana, given):
    answer = enter(stranger, **given)
    assert answer.status_code == 401
    assert "Wrong name or password" in answer.text
    assert not is_in(stranger)


def test_failures_of_a_name_make_it_wait_wherever_they_came_from(library, stranger, jana):
    with library.database.write() as session:
        session.add_all(FailedSignIn(who="name:jana") for _ in range(10))
    assert enter(stranger, name="JANA").status_code == 429


def test_many_failures_from_one_address_are_429(library, stranger, jana):
    with library.database.write() as session:
        session.add_all(FailedSignIn(who="address:127.0.0.1") for _ in range(8))
    codes = [enter(stranger, name=f"guess{n}").status_code for n in range(3)]
    assert codes == [401, 401, 429]
    answer = enter(stranger)
    assert answer.status_code == 429, "the right password has to wait too"
    assert 0 < int(answer.headers["Retry-After"]) <= 15 * 60


def test_of_many_guesses_at_once_no_more_are_tried_than_are_allowed(library, jana, monkeypatch):
    tried = []
    monkeypatch.setattr(signin, "check_password_hash", lambda *_: tried.append(sleep(0.05)))

    def guess(_):
        with pytest.raises((NotSignedIn, TooMany)):
            signin.by_password(
                library.database, "Jana", password="wrong", address="10.0.0.1", limits=WebSettings()
            )

    with ThreadPoolExecutor(20) as pool:
        list(pool.map(guess, range(40)))
    assert len(tried) == WebSettings().sign_in_failures


def test_who_signs_in_leaves_no_failure_behind(library, stranger, jana):
    assert enter(stranger, password="wrong").status_code == 401
    assert enter(stranger).status_code == 303
    with library.database.read() as session:
        assert [row.who for row in session.query(FailedSignIn)] == ["address:127.0.0.1"]


def test_failures_are_forgotten(library, stranger, jana):
    with library.database.write() as session:
        session.add_all(FailedSignIn(who="name:jana", at=now() - timedelta(minutes=16)) for _ in range(20))
    assert enter(stranger).status_code == 303


def test_signing_out_ends_the_session(client):
    assert is_in(client)
    client.post("/sign-out")
    assert not is_in(client)


def test_a_copy_of_the_cookie_is_worth_nothing_after_signing_out(app, client, sign_in, owner):
    other = sign_in(owner)
    copy = client.get_cookie("expmap").value
    assert is_in(client)
    client.post("/sign-out")
    thief = app.test_client()
    thief.set_cookie("expmap", copy)
    assert not is_in(thief)
    assert is_in(other), "another session of the account goes on"


def test_ended_sessions_are_forgotten_once_their_cookies_are_too_old(library):
    with library.database.write() as session:
        session.add(EndedSession(id_hash="old", at=now() - timedelta(days=15)))
    with library.database.write() as session:
        signin.end_session(session, "new", days=14)
        signin.end_session(session, "new", days=14)
    with library.database.read() as session:
        assert session.scalars(select(EndedSession.id_hash)).all() == [accounts.hashed("new")]


def test_a_session_has_an_account_until_it_is_signed_out_of_or_the_account_is_gone(library, jana):
    with library.database.write() as session:
        assert signin.account_of_session(session, "one", account_id=jana.id).name == jana.name
        signin.end_session(session, "one", days=14)
        assert signin.account_of_session(session, "one", account_id=jana.id) is None
        assert signin.account_of_session(session, "another", account_id=jana.id) is not None
        session.delete(session.get(Account, jana.id))
        session.flush()
        assert signin.account_of_session(session, "another", account_id=jana.id) is None


def test_a_password_is_set_and_signs_out_elsewhere(client, sign_in, owner, stranger):
    elsewhere = sign_in(owner)
    assert client.post("/account/password", data={"password": "short"}).status_code == 400
    assert is_in(elsewhere)
    assert client.post("/account/password", data={"password": PASSWORD}).status_code == 303
    assert is_in(client)
    assert not is_in(elsewhere)
    assert enter(stranger, name="owner").status_code == 303


def test_a_password_is_changed_only_by_who_knows_it(jana, sign_in):
    client = sign_in(jana)
    new = "another good password"
    assert client.post("/account/password", data={"password": new, "current": "wrong"}).status_code == 401
    assert client.post("/account/password", data={"password": new, "current": PASSWORD}).status_code == 303


def test_sessions_end_everywhere_else(client, sign_in, owner):
    elsewhere = sign_in(owner)
    client.post("/account/end-sessions")
    assert is_in(client)
    assert not is_in(elsewhere)


@pytest.mark.parametrize("user_id", ["", "1", "x.y", "1.99", "99.0", "1.0.0", "².0"])
def test_a_session_that_names_nobody_is_none(stranger, owner, user_id):
    with stranger.session_transaction() as session:
        session["_user_id"] = user_id
    assert stranger.get("/account").status_code == 302


def test_a_token_is_shown_once_and_works_without_csrf(app, client, park):
    page = client.post("/account/tokens", data={"name": "robot"}).text
    token = re.search(r'value="(expmap_[^"]+)"', page)[1]
    assert token not in client.get("/account").text
    program = app.test_client()
    program.csrf = False
    headers = {"Authorization": f"Bearer {token}"}
    assert program.get(f"/api/v1/jobs?map={park}", headers=headers).status_code == 200
    assert program.post("/api/v1/jobs/1/cancel", headers=headers).status_code == 404
    assert program.get("/account", headers=headers).status_code == 302, "it counts for the API alone"


def test_a_token_that_is_revoked_or_unknown_is_refused(app, client, library, owner, park):
    with library.database.write() as session:
        token = accounts.new_token(session, owner, name="robot")
    path, program = f"/api/v1/jobs?map={park}", app.test_client()
    assert program.get(path, headers={"Authorization": f"Bearer {token}"}).status_code == 200
    client.post("/account/tokens/1/revoke")
    for sent in (token, "expmap_guess"):
        answer = program.get(path, headers={"Authorization": f"Bearer {sent}"})
        assert answer.status_code == 401
        assert answer.json["error"]["message"] == "unknown token"
    # A valid session does not compensate for a wrong token.
    assert client.get(path, headers={"Authorization": "Bearer expmap_guess"}).status_code == 401


def test_nobody_revokes_the_token_of_another(library, sign_in, owner, jana):
    with library.database.write() as session:
        accounts.new_token(session, owner, name="robot")
    assert sign_in(jana).post("/account/tokens/1/revoke").status_code == 404
    with library.database.read() as session:
        assert len(accounts.tokens(session, owner)) == 1


def test_the_owner_gives_accounts_to_others(app, client):
    page = client.post("/people", data={"name": "Petr"}).text
    path = re.search(r'value="http://localhost(/sign-in/[^"]+)"', page)[1]
    petr = app.test_client()
    assert petr.post(path).status_code == 303
    assert "Petr" in petr.get("/account").text
    assert client.post("/people", data={"name": "petr"}).status_code == 409
    assert client.post("/people/2/remove").status_code == 303
    assert not is_in(petr)


def test_the_last_owner_cannot_remove_the_own_account(client, owner):
    assert client.post(f"/people/{owner.id}/remove").status_code == 400
    assert is_in(client)


def test_people_are_for_the_owner_of_the_library(jana, sign_in):
    client = sign_in(jana)
    assert client.get("/people").status_code == 403
    assert client.post("/people", data={"name": "x"}).status_code == 403


def test_the_language_is_the_account_s(client, library, owner):
    client.post("/language", data={"language": "cs"}, headers={"Referer": "http://localhost/account"})
    assert '<html lang="cs"' in client.get("/", headers={"Accept-Language": "en"}).text
    with library.database.read() as session:
        assert session.get(Account, owner.id).language == "cs"
    assert client.post("/language", data={"language": "xx"}).status_code == 404


def test_the_language_of_a_stranger_is_of_the_browser(stranger):
    stranger.post("/language", data={"language": "cs"})
    assert '<html lang="cs"' in stranger.get("/sign-in").text


def test_a_name_is_changed_unless_somebody_has_it(client, jana):
    assert client.post("/account/name", data={"name": "JANA"}).status_code == 409
    assert client.post("/account/name", data={"name": ""}).status_code == 400
    assert client.post("/account/name", data={"name": "Boss"}).status_code == 303
    assert "Boss" in client.get("/account").text


def test_names_of_accounts_have_no_break_spaces_and_none_is_taken_for_another(client, jana):
    assert client.post("/account/name", data={"name": "Jana\u200b"}).status_code == 409
    assert client.post("/account/name", data={"name": "Zoe\u0301\u202f!\u2060"}).status_code == 303
    assert "Zoé !" in client.get("/account").text


def test_accounts_whose_names_are_alike_since_an_update_are_told_apart(library, new_account):
    first, second = new_account("Ana 1"), new_account("Eva")
    with library.database.write() as session:
        session.get_one(Account, second.id).name = "Ana\u00a0１"
    with library.database.read() as session:
        assert accounts.named(session, "Ana\u00a0１").id == second.id
        assert accounts.named(session, "Ana 1").id == accounts.named(session, "ANA 1").id == first.id
        for name in ("Ana\x00", "Ana\ud800"):
            with pytest.raises(NotFound):
                accounts.named(session, name)


def test_the_session_of_a_deleted_account_is_not_that_of_the_next_one(library, sign_in, new_account):
    gone = new_account("Karel")
    browser = sign_in(gone)
    assert is_in(browser)
    with library.database.write() as session:
        accounts.remove(session, session.get(Account, gone.id))
    assert new_account("Petra").id > gone.id
    assert not is_in(browser)


def test_letters_of_another_script_make_no_other_name(client, library, jana):
    for name in ("J\u0430na", "\u0408\u0410\u039d\u0410"):
        assert client.post("/account/name", data={"name": name}).status_code == 409
    with library.database.write() as session, pytest.raises(Conflict, match="already taken"):
        accounts.create(session, "j\u0430na")
    with library.database.write() as session:
        accounts.create(session, "\u0418\u0432\u0430\u043d")  # a whole name in one script


def test_both_normal_forms_of_a_name_sign_in(library, app):
    with library.database.write() as session:
        account = accounts.create(session, "Zoe\u0301")
        account.password_hash = signin.password_hash(PASSWORD, minimum=10)
    for name in ("Zo\u00e9", "Zoe\u0301", "ZOE\u0301"):
        assert enter(app.test_client(), name=name).status_code == 303


def test_a_browser_drops_its_cache_when_the_account_changes(stranger, link):
    for address in (link, "/sign-out"):
        assert stranger.post(address).headers["Clear-Site-Data"] == '"cache"'


@pytest.mark.parametrize("written", ["Jana  Novotna", "jana\tNOVOTNA", " Jana   Novotna "])
def test_other_ways_to_write_a_name_are_no_further_attempts(library, app, settings, written):
    with library.database.write() as session:
        accounts.create(session, "Jana Novotna").password_hash = "none"
    for n in range(settings.web.sign_in_failures):
        origin = {"REMOTE_ADDR": f"10.0.0.{n}"}
        app.test_client().post(
            "/sign-in", data={"name": "Jana Novotna", "password": "x"}, environ_overrides=origin
        )
    assert enter(app.test_client(), name=written).status_code == 429


def test_the_page_lists_where_one_is_signed_in_and_ends_each(app, jana):
    agents = {
        "Firefox · Linux": "Mozilla/5.0 (X11; Linux x86_64; rv:128.0) Gecko/20100101 Firefox/128.0",
        "Chrome · Android": "Mozilla/5.0 (Linux; Android 14) Chrome/126.0 Mobile Safari/537.36",
        "Safari · iPhone": "Mozilla/5.0 (iPhone; CPU iPhone OS 17_5 like Mac OS X) Version/17.5 Safari/604.1",
    }
    browsers = {}
    for device, agent in agents.items():
        browsers[device] = app.test_client()
        browsers[device].environ_base["HTTP_USER_AGENT"] = agent
        enter(browsers[device])
    here, phone, lost = browsers.values()
    page = here.get("/account").text
    assert [device in page for device in agents] == [True] * 3
    assert page.count("this one") == 1
    ends = re.findall(r"/account/sessions/\d+/end", page)
    assert len(ends) == 2
    here.post(ends[0])
    assert [is_in(one) for one in (here, phone, lost)] == [True, True, False]
    assert "Safari" not in here.get("/account").text
    here.post("/account/end-sessions")
    assert is_in(here) and not is_in(phone)
    assert "Android" not in here.get("/account").text


def test_nobody_ends_the_session_of_another(app, jana, sign_in, new_account):
    mine = app.test_client()
    enter(mine)
    assert sign_in(new_account("Eve")).post("/account/sessions/1/end").status_code == 404
    assert is_in(mine)
