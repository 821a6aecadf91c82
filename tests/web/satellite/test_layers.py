"""Pages of a map may show the tiles of the services that the server names, and no page of others."""

import dataclasses
import json

import pytest

PAGES = ("/maps/{park}/edit", "/maps/{park}/localize", "/maps/{park}/image", "/field")


@pytest.mark.parametrize("page", PAGES)
def test_the_pages_of_a_map_may_load_images_of_these_services(client, park, page):
    policy = client.get(page.format(park=park)).headers["Content-Security-Policy"]
    (images,) = [rule for rule in policy.split("; ") if rule.startswith("img-src")]
    assert "https://tile.openstreetmap.org" in images.split()
    assert "tile.openstreetmap" not in client.get("/").headers["Content-Security-Policy"]


def test_what_the_server_names_is_offered_and_nothing_else(client, park, app, tmp_path):
    file = tmp_path / "services.json"
    one = {"name": "<Plan>", "url": "https://t.example/{z}/{x}/{y}", "attribution": "© us", "max_zoom": 18}
    file.write_text(json.dumps([one]), encoding="utf-8")
    state = app.extensions["expmap"]
    app.extensions["expmap"] = dataclasses.replace(
        state, settings=dataclasses.replace(state.settings, tile_services=file)
    )
    page = client.get(f"/maps/{park}/edit")
    assert "https://t.example" in page.headers["Content-Security-Policy"]
    assert "openstreetmap" not in page.headers["Content-Security-Policy"]
    assert 'data-url="https://t.example/{z}/{x}/{y}" data-attribution="© us" data-max-zoom="18"' in page.text
    assert ">&lt;Plan&gt;<" in page.text
    assert page.text.count("data-max-zoom") == 1
