"""The list of missions: paginated, with a number of statements independent of its length."""

import pytest
from sqlalchemy import event

from webapp.missions.store import missions
from webapp.missions.store.schema import Mission
from webapp.store.schema import Account


@pytest.fixture
def ask(client):
    """Request a page; return the names on it, and the cursor of the next one."""

    def get(browser=client, **query):
        answer = browser.get("/api/v1/missions", query_string=query)
        assert answer.status_code == 200, answer.json
        return [mission["name"] for mission in answer.json["missions"]], answer.json["next"]

    return get


@pytest.fixture
def statements(library):
    """The statements that are executed."""
    seen = []

    def note(_connection, _cursor, statement, *_rest):
        seen.append(statement)

    event.listen(library.database.engine, "before_cursor_execute", note)
    yield seen
    event.remove(library.database.engine, "before_cursor_execute", note)


@pytest.mark.parametrize("whose", ["owner", "viewer"])
def test_twenty_take_as_many_statements_as_one(
    new_mission, new_map, new_account, sign_in, owner, send, walk, statements, ask, whose
):
    ann = new_account("ann")
    browser = sign_in({"owner": owner, "viewer": ann}[whose])

    def counted(**query):
        statements.clear()
        names, _ = ask(browser, **query)
        return len(names), len(statements)

    def add():
        slug = new_map(owner, shared={ann: "viewer"})
        id = new_mission(map=slug)
        send([*walk(3), *walk(2, source="odometry", track="o")], id=id)

    add()
    few, before = counted()
    for _ in range(19):
        add()
    assert counted() == (few + 19, before)
    assert counted(limit=10) == (10, before)


def test_each_page_has_its_content(client, new_mission, new_map, new_account, sign_in, owner, send, walk):
    ann = new_account("ann")
    park, wood = (
        new_map(owner, name=name, shared={ann: role}) for name, role in (("A", "viewer"), ("B", "editor"))
    )
    first, second, own = new_mission(map=park), new_mission(map=wood), new_mission(sign_in(ann))
    new_mission()  # of another owner
    send(walk(3), id=first)
    send(
        [*walk(5), {"type": "object", "id": "a", "class": "car", "time": 1.0, "lat": 50, "lon": 14}],
        id=second,
    )
    browser = sign_in(ann)
    result = {m["id"]: m for m in browser.get("/api/v1/missions").json["missions"]}
    facts = {id: (m["map"], m["role"], m["can_edit"], m["poses"], m["objects"]) for id, m in result.items()}
    assert facts == {
        first: (park, "viewer", False, 3, 0),
        second: (wood, "editor", True, 5, 1),
        own: (None, "owner", True, 0, 0),
    }
    for id, mission in result.items():
        alone = browser.get(f"/api/v1/missions/{id}").json
        mission.pop("preview")  # only in the list
        assert {key: alone[key] for key in mission} == mission


@pytest.mark.parametrize("limit", [1, 2, 3, 7, 8])
def test_pages_are_the_list(new_mission, ask, limit):
    for number in range(7):
        new_mission(name=str(number))
    whole, nothing = ask()
    assert (whole, nothing) == (list("6543210"), None)
    names, after = ask(limit=limit)
    while after is not None:
        more, after = ask(limit=limit, after=after)
        assert 0 < len(more) <= limit
        names += more
    assert names == whole


def test_missions_that_changed_at_one_moment_are_all_listed(library, new_mission, ask):
    ids = [new_mission(name=str(number)) for number in range(4)]
    with library.database.write() as session:
        moment = session.get_one(Mission, ids[0]).changed_at
        for id in ids:
            session.get_one(Mission, id).changed_at = moment
    names, after = ask(limit=3)
    assert (names, ask(limit=3, after=after)) == (["3", "2", "1"], (["0"], None))


def test_a_mission_that_changes_meanwhile_is_not_listed_twice(new_mission, ask, send, walk):
    ids = [new_mission(name=str(number)) for number in range(4)]
    names, after = ask(limit=2)
    send(walk(1), id=ids[2])  # the last one on the page
    assert (names, ask(limit=2, after=after)[0]) == (["3", "2"], ["1", "0"])


