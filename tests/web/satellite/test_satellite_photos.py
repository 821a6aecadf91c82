"""Photos of a map that gets another image."""

import pytest

from tests.web.satellite.images import CORNERS, LARGER, message, png
from webapp.core.geo.fit import Corners, from_corners
from webapp.core.geo.types import LatLon
from webapp.files.maps.map_json import parse_georeference
from webapp.store.schema import Job, PlacedElsewhere


def _corners(corners):
    return Corners(*(LatLon(**corners[name]) for name in ("top_left", "bottom_right")))


class TestPhotosOnANewImage:
    def test_they_keep_their_place_on_the_earth(self, put, add_photos, photo, library, record, client, base):
        put(png(400, 200), corners=CORNERS)
        add_photos({"x_px": 100.0, "y_px": 50.0, "heading_deg": 30.0}, {"x_px": 0.0, "y_px": 200.0})
        with library.database.write() as session:
            session.add(
                PlacedElsewhere(map_id=record().id, placement="clusters", photo_id=0, x_px=200.0, y_px=100.0)
            )
        where = from_corners(_corners(CORNERS), width=400, height=200).georeference
        answer = put(png(800, 600), corners=LARGER)
        assert {p["id"] for p in answer.json["photos"]} == {0, 1}
        now = parse_georeference(record().georeference)
        for id, before in ((0, (100.0, 50.0)), (1, (0.0, 200.0))):
            at = now.latlon_from_pixel([(photo(id).x_px, photo(id).y_px)])
            assert at == pytest.approx(where.latlon_from_pixel([before]), abs=1e-9)
        assert photo(0).heading_deg == 30.0
        assert answer.json["placements"][0]["positions"]["0"] == pytest.approx([400.0, 300.0])
        client.post(f"{base}/undo")
        assert (photo(0).x_px, photo(0).y_px, record().satellite_width) == (100.0, 50.0, 400)

    def test_outside_it_is_refused_or_they_go_to_the_tray(self, put, add_photos, photo, record):
        put(png(400, 200))
        add_photos({"x_px": 390.0, "y_px": 190.0}, {"x_px": 10.0, "y_px": 10.0})
        answer = put(png(200, 100, shade=3))
        assert "1 placed photos would lie outside" in message(answer, 400)
        assert "scale=1" in answer.json["error"]["hint"]
        assert record().satellite_width == 400
        assert put(png(200, 100, shade=3), tray=1).json["to_tray"] == 1
        assert photo(0).x_px is None
        assert photo(1).x_px == 10.0

    def test_the_page_says_how_many_were_taken_outside(self, put, add_photos, client, record):
        add_photos({"gps_lat": 50.0005, "gps_lon": 14.001}, {"gps_lat": 51.0, "gps_lon": 14.0}, {})
        address = f"/maps/{record().slug}/image"
        assert "taken outside this image" not in client.get(address).text
        put(png(400, 200), corners=CORNERS)
        assert "1 photo in the tray was taken outside this image" in client.get(address).text

    def test_the_page_leads_on_to_a_query_when_all_are_placed(self, put, add_photos, client, record):
        put(png(400, 200))
        add_photos({"x_px": 390.0, "y_px": 190.0}, {"x_px": 10.0, "y_px": 10.0})
        address = f"/maps/{record().slug}/image"
        text = client.get(address).text
        assert "All 2 photos are placed." in text and "Try a photo" in text and "Place photos" not in text
        assert '"placed": [[390.0, 190.0], [10.0, 10.0]]' in text
        add_photos({})
        assert "Place photos" in client.get(address).text

    def test_control_points_go_with_them(self, put, client, base, record):
        put(png(400, 200))
        points = f"{base}/landmarks/control-points"
        for name, at in (("gate", (390.0, 190.0)), ("well", (10.0, 10.0))):
            assert client.put(f"{points}/{name}", json={"x_px": at[0], "y_px": at[1]}).status_code == 200
        assert put(png(200, 100, shade=3)).status_code == 200
        gate, well = client.get(points).json["points"]
        assert (gate["x_px"], well["x_px"]) == (None, 10.0)
        client.post(f"{base}/undo")
        assert put(png(800, 200, shade=4), scale=1).status_code == 200
        assert [point["x_px"] for point in client.get(points).json["points"]] == [780.0, 20.0]

    def test_they_are_scaled_where_that_is_wished(self, put, add_photos, photo):
        put(png(400, 200))
        add_photos({"x_px": 390.0, "y_px": 190.0})
        assert put(png(200, 400, shade=3), scale=1).status_code == 200
        assert (photo(0).x_px, photo(0).y_px) == (195.0, 380.0)

    def test_the_first_georeference_places_photos_by_their_gps(self, put, add_photos, photo, library):
        add_photos({"gps_lat": 50.0005, "gps_lon": 14.001}, {"gps_lat": 51.0, "gps_lon": 14.0}, {})
        answer = put(png(400, 200), corners=CORNERS)
        assert answer.json["from_tray"] == 1
        assert (photo(0).x_px, photo(0).y_px) == pytest.approx((200.0, 100.0))
        assert photo(1).x_px is None
        with library.database.read() as session:
            assert [job.kind for job in session.query(Job)] == ["index"]
