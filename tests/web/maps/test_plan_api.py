"""The plan of the next photos through the API: computed, stored, exported as a walk, and its photos added."""

import io
import json
import math

import pytest
from PIL import Image

from webapp.core.geo.georeference import Georeference
from webapp.core.mapmodel.photo_plan import Reason
from webapp.files.exchange.gpx import GpxWaypoint, read_gpx
from webapp.tasks.landmarks import stored
from webapp.tasks.landmarks.place_rest import LeftPhoto, RestReport
from webapp.web.maps.api_checks import SpotOut

CORNERS = {"top_left": {"lat": 50.1, "lon": 14.4}, "bottom_right": {"lat": 50.098, "lon": 14.403}}


def jpeg(shade):
    file = io.BytesIO()
    Image.new("RGB", (40, 30), (shade, 0, 0)).save(file, "JPEG")
    file.seek(0)
    return file


def put_satellite(client, url, colour):
    file = io.BytesIO()
    Image.new("RGB", (300, 200), colour).save(file, "PNG")
    file.seek(0)
    satellite = {"file": (file, "s.png"), "corners": json.dumps(CORNERS)}
    assert client.put(f"{url}/satellite", data=satellite).status_code == 200


@pytest.fixture
def url(client, park):
    """The address of a georeferenced map with four photos in a row facing east."""
    url = f"/api/v1/maps/{park}"
    put_satellite(client, url, "green")
    for number in range(4):
        client.post(f"{url}/photos", data={"file": (jpeg(20 * number), f"{number}.jpg")})
    changes = [{"id": n, "x_px": 50 + 40 * n, "y_px": 100, "heading_deg": 90} for n in range(4)]
    answer = client.patch(f"{url}/experiences", json={"kind": "place", "changes": changes})
    assert answer.status_code == 200
    return url


def photo_at(client, url, **fields):
    data = {"file": (jpeg(200), "new.jpg"), "x_px": 60, "y_px": 90, **fields}
    return client.post(f"{url}/photo-plan/photos", data=data)


def test_a_plan_is_made_and_kept(client, url):
    assert client.get(f"{url}/photo-plan").json == {"plan": None, "current": False, "replaced": False}
    assert client.get(f"{url}/photo-plan/walk.gpx").status_code == 404
    made = client.post(f"{url}/photo-plan", json={"spots": 3}).json
    assert made["current"]
    plan = made["plan"]
    assert [spot["number"] for spot in plan["spots"]] == [1, 2, 3]
    assert {spot["reason"] for spot in plan["spots"]} <= set(Reason.__args__)
    assert SpotOut().fields["reason"].metadata["enum"] == [*Reason.__args__]
    assert plan["recognised_share"] < plan["expected_share"]
    assert client.get(f"{url}/photo-plan").json == made
    again = client.post(f"{url}/photo-plan", json={}).json["plan"]
    assert again["id"] != plan["id"]
    photo_at(client, url)
    assert not client.get(f"{url}/photo-plan").json["current"]


def test_weak_places_count_where_nothing_was_evaluated(client, url, library, park):
    photos = [{"id": n, "state": "lonely" if n == 3 else "good"} for n in range(4)]
    survey = {"version": 1, "revision": 1, "place_radius_px": 80, "photos": photos}
    (library.map_folder(park) / "derived" / "health.json").write_text(json.dumps(survey))
    plan = client.post(f"{url}/photo-plan", json={"spots": 1}).json["plan"]
    assert (plan["trials"], plan["tried"]) == ("health", 4)


def test_an_area_is_kept_to(client, url):
    spots = client.post(f"{url}/photo-plan", json={"area": [200, 0, 300, 60]}).json["plan"]["spots"]
    assert spots
    assert all(spot["x_px"] >= 200 and spot["y_px"] <= 60 for spot in spots)
    answer = client.post(f"{url}/photo-plan", json={"area": [900, 0, 950, 60]})
    assert (answer.status_code, answer.json["error"]["where"]) == (400, "area")


