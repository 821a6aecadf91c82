"""Who gets in, what groups give and take, identities on the page, and sign-in only by the provider."""

import re

import pytest
from sqlalchemy import select

from tests.connect.oidc.conftest import enter, there
from webapp.app import main as program
from webapp.store.accounts import accounts, identities, sign_in
from webapp.store.accounts.identities import Person, SignInIdentity
from webapp.store.maps.maps import role_of
from webapp.store.schema import Account, MapRecord

PASSWORD = "correct horse battery"
PAGE = "/account/oidc"


@pytest.fixture
def role(library):
    """Return the role of an account on a map."""

    def of(name, slug):
        with library.database.read() as session:
            record = session.scalars(select(MapRecord).where(MapRecord.slug == slug)).one()
            return role_of(session, record, account=accounts.named(session, name))

    return of


def is_owner(library, name):
    with library.database.read() as session:
        return accounts.named(session, name).is_owner


def client_of(app, account):
    browser = app.test_client()
    with browser.session_transaction() as session:
        session["_user_id"], session["session_id"] = f"{account.id}.{account.epoch}", "0" * 32
    return browser


def add_rules(browser, *rules):
    for group, given in rules:
        assert browser.post(f"{PAGE}/groups", data={"group": group, "role": given}).status_code == 303


def test_groups_give_roles_and_take_them_back(app, provider, owner, new_map, role, library):
    park, lake = new_map(owner, name="Park"), new_map(owner, name="Lake")
    add_rules(client_of(app, owner), ("rangers", "editor 1"), ("all", "viewer 1"), ("lake", "owner 2"))
    add_rules(client_of(app, owner), ("admins", "owner"))
    provider.user["groups"] = ["rangers", "all", "lake", "unknown"]
    enter(app.test_client())
    assert (role("Jana", park), role("Jana", lake)) == ("editor", "owner")
    assert not is_owner(library, "Jana")
    provider.user["groups"] = ["all", "admins"]
    enter(app.test_client())
    with library.database.write() as session:
        jana = accounts.named(session, "Jana")
        assert jana.is_owner
        jana.is_owner = False  # so that the role is not that of an owner of the library
    assert (role("Jana", park), role("Jana", lake)) == ("viewer", None)
    provider.user["groups"] = "all"  # some providers send a single one like this
    enter(app.test_client())
    assert role("Jana", park) == "viewer"
    provider.user["groups"] = {"all": True}
    enter(app.test_client())
    assert role("Jana", park) is None


def test_groups_in_the_answer_of_userinfo_count(app, provider, owner, park, role):
    add_rules(client_of(app, owner), ("rangers", "viewer 1"))
    provider.userinfo = {"groups": ["rangers"]}
    enter(app.test_client())
    assert role("Jana", park) == "viewer"
    provider.userinfo["sub"] = "somebody else"
    assert "The provider describes somebody else" in enter(app.test_client()).text


def test_an_owner_by_group_is_one_as_long_as_the_group_has_them(app, provider, owner, library):
    add_rules(client_of(app, owner), ("admins", "owner"))
    provider.user["groups"] = ["admins"]
    enter(app.test_client())
    assert is_owner(library, "Jana")
    provider.user["groups"] = []
    enter(app.test_client())
    assert not is_owner(library, "Jana")


def test_the_last_owner_of_the_library_stays_one(library, new_account):
    with library.database.write() as session:
        identities.add_rule(session, "admins", role="owner", map_id=None)
        identity = identities.note(session, PERSON)
        account = identities.new_account(session, identity)
        identities.apply_groups(session, identity, groups=["admins"])
        assert account.is_owner
        identities.apply_groups(session, identity, groups=[])
        assert account.is_owner


PERSON = Person("https://id.example.org", "1", "Eva", None, False, ())


