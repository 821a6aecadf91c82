"""Maps and edits through the API: responses, errors, and updated files."""

import pytest
from sqlalchemy import event

from webapp.store.accounts import accounts
from webapp.store.maps import edits, maps
from webapp.store.schema import MapRecord, Photo
from webapp.tasks.maps import delete_map
from webapp.tasks.maps.export import export_late_maps

API = "/api/v1/maps"


@pytest.fixture
def ben(library):
    with library.database.write() as session:
        return accounts.create(session, "ben")


@pytest.fixture
def park(library, owner, ben, new_map):
    """A map with an image and three photos, shared with ben."""
    slug = new_map(owner, shared={ben: "editor"})
    folder = library.map_folder(slug)
    folder.mkdir()
    (folder / "plan.png").write_bytes(b"only named here")
    with library.database.write() as session:
        record = maps.find(session, slug, account=owner)
        for n in range(3):
            known = {"size_bytes": 1, "width": 4, "height": 3, "gps_lat": 50.0, "gps_lon": 14.0}
            photo = Photo(name=f"{n}.jpg", path=f"photos/{n}.jpg", sha256=str(n), **known)
            maps.add_photo(session, record, row=photo)
        image = {"satellite_path": "plan.png", "satellite_width": 100, "satellite_height": 80}
        edits.apply(session, record, changes={"map": image}, kind="satellite", account_id=None)
    return slug


def state(client, slug):
    return client.get(f"{API}/{slug}").json


def edit(client, slug, *changes, **more):
    return client.patch(f"{API}/{slug}/experiences", json={"kind": "place", "changes": changes, **more})


def test_make_rename_bin_and_restore(client):
    made = client.post(API, json={"name": "  Petřín  hill "})
    assert (made.status_code, made.json["slug"], made.json["name"]) == (201, "petrin-hill", "Petřín hill")
    assert client.post(API, json={"name": "Petrin hill"}).json["slug"] == "petrin-hill-2"
    assert client.patch(f"{API}/petrin-hill", json={"name": "Hill"}).json["name"] == "Hill"
    assert client.delete(f"{API}/petrin-hill").json["binned"] is True
    assert [m["slug"] for m in client.get(API).json["maps"]] == ["petrin-hill-2"]
    assert [m["slug"] for m in client.get(f"{API}?bin=1").json["maps"]] == ["petrin-hill"]
    assert client.get(f"{API}/petrin-hill/changes").status_code == 404
    client.post(f"{API}/petrin-hill/restore")
    assert len(client.get(API).json["maps"]) == 2


@pytest.mark.parametrize("address", [API, "/", "/bin", "/api/v1/jobs"])
@pytest.mark.parametrize("role", ["owner", "viewer"])
def test_many_maps_are_listed_with_as_many_statements_as_few(
    library, owner, new_account, new_map, sign_in, address, role
):
    eve = new_account("eve")
    browser = sign_in(owner if role == "owner" else eve)
    asked = []

    def note(_connection, _cursor, statement, *_rest):
        asked.append(statement)

    def statements(count):
        for _ in range(count):
            slug = new_map(owner, shared={eve: "viewer"})
            if address == "/bin":
                sign_in(owner).delete(f"{API}/{slug}")
        asked.clear()
        event.listen(library.database.engine, "before_cursor_execute", note)
        try:
            assert browser.get(address).status_code == 200
        finally:
            event.remove(library.database.engine, "before_cursor_execute", note)
        return len(asked)

    statements(1)  # statements that are only needed once, such as for the session
    assert statements(1) == statements(4)


def test_the_list_says_of_each_map_how_many_photos_it_has_and_who_one_is(
    library, owner, new_account, new_map, sign_in, park
):
    eve = new_account("eve")
    new_map(owner, name="Yard", shared={eve: "editor"})
    edit(sign_in(owner), park, {"id": 1, "x_px": 1.0, "y_px": 2.0})
    entries = {one["slug"]: one for one in sign_in(owner).get(API).json["maps"]}
    assert {slug: (one["role"], one["photos"]) for slug, one in entries.items()} == {
        "park": ("owner", 3),
        "yard": ("owner", 0),
    }
    assert entries["park"]["placed"] == 1
    assert [(one["slug"], one["role"]) for one in sign_in(eve).get(API).json["maps"]] == [("yard", "editor")]


