"""How tracks look: set by editors, for all who look, in exports, and back to the usual."""

import json

import pytest

USUAL = {"title": "", "colour": None, "width_px": None, "hidden": False}
LOOK = {"title": "Team 2", "colour": "#d55e00", "width_px": 6.0, "hidden": True}


@pytest.fixture
def track(send, walk, state):
    """The id of a track of three poses."""
    send(walk(3))
    return state()["tracks"][0]["id"]


@pytest.fixture
def change(client, mission, track):
    """Change how the track looks, and return the answer."""

    def patch(given, *, browser=client, id=track):
        return browser.patch(f"/api/v1/missions/{mission}/tracks/{id}", json=given)

    return patch


def test_a_look_is_set_changed_and_reset(change, state):
    assert state()["tracks"][0]["look"] == USUAL
    before = state()["revision"]
    answer = change({**LOOK, "title": "  Team  2 "})
    assert (answer.status_code, answer.json["look"]) == (200, LOOK)
    assert (state()["tracks"][0]["look"], state()["revision"]) == (LOOK, before + 1)
    change({"colour": None, "hidden": False})
    assert state()["tracks"][0]["look"] == {**LOOK, "colour": None, "hidden": False}
    assert change(USUAL).json["look"] == USUAL
    assert change(USUAL).status_code == 200
    assert state()["revision"] == before + 3, "the last one changed nothing"


@pytest.mark.parametrize(
    ("given", "status"),
    [
        ({"title": "a\nb\x07"}, 400),
        ({"title": "x" * 121}, 422),
        ({"title": None}, 422),
        ({"colour": "red"}, 422),
        ({"colour": "#D55E00"}, 422),
        ({"colour": "#d55e00\n"}, 422),
        ({"width_px": 0}, 422),
        ({"width_px": 12.5}, 422),
        ({"width_px": "NaN"}, 422),
        ({"hidden": 3}, 422),
        ({"name": "other"}, 422),
    ],
)
def test_what_is_no_look(change, state, given, status):
    assert change(given).status_code == status
    assert state()["tracks"][0]["look"] == USUAL


def test_only_editors_of_the_mission_change_it(client, mission, change, new_account, new_map, owner, sign_in):
    viewer, editor = new_account("viewer"), new_account("editor")
    slug = new_map(owner, shared={viewer: "viewer", editor: "editor"})
    client.patch(f"/api/v1/missions/{mission}", json={"map": slug})
    browsers = [sign_in(viewer), sign_in(editor), sign_in(new_account("other"))]
    assert [change(LOOK, browser=browser).status_code for browser in browsers] == [403, 200, 404]


def test_a_track_of_another_mission_is_not_found(client, change, new_mission, track):
    other = new_mission()
    answer = client.patch(f"/api/v1/missions/{other}/tracks/{track}", json=LOOK)
    assert (answer.status_code, change(LOOK, id=track + 1).status_code) == (404, 404)


def test_open_pages_receive_it_without_new_poses(client, mission, change, track, state):
    known = state()["cursor"]
    change(LOOK)
    answer = client.get(f"/api/v1/missions/{mission}/events", query_string={"cursor": known}, buffered=False)
    stream = iter(answer.response)
    assert next(stream) == b"retry: 1000\n\n"
    fields = dict(line.partition(": ")[::2] for line in next(stream).decode().splitlines())
    answer.close()
    (received,) = json.loads(fields["data"])["tracks"]
    assert (received["id"], received["look"], received["new"]) == (track, LOOK, [])


def test_new_poses_keep_it(send, walk, change, state):
    change(LOOK)
    send(walk(2, begin=3), first=3)
    (after,) = state()["tracks"]
    assert (after["poses"], after["look"]) == (5, LOOK)


def test_visitors_and_downloads_see_it(client, mission, change, stranger):
    change(LOOK)
    shared = client.post(f"/api/v1/missions/{mission}/shares", json={}).json["url"]
    token = shared.rpartition("/")[2]
    (track,) = stranger.get(f"/api/v1/shared-missions/{token}").json["tracks"]
    assert track["look"] == LOOK
    kml = stranger.get(f"{shared}/export.kml").text
    assert "<name>Team 2</name><visibility>0</visibility>" in kml.replace("\n", "")
    assert "<color>ff005ed5</color><width>6</width>" in kml
    (line,) = json.loads(client.get(f"/api/v1/missions/{mission}/export.geojson").text)["features"]
    assert (line["properties"]["name"], line["properties"]["stroke"]) == ("Team 2", "#d55e00")
