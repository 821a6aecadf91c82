"""Search for places: off by default, one request at a time, each only once, and results validated."""

import dataclasses
from concurrent.futures import ThreadPoolExecutor

import pytest

from tests.geocoder_server import LUND, geocoding
from webapp import __version__
from webapp.errors import Busy, InputError, NotFound
from webapp.files.lock import rate_limited
from webapp.settings import GeocoderSettings, Settings
from webapp.tasks.satellite.geocode import geocode

GAP_S = 0.05


@pytest.fixture
def geocoder():
    with geocoding() as server:
        yield server


@pytest.fixture
def settings(tmp_path, geocoder):
    chosen = GeocoderSettings(address=geocoder.address, requests_per_second=1 / GAP_S)
    return Settings(library=tmp_path / "library", geocoder=chosen)


@pytest.fixture
def find(settings, tmp_path):
    def find(text, **changes):
        chosen = dataclasses.replace(settings.geocoder, **changes)
        return geocode(text, language="en", cache=tmp_path / "places", settings=chosen)

    return find


def test_a_place_is_found_by_its_name(client, geocoder):
    found = client.get("/api/v1/places?q=lund").json
    assert found["attribution"] == "© OpenStreetMap contributors"
    (place,) = found["places"]
    assert place["name"] == LUND["display_name"]
    assert (place["lat"], place["lon"]) == (55.7029, 13.1929)
    assert (place["south"], place["north"], place["west"], place["east"]) == (55.68, 55.74, 13.14, 13.25)
    assert geocoder.agents == {f"experience-map/{__version__} (search for a place by a person)"}
    (query,) = geocoder.asked
    assert query["format"] == ["jsonv2"] and query["accept-language"] == ["en"]


def test_nobody_is_asked_where_it_is_switched_off(geocoder, find):
    assert Settings().geocoder.address is None
    with pytest.raises(NotFound, match="place search is disabled here"):
        find("Lund", address=None)
    assert geocoder.asked == []


def test_only_who_is_signed_in_may_search(stranger, geocoder):
    assert stranger.get("/api/v1/places?q=Lund").status_code == 401
    assert geocoder.asked == []


def test_the_same_is_asked_once(find, geocoder):
    assert find("Lund") == find("  LUND ") == find("lund")
    assert find("Atlantis") == find("Atlantis") == ()
    assert len(geocoder.asked) == 2
    find("Lund", cache_days=1e-9)
    assert len(geocoder.asked) == 3


def test_there_is_a_pause_between_two_requests(find, geocoder):
    with ThreadPoolExecutor(4) as pool:
        list(pool.map(find, ["Lund a", "Lund b", "Lund c", "Lund d"]))
    first, *others = geocoder.times
    for one in others:
        assert one - first >= 0.9 * GAP_S
        first = one


def test_who_waits_too_long_is_told(tmp_path):
    turn = tmp_path / "turn"
    with (
        rate_limited(turn, gap_s=0.01, wait_s=1),
        pytest.raises(Busy),
        rate_limited(turn, gap_s=0.01, wait_s=0.01),
    ):
        pass


@pytest.mark.parametrize(
    ("status", "body", "words"),
    [
        (503, b"", "answered 503"),
        (302, b"", "answered 302"),
        (200, b"<html>", "did not send a list of places"),
        (200, b'{"error": "x"}', "did not send a list of places"),
        (200, b"[" + b" " * 2_000_000 + b"]", "too much data"),
    ],
)
def test_what_is_no_answer_is_an_error_and_not_kept(find, geocoder, status, body, words):
    geocoder.status, geocoder.body = status, body
    with pytest.raises(InputError, match=words):
        find("Lund")
    geocoder.status, geocoder.body = 200, None
    assert len(find("Lund")) == 1


def test_places_that_are_nowhere_are_left_out(find, geocoder):
    geocoder.body = (
        b'[{"lat": "95", "lon": "0", "display_name": "x", "boundingbox": ["0", "1", "0", "1"]},'
        b' {"lat": "nan", "lon": "0", "display_name": "x", "boundingbox": ["0", "1", "0", "1"]},'
        b' {"lat": "1", "lon": "0", "display_name": "x", "boundingbox": "0"}, 7, {}]'
    )
    assert find("Lund") == ()