@pytest.mark.parametrize("name", ["Où ? 👨\u200d👩\u200d👧", "Où\u202f? \u00a0👨\u200d👩\u200d👧"])
def test_names_have_joined_emoji_and_any_space(client, name):
    assert client.post(API, json={"name": name}).json["name"] == "Où ? 👨\u200d👩\u200d👧"
    mission = client.post("/api/v1/missions", json={"name": name, "note": "«\u00a0Ici\u202f!\u00a0»\n"})
    assert mission.status_code == 201 and mission.json["name"] == "Où ? 👨\u200d👩\u200d👧"


def test_a_map_is_made_while_another_request_deletes_what_was_computed_for_none(client, library, monkeypatch):
    gone = library.map_folder("park") / "derived"
    gone.mkdir(parents=True)
    look, begun = delete_map._is_alone, []

    def look_with_another(folder):
        begun.append(folder)
        if len(begun) == 1:
            assert client.post(API, json={"name": "Park"}).json["slug"] == "park"
        return look(folder)

    monkeypatch.setattr(delete_map, "_is_alone", look_with_another)
    assert client.post(API, json={"name": "Park"}).json["slug"] == "park-2"


@pytest.mark.parametrize("name", ["", "   ", "x" * 121, "a\u0000b", "\u200b", None, 7])
def test_a_name_that_is_none_is_refused(client, name):
    answer = client.post(API, json={"name": name})
    assert answer.status_code in (400, 422)
    assert answer.json["error"].keys() == {"code", "message", "hint", "where"}
    assert client.get(API).json["maps"] == []


def test_the_state_of_a_map(client, park):
    result = state(client, park)
    assert (result["slug"], result["can_edit"], result["role"], result["revision"]) == (
        "park",
        True,
        "owner",
        4,
    )
    assert result["satellite"].items() >= {"width": 100, "height": 80, "tiles": None}.items()
    assert [p["id"] for p in result["photos"]] == [0, 1, 2]
    assert result["photos"][0]["gps"] == {
        "lat": 50.0, "lon": 14.0, "accuracy_m": None, "x_px": None, "y_px": None, "radius_px": None,
    }  # fmt: skip
    assert (result["georeference"], result["undo"], result["redo"], result["placements"]) == (
        None,
        None,
        None,
        [],
    )


def test_place_turn_undo_and_redo(client, library, park):
    answer = edit(client, park, {"id": 1, "x_px": 10.5, "y_px": 20}, {"id": 2, "x_px": 3, "y_px": 4})
    assert answer.status_code == 200
    assert [(p["id"], p["x_px"]) for p in answer.json["photos"]] == [(1, 10.5), (2, 3.0)]
    assert answer.json["undo"] == {"kind": "place", "count": 2}
    export_late_maps(library)
    assert library.cfg(park).read_text() == "plan.png;100;80\n1;photos/1.jpg;11;20\n2;photos/2.jpg;3;4\n"
    edit(client, park, {"id": 1, "heading_deg": -90.0}, kind="turn")
    assert state(client, park)["photos"][1]["heading_deg"] == 270.0
    client.post(f"{API}/{park}/undo")
    undone = client.post(f"{API}/{park}/undo").json
    assert [(p["id"], p["x_px"]) for p in undone["photos"]] == [(1, None), (2, None)]
    export_late_maps(library)
    assert library.cfg(park).read_text() == "plan.png;100;80\n"
    assert client.post(f"{API}/{park}/undo").status_code == 409
    assert client.post(f"{API}/{park}/redo").json["redo"] == {"kind": "turn", "count": 1}


