"""Pages of a map may show tiles of the configured services, and no others."""

import dataclasses
import io
import json

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
