"""A blank plan, and an area of a tile service."""

import io
import json
from dataclasses import replace
from typing import ClassVar

import pytest
from PIL import Image

from tests.tile_server import serving
from tests.web.satellite.images import message, png
from webapp.settings import Settings
from webapp.store.schema import Job


class TestBlank:
    def test_of_a_size(self, client, base, record):
        answer = client.post(f"{base}/satellite/blank", json={"width": 640, "height": 480})
        assert answer.status_code == 200, answer.text
        assert (record().satellite_width, record().satellite_height) == (640, 480)
        assert Image.open(io.BytesIO(client.get(f"{base}/satellite", buffered=True).data)).size == (640, 480)

    def test_around_the_photos(self, client, base, record, add_photos, photo):
        add_photos({"gps_lat": 50.0, "gps_lon": 14.0}, {"gps_lat": 50.001, "gps_lon": 14.002})
        answer = client.post(f"{base}/satellite/blank", json={})
        assert answer.json["from_tray"] == 2
        assert record().georeference["method"] == "blank"
        width = record().satellite_width
        assert photo(1).x_px - photo(0).x_px == pytest.approx(width / 1.1, rel=0.01)

    @pytest.mark.parametrize(
        "wish", [{}, {"width": 100}, {"width": 5, "height": 500}, {"width": 10**9, "height": 500}]
    )
    def test_refused(self, client, base, record, wish):
        answer = client.post(f"{base}/satellite/blank", json=wish)
        assert len(message(answer, 400)) > 10
        assert record().revision == 0


class TestTiles:
    @pytest.fixture
    def service(self, tmp_path, app, library, settings):
        with serving() as tiles:
            file = tmp_path / "services.json"
            one = {"name": "Local", "url": tiles.url, "attribution": "© me", "max_zoom": 19, "max_tiles": 30}
            file.write_text(json.dumps([one]))
            state = app.extensions["expmap"]
            app.extensions["expmap"] = replace(
                state, settings=Settings(library=settings.library, tile_services=file)
            )
            yield tiles

    AREA: ClassVar = {
        "service": "Local",
        "zoom": 17,
        "north": 50.001,
        "south": 50.0,
        "west": 14.0,
        "east": 14.002,
    }

    def test_a_job_is_queued_once_with_the_last_wish(self, service, client, base, library):
        answer = client.post(f"{base}/satellite/tiles", json=self.AREA)
        assert answer.status_code == 202, answer.text
        assert answer.json["attribution"] == "© me"
        assert answer.json["tiles"] <= 30
        again = client.post(f"{base}/satellite/tiles", json={**self.AREA, "zoom": 16})
        assert again.json["job"] == answer.json["job"]
        with library.database.read() as session:
            (job,) = session.query(Job)
            assert job.arguments["zoom"] == 16
        assert not service.asked

    @pytest.mark.parametrize(
        ("wrong", "status"),
        [
            ({"service": "http://127.0.0.1:1/{z}/{x}/{y}"}, 404),
            ({"zoom": 22}, 400),
            ({"zoom": 99}, 422),
            ({"north": 60.0}, 400),
            ({"north": 49.0}, 422),
            ({"east": "far"}, 422),
        ],
    )
    def test_refused_at_once(self, service, client, base, library, wrong, status):
        answer = client.post(f"{base}/satellite/tiles", json={**self.AREA, **wrong})
        assert len(message(answer, status)) > 5
        with library.database.read() as session:
            assert not session.query(Job).count()

    def test_services_are_listed(self, service, client):
        (one,) = client.get("/api/v1/tile-services").json["services"]
        assert (one["name"], one["max_tiles"]) == ("Local", 30)


class TestUndo:
    @pytest.fixture
    def other(self, new_account, sign_in, client, base):
        """The browser of another editor."""
        bob = new_account("Bob")
        client.post(f"{base}/members", json={"name": "Bob", "role": "editor"})
        return sign_in(bob)

    @staticmethod
    def place(browser, base, id, x, y):
        changes = [{"id": id, "x_px": x, "y_px": y}]
        assert browser.patch(f"{base}/experiences", json={"changes": changes}).status_code == 200

    def test_an_image_stays_once_somebody_has_placed_photos_on_it(
        self, put, client, base, other, record, add_photos, photo
    ):
        add_photos({}, {})
        put(png(400, 300))
        self.place(other, base, 0, 10.0, 10.0)
        answer = client.post(f"{base}/undo")
        assert "Bob has placed photos on the satellite image" in message(answer, 409)
        assert record().satellite_width == 400 and photo(0).x_px == 10.0
        assert client.get(f"{base}/map.cfg").status_code == 200

    def test_an_earlier_image_does_not_come_back_under_photos_of_others(
        self, put, client, base, other, record, add_photos
    ):
        add_photos({})
        put(png(400, 300))
        put(png(500, 300))
        self.place(other, base, 0, 10.0, 10.0)
        assert client.post(f"{base}/undo").status_code == 409
        assert record().satellite_width == 500

    def test_photos_that_came_by_themselves_keep_their_image(self, put, client, base, record, add_photos):
        put(png(400, 300))
        add_photos({"x_px": 10.0, "y_px": 10.0})
        assert "photos were placed" in message(client.post(f"{base}/undo"), 409)
        assert record().satellite_width == 400

    def test_own_steps_are_undone_one_by_one_and_done_again(
        self, put, client, base, record, add_photos, photo
    ):
        add_photos({})
        put(png(400, 300))
        self.place(client, base, 0, 350.0, 10.0)
        self.place(client, base, 0, 20.0, 10.0)
        for _ in range(3):
            assert client.post(f"{base}/undo").status_code == 200
        assert record().satellite_path is None and photo(0).x_px is None
        for _ in range(3):
            assert client.post(f"{base}/redo").status_code == 200
        assert record().satellite_width == 400 and photo(0).x_px == 20.0

    def test_what_others_have_taken_back_is_no_reason(self, put, client, base, other, record, add_photos):
        add_photos({})
        put(png(400, 300))
        self.place(other, base, 0, 10.0, 10.0)
        assert other.post(f"{base}/undo").status_code == 200
        assert client.post(f"{base}/undo").status_code == 200
        assert record().satellite_path is None
