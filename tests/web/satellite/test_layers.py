"""Pages of a map may show tiles of the configured services, and no others."""

import dataclasses
import io
import json
import sqlite3
from contextlib import closing

import pytest
from PIL import Image

PAGES = ("/maps/{park}/edit", "/maps/{park}/localize", "/maps/{park}/image", "/field")


@pytest.mark.parametrize("page", PAGES)
def test_the_pages_of_a_map_may_load_images_of_these_services(client, park, page):
    policy = client.get(page.format(park=park)).headers["Content-Security-Policy"]
    (images,) = [rule for rule in policy.split("; ") if rule.startswith("img-src")]
    assert "https://tile.openstreetmap.org" in images.split()
    assert "tile.openstreetmap" not in client.get("/").headers["Content-Security-Policy"]


@pytest.fixture
def services(app, tmp_path):
    """Let the server offer the services of a file; return a function that writes it."""
    file = tmp_path / "services.json"
    state = app.extensions["expmap"]
    app.extensions["expmap"] = dataclasses.replace(
        state, settings=dataclasses.replace(state.settings, tile_services=file)
    )
    return file.write_text


def service(name, **fields):
    host = f"https://{name}.example"
    return {"name": name, "url": host + "/{z}/{x}/{y}", "attribution": "© us", "max_zoom": 18, **fields}


def test_what_the_server_names_is_offered_and_nothing_else(client, park, services):
    services(json.dumps([{**service("t"), "name": "<Plan>"}]))
    page = client.get(f"/maps/{park}/edit")
    assert "https://t.example" in page.headers["Content-Security-Policy"]
    assert "openstreetmap" not in page.headers["Content-Security-Policy"]
    assert 'data-url="https://t.example/{z}/{x}/{y}" data-attribution="© us" data-max-zoom="18"' in page.text
    assert ">&lt;Plan&gt;<" in page.text
    assert page.text.count("data-max-zoom") == 1


@pytest.mark.parametrize("content", ["", "[{", "[]", '[{"name": "x"}]'])
def test_a_file_that_cannot_be_used_takes_no_page_down(client, park, services, caplog, content):
    services(content)
    for page in PAGES:
        answer = client.get(page.format(park=park))
        assert (answer.status_code, answer.text.count("data-max-zoom")) == (200, 0)
    assert "no map tile services are offered: " in caplog.text


@pytest.fixture
def picture():
    file = io.BytesIO()
    Image.new("RGB", (300, 200), "green").save(file, "PNG")
    return file.getvalue()


def test_visitors_get_the_addresses_of_public_services_only(client, stranger, park, services, put, picture):
    corners = {"top_left": {"lat": 50.1, "lon": 14.4}, "bottom_right": {"lat": 50.09, "lon": 14.42}}
    assert put(picture, corners=corners).status_code == 200
    paid = service("paid", url="https://paid.example/{z}/{x}/{y}?key=SECRET")
    services(json.dumps([service("open", public=True), paid]))
    url = client.post(f"/api/v1/maps/{park}/shares", json={}).json["url"]
    token = url.rsplit("/", 1)[-1]
    for address in (f"/s/{token}", f"/embed/{token}"):
        answer = stranger.get(address)
        assert answer.status_code == 200 and "https://open.example/{z}/{x}/{y}" in answer.text
        assert "SECRET" not in answer.text and "paid" not in answer.headers["Content-Security-Policy"]
    assert "SECRET" in client.get(f"/maps/{park}/edit").text


def test_a_file_of_tiles_is_shown_by_this_server(client, stranger, park, services, tmp_path):
    with closing(sqlite3.connect(tmp_path / "park.mbtiles")) as database:
        database.execute("CREATE TABLE tiles (zoom_level, tile_column, tile_row, tile_data BLOB)")
        database.execute("INSERT INTO tiles VALUES (1, 0, 1, ?)", (b"\xff\xd8\xff a picture",))
        database.commit()
    own = {"name": "Own / map", "file": "park.mbtiles", "attribution": "© us", "max_zoom": 1}
    services(json.dumps([own, {**own, "name": "Open", "public": True}, service("t")]))
    page = client.get(f"/maps/{park}/edit")
    assert "/api/v1/tile-services/Own%20%2F%20map/tiles/{z}/{x}/{y}" in page.text
    (found, *_) = client.get("/api/v1/tile-services").json["services"]
    tile = client.get(found["url"].format(z=1, x=0, y=0))
    assert (tile.status_code, tile.mimetype, tile.data) == (200, "image/jpeg", b"\xff\xd8\xff a picture")
    for z, x, y in ((1, 1, 0), (2, 0, 0), (1, 2, 0), (0, 0, 0)):
        assert client.get(found["url"].format(z=z, x=x, y=y)).status_code == 404
    assert client.get("/api/v1/tile-services/t/tiles/0/0/0").status_code == 404
    assert stranger.get(found["url"].format(z=1, x=0, y=0)).status_code == 401
    assert stranger.get("/api/v1/tile-services/Open/tiles/1/0/0").status_code == 200
