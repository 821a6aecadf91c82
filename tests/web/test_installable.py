"""The manifest, the service worker and its cache."""

import json
import re

import pytest


@pytest.fixture
def worker(stranger):
    """Return the version and files at the start of the service worker."""
    answer = stranger.get("/sw.js")
    assert answer.status_code == 200 and answer.mimetype == "text/javascript"
    return json.loads(re.match(r"const SHELL = (.*);\n", answer.text)[1])


def test_the_manifest_names_icons_that_are_there(stranger):
    manifest = stranger.get("/manifest.webmanifest")
    assert manifest.mimetype == "application/manifest+json"
    result = manifest.json
    assert result["start_url"] == result["scope"] == "/" and result["display"] == "standalone"
    assert {"192x192", "512x512"} <= {icon["sizes"] for icon in result["icons"]}
    for icon in result["icons"]:
        with stranger.get(icon["src"]) as image:
            assert image.status_code == 200 and image.mimetype == "image/png"
            side = int(icon["sizes"].partition("x")[0])
            assert int.from_bytes(image.data[16:20]) == int.from_bytes(image.data[20:24]) == side


def test_every_file_that_is_kept_is_there(stranger, worker):
    assert any("js/field/main.js" in address for address in worker["files"])
    for address in worker["files"]:
        with stranger.get(address) as file:
            assert file.status_code == 200, address


@pytest.mark.parametrize(
    "page", ["/", "/field", "/offline", "/missions", "/maps/park/edit", "/maps/park/localize"]
)
def test_all_that_a_page_needs_without_a_network_is_kept(client, park, worker, page):
    named = set(re.findall(r'(?:src|href|content)="(/static/[^"#]+)', client.get(page).text))
    assert len(named) > 3 and named <= set(worker["files"])


def test_the_policy_lets_no_other_worker_in(client):
    assert "worker-src 'self'" in client.get("/").headers["Content-Security-Policy"]


def test_the_page_for_the_field_is_for_people_with_an_account(client, stranger):
    assert client.get("/field").status_code == 200
    assert stranger.get("/field").status_code == 302


def test_pages_that_were_kept_learn_who_is_signed_in(client, stranger, owner):
    result = client.get("/api/v1/session").json
    assert result["account"] == owner.id and len(result["csrf"]) > 20
    assert f'name="expmap-account" content="{owner.id}"' in client.get("/").text
    assert stranger.get("/api/v1/session").status_code == 401
    client.csrf = False
    made = client.post("/api/v1/maps", json={"name": "x"}, headers={"X-CSRFToken": result["csrf"]})
    assert made.status_code == 201
