"""GeoPackages from the web application, and their entries in its export menus."""

import re

import pytest

from tests.connect.gis.ogr import read_layers
from webapp.connect.gis import downloads

MEDIA_TYPE = "application/geopackage+sqlite3"


@pytest.fixture
def addresses(park, search):
    """The pages of a map and a mission, and their GeoPackages."""
    mission = search.removeprefix("mission-")
    return {
        "/maps/park-2/edit": "/api/v1/maps/park-2/export.gpkg",
        f"/missions/{mission}": f"/api/v1/missions/{mission}/export.gpkg",
    }


@pytest.fixture
def saved(client, library, tmp_path):
    """Download a GeoPackage, and return the features of its layers."""

    def save(address):
        with client.get(address) as answer:
            assert (answer.status_code, answer.content_type) == (200, MEDIA_TYPE)
            assert ".gpkg" in answer.headers["Content-Disposition"]
            path = tmp_path / "download.gpkg"
            path.write_bytes(answer.data)
        assert [*library.uploads.glob("*")] == []
        return read_layers(path)

    return save


def test_the_export_menus_lead_to_geopackages(client, addresses):
    for page, address in addresses.items():
        (label,) = re.findall(
            rf'href="{address}" download>(?:<svg.*?</svg>)?\s*([^<]+)', client.get(page).text
        )
        assert label == "GeoPackage (QGIS, QField)"
        with client.get(address) as answer:
            assert answer.status_code == 200


def test_a_map_is_saved_with_paths_as_in_its_zip(saved, park):
    layers = saved("/api/v1/maps/park-2/export.gpkg")
    assert [one["photo"] for one in layers["photos"]] == [f"{n}.jpg" for n in range(5)]
    assert [one["title"] for one in layers["notes"]] == ["Bench", "Lost"]


def test_a_mission_is_saved_thinned_if_asked(saved, search):
    address = f"/api/v1/missions/{search.removeprefix('mission-')}/export.gpkg"
    layers = saved(address)
    assert [line["poses"] for line in layers["tracks"]] == ["2", "2"]
    assert (len(layers["poses"]), len(layers["objects"])) == (4, 3)
    assert len(saved(f"{address}?points=2")["poses"]) == 4


def test_a_download_has_a_limit_of_poses(client, search, monkeypatch, library):
    monkeypatch.setattr(downloads, "_MOST_POSES", 3)
    answer = client.get(f"/api/v1/missions/{search.removeprefix('mission-')}/export.gpkg")
    assert answer.status_code == 400
    assert (answer.json["error"]["where"], "4 poses" in answer.json["error"]["message"]) == ("points", True)
    assert [*library.uploads.glob("*")] == []


def test_a_map_without_a_georeference_says_so(client, park):
    client.delete("/api/v1/maps/park-2/georeference")
    answer = client.get("/api/v1/maps/park-2/export.gpkg")
    assert answer.status_code == 400
    assert "no georeference" in answer.json["error"]["message"]


def test_only_who_has_a_role_downloads(addresses, new_account, sign_in, stranger):
    browser = sign_in(new_account("Eva"))
    for address in addresses.values():
        assert stranger.get(address).status_code == 401
        assert browser.get(address).status_code == 404
