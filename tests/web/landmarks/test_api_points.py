"""Control points by the API: saved as edits, and evaluated when the landmarks are laid."""

import pytest

from tests.web.landmarks.conftest import AT
from webapp.core.landmarks.absolute_pose import Lens
from webapp.store.accounts import accounts
from webapp.store.schema import Account, Job, MapRecord
from webapp.tasks.landmarks import control_points
from webapp.tasks.landmarks.show_cloud import align_in_library

WIDTH, HEIGHT, FOCAL = 40, 30, 30.0


def clicks(spot, photos):
    """Return the pixels of a spot (map pixels, height) in photos that all face the top of the image."""
    found = []
    for id in photos:
        x, y = AT[id]
        front, right, down = y - spot[1], spot[0] - x, -spot[2]
        found.append(
            {"id": id, "x": 0.5 + FOCAL * right / front / WIDTH, "y": 0.5 + FOCAL * down / front / HEIGHT}
        )
    return found


@pytest.fixture
def points(joined, monkeypatch):
    """The address of the control points of a map with landmarks of three placed photos, and its record."""
    url, record = joined
    lens = Lens(WIDTH, HEIGHT, FOCAL)
    monkeypatch.setattr(control_points.PhotoLenses, "lens", lambda self, number: lens)
    return f"{url}/control-points", record


def gate(**other):
    found = {"x_px": 90.0, "y_px": 0.0, "accuracy_m": None, "height_m": None, "tag": None, "check": False}
    return {**found, "photos": [{"id": 1, "x": 0.1, "y": 0.4}], **other}


def test_a_point_is_kept_changed_taken_away_and_brought_back(client, points):
    url, _ = points
    map_url = url.removesuffix("/landmarks/control-points")
    assert client.get(url).json["points"] == []
    answer = client.put(f"{url}/gate", json=gate(height_m=212.5, accuracy_m=0.05))
    assert answer.status_code == 200
    expected = {"name": "gate", **gate(height_m=212.5, accuracy_m=0.05)}
    assert answer.json["points"] == [expected]
    client.put(f"{url}/gate", json=gate())
    assert client.post(f"{map_url}/undo").status_code == 200
    assert client.get(url).json["points"] == [expected]
    assert client.delete(f"{url}/gate").json["points"] == []
    assert client.post(f"{map_url}/undo").status_code == 200
    assert client.get(url).json["points"] == [expected]
    assert client.post(f"{map_url}/redo").status_code == 200
    assert client.get(url).json["points"] == []
    assert client.delete(f"{url}/gate").status_code == 404


def test_a_tag_is_kept_with_a_point_and_brought_back(client, points):
    url, _ = points
    tag = {"family": "36h11", "id": 3, "size_mm": 150.0, "mount": "wall", "heading_deg": None}
    assert client.put(f"{url}/gate", json=gate(tag=tag)).json["points"][0]["tag"] == tag
    floor = tag | {"mount": "floor", "heading_deg": 12.5}
    assert client.put(f"{url}/gate", json=gate(tag=floor)).json["points"][0]["tag"] == floor
    assert client.put(f"{url}/gate", json=gate()).json["points"][0]["tag"] is None
    assert client.post(f"{url.removesuffix('/landmarks/control-points')}/undo").status_code == 200
    assert client.get(url).json["points"][0]["tag"] == floor


@pytest.mark.parametrize(
    "other",
    [
        {"family": "16h5"},
        {"id": 587},
        {"id": -1},
        {"size_mm": 0.0},
        {"mount": "roof"},
        {"heading_deg": 360.0},
    ],
)
def test_a_tag_that_cannot_be_is_refused(client, points, other):
    url, _ = points
    tag = {"family": "36h11", "id": 3, "size_mm": 150.0} | other
    assert client.put(f"{url}/gate", json=gate(tag=tag)).status_code in (400, 422)
    assert client.get(url).json["points"] == []


def test_tags_are_printed(client, points):
    url, _ = points
    answer = client.get(f"{url}/tags.pdf?family=5x5_100&ids=1-3&size_mm=80&paper=letter")
    assert (answer.status_code, answer.mimetype) == (200, "application/pdf")
    assert answer.data.startswith(b"%PDF-")
    assert "tags-5x5_100.pdf" in answer.headers["Content-Disposition"]
    assert client.get(f"{url}/tags.pdf?ids=1-9999").status_code == 400


@pytest.mark.parametrize(
    ("change", "status", "words"),
    [
        ({"y_px": None}, 400, "x_px and y_px go together"),
        ({"x_px": 4000.0}, 400, "outside the image"),
        ({"accuracy_m": 1e160}, 400, "accuracy_m that is not above 0 and at most 1000"),
        ({"height_m": -20_001.0}, 400, "height_m that is not from -20000 to 20000"),
        ({"photos": [{"id": 77, "x": 0.1, "y": 0.1}]}, 404, "no photo 77"),
        ({"photos": [{"id": 1, "x": 0.1, "y": 0.1}] * 2}, 400, "once"),
        ({"photos": [{"id": 1, "x": 1.1, "y": 0.1}]}, 422, ""),
        ({"accuracy_m": 0.0}, 422, ""),
    ],
)
def test_what_is_not_valid_is_refused(client, points, change, status, words):
    url, _ = points
    answer = client.put(f"{url}/gate", json=gate(**change))
    assert answer.status_code == status
    assert words in answer.get_data(as_text=True)
    assert client.get(url).json["points"] == []