def test_roles_that_people_gave_stay(library, new_map, owner, new_account):
    eva = new_account("Eva")
    slug = new_map(owner, shared={eva: "editor"})
    with library.database.write() as session:
        record = session.scalars(select(MapRecord)).one()
        assert record.slug == slug
        identity = identities.note(session, PERSON)
        identities.link(session, identity, account=eva)

        def after(given, groups):
            for rule, _map in identities.rules(session):
                session.delete(rule)
            session.flush()
            identities.add_rule(session, "g", role=given, map_id=record.id)
            identities.apply_groups(session, identity, groups=groups)
            return role_of(session, record, account=eva)

        assert after("viewer", ["g"]) == "editor", "the higher one"
        assert after("viewer", []) == "editor"
        assert after("owner", ["g"]) == "owner"
        assert after("viewer", ["g"]) == "editor", "what people gave is back"
        assert after("owner", ["g"]) == "owner"
        accounts.set_member_role(session, record, account=eva, role="viewer")  # a person took it
        assert after("owner", []) == "viewer"
        assert after("owner", ["g"]) == "owner"
        accounts.remove_member(session, record, account=session.get_one(Account, owner.id))
        assert after("owner", []) == "owner", "a map needs an owner"


def test_lines_of_the_table_are_checked(app, owner, park, new_account):
    browser = client_of(app, owner)
    add_rules(browser, ("rangers", "viewer 1"))
    wrong = [
        ("rangers", "editor 1", 409),
        ("", "viewer 1", 400),
        ("x" * 256, "viewer 1", 400),
        ("a", "sign-in 1", 400),
        ("a", "viewer", 400),
        ("a", "viewer 99", 404),
        ("a", "viewer x", 400),
    ]
    for group, given, status in wrong:
        answer = browser.post(f"{PAGE}/groups", data={"group": group, "role": given})
        assert (answer.status_code, 'data-testid="error-message"' in answer.text) == (status, True), given
    assert browser.get(PAGE).text.count("/account/oidc/groups/") == 1
    assert browser.post(f"{PAGE}/groups/1/remove").status_code == 303
    assert browser.post(f"{PAGE}/groups/1/remove").status_code == 404
    stranger = client_of(app, new_account("Eve"))
    for path in ("groups", "groups/1/remove", "1/link"):
        assert stranger.post(f"{PAGE}/{path}", data={"group": "g", "role": "owner"}).status_code == 403
    assert "What groups may do" not in stranger.get(PAGE).text


def test_only_listed_groups_get_in_if_the_setting_says_so(app_with, provider, owner, park, role):
    app = app_with(accounts="groups")
    browser = app.test_client()
    answer = enter(browser)
    assert answer.status_code == 403 and "in none of the groups that may sign in" in answer.text
    add_rules(client_of(app, owner), ("guests", "sign-in"), ("rangers", "viewer 1"))
    provider.user["groups"] = ["guests", "rangers"]
    assert enter(browser).status_code == 303
    assert role("Jana", park) == "viewer"
    provider.user["groups"] = []
    assert enter(app.test_client()).status_code == 403
    assert role("Jana", park) is None


def test_an_unknown_identity_waits_until_an_owner_links_it(app_with, provider, owner, new_account, library):
    app, jana = app_with(), new_account("Jana K")
    browser, boss = app.test_client(), client_of(app, owner)
    answer = enter(browser)
    assert answer.status_code == 403 and "You have no account here yet" in answer.text
    shown = boss.get(PAGE).text
    assert "Waiting for an account" in shown and "jana@example.org" in shown and "u-17" in shown
    assert boss.post(f"{PAGE}/1/link", data={"account": "Nobody"}).status_code == 404
    assert boss.post(f"{PAGE}/1/link", data={"account": "Jana K"}).status_code == 303
    assert enter(browser).status_code == 303
    assert 'value="Jana K"' in browser.get("/account").text
    assert boss.post(f"{PAGE}/1/link", data={"account": "owner"}).status_code == 409
    provider.user = {"sub": "u-99", "name": " \u202e "}
    enter(app.test_client())
    assert boss.post(f"{PAGE}/2/link", data={"account": ""}).status_code == 303
    other = app.test_client()
    assert enter(other).status_code == 303
    assert boss.post(f"{PAGE}/2/unlink").status_code == 303
    assert enter(app.test_client()).status_code == 403, "it waits again"
    with library.database.write() as session:
        assert session.get(Account, jana.id) is not None, "the account stays"


def test_waiting_identities_are_limited(library, monkeypatch):
    monkeypatch.setattr(identities, "_MOST_WAITING", 3)
    with library.database.write() as session:
        for number in range(6):
            identities.note(session, person(number))
        assert session.scalars(select(SignInIdentity.subject).order_by(SignInIdentity.id)).all() == [
            "3",
            "4",
            "5",
        ]


