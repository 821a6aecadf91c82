"""Findings with fixes, health, external edits and placements through the API."""

import json

import pytest

from webapp.store.accounts import accounts
from webapp.store.schema import Account, MapRecord
from webapp.tasks.maps import adopt_map


@pytest.fixture
def park(library, owner, make_map):
    """The slug of a map of the owner, with three placed photos."""
    make_map(library.map_folder("park"), 3)
    adopt_map.adopt_map(library, "park", account_id=owner.id)
    return "park"


@pytest.fixture
def viewer(library, sign_in, new_account, park):
    account = new_account("vera")
    with library.database.write() as session:
        record = session.query(MapRecord).one()
        accounts.set_member_role(session, record, account=session.get(Account, account.id), role="viewer")
    return sign_in(account)


def test_a_finding_has_words_on_its_button_and_the_button_works(client, viewer, park, library):
    (library.map_folder(park) / "photos" / "1.jpg").unlink()
    (finding,) = viewer.get(f"/api/v1/maps/{park}/findings").json["findings"]
    assert (finding["code"], finding["severity"], finding["ids"]) == ("missing-photo", "error", [1])
    assert finding["fixes"] == [{"code": "remove", "label": "Remove from the map"}]
    wish = {"code": finding["fixes"][0]["code"], "ids": finding["ids"]}
    assert viewer.post(f"/api/v1/maps/{park}/findings/fix", json=wish).status_code == 403
    answer = client.post(f"/api/v1/maps/{park}/findings/fix", json=wish)
    assert answer.status_code == 200
    assert [photo["id"] for photo in answer.json["photos"] if photo.get("removed")] == [1]
    assert answer.json["undo"] == {"kind": "fix", "count": 1}
    assert client.get(f"/api/v1/maps/{park}/findings").json["findings"] == []
    assert client.post(f"/api/v1/maps/{park}/undo", json={}).status_code == 200
    assert len(client.get(f"/api/v1/maps/{park}/findings").json["findings"]) == 1


@pytest.mark.parametrize(
    "wish", [{"code": "none"}, {"code": "remove", "ids": [99]}, {"code": "swap", "ids": ["x"]}]
)
def test_wrong_fixes_are_refused(client, park, wish):
    assert 400 <= client.post(f"/api/v1/maps/{park}/findings/fix", json=wish).status_code < 500


def test_health_is_asked_for_and_found(client, viewer, park, library):
    empty = client.get(f"/api/v1/maps/{park}/health").json
    assert (empty["revision"], empty["photos"], empty["job"]) == (None, [], None)
    asked = viewer.post(f"/api/v1/maps/{park}/health", json={})
    assert asked.status_code == 202 and asked.json["job"] is not None
    photo = {"id": 0, "state": "lonely", "taken_for": None, "probability": None}
    content = {"version": 1, "revision": 0, "place_radius_px": 40.0, "photos": [photo]}
    (library.map_folder(park) / "derived").mkdir(exist_ok=True)
    (library.map_folder(park) / "derived" / "health.json").write_text(json.dumps(content))
    found = client.get(f"/api/v1/maps/{park}/health").json
    assert found["current"] and found["photos"] == [photo]


@pytest.mark.parametrize(("what", "x"), [("take", 7), ("discard", 100)])
def test_an_edit_from_outside(client, viewer, park, library, what, x):
    assert client.get(f"/api/v1/maps/{park}/outside-edit").json == {"changed": False}
    cfg = library.cfg(park)
    cfg.write_text(cfg.read_text().replace("100;100", "7;8"))
    shown = viewer.get(f"/api/v1/maps/{park}/outside-edit").json
    assert shown["changed"] and shown["moved"][0]["to"] == [7, 8]
    wish = {"sha256": shown["sha256"]}
    assert viewer.post(f"/api/v1/maps/{park}/outside-edit/{what}", json=wish).status_code == 403
    assert (
        client.post(f"/api/v1/maps/{park}/outside-edit/{what}", json={"sha256": "0" * 64}).status_code == 409
    )
    assert client.post(f"/api/v1/maps/{park}/outside-edit/{what}", json=wish).status_code == 200
    assert client.get(f"/api/v1/maps/{park}").json["photos"][0]["x_px"] == x
    assert not client.get(f"/api/v1/maps/{park}/outside-edit").json["changed"]


def test_placements(client, viewer, park, library):
    address = f"/api/v1/maps/{park}/placements/clusters"
    assert viewer.put(address, json={}).status_code == 403
    assert client.put(address, json={"clusters_px": 120}).status_code == 200
    text = b"plan.png;400;200\n0;photos/0.jpg;200;100\n1;photos/1.jpg;200;100\n2;photos/2.jpg;200;100\n"
    assert viewer.get(f"{address}.cfg").data == text
    assert (library.map_folder(park) / "clusters.cfg").read_bytes() == text
    assert client.put(address, json={"positions": {"1": [5, 6]}}).json["placements"][0]["positions"] == {
        "1": [5, 6]
    }
    assert client.delete(address).status_code == 200
    assert client.delete(address).status_code == 404


@pytest.mark.parametrize(
    ("name", "wish"),
    [
        ("map", {}),
        ("a b", {}),
        ("x", {"clusters_px": -1}),
        ("x", {"clusters_px": 1, "positions": {}}),
        ("x", {"positions": {"0": [1]}}),
        ("x", {"positions": {"0": [1, 1e9]}}),
        ("x", {"positions": {"a": [1, 1]}}),
        ("x", {"positions": {"99": [1, 1]}}),
    ],
)
def test_wrong_placements_are_refused(client, park, name, wish):
    answer = client.put(f"/api/v1/maps/{park}/placements/{name}", json=wish)
    assert 400 <= answer.status_code < 500 and answer.json["error"]["message"]


def test_an_edit_cannot_make_a_placement_that_would_replace_the_map(client, park):
    wish = {"placement": "map", "changes": [{"id": 0, "x_px": 1, "y_px": 1}]}
    assert client.patch(f"/api/v1/maps/{park}/experiences", json=wish).status_code == 400
    assert client.get(f"/api/v1/maps/{park}").json["placements"] == []
