"""A map of printed tags without photos answers by the API and shows its page."""

import io

import cv2
import numpy as np
import pytest

from tests.core.tags.drawn import corners_of, looking, photo_of, tag_at

WORLD_FILE = "0.05\n0\n0\n-0.05\n500000.025\n5549999.975\n"
CENTRE = np.array([0.0, 3.0, -1.5])


@pytest.fixture
def tagged(client, park):
    """The address of a map of 0.05 metres a pixel, without photos."""
    base = f"/api/v1/maps/{park}"
    assert client.post(f"{base}/satellite/blank", json={"width": 600, "height": 400}).status_code < 300
    world = {"kind": "worldfile", "worldfile": WORLD_FILE, "crs": "EPSG:32633"}
    assert client.put(f"{base}/georeference", json=world).status_code < 300
    return base


def tag(**other):
    one = {"family": "36h11", "id": 3, "size_mm": 200.0, "heading_deg": 180.0, **other}
    return {"x_px": 300.0, "y_px": 200.0, "accuracy_m": 0.01, "height_m": 1.5, "tag": one}


def ask(client, base, number=3):
    seen = tag_at((0, 0, -1.5), heading_deg=180.0)
    corners = corners_of(seen, seen.at, centre=CENTRE, rotation=looking(0.0))
    photo = cv2.imencode(".jpg", photo_of([("36h11", number, corners)], noise=3.0))[1].tobytes()
    data = {"file": (io.BytesIO(photo), "a.jpg"), "fov": "61.93"}
    return client.post(f"{base}/localize", data=data)


def test_a_map_of_tags_alone_answers(client, tagged):
    assert ask(client, tagged).status_code >= 400  # neither photos nor tags
    assert client.put(f"{tagged}/landmarks/control-points/door", json=tag()).status_code == 200
    answer = ask(client, tagged)
    assert answer.status_code == 200, answer.json
    best = answer.json["hypotheses"][0]
    assert (best["x_px"], best["y_px"]) == pytest.approx((300.0, 260.0), abs=2.0)
    assert best["heading_deg"] == pytest.approx(0.0, abs=2.0) or best["heading_deg"] > 358.0
    assert 0.01 < best["radius_m"] < 0.4
    assert best["camera"]["height_m"] == pytest.approx(1.5, abs=0.1)
    assert answer.json["verdict"] == "place"
    assert answer.json["note"] == "by the tag 36h11 3"
    nothing = ask(client, tagged, 5).json
    assert nothing["hypotheses"] == []
    assert "the tag 36h11 5, which the map does not have" in nothing["no_pose"]


def test_the_pages_of_a_map_without_photos_are_there(client, tagged, park):
    client.put(f"{tagged}/landmarks/control-points/door", json=tag())
    page = client.get(f"/maps/{park}/control-points")
    assert page.status_code == 200
    assert 'action="/api/v1/maps/park/landmarks/control-points/tags.pdf"' in page.text
    assert client.get(f"/maps/{park}/localize").status_code == 200
