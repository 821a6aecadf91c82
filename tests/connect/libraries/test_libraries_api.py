"""Photo libraries by JSON: connected, linked, updated, written back, only by those who may."""

import pytest

from tests.connect.libraries.conftest import Linked, at

API = "/api/v1/account/libraries"


@pytest.fixture
def ask(client):
    """Send a request, and return the JSON of its answer."""

    def send(method, path="", *, status=200, by=client, **data):
        answer = by.open(f"{API}{path}", method=method, json=data or None)
        assert answer.status_code == status, answer.text
        return answer.json if answer.data else None

    return send


@pytest.fixture
def made(ask, server):
    """The id of a connected photo library."""
    data = {"kind": server.kind, "address": server.url, "key": server.key}
    return ask("POST", status=201, **data)["id"]


@pytest.fixture
def album(ask, made, server, park, client, library, settings):
    """An album that is on a map; the first update has been done."""
    (there,) = ask("GET", f"/{made}/albums")["albums"]
    assert (there["name"], there["items"]) == ("Round", 3)
    wish = {"album": there["id"], "map": park, "every_h": 24, "writes_back": True}
    linked = ask("POST", f"/{made}/albums", status=201, **wish)
    assert (linked["map"], linked["photos"], linked["updated_at"]) == (park, 0, None)
    found = Linked(client, library, settings, park)
    found.work()
    return found


def test_an_album_is_brought_shown_and_written_back(ask, album, server):
    shown = ask("GET", "/albums/1")
    assert (shown["photos"], shown["kept"], shown["unusable"], shown["error"]) == (3, 0, 0, None)
    assert shown["updated_at"] and ask("GET")["linked"] == [shown]
    photos = {one["asset"]: one for one in ask("GET", "/albums/1/photos")["photos"]}
    assert (photos["a"]["lat"], photos["b"]["lat"]) == (pytest.approx(at(100, 200)[0]), None)
    assert {one["photo"] for one in photos.values()} == {photo.id for photo in album.photos().values()}
    album.edit("b", x_px=500.0, y_px=600.0)
    job = ask("POST", "/albums/1/update", status=202)
    assert (job["kind"], job["state"]) == ("photo-library", "queued")
    assert album.work().result["written"] == 1
    photos = {one["asset"]: one for one in ask("GET", "/albums/1/photos")["photos"]}
    assert photos["b"]["written"] and photos["b"]["lon"] == pytest.approx(at(500, 600)[1])
    assert [id for id, *_ in server.written] == ["b"]


def test_it_is_changed_and_removed(ask, album):
    changed = ask("PATCH", "/albums/1", writes_back=False)
    assert (changed["every_h"], changed["writes_back"]) == (24, False)
    assert ask("PATCH", "/albums/1", every_h=0)["due_at"] is None
    assert "every_h" in str(ask("PATCH", "/albums/1", status=422, every_h=5)["error"])
    assert ask("DELETE", "/albums/1", status=204) is None
    assert len(album.client.get(f"/api/v1/maps/{album.slug}").json["photos"]) == 3
    ask("DELETE", "/1", status=204)
    assert ask("GET") == {"libraries": [], "linked": []}


def test_the_key_is_never_in_an_answer(ask, made, server):
    assert server.key not in str(ask("GET"))
    assert "sealed" not in str(ask("GET"))


def test_only_the_own_account_and_editors_of_the_map(
    ask, album, server, new_account, sign_in, client, stranger
):
    eva = new_account("Eva")
    browser = sign_in(eva)
    for method, path, data in (
        ("GET", "/1/albums", {}),
        ("POST", "/1/albums", {"album": "x", "map": album.slug}),
        ("DELETE", "/1", {}),
        ("GET", "/albums/1", {}),
        ("GET", "/albums/1/photos", {}),
        ("PATCH", "/albums/1", {"every_h": 0}),
        ("POST", "/albums/1/update", {}),
        ("DELETE", "/albums/1", {}),
    ):
        ask(method, path, status=404, by=browser, **data)
        ask(method, path, status=401, by=stranger, **data)
    data = {"kind": server.kind, "address": server.url, "key": server.key}
    own = ask("POST", status=201, by=browser, **data)["id"]
    wish = {"album": next(iter(server.albums)), "map": album.slug}
    ask("POST", f"/{own}/albums", status=404, by=browser, **wish)
    people = f"/api/v1/maps/{album.slug}/members"
    assert client.post(people, json={"name": "Eva", "role": "viewer"}).status_code == 200
    assert "editor" in ask("POST", f"/{own}/albums", status=403, by=browser, **wish)["error"]["message"]


def test_what_is_wrong_is_named(ask, made, server, park):
    data = {"kind": server.kind, "address": server.url, "key": "wrong"}
    assert "refuses the API key (401)" in ask("POST", status=422, **data)["error"]["message"]
    ask("POST", status=422, **{**data, "kind": "other"})
    ask("POST", status=400, **{**data, "address": "photos"})
    wish = {"album": next(iter(server.albums)), "map": park}
    ask("POST", f"/{made}/albums", status=404, **{**wish, "album": "none"})
    ask("POST", f"/{made}/albums", status=404, **{**wish, "map": "none"})
    ask("POST", f"/{made}/albums", status=422, **wish, every_h=5)
    ask("POST", f"/{made}/albums", status=201, **wish)
    assert "already" in ask("POST", f"/{made}/albums", status=409, **wish)["error"]["message"]
    server.failing[server.ALBUMS] = [(500, {})] * 9
    assert ask("GET", f"/{made}/albums", status=422)["error"]["message"]