def test_two_tabs_do_not_lose_each_others_work(client, sign_in, ben, park):
    seen = state(client, park)["revision"]
    other = sign_in(ben)
    assert edit(other, park, {"id": 0, "x_px": 1, "y_px": 1}, seen=seen).status_code == 200
    late = edit(client, park, {"id": 0, "x_px": 9, "y_px": 9}, {"id": 1, "x_px": 9, "y_px": 9}, seen=seen)
    assert late.status_code == 409
    assert late.json["error"]["message"] == "ben has changed the photo 0.jpg in the meantime"
    one = client.patch(
        f"{API}/{park}/experiences/0", json={"x_px": 9, "y_px": 9}, headers={"If-Match": f'"{seen}"'}
    )
    assert one.status_code == 412
    assert [p["x_px"] for p in state(client, park)["photos"]] == [1.0, None, None]
    assert edit(client, park, {"id": 1, "x_px": 9, "y_px": 9}, seen=seen).status_code == 200


def test_changes_are_only_what_is_new(client, sign_in, ben, park):
    since = state(client, park)["revision"]
    assert client.get(f"{API}/{park}/changes?since={since}").json["photos"] == []
    edit(sign_in(ben), park, {"id": 2, "x_px": 1, "y_px": 1})
    client.delete(f"{API}/{park}/experiences/0")
    result = client.get(f"{API}/{park}/changes?since={since}").json
    assert [(p["id"], p.get("removed", False)) for p in result["photos"]] == [(2, False), (0, True)]
    assert "satellite" not in result
    assert result["undo"] == {"kind": "remove", "count": 1}
    assert "satellite" in client.get(f"{API}/{park}/changes?since=0").json


def test_times_are_corrected_and_undone(client, park):
    taken = "2026-05-31T14:05:00"
    assert edit(client, park, {"id": 0, "taken_at": taken}, kind="retime").status_code == 200
    first, second, _ = state(client, park)["photos"]
    assert (first["taken_at"], second["taken_at"]) == (taken, None)
    assert state(client, park)["undo"] == {"kind": "retime", "count": 1}
    assert client.post(f"{API}/{park}/undo").status_code == 200
    assert state(client, park)["photos"][0]["taken_at"] is None
    answer = edit(client, park, {"id": 0, "taken_at": "half past"}, kind="retime")
    assert answer.status_code == 400 and answer.json["error"]["message"] == "taken_at is not a time"


def test_removed_photos_come_back_by_undo(client, park):
    edit(client, park, {"id": 0, "x_px": 5, "y_px": 6})
    assert client.delete(f"{API}/{park}/experiences", json={"ids": [0, 1]}).status_code == 200
    assert [p["id"] for p in state(client, park)["photos"]] == [2]
    assert edit(client, park, {"id": 0, "x_px": 1, "y_px": 1}).status_code == 404
    client.post(f"{API}/{park}/undo")
    assert [(p["id"], p["x_px"]) for p in state(client, park)["photos"]] == [(0, 5.0), (1, None), (2, None)]


def test_further_placements(client, library, park):
    edit(client, park, {"id": 0, "x_px": 5, "y_px": 6})
    edit(client, park, {"id": 0, "x_px": 50, "y_px": 60}, placement="clusters")
    assert state(client, park)["placements"] == [{"name": "clusters", "positions": {"0": [50.0, 60.0]}}]
    export_late_maps(library)
    assert (
        library.map_folder(park) / "clusters.cfg"
    ).read_text() == "plan.png;100;80\n0;photos/0.jpg;50;60\n"
    assert edit(client, park, {"id": 0, "x_px": 1, "y_px": 1}, placement="../evil").status_code == 422


