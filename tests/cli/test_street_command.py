"""`expmap map street-photos` for people and scripts."""

import json
from dataclasses import replace

import pytest

from tests.street_server import Shot, street
from webapp.core.geo.georeference import Georeference
from webapp.files.maps.folder import read_map, write_map

PLACE = Georeference("EPSG:4326", (1e-5, 0, 14.4, 0, -1e-5, 50.1, 0, 0, 1), "corners")


@pytest.fixture
def service(monkeypatch):
    with street(Shot("a1", 50.0996, 14.4005), Shot("b2", 50.0988, 14.4015)) as server:
        monkeypatch.setenv("EXPMAP_STREET_PANORAMAX", server.base)
        monkeypatch.setenv("EXPMAP_STREET_REQUESTS_PER_SECOND", "1000")
        yield server


@pytest.fixture
def cfg(tmp_path, make_map):
    cfg = make_map(tmp_path / "park", 2)
    write_map(cfg, replace(read_map(cfg), georeference=PLACE))
    return cfg


def test_count_and_size_are_said_and_nothing_is_downloaded(expmap, cfg, service):
    before = cfg.read_bytes()
    code, out, err = expmap("map", "street-photos", cfg, "--dry-run", "--json")
    assert code == 0
    found = json.loads(out)
    assert (found["service"], found["found"], found["to_download"], found["added"]) == ("Panoramax", 2, 2, 0)
    assert found["licences"] == {"CC-BY-SA-4.0": 2} and found["authors"] == 1
    assert found["size_mb"] == pytest.approx(2 * 2048 * 1536 * 0.25 / 1e6, abs=1e-3)
    assert "2 photos to download, about 1.6 MB; licences CC-BY-SA-4.0: 2" in err
    assert cfg.read_bytes() == before and not service.photos_asked()


def test_photos_are_added_once(expmap, cfg, service):
    code, out, err = expmap("map", "street-photos", cfg)
    assert (code, out) == (0, "2 photos added, 0 failed\n")
    code, out, err = expmap("map", "street-photos", cfg, "--source", "panoramax")
    assert (code, out) == (0, "0 photos added, 0 failed\n")
    assert "2 in the map already" in err
    sources = [e.source.id for e in read_map(cfg).experiences if e.source is not None]
    assert sorted(sources) == ["a1", "b2"]


def test_an_area_in_degrees_or_in_pixels(expmap, cfg, service):
    for area in (("--bbox", "14.40,50.099,14.401,50.1"), ("--within", "0,0,100,100")):
        _, out, _ = expmap("map", "street-photos", cfg, *area, "--dry-run", "--json")
        assert json.loads(out)["to_download"] == 1
    code, _, err = expmap("map", "street-photos", cfg, "--bbox", "1,2,3")
    assert code == 2 and "four numbers separated by commas" in err
    code, _, err = expmap("map", "street-photos", cfg, "--bbox", "1,2,3,4", "--within", "1,2,3,4")
    assert code == 2 and "either --bbox or --within" in err


def test_a_photo_that_fails_is_named(expmap, cfg, service):
    service.failing["/photo/a1/sd"] = [404]
    code, out, _ = expmap("map", "street-photos", cfg)
    assert code == 1
    assert out.splitlines() == ["a1  Panoramax answered 404", "1 photos added, 1 failed"]


def test_without_a_service_one_sentence(expmap, cfg):
    code, out, err = expmap("map", "street-photos", cfg)
    assert (code, out) == (2, "")
    assert "no street-level service is set up (set street.panoramax or street.mapillary_token" in err


def test_the_token_is_not_printed(expmap, monkeypatch):
    monkeypatch.setenv("EXPMAP_STREET_MAPILLARY_TOKEN", "MLY|1|secret")
    for form in ((), ("--json",)):
        code, out, _ = expmap("settings", *form)
        assert code == 0 and "secret)" in out and "MLY" not in out