def test_a_mission_that_changes_between_two_statements_keeps_its_tracks(library, new_mission, send, walk):
    """As in a database in which each statement sees what was committed before it."""
    ids = [new_mission(name=str(number)) for number in range(3)]
    for id in ids:
        send(walk(3), id=id)

    def batch(connection, _cursor, statement, *_rest):
        if "FROM track" in statement:
            latest = "UPDATE mission SET changed_at = '2100-01-01 00:00:00.000000' WHERE id = ?"
            connection.exec_driver_sql(latest, (ids[0],))

    event.listen(library.database.engine, "before_cursor_execute", batch)
    try:
        with library.database.write() as session:
            account = session.query(Account).filter_by(is_owner=True).one()
            page = missions.list_missions(session, account, part=missions.MissionListPart(limit=2))
    finally:
        event.remove(library.database.engine, "before_cursor_execute", batch)
    assert [(entry.mission.id, entry.poses) for entry in page] == [(ids[2], 3), (ids[1], 3)]


def test_tracks_of_more_missions_than_a_statement_takes_values(new_mission, send, walk, client, monkeypatch):
    monkeypatch.setattr(missions, "_MOST_PARAMETERS", 2)
    for number in range(5):
        send(walk(number + 1), id=new_mission(name=str(number)))
    assert [m["poses"] for m in client.get("/api/v1/missions").json["missions"]][:5] == [5, 4, 3, 2, 1]


def test_pages_of_the_bin_and_of_a_map(client, new_mission, new_map, owner, ask):
    slug = new_map(owner)
    for number in range(3):
        new_mission(name=f"on {number}", map=slug)
        client.delete(f"/api/v1/missions/{new_mission(name=f'gone {number}')}")
    for query, kind in (({"map": slug}, "on"), ({"bin": True}, "gone")):
        names, after = ask(limit=2, **query)
        names += ask(limit=2, after=after, **query)[0]
        assert sorted(names) == [f"{kind} {number}" for number in range(3)]


@pytest.mark.parametrize(
    "query",
    [
        {"limit": 0},
        {"limit": 10_001},
        {"after": "x"},
        {"after": "1.2.3"},
        {"after": "9" * 18 + ".1"},
        {"after": "12.3\n"},
    ],
)
def test_pages_that_do_not_exist(client, query):
    assert client.get("/api/v1/missions", query_string=query).status_code == 422


def test_after_any_place_that_can_be_written(ask):
    for after in ("0.0", "9" * 17 + f".{2**31 - 1}"):
        assert ask(after=after) == ([], None)


def test_a_search_finds_names_of_missions_and_of_maps_page_by_page(client, owner, new_map, ask):
    slug = new_map(owner, name="Žižkov")
    for number in range(3):
        client.post("/api/v1/missions", json={"name": f"Élan {number}"})
    client.post("/api/v1/missions", json={"name": "Round", "map": slug})
    assert ask(search="ÉLAN 1") == (["Élan 1"], None)
    assert ask(search="elan") == (["Élan 2", "Élan 1", "Élan 0"], None)
    assert ask(search=" zizkov ") == (["Round"], None)
    assert ask(search="100%") == ask(search="_") == ([], None)
    first, follow = ask(search="elan", limit=2)
    assert (first, ask(search="elan", limit=2, after=follow)) == (["Élan 2", "Élan 1"], (["Élan 0"], None))


def test_a_search_shows_only_what_one_may_see(client, sign_in, new_account, ask):
    client.post("/api/v1/missions", json={"name": "Élan"})
    assert ask(sign_in(new_account("eve")), search="elan") == ([], None)


def test_a_search_that_finds_very_many_gives_all_of_them_in_order(client, ask, monkeypatch):
    monkeypatch.setattr(missions, "_MOST_PARAMETERS", 2)
    for number in range(5):
        client.post("/api/v1/missions", json={"name": f"Élan {number}"})
    assert ask(search="elan")[0] == [f"Élan {number}" for number in reversed(range(5))]