@pytest.mark.parametrize(
    ("change", "more"),
    [
        ({"id": 0, "x_px": 101, "y_px": 5}, {}),
        ({"id": 0, "x_px": -0.1, "y_px": 5}, {}),
        ({"id": 0, "x_px": 5}, {}),
        ({"id": 0, "x_px": None, "y_px": 5}, {}),
        ({"id": 0, "x_px": "NaN", "y_px": 5}, {}),
        ({"id": 0, "heading_deg": "Infinity"}, {}),
        ({"id": 0, "x_px": "left", "y_px": 5}, {}),
        ({"id": "../0", "x_px": 5, "y_px": 5}, {}),
        ({"id": 0, "x_px": 5, "y_px": 5}, {"kind": "satellite"}),
        ({"id": 0, "x_px": 5, "y_px": 5}, {"seen": "yesterday"}),
        ({"id": 99, "x_px": 5, "y_px": 5}, {}),
        ({"id": 10**30, "x_px": 5, "y_px": 5}, {}),
    ],
)
def test_bad_edits_are_refused_and_change_nothing(client, park, change, more):
    answer = edit(client, park, {"id": 1, "x_px": 5, "y_px": 5}, change, **more)
    assert 400 <= answer.status_code < 500
    assert answer.json["error"]["message"]
    assert state(client, park)["revision"] == 4


def test_without_an_image_nothing_can_be_placed(client, library, owner):
    slug = client.post(API, json={"name": "Empty"}).json["slug"]
    with library.database.write() as session:
        record = maps.find(session, slug, account=owner)
        known = {"size_bytes": 1, "width": 4, "height": 3}
        maps.add_photo(session, record, row=Photo(name="a", path="photos/a.jpg", sha256="a", **known))
    answer = edit(client, slug, {"id": 0, "x_px": 5, "y_px": 5})
    assert answer.status_code == 400
    assert "no satellite image" in answer.json["error"]["message"]


def test_a_viewer_sees_and_changes_nothing(library, sign_in, owner, new_map, ben):
    slug = new_map(owner, name="Shared", shared={ben: "viewer"})
    client = sign_in(ben)
    assert state(client, slug)["can_edit"] is False
    for answer in (
        client.post(f"{API}/{slug}/undo"),
        client.patch(f"{API}/{slug}", json={"name": "Mine"}),
        client.delete(f"{API}/{slug}"),
        client.delete(f"{API}/{slug}/experiences", json={"ids": [0]}),
    ):
        assert answer.status_code == 403
    with library.database.read() as session:
        assert session.get(MapRecord, 1).binned_at is None


def test_a_stranger_learns_nothing(stranger, sign_in, library, park):
    assert stranger.get(f"{API}/{park}").status_code == 401
    with library.database.write() as session:
        eve = accounts.create(session, "eve")
    result = [sign_in(eve).get(f"{API}/{slug}").json["error"]["message"] for slug in (park, "no-such-map")]
    assert result[0] == result[1]


@pytest.mark.parametrize("token", [False, True])
def test_json_that_no_edit_needs_is_refused_before_it_is_read(client, stranger, library, owner, token):
    headers = {}
    if token:
        with library.database.write() as session:
            headers = {"Authorization": f"Bearer {accounts.new_token(session, owner, name='robot')}"}
    body = b'{"name": "' + 17_000_000 * b" " + b'park"}'
    answer = (stranger if token else client).post(
        API, data=body, content_type="application/json", headers=headers
    )
    assert answer.status_code == 413


def test_a_question_for_changes_asks_for_the_map_once_and_an_edit_for_its_photo(client, park, library):
    revision = state(client, park)["revision"]
    asked = []
    event.listen(library.database.engine, "before_cursor_execute", lambda *args: asked.append(args[2]))
    assert client.get(f"{API}/{park}/changes?since={revision}").status_code == 200
    assert sum("FROM map " in " ".join(sent.split()) for sent in asked) == 1
    asked.clear()
    assert edit(client, park, {"id": 1, "x_px": 5.0, "y_px": 6.0}).status_code == 200
    before = asked[: next(n for n, sent in enumerate(asked) if sent.startswith("UPDATE photo"))]
    assert sum("FROM photo " in " ".join(sent.split()) for sent in before) == 1


@pytest.mark.parametrize("kind", ["remove", "move"])
def test_a_change_without_a_field_is_refused(client, park, kind):
    answer = client.patch(f"{API}/{park}/experiences", json={"kind": kind, "changes": [{"id": 0}]})
    assert answer.status_code == 400 and answer.json["error"]["where"] == "photo/0"
    assert "DELETE" in answer.json["error"]["hint"]
    assert client.patch(f"{API}/{park}/experiences/0", json={}).status_code == 400
