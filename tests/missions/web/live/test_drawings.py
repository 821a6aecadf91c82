"""Search areas, lines and markers: who draws them, their coverage by tracks, and bad input."""

import json

import numpy as np
import pytest

from webapp.errors import Busy
from webapp.missions.tasks.coverage import CoverageCache
from webapp.missions.web import api_drawings

SQUARE = [[50.0, 14.0], [50.0, 14.0014], [50.0009, 14.0014], [50.0009, 14.0]]
"""About 100 m wide and high; the walk of the fixture runs along its western side."""


@pytest.fixture
def drawings(client, mission):
    """The address of the drawings of the mission."""
    return f"/api/v1/missions/{mission}/drawings"


@pytest.fixture
def area(client, drawings):
    """A search area, as the API answers."""
    answer = client.post(drawings, json={"kind": "area", "name": "Yard", "points": SQUARE})
    assert answer.status_code == 201, answer.json
    return answer.json


@pytest.fixture
def covered(client, mission):
    """The coverage of the first area."""
    return lambda: client.get(f"/api/v1/missions/{mission}/coverage").json["areas"][0]


def test_an_area_is_assigned_searched_and_deleted(client, drawings, area, owner, state):
    before = state()["drawings_revision"]
    one = f"{drawings}/{area['id']}"
    assert (area["assigned"], area["searched"], area["radius_m"]) == ("", False, 5.0)
    assert area["area_m2"] == pytest.approx(100.4 * 100.1, rel=0.01)
    assert client.patch(one, json={"assigned": "Team 2", "radius_m": 8}).json["assigned"] == "Team 2"
    done = client.patch(one, json={"searched": True}).json
    assert (done["searched"], done["searched_by"], done["revision"]) == (True, owner.name, 3)
    assert done["searched_time_s"] >= done["created_time_s"]
    assert client.get(drawings).json["drawings"] == [done]
    assert state()["drawings_revision"] == state()["revision"] > before
    assert client.patch(one, json={"searched": False}).json["searched_by"] is None
    assert client.delete(one).status_code == 204
    assert client.get(drawings).json["drawings"] == []


def test_the_same_again_changes_nothing(client, drawings, area, state):
    one, before = f"{drawings}/{area['id']}", state()["revision"]
    assert client.patch(one, json={"name": "Yard", "points": SQUARE}).json == area
    assert state()["revision"] == before


def test_a_change_of_what_somebody_else_has_changed_is_a_conflict(client, drawings, area):
    one = f"{drawings}/{area['id']}"
    client.patch(one, json={"name": "Garden"})
    for answer in (
        client.patch(one, json={"name": "Lawn", "revision": 1}),
        client.delete(f"{one}?revision=1"),
    ):
        assert (answer.status_code, answer.json["error"]["where"]) == (409, "revision")
    assert client.patch(one, json={"name": "Lawn", "revision": 2}).json["name"] == "Lawn"


def test_lines_are_measured_and_markers_are_points(client, drawings):
    line = client.post(drawings, json={"kind": "line", "name": "Rope", "points": SQUARE[:2]}).json
    assert line["length_m"] == pytest.approx(100.4, rel=0.01)
    assert (line["area_m2"], line["radius_m"]) == (None, None)
    marker = client.post(drawings, json={"kind": "marker", "name": "Post", "points": SQUARE[:1]}).json
    assert (marker["points"], marker["length_m"]) == (SQUARE[:1], None)
    assert client.patch(f"{drawings}/{line['id']}", json={"searched": True}).status_code == 400


def test_a_walk_along_a_side_covers_a_strip(send, walk, area, covered):
    assert covered() == {"id": area["id"], "share": 0.0, "tracks": [], "exact": True}
    send(walk(50))
    half = covered()
    assert half["share"] == pytest.approx(5 * 54 / 10_050, rel=0.1)
    send(walk(100, begin=50), first=50)
    assert covered()["share"] == pytest.approx(5 * 100 / 10_050, rel=0.1)
    assert covered()["tracks"] == half["tracks"] != []


def test_a_larger_radius_covers_more(client, drawings, send, walk, area, covered):
    send(walk(110))
    before = covered()["share"]
    client.patch(f"{drawings}/{area['id']}", json={"radius_m": 20})
    assert covered()["share"] == pytest.approx(4 * before, rel=0.1)


