"""Accounts, tokens and members through the API, like with the forms of the pages."""

import pytest

from webapp.errors import DatabaseUnavailable
from webapp.store.maps import maps

API = "/api/v1"


@pytest.fixture
def bearer(app):
    """Send a request with a token and without cookies."""

    def ask(token, method, path, **options):
        headers = {"Authorization": f"Bearer {token}"}
        return app.test_client().open(f"{API}{path}", method=method, headers=headers, **options)

    return ask


def test_a_token_is_made_used_listed_and_revoked(client, bearer):
    made = client.post(f"{API}/account/tokens", json={"name": "robot"})
    assert made.status_code == 201
    token, id = made.json["token"], made.json["id"]
    assert bearer(token, "GET", "/account").json["name"] == "owner"
    (listed,) = client.get(f"{API}/account/tokens").json["tokens"]
    assert (listed["id"], listed["name"], "token" in listed) == (id, "robot", False)
    assert listed["used_at"] is not None
    assert client.post(f"{API}/account/tokens", json={"name": "robot"}).status_code == 409
    assert bearer(token, "DELETE", f"/account/tokens/{id}").status_code == 204
    assert bearer(token, "GET", "/account").status_code == 401
    assert client.get(f"{API}/account/tokens").json["tokens"] == []


def test_nobody_revokes_the_token_of_another(client, sign_in, new_account):
    id = client.post(f"{API}/account/tokens", json={"name": "robot"}).json["id"]
    other = sign_in(new_account("eve"))
    assert other.delete(f"{API}/account/tokens/{id}").status_code == 404
    assert other.get(f"{API}/account/tokens").json["tokens"] == []
    assert len(client.get(f"{API}/account/tokens").json["tokens"]) == 1


def test_name_and_language_are_changed_one_by_one(sign_in, new_account):
    new_account("eve")
    client = sign_in(new_account("ana"))
    assert client.patch(f"{API}/account", json={"name": "Anna"}).json["name"] == "Anna"
    assert client.patch(f"{API}/account", json={"language": "cs"}).json["language"] == "cs"
    shown = client.get(f"{API}/account").json
    assert (shown["name"], shown["language"], shown["is_owner"], shown["has_password"]) == (
        "Anna",
        "cs",
        False,
        False,
    )
    assert client.patch(f"{API}/account", json={"language": None}).json["language"] is None
    assert client.patch(f"{API}/account", json={"name": "Eve"}).status_code == 409
    assert client.patch(f"{API}/account", json={"language": "xx"}).status_code == 422
    assert client.get(f"{API}/account").json["name"] == "Anna"


def test_the_owner_gives_accounts_and_takes_them(client, app):
    made = client.post(f"{API}/accounts", json={"name": "ana"})
    assert made.status_code == 201
    person = app.test_client()
    assert person.post(made.json["url"]).status_code == 303
    assert person.get(f"{API}/account").json["id"] == made.json["account"]
    again = client.post(f"{API}/accounts/{made.json['account']}/link")
    assert (again.status_code, again.json["url"] != made.json["url"]) == (201, True)
    assert [one["name"] for one in client.get(f"{API}/accounts").json["accounts"]] == ["ana", "owner"]
    assert client.delete(f"{API}/accounts/{made.json['account']}").status_code == 204
    assert person.get(f"{API}/account").status_code == 401
    assert client.delete(f"{API}/accounts/{made.json['account']}").status_code == 404


def test_a_library_keeps_an_owner(client, owner):
    assert client.delete(f"{API}/accounts/{owner.id}").status_code == 400
    assert client.get(f"{API}/account").status_code == 200


@pytest.mark.parametrize(
    ("method", "path"),
    [("GET", ""), ("POST", ""), ("POST", "/1/link"), ("DELETE", "/1")],
)
def test_accounts_are_for_the_owner_of_the_library(client, sign_in, new_account, method, path):
    other = sign_in(new_account("eve"))
    assert other.open(f"{API}/accounts{path}", method=method, json={"name": "x"}).status_code == 403
    assert [one["name"] for one in client.get(f"{API}/accounts").json["accounts"]] == ["eve", "owner"]


@pytest.fixture
def people(new_account):
    """Three accounts by their role."""
    return {role: new_account(role.title()) for role in ("owner", "editor", "viewer")}


@pytest.fixture
def members(people, new_map):
    """The address of the members of a map that they share."""
    others = {people[role]: role for role in ("editor", "viewer")}
    return f"{API}/maps/{new_map(people['owner'], name='Shared', shared=others)}/members"


def roles(client, members):
    return {one["name"]: one["role"] for one in client.get(members).json["members"]}


def test_a_map_is_shared_and_taken_back(people, members, sign_in, new_account):
    client, eve = sign_in(people["owner"]), new_account("Eve")
    given = client.post(members, json={"name": "eve", "role": "viewer"})
    assert (given.status_code, given.json) == (200, {"account": eve.id, "name": "Eve", "role": "viewer"})
    assert client.post(members, json={"name": "Eve", "role": "editor"}).json["role"] == "editor"
    assert roles(sign_in(eve), members)["Eve"] == "editor"
    assert client.delete(f"{members}/{eve.id}").status_code == 204
    assert sign_in(eve).get(members).status_code == 404


@pytest.mark.parametrize(
    ("wish", "status"),
    [
        ({"name": "nobody", "role": "viewer"}, 404),
        ({"name": "Viewer", "role": "king"}, 422),
        ({"name": "Viewer"}, 422),
        ({"name": "Owner", "role": "viewer"}, 400),
    ],
)
def test_what_cannot_be_changes_nothing(people, members, sign_in, wish, status):
    client = sign_in(people["owner"])
    before = roles(client, members)
    assert client.post(members, json=wish).status_code == status
    assert roles(client, members) == before


@pytest.mark.parametrize("role", ["editor", "viewer"])
def test_only_owners_share(people, members, sign_in, role):
    client = sign_in(people[role])
    before = roles(client, members)
    assert set(before.values()) == set(maps.ROLES)
    assert client.post(members, json={"name": role, "role": "owner"}).status_code == 403
    assert client.delete(f"{members}/{people['owner'].id}").status_code == 403
    assert roles(client, members) == before
    assert client.delete(f"{members}/{people[role].id}").status_code == 204, "everybody may leave"
    assert client.get(members).status_code == 404


def test_a_token_is_good_for_reading_while_nothing_can_be_written(client, bearer, library, monkeypatch):
    def read_only(**_):
        raise DatabaseUnavailable("the database is read-only", wait_s=2)

    token = client.post(f"{API}/account/tokens", json={"name": "robot"}).json["token"]
    monkeypatch.setattr(library.database, "write", read_only)
    assert bearer(token, "GET", "/account").json["name"] == "owner"
    assert bearer(token, "POST", "/account/tokens", json={"name": "other"}).status_code == 503
