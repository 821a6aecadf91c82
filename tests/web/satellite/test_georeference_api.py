"""A georeference is previewed, applied, and removed."""

import pytest

from tests.web.satellite.images import CORNERS, LARGER, message, png


class TestGeoreference:
    POINTS = (
        {"x": 0, "y": 0, "lat": 50.001, "lon": 14.0},
        {"x": 400, "y": 0, "lat": 50.001, "lon": 14.002},
        {"x": 400, "y": 200, "lat": 50.0, "lon": 14.002},
        {"x": 0, "y": 200, "lat": 50.0, "lon": 14.00003},
    )

    def test_residuals_come_before_anything_is_applied(self, put, client, base, record):
        put(png(400, 200))
        wish = {"kind": "control-points", "points": self.POINTS, "model": "affine"}
        answer = client.post(f"{base}/georeference/preview", json=wish)
        assert answer.status_code == 200, answer.text
        result = answer.json
        assert result["kind"] == "affine"
        assert len(result["residuals"]) == len(result["points"]) == 4
        assert 0.3 < result["rms_m"] < 2.0
        assert result["points"][3]["fitted_x"] != pytest.approx(0.0, abs=0.1)
        assert result["corners"]["top_left"]["lat"] == pytest.approx(50.001, abs=1e-5)
        assert result["metres_per_pixel"] == pytest.approx(0.45, abs=0.2)
        assert record().georeference is None

    def test_applied_replaced_and_taken_away(self, put, client, base, record):
        put(png(400, 200))
        wish = {"kind": "control-points", "points": self.POINTS}
        answer = client.put(f"{base}/georeference", json=wish)
        assert answer.json["georeference"]["method"] == "projective"
        assert answer.json["undo"]["kind"] == "georeference"
        client.put(f"{base}/georeference", json={"kind": "corners", "corners": CORNERS})
        assert record().georeference["method"] == "corners"
        text = "0.5\n0\n0\n-0.5\n500000.25\n5539999.75\n"
        wish = {"kind": "worldfile", "worldfile": text, "crs": "EPSG:32633"}
        assert client.put(f"{base}/georeference", json=wish).status_code == 200
        assert record().georeference["plane"] == "EPSG:32633"
        assert client.delete(f"{base}/georeference").json["georeference"] is None
        client.post(f"{base}/undo")
        assert record().georeference["method"] == "worldfile"

    def test_photos_stay_on_the_image_and_arrows_as_they_were_drawn(
        self, put, client, base, add_photos, photo
    ):
        put(png(400, 400))
        add_photos({"x_px": 100.0, "y_px": 50.0, "heading_deg": 30.0})
        turned = [
            {"x": 200, "y": 0, "lat": 50.0, "lon": 14.001},
            {"x": 200, "y": 400, "lat": 50.0, "lon": 14.0},
        ]
        wish = {"kind": "control-points", "points": turned}
        assert client.put(f"{base}/georeference", json=wish).status_code == 200
        assert (photo(0).x_px, photo(0).y_px) == (100.0, 50.0)
        # the top of the image is east now
        assert photo(0).heading_deg == pytest.approx(120.0, abs=0.2)

    def test_photos_placed_by_gps_go_along_with_the_earth(self, put, client, base, add_photos, photo):
        put(png(400, 200), corners=CORNERS)
        add_photos({"gps_lat": 50.0005, "gps_lon": 14.001, "x_px": 200.0, "y_px": 100.0, "heading_deg": 9.0})
        client.put(f"{base}/georeference", json={"kind": "corners", "corners": LARGER})
        assert (photo(0).x_px, photo(0).y_px) == pytest.approx((200.0, 100.0), abs=0.01)
        corners = {"top_left": {"lat": 50.001, "lon": 14.0005}, "bottom_right": {"lat": 50.0, "lon": 14.0025}}
        client.put(f"{base}/georeference", json={"kind": "corners", "corners": corners})
        assert (photo(0).x_px, photo(0).y_px) == pytest.approx((100.0, 100.0), abs=0.01)
        assert photo(0).heading_deg == 9.0

    def test_an_image_that_changed_in_between_is_a_conflict(self, put, client, base, record):
        put(png(400, 200))
        seen = record().revision
        client.put(f"{base}/georeference", json={"kind": "corners", "corners": CORNERS, "seen": seen})
        wish = {"kind": "corners", "corners": LARGER, "seen": seen}
        assert "in the meantime" in message(client.put(f"{base}/georeference", json=wish), 409)

    @pytest.mark.parametrize(
        ("wish", "status"),
        [
            ({"kind": "corners"}, 400),
            ({"kind": "worldfile"}, 400),
            ({"kind": "guess"}, 422),
            ({"kind": "corners", "corners": {"top_left": {"lat": "x"}}}, 422),
            ({"kind": "corners", "corners": {**CORNERS, "bottom_right": CORNERS["top_left"]}}, 422),
            ({"kind": "control-points", "points": []}, 422),
            ({"kind": "control-points", "points": [POINTS[0]]}, 422),
            ({"kind": "control-points", "points": [POINTS[0], POINTS[0]]}, 422),
            ({"kind": "control-points", "points": [{"x": 1}]}, 422),
            ({"kind": "worldfile", "worldfile": "1 2 3"}, 422),
            ({"kind": "worldfile", "worldfile": "1\n0\n0\n-1\n0\n0", "crs": "EPSG:0"}, 422),
            ({"kind": "worldfile", "worldfile": "1\n0\n0\n-1\n0\n0", "crs": "+nadgrids=/dev/zero"}, 422),
        ],
    )
    def test_what_gives_none_is_refused_with_a_sentence(self, put, client, base, record, wish, status):
        put(png(400, 200))
        revision = record().revision
        for send in (client.put, lambda path, json: client.post(f"{path}/preview", json=json)):
            assert len(message(send(f"{base}/georeference", json=wish), status)) > 10
        assert record().revision == revision

    def test_a_map_without_an_image_has_none(self, client, base):
        wish = {"kind": "corners", "corners": CORNERS}
        assert "no satellite image yet" in message(
            client.post(f"{base}/georeference/preview", json=wish), 400
        )