def test_nothing_is_covered_between_poses_that_are_far_apart_in_time(send, area, covered):
    ends = [{"lat": 50.00045, "lon": 14.0 + n * 0.0014} for n in (0, 1)]
    times = [0.0, 1.0, 2.0, 60.0, 61.0, 62.0]
    send([{"type": "pose", "time": 1000 + t, **ends[int(t > 30)]} for t in times])
    assert covered()["share"] == pytest.approx(np.pi * 25 / 10_050, rel=0.15)


def test_poses_sent_one_by_one_cover_what_they_cover_together(send, area, covered):
    def pose(n):
        time = 1000 + n + (100 if n >= 40 else 0)
        return {"type": "pose", "time": time, "lat": 50.0004, "lon": 14.0 + (n + (n >= 40) * 20) * 1.4e-5}

    for n in range(80):
        send([pose(n)], first=n)
        if n % 7 == 0 or n in (40, 41):
            covered()
    alone = covered()["share"]
    assert alone == pytest.approx((80 * 10 + np.pi * 25) / 10_050, rel=0.05)


def test_areas_whose_grid_was_released_keep_their_share(
    client, drawings, send, walk, area, covered, library, mission
):
    send(walk(40))
    cache = CoverageCache(samples=1)
    before = cache.of_mission(library, mission)
    assert before[0].share == covered()["share"] > 0
    assert [kept.coverage for kept in cache._kept.values()] == [None]
    assert cache.of_mission(library, mission) == before
    send(walk(40, begin=40), first=40)
    assert cache.of_mission(library, mission)[0].share == covered()["share"] > before[0].share


def test_a_call_that_takes_too_long_ends_and_the_next_goes_on(
    client, drawings, send, walk, area, covered, library, mission
):
    for name in "ab":
        client.post(drawings, json={"kind": "area", "name": name, "points": SQUARE, "radius_m": 7})
    send(walk(1500))
    cache, ended = CoverageCache(budget_s=0), 0
    while ended < 10:
        try:
            found = cache.of_mission(library, mission)
            break
        except Busy:
            ended += 1
    assert 2 < ended < 10
    assert found[0].share == covered()["share"] > 0
    assert found[2].share > found[0].share


def test_odometry_counts_only_where_there_is_nothing_better(send, walk, area, covered):
    send(walk(50, source="odometry"))
    share = covered()["share"]
    assert share > 0
    send([{"type": "pose", "time": 1.0, "lat": 50.0004, "lon": 14.0007}], first=50)
    assert covered()["share"] == pytest.approx(np.pi * 25 / 10_050, rel=0.1)


BAD = {
    "crossing": [SQUARE[0], SQUARE[2], SQUARE[1], SQUARE[3]],
    "touching": [[50.0, 14.0], [50.0, 14.002], [50.0, 14.001], [50.001, 14.001]],
    "two points": SQUARE[:2],
    "one point thrice": [SQUARE[0]] * 3,
    "out of range": [[91.0, 14.0], *SQUARE[:2]],
    "too many": [[50.0 + n * 1e-8, 14.0] for n in range(100_000)],
    "too large": [[0.0, 0.0], [0.0, 90.0], [45.0, 45.0]],
    "opposite": [[0.0, 0.0], [0.0, 180.0], [0.0, 90.0]],
    "no point": [],
    "three numbers": [[50.0, 14.0, 1.0]] * 3,
    "a text": [["a", "b"]] * 3,
    "flat": [[50.0, 14.0], [50.0, 14.0000001], [50.0000001, 14.0]],
    "infinite": [[1e400, 14.0], *SQUARE[:2]],
}


@pytest.mark.parametrize("points", BAD.values(), ids=BAD)
def test_bad_shapes_are_refused(client, drawings, points):
    answer = client.post(drawings, json={"kind": "area", "name": "Yard", "points": points})
    assert answer.status_code in (400, 413, 422)
    assert set(answer.json["error"]) == {"code", "message", "hint", "where"}
    assert client.get(drawings).json["drawings"] == []


