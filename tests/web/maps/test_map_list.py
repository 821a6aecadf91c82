"""The paginated list of maps: next page, search, and permissions."""

import re

import pytest

from webapp.store.accounts import accounts
from webapp.store.maps import maps

API = "/api/v1/maps"


@pytest.fixture
def rows(library, owner):
    """Sixty maps; the newest is listed first."""
    names = [f"Žlutá row {number:02}" for number in range(60)]
    with library.database.write() as session:
        for name in names:
            maps.create(session, name, account_id=owner.id)
    return names[::-1]


def names(answer):
    return [one["name"] for one in answer.json["maps"]]


def test_parts_follow_each_other(client, rows):
    found, after = [], ""
    while after is not None:
        answer = client.get(f"{API}?limit=25{after and f'&after={after}'}")
        found += names(answer)
        after = answer.json["next"]
    assert found == rows
    assert names(client.get(API)) == rows
    assert client.get(API).json["next"] is None
    assert client.get(f"{API}?limit=60").json["next"] is None


def test_a_search_knows_neither_case_nor_accents(client, rows):
    first = client.get(f"{API}?search=zluta ROW 1&limit=4")
    assert names(first) == [f"Žlutá row {number}" for number in (19, 18, 17, 16)]
    more = client.get(f"{API}?search=zluta ROW 1&limit=9&after={first.json['next']}")
    assert (names(more), more.json["next"]) == ([f"Žlutá row {number}" for number in range(15, 9, -1)], None)
    assert names(client.get(f"{API}?search=nowhere")) == []


def test_everybody_sees_their_own(client, library, rows, sign_in):
    with library.database.write() as session:
        ben = accounts.create(session, "ben")
        shown = maps.create(session, "Row of Ben", account_id=ben.id)
    assert shown.name in names(client.get(f"{API}?search=row&limit=1"))
    own = sign_in(ben)
    assert names(own.get(f"{API}?search=row")) == names(own.get(f"{API}?limit=5")) == ["Row of Ben"]


@pytest.mark.parametrize("query", ["after=x", "after=1.99999999999", "limit=0", f"search={'x' * 121}"])
def test_a_part_that_cannot_be_is_refused(client, rows, query):
    answer = client.get(f"{API}?{query}")
    assert answer.status_code == 422
    assert answer.json["error"]["where"]
    if not query.startswith("limit"):
        assert client.get(f"/?{query}").status_code == 400


def test_the_page_leads_to_the_next_part(client, rows):
    page = client.get("/").text
    assert re.findall(r'data-name="([^"]+)"', page) == rows[:48]
    (address,) = re.findall(r'id="more"[^>]*href="([^"]+)"', page)
    following = client.get(address).text
    assert re.findall(r'data-name="([^"]+)"', following) == rows[48:]
    assert re.search(r'id="more"[^>]* hidden', following)
    assert re.findall(r'data-name="([^"]+)"', client.get("/?whole=true").text) == rows


def test_the_page_of_a_search(client, rows):
    assert re.findall(r'data-name="([^"]+)"', client.get("/?search=row 07").text) == ["Žlutá row 07"]
    nothing = client.get("/?search=nowhere").text
    assert 'id="list-search"' in nothing and 'data-testid="welcome"' not in nothing


def test_the_bin_comes_in_parts(client, library, rows):
    with library.database.write() as session:
        for name in rows[:50]:
            maps.put_into_bin(session.query(maps.MapRecord).filter_by(name=name).one())
    page = client.get("/bin").text
    assert re.findall(r'data-name="([^"]+)"', page) == rows[:48]
    (address,) = re.findall(r'id="more"[^>]*href="([^"]+)"', page)
    assert address.startswith("/bin?")
    assert re.findall(r'data-name="([^"]+)"', client.get(address).text) == rows[48:50]