def test_no_two_points_look_the_same(client, points):
    url, _ = points
    assert client.put(f"{url}/gate", json=gate()).status_code == 200
    answer = client.put(f"{url}/ga%E2%80%8Bte", json=gate())
    assert answer.status_code == 400
    assert "looks the same" in answer.json["error"]["message"]
    assert client.put(f"{url}/gate", json=gate(height_m=3.0)).status_code == 200
    assert client.put(f"{url}/Gate", json=gate()).status_code == 200
    assert [point["name"] for point in client.get(url).json["points"]] == ["Gate", "gate"]


def test_a_point_stays_editable_without_a_photo_that_showed_it(client, points):
    url, _ = points
    seen = [{"id": 1, "x": 0.1, "y": 0.4}, {"id": 2, "x": 0.2, "y": 0.4}]
    client.put(f"{url}/gate", json=gate(photos=seen))
    map_url = url.removesuffix("/landmarks/control-points")
    assert client.delete(f"{map_url}/experiences/1").status_code == 200
    (point,) = client.get(url).json["points"]
    assert point["photos"] == seen[1:]
    name = point.pop("name")
    assert client.put(f"{url}/{name}", json={**point, "x_px": 91.0}).status_code == 200


def test_undo_is_offered_while_the_last_edit_is_one_of_a_point(client, points):
    url, _ = points
    map_url = url.removesuffix("/landmarks/control-points")
    assert client.get(url).json["can_undo"] is False
    assert client.put(f"{url}/gate", json=gate()).json["can_undo"] is True
    client.delete(f"{map_url}/experiences/2")
    assert client.put(f"{url}/gate", json=gate()).json["can_undo"] is False
    client.post(f"{map_url}/undo")
    assert client.get(url).json["can_undo"] is True
    client.post(f"{map_url}/undo")
    assert client.get(url).json["can_undo"] is False


def test_they_are_judged_when_the_landmarks_are_laid(client, points, library):
    url, record = points
    spot = (190.0, 5.0, 5.0)
    body = {"x_px": spot[0], "y_px": spot[1], "photos": clicks(spot, [1, 2])}
    first = client.put(f"{url}/oak", json=body).json
    assert (first["laid"], first["current"]) == (False, False)
    with library.database.read() as session:
        assert session.get_one(Job, first["job"]).kind == "landmarks"
    client.put(f"{url}/lonely", json={"x_px": 10.0, "y_px": 10.0, "photos": clicks(spot, [2])})
    with library.database.read() as session:
        record = session.get_one(MapRecord, record.id)
    align_in_library(library, record)
    found = client.get(url).json
    assert (found["laid"], found["current"]) == (True, True)
    judged = {one["name"]: one for one in found["residuals"]}
    assert set(judged) == {"0.jpg", "1.jpg", "2.jpg", "oak", "lonely"}
    assert judged["oak"]["residual_px"] == pytest.approx(0.0, abs=0.05)
    assert judged["oak"]["problem"] is None
    assert "2.jpg" in judged["lonely"]["problem"]
    assert judged["1.jpg"]["photo"] == 1
    assert judged["1.jpg"]["residual_px"] == pytest.approx(0.0, abs=0.05)


def test_a_check_point_is_left_out_and_judged(client, points, library):
    url, record = points
    spot = (190.0, 5.0, 5.0)
    body = {"x_px": spot[0] + 3.0, "y_px": spot[1] - 4.0, "photos": clicks(spot, [1, 2]), "check": True}
    assert client.put(f"{url}/oak", json=body).json["points"][0]["check"] is True
    with library.database.read() as session:
        record = session.get_one(MapRecord, record.id)
    align_in_library(library, record)
    found = client.get(url).json
    oak = next(one for one in found["residuals"] if one["name"] == "oak")
    assert (oak["check"], oak["contradicts"], oak["photos"]) == (True, False, 2)
    assert (oak["dx_px"], oak["dy_px"]) == pytest.approx((-3.0, 4.0), abs=0.05)
    assert found["accuracy"]["check"]["rmse_px"] == pytest.approx(5.0, abs=0.05)
    assert found["accuracy"]["control"]["points"] == 0
    assert client.put(f"{url}/oak", json={**body, "check": "yes"}).status_code == 422


def test_viewers_only_look(sign_in, new_account, points, park, library):
    url, _ = points
    vera = new_account("vera")
    with library.database.write() as session:
        record = session.query(MapRecord).filter_by(slug=park).one()
        accounts.set_member_role(session, record, account=session.get(Account, vera.id), role="viewer")
    viewer = sign_in(vera)
    assert viewer.get(url).status_code == 200
    assert viewer.put(f"{url}/gate", json=gate()).status_code == 403
    assert viewer.delete(f"{url}/gate").status_code == 403
