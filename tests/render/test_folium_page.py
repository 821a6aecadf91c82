"""The exported page is self-contained, and its image is georeferenced."""

import math
from dataclasses import replace

import cv2
import numpy as np
import pytest

from webapp.core.geo.georeference import Georeference
from webapp.errors import UsageError
from webapp.files.maps.folder import read_map, write_map
from webapp.render import folium_page
from webapp.render.mercator import to_mercator
from webapp.settings import Settings
from webapp.tasks.exchange.export_source import of_folder

TURNED = Georeference("EPSG:4326", (1.5e-5, 4e-6, 26.5, 2e-6, -7.5e-6, 60.4, 0, 0, 1), "affine")
TITLE = "</title><script>window.hacked = 1</script>"
NAME = "photos/1 </script><script>window.hacked=1<img src=x onerror=hacked()>.jpg".replace("</", "<")


@pytest.fixture
def source(make_map, tmp_path):
    cfg = make_map(tmp_path / "folder", 3)
    map_ = read_map(cfg)
    (cfg.parent / "photos" / "1.jpg").rename(cfg.parent / NAME)
    first, second, third = map_.experiences
    second = replace(second, photo=NAME, heading_deg=90.0)
    write_map(cfg, replace(map_, experiences=(first, second, third)))
    return of_folder(cfg, title=TITLE)


def page_of(source):
    return b"".join(folium_page.export_map_page(source, settings=Settings()).pieces)


def test_nothing_of_it_is_on_a_server(source):
    page = page_of(source).decode()
    for attribute in ('src="http', "src='http", 'href="http', "url(http", "@import"):
        assert attribute not in page


def test_too_many_photos_for_a_page(source, monkeypatch):
    monkeypatch.setattr(folium_page, "MAX_PHOTOS", 2)
    with pytest.raises(UsageError, match="2 photos"):
        page_of(source)


def test_without_image_the_markers_are_left(source):
    (source.cfg.parent / "plan.png").unlink()
    script = page_of(source).rsplit(b"</head>", 1)[-1]
    assert b"L.imageOverlay(" not in script
    assert script.count(b'"Feature"') == 3


def test_a_turned_image_is_redrawn_where_it_is():
    picture = np.full((200, 400, 3), 50, np.uint8)
    spots = {(40, 30): (255, 0, 0), (350, 160): (0, 255, 0), (200, 100): (0, 0, 255)}
    for (x, y), colour in spots.items():
        cv2.circle(picture, (x, y), 5, colour, -1)
    drawn = to_mercator(picture, TURNED, size=(400, 200))
    height, width = drawn.pixels.shape[:2]
    top, bottom = (math.asinh(math.tan(math.radians(v))) for v in (drawn.north, drawn.south))
    for (x, y), colour in spots.items():
        lat, lon = TURNED.latlon_from_pixel([(x + 0.5, y + 0.5)])[0]
        column = (lon - drawn.west) / (drawn.east - drawn.west) * width
        row = (top - math.asinh(math.tan(math.radians(lat)))) / (top - bottom) * height
        assert drawn.pixels[int(row), int(column)].tolist() == [*colour, 255]
    assert drawn.pixels[0, 0, 3] == 0, "outside the turned image it is transparent"


def test_an_image_that_reaches_beyond_the_horizon_is_not_redrawn():
    horizon = Georeference("EPSG:4326", (1e-5, 0, 26.5, 0, -1e-5, 60.4, -1 / 150, 0, 1), "projective")
    assert to_mercator(np.zeros((20, 40, 3), np.uint8), horizon, size=(400, 200)) is None