@pytest.mark.parametrize(
    "given",
    [
        {"kind": "circle"},
        {"name": " "},
        {"name": "a\x00b"},
        {"radius_m": 0},
        {"radius_m": 1e9},
        {"note": "\x00"},
        {"searched": "yes"},
        {"extra": 1},
    ],
)
def test_bad_fields_are_refused(client, drawings, given):
    whole = {"kind": "area", "name": "Yard", "points": SQUARE, **given}
    answer = client.post(drawings, json=whole)
    assert answer.status_code in (400, 422)
    assert set(answer.json["error"]) == {"code", "message", "hint", "where"}


def test_nan_is_refused(client, drawings):
    text = json.dumps({"kind": "area", "name": "Yard", "points": [[float("nan"), 14.0], *SQUARE[:2]]})
    answer = client.post(drawings, data=text, content_type="application/json")
    assert answer.status_code in (400, 422)
    assert set(answer.json["error"]) == {"code", "message", "hint", "where"}


def test_an_area_of_a_thousand_points_is_taken(client, drawings):
    turn = np.linspace(0, 2 * np.pi, 1000, endpoint=False)
    ring = np.column_stack([50 + 0.001 * np.sin(turn), 14 + 0.001 * np.cos(turn)]).tolist()
    answer = client.post(drawings, json={"kind": "area", "name": "Ring", "points": [*ring, ring[0]]})
    assert (answer.status_code, len(answer.json["points"])) == (201, 1000)


def test_an_area_across_the_180th_meridian(client, drawings, send, covered):
    points = [[-16.8, 179.9995], [-16.8, -179.9995], [-16.799, -179.9995], [-16.799, 179.9995]]
    answer = client.post(drawings, json={"kind": "area", "name": "Taveuni", "points": points})
    assert answer.json["area_m2"] == pytest.approx(106.6 * 110.7, rel=0.01)
    send([{"type": "pose", "time": 1.0, "lat": -16.7995, "lon": 180.0}])
    assert covered()["share"] == pytest.approx(np.pi * 25 / answer.json["area_m2"], rel=0.1)


def test_viewers_see_drawings_but_do_not_draw(owner, new_map, new_account, sign_in, new_mission, client):
    people = {role: new_account(role) for role in ("viewer", "editor", "other")}
    slug = new_map(owner, shared={people[role]: role for role in ("viewer", "editor")})
    drawings = f"/api/v1/missions/{new_mission(map=slug)}/drawings"
    given = {"kind": "area", "name": "Yard", "points": SQUARE}
    editor, viewer, other = (sign_in(people[role]) for role in ("editor", "viewer", "other"))
    assert editor.post(drawings, json=given).json["created_by"] == "editor"
    (found,) = viewer.get(drawings).json["drawings"]
    one = f"{drawings}/{found['id']}"
    assert viewer.post(drawings, json=given).status_code == 403
    assert viewer.patch(one, json={"searched": True}).status_code == 403
    assert viewer.delete(one).status_code == 403
    assert {other.get(drawings).status_code, other.delete(one).status_code} == {404}
    of_another = f"/api/v1/missions/{new_mission()}/drawings/{found['id']}"
    assert client.delete(of_another).status_code == 404


def test_visitors_see_areas_without_names_of_people(client, app, mission, area, drawings, send, walk):
    client.patch(f"{drawings}/{area['id']}", json={"assigned": "Ann", "note": "Ann's", "searched": True})
    send(walk(50))
    share = client.post(f"/api/v1/missions/{mission}/shares", json={"public": False, "photos": False}).json
    base = f"/api/v1/shared-missions/{share['url'].rpartition('/')[2]}"
    visitor = app.test_client()
    (found,) = visitor.get(f"{base}/drawings").json["drawings"]
    assert (found["name"], found["points"], found["searched"]) == ("Yard", SQUARE, True)
    hidden = ("assigned", "note", "searched_by", "created_by", "changed_by")
    assert not any(found[name] for name in hidden)
    assert visitor.get(f"{base}/coverage").json["areas"][0]["share"] > 0
    assert visitor.get(base).json["drawings_revision"] > 0


def test_coverage_leaves_threads_for_others(app, client, mission, area):
    where = f"/api/v1/missions/{mission}/coverage"
    with app.app_context():
        free = api_drawings._limit.semaphore()
    taken = 0
    while free.acquire(blocking=False):
        taken += 1
    refused = client.get(where)
    assert taken == 2 and refused.headers["Retry-After"] and refused.json["error"]["message"]
    free.release()
    for _ in range(2):
        assert client.get(where).status_code == 200
