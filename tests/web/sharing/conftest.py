"""Maps with a photo of stripes."""

import io
import json

import pytest
from PIL import Image

from tests.web.sharing.stripes import stripes


@pytest.fixture
def fill_map():
    """Give a map an image and a placed photo, and return its slug."""

    def fill(browser, slug):
        image = io.BytesIO()
        Image.new("RGB", (400, 300), "green").save(image, "PNG")
        image.seek(0)
        corners = {"top_left": {"lat": 50.1, "lon": 14.4}, "bottom_right": {"lat": 50.09, "lon": 14.42}}
        data = {"file": (image, "s.png"), "corners": json.dumps(corners)}
        browser.put(f"/api/v1/maps/{slug}/satellite", data=data)
        browser.post(f"/api/v1/maps/{slug}/photos", data={"file": [(io.BytesIO(stripes()), "a.jpg")]})
        place = {"changes": [{"id": 0, "x_px": 50.0, "y_px": 60.0}]}
        assert browser.patch(f"/api/v1/maps/{slug}/experiences", json=place).status_code == 200
        return slug

    return fill


@pytest.fixture
def full(client, park, fill_map):
    """A map with an image and a placed photo."""
    return fill_map(client, park)