def test_the_walk_is_gpx_in_the_language_of_the_page(client, url):
    spots = client.post(f"{url}/photo-plan", json={"spots": 2}).json["plan"]["spots"]
    answer = client.get(f"{url}/photo-plan/walk.gpx")
    assert answer.status_code == 200, answer.text
    assert answer.mimetype == "application/gpx+xml"
    points = [item for item in read_gpx(io.BytesIO(answer.data)) if isinstance(item, GpxWaypoint)]
    assert [(p.point.lat, p.point.lon) for p in points] == [
        pytest.approx((s["lat"], s["lon"]), abs=1e-6) for s in spots
    ]
    assert "Look " in answer.text
    assert "Dívejte se" in client.get(f"{url}/photo-plan/walk.gpx", headers={"Accept-Language": "cs"}).text


def test_a_photo_of_a_spot_has_it_as_a_suggestion(client, url):
    answer = photo_at(client, url, heading_deg=180)
    assert answer.status_code == 200
    assert (answer.json["placed"], answer.json["suggested"]) == (False, True)
    (one,) = client.get(f"{url}/place-rest").json["suggested"]
    assert (one["id"], one["x_px"], one["y_px"], one["heading_deg"]) == (answer.json["id"], 60, 90, 180)
    assert one["radius_px"] > 0
    assert photo_at(client, url, x_px=70).json["duplicate"], "sent again, as the answer was lost"
    (one,) = client.get(f"{url}/place-rest").json["suggested"]
    assert one["x_px"] == 70
    client.post(f"{url}/place-rest/accept", json={"ids": [one["id"]]})
    assert not photo_at(client, url).json["suggested"], "it has a place by now"


def test_a_spot_outside_of_the_image_is_not_suggested(client, url):
    answer = photo_at(client, url, x_px=301)
    assert (answer.status_code, answer.json["suggested"]) == (200, False)
    assert client.get(f"{url}/place-rest").json["suggested"] == []


@pytest.mark.parametrize("scale", [math.nan, 0.0])
def test_a_spot_where_the_image_has_no_scale_is_not_suggested(client, url, monkeypatch, scale):
    monkeypatch.setattr(Georeference, "metres_per_pixel", lambda *_: scale)
    answer = photo_at(client, url)
    assert (answer.status_code, answer.json["suggested"]) == (200, False)
    assert client.get(f"{url}/place-rest").json["suggested"] == []


def test_a_spot_of_another_image_is_not_suggested(client, url):
    revision = client.post(f"{url}/photo-plan", json={}).json["plan"]["revision"]
    id = photo_at(client, url, revision=revision).json["id"]
    assert [one["id"] for one in client.get(f"{url}/place-rest").json["suggested"]] == [id]
    assert not client.get(f"{url}/photo-plan").json["replaced"]
    put_satellite(client, url, "blue")
    assert client.get(f"{url}/photo-plan").json["replaced"]
    assert client.get(f"{url}/place-rest").json["suggested"] == []
    assert client.post(f"{url}/place-rest/accept", json={"ids": [id]}).status_code == 404
    assert not photo_at(client, url, revision=revision).json["suggested"], "it waited on the phone"
    assert photo_at(client, url).json["suggested"]


def test_a_suggestion_by_a_spot_outlives_a_search_that_finds_none(client, url, library, park):
    id = photo_at(client, url).json["id"]
    left = RestReport((), (LeftPhoto(id, "photos/new.jpg", "too few photos overlap enough"),), (), ())
    stored.keep(library.cfg(park), left, revision=9)
    rest = client.get(f"{url}/place-rest").json
    assert ([one["id"] for one in rest["suggested"]], rest["left"]) == ([id], [])


def test_visitors_see_the_plan_and_editors_make_it(client, url, sign_in, new_account, library, park):
    client.post(f"{url}/photo-plan", json={})
    other = new_account("Eva")
    assert sign_in(other).post(f"{url}/photo-plan", json={}).status_code == 404
    assert photo_at(sign_in(other), url).status_code == 404