def person(number):
    return Person("https://id.example.org", str(number), "Eva", None, False, ())


def test_people_link_their_own_identity(app_with, provider, owner, new_account):
    app = app_with()
    browser, eva = client_of(app, owner), client_of(app, new_account("Eva"))
    assert "/account/oidc" in browser.get("/account").text

    def linking(client):
        page = client.post("/oidc/link")
        address = re.search(r'content="0; url=([^"]+)"', page.text)[1].replace("&amp;", "&")
        return client.get(there(address))

    assert linking(browser).headers["Location"] == PAGE
    assert "u-17" in browser.get(PAGE).text
    answer = linking(eva)
    assert answer.status_code == 409 and "This identity belongs to another account" in answer.text
    fresh = app.test_client()
    assert enter(fresh).status_code == 303
    assert 'value="owner"' in fresh.get("/account").text
    assert eva.post(f"{PAGE}/1/unlink").status_code == 403
    assert browser.post(f"{PAGE}/1/unlink").status_code == 400, "there is no password to sign in with"


def test_a_link_ends_with_the_account_that_began_it(app_with, provider, owner, new_account):
    app = app_with()
    browser = client_of(app, owner)
    page = browser.post("/oidc/link")
    back = there(re.search(r'content="0; url=([^"]+)"', page.text)[1].replace("&amp;", "&"))
    eve = new_account("Eve")
    with browser.session_transaction() as session:
        session["_user_id"] = f"{eve.id}.{eve.epoch}"
    answer = browser.get(back)
    assert answer.status_code == 401 and "Another account is signed in by now" in answer.text


def test_where_the_provider_is_required_others_are_refused(app_with, library, owner, new_account):
    app, eva = app_with(required="yes", accounts="everybody"), new_account("Eva")
    with library.database.write() as session:
        for account in (owner, eva):
            account = session.get_one(Account, account.id)
            account.password_hash = sign_in.password_hash(PASSWORD, minimum=10)
        links = [sign_in.new_link(session, account, hours=1) for account in (owner, eva)]
    browser = app.test_client()
    shown = browser.get("/sign-in").text
    assert 'name="password"' not in shown and "Sign in with Ranger ID" in shown
    for name in ("owner", "Eva"):
        answer = browser.post("/sign-in", data={"name": name, "password": PASSWORD})
        assert answer.status_code == 403 and "This server accepts no passwords" in answer.text
    assert browser.get(f"/sign-in/{links[1]}").status_code == 403
    assert browser.post(f"/sign-in/{links[1]}").status_code == 403
    assert browser.get("/account").status_code == 302
    assert browser.post(f"/sign-in/{links[0]}").status_code == 303, "the rescue of owners"
    assert 'name="current"' not in browser.get("/account").text
    assert browser.post("/account/password", data={"password": PASSWORD}).status_code == 403
    assert browser.post("/people", data={"name": "Petr"}).status_code == 403
    assert browser.post("/people/2/link").status_code == 403
    assert browser.post("/api/v1/accounts", json={"name": "Petr"}).status_code == 403
    assert browser.post("/api/v1/accounts/2/link").status_code == 403
    other = app.test_client()
    assert enter(other).status_code == 303


def test_the_command_checks_the_provider(provider, monkeypatch, tmp_path, capsys):
    def run(*words):
        with pytest.raises(SystemExit) as ended:
            program.main(list(words))
        out, err = capsys.readouterr()
        return ended.value.code, out, err

    monkeypatch.chdir(tmp_path)
    code, _out, err = run("connect", "oidc")
    assert code != 0 and "no provider is set" in err
    monkeypatch.setenv("EXPMAP_OIDC_ISSUER", provider.issuer)
    monkeypatch.setenv("EXPMAP_OIDC_CLIENT_ID", "maps")
    monkeypatch.setenv("EXPMAP_OIDC_CLIENT_SECRET", "hidden")
    code, out, err = run("connect", "oidc", "--site", "https://maps.example.org/")
    assert (code, err) == (0, "")
    assert "redirect address\thttps://maps.example.org/oidc/callback" in out
    assert "signs people out\tyes" in out
    assert "hidden" not in out + run("settings")[1]
