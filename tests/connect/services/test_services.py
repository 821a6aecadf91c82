"""Layers of WMS and WMTS: each pixel of an image made of them is where it belongs, and services that lie."""

import json

import numpy as np
import pytest
from PIL import Image

from tests.connect.services.map_server import serving
from webapp.app import main as program
from webapp.connect.services.capabilities import Where, capabilities_address, parse_capabilities
from webapp.core.geo.tilegrid import GeoBox
from webapp.errors import InputError
from webapp.net.tiles import tile_services
from webapp.progress import Progress
from webapp.settings import Settings, TileSettings
from webapp.store.library import open_library
from webapp.store.maps import maps
from webapp.store.schema import Account
from webapp.tasks.satellite.tiles import TileRequest, fetch_tiles

LANDMARKS = [(50.0765, 14.4164), (50.0771, 14.4187), (50.0779, 14.4172)]
BOX = GeoBox(north=50.0783, south=50.0760, west=14.4155, east=14.4196)


@pytest.fixture
def expmap(capsys):
    """Runs a command and returns exit code, standard output and standard error."""

    def call(*words):
        with pytest.raises(SystemExit) as ended:
            program.main(["connect", "services", *map(str, words)])
        output = capsys.readouterr()
        return ended.value.code, output.out, output.err

    return call


@pytest.fixture
def server():
    with serving() as maps_of_town:
        maps_of_town.landmarks = LANDMARKS
        yield maps_of_town


@pytest.fixture
def image_of(tmp_path):
    """Fetch an area from the first service of a file; return its pixels and its georeference."""
    library = open_library(tmp_path / "library")

    def fetch(services, zoom):
        with library.database.write() as session:
            account = Account(name="Eva", is_owner=True)
            session.add(account)
            session.flush()
            map_id = maps.create(session, "Park", account_id=account.id).id
        settings = Settings(tile_services=services, tiles=TileSettings(requests_per_second=1000.0))
        request = TileRequest(tile_services(services)[0].name, BOX, zoom)
        new = fetch_tiles(library, map_id, request=request, settings=settings, progress=Progress()).new
        pixels = np.asarray(Image.open(library.map_folder("park") / new.path).convert("RGB")).astype(int)
        return pixels, new.image.georeference

    yield fetch
    library.database.close()


def crosses(pixels):
    """Return the centres of the red crosses."""
    red = (pixels[:, :, 0] > 200) & (pixels[:, :, 1] < 60) & (pixels[:, :, 2] < 60)
    return sorted(
        (int(x), int(y))
        for y, x in zip(*np.nonzero(red), strict=True)
        if red[max(y - 3, 0) : y + 4, x].sum() == 7 and red[y, max(x - 3, 0) : x + 4].sum() == 7
    )


def entry(address, tmp_path, expmap, *options):
    out = tmp_path / "services.json"
    code, said, error = expmap(address, "--add", out, *options)
    assert (code, error) == (0, ""), error
    assert said.startswith("added ")
    return out, json.loads(out.read_text())[-1]


def test_the_layers_of_a_wms_are_listed_with_what_prevents_their_use(server, expmap):
    code, said, _ = expmap(f"{server.url}/wms?map=town")
    assert code == 0
    assert said.splitlines() == [
        "degrees: In degrees (up to zoom 20, image/jpeg, image/png)",
        "ortho & more: Aerial photos (up to zoom 19, image/jpeg, image/png)",
        "whole: One picture (only the whole picture can be fetched)",
        "local: Only local (it has neither EPSG:3857 nor EPSG:4326, but EPSG:25833)",
    ]
    assert server.asked == ["/wms?map=town&SERVICE=WMS&REQUEST=GetCapabilities&VERSION=1.3.0"]


def test_the_layers_of_a_wmts_are_listed(server, expmap):
    code, said, _ = expmap(f"{server.url}/wmts")
    assert code == 0
    first, second, third = said.splitlines()
    assert first == "rest: By address (up to zoom 18, image/png)"
    assert second == "kvp: By parameters (up to zoom 17, image/png)"
    assert third.startswith("local: Another grid (it does not have the usual grid of web Mercator")


@pytest.mark.parametrize(
    ("path", "layer", "options"),
    [
        ("/wms?map=town", "ortho & more", ["--picture", "png"]),
        ("/wms?map=town", "degrees", ["--picture", "png"]),
        ("/wmts", "rest", []),
        ("/wmts", "kvp", []),
    ],
)
def test_an_image_of_a_layer_is_right_to_a_pixel(server, tmp_path, expmap, image_of, path, layer, options):
    services, added = entry(f"{server.url}{path}", tmp_path, expmap, "--layer", layer, *options)
    pixels, georeference = image_of(services, 17)
    at = georeference.pixel_from_latlon(LANDMARKS)
    assert crosses(pixels) == sorted((int(x), int(y)) for x, y in np.floor(at).tolist())
    assert added["public"] is False


def test_an_entry_has_what_the_service_says_and_what_is_wished(server, tmp_path, expmap):
    _, plain = entry(f"{server.url}/wms?map=town", tmp_path, expmap, "--layer", "ortho & more")
    assert plain == {
        "name": "Aerial photos",
        "url": f"{server.url}/wms?map=town&SERVICE=WMS&VERSION=1.3.0&REQUEST=GetMap&LAYERS=ortho%20%26%20more"
        "&STYLES=&CRS=EPSG:3857&WIDTH=256&HEIGHT=256&FORMAT=image/jpeg&BBOX={bbox}",
        "attribution": "© Town (CC BY 4.0)",
        "max_zoom": 19,
        "public": False,
    }
    wished = ["--name", "Ours", "--attribution", "Us", "--max-zoom", 15, "--public"]
    file, own = entry(f"{server.url}/wmts", tmp_path, expmap, "--layer", "rest", *wished)
    assert [own[name] for name in ("name", "attribution", "max_zoom", "public")] == ["Ours", "Us", 15, True]
    assert own["url"] == f"{server.url}/rest/plain%20style/2026/GoogleMapsCompatible/{{z}}/{{y}}/{{x}}.png"
    entry(f"{server.url}/wmts", tmp_path, expmap, "--layer", "kvp", "--name", "Ours")
    assert [one["name"] for one in json.loads(file.read_text())] == ["Aerial photos", "Ours"]
    assert [service.attribution for service in tile_services(file)] == ["© Town (CC BY 4.0)", "Town survey"]


def test_a_wms_that_names_itself_by_an_inner_address_is_asked_where_it_was_found(server, tmp_path, expmap):
    server.base = "http://10.0.0.7:8080/geoserver/wms"
    _, added = entry(f"{server.url}/wms?map=town", tmp_path, expmap, "--layer", "ortho & more")
    assert added["url"].startswith(f"{server.url}/wms?map=town&SERVICE=WMS&")


@pytest.mark.parametrize(
    "elsewhere", ["http://10.0.0.7", "http://localhost", "file:///etc", "http://a@127.0.0.1"]
)
def test_tiles_of_another_host_need_its_name(server, expmap, elsewhere, tmp_path):
    server.tiles = elsewhere
    code, said, _ = expmap(f"{server.url}/wmts")
    assert (code, "rest: By address (its tiles are on another host" in said) == (0, True)
    code, _, error = expmap(f"{server.url}/wmts", "--layer", "rest", "--add", tmp_path / "new.json")
    assert (code, "another host" in error) == (2, True)
    assert not (tmp_path / "new.json").exists()


def test_another_host_can_be_trusted(server, expmap):
    server.tiles = f"http://localhost:{server.port}"
    assert "rest: By address (up to zoom" in expmap(f"{server.url}/wmts", "--host", "LOCALHOST")[1]


REPORT = (
    b'<ServiceExceptionReport><ServiceException code="LayerNotDefined">No layer ortho</ServiceException>'
    b"</ServiceExceptionReport>"
)
BOMB = b'<!DOCTYPE a [<!ENTITY a "aaaa">]><WMS_Capabilities>&a;</WMS_Capabilities>'


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        ((404, "text/html", b"gone"), "the service answered 404"),
        ((302, "text/html", b"http://169.254.169.254/"), "redirects to http://169.254.169.254/"),
        ((200, "text/html", b"<html><p>Hello"), "it is <html>"),
        ((200, "application/json", b"{}"), "the XML is damaged"),
        ((200, "text/xml", b""), "the XML is damaged"),
        ((200, "text/xml", REPORT), "No layer ortho"),
        ((200, "text/xml", BOMB), "declares a document type or entities"),
        ((200, "text/xml", b"<WMS_Capabilities>" + b"<Layer>" * 1000), "nested more than 60 deep"),
        ((200, "text/xml", b"<WMT_MS_Capabilities version='1.1.1'/>"), "it is <WMT_MS_Capabilities>"),
        ((200, "text/xml", b"<WMS_Capabilities/>"), "the service has no layers"),
        ((200, "text/xml", b"<Capabilities/>"), "it is <Capabilities>"),
        ((200, "text/xml", b" " * 20_000_001), "more than 20 MB"),
    ],
)  # fmt: skip
def test_what_is_no_capabilities_document_is_named(server, expmap, answer, said):
    server.answers["/wms"] = answer
    code, out, error = expmap(f"{server.url}/wms")
    assert (code, out) == (1, "")
    assert said in error


def test_a_dead_service_and_bad_addresses(expmap):
    code, _, error = expmap("http://127.0.0.1:1/wms")
    assert (code, "cannot be reached" in error) == (1, True)
    for address in (
        "ftp://a.test/",
        "wms",
        "http://",
        "http://u:p@a.test/",
        "http://a.test/{x}",
        "http://[::1",
    ):
        code, _, error = expmap(address)
        assert (code, "not a web address" in error) == (2, True), address


@pytest.mark.parametrize(
    ("answer", "said"),
    [
        ((200, "text/xml", REPORT), "did not send a tile: No layer ortho"),
        ((200, "image/png", b"\x89PNG\r\n\x1a\n broken"), "damaged tile"),
        ((200, "image/png", None), "a tile of (512, 512) pixels"),
        ((403, "text/plain", b"no"), "answered 403"),
    ],
)
def test_a_layer_is_added_only_if_it_sends_tiles(server, expmap, tmp_path, answer, said):
    status, kind, body = answer
    if body is None:
        Image.new("RGB", (512, 512)).save(tmp_path / "large.png")
        body = (tmp_path / "large.png").read_bytes()
    server.answers["/kvp"] = (status, kind, body)
    out = tmp_path / "services.json"
    known = {"name": "A", "url": "http://a.test/{z}/{x}/{y}", "attribution": "A", "max_zoom": 3}
    out.write_text(before := json.dumps([known]))
    code, _, error = expmap(f"{server.url}/wmts", "--layer", "kvp", "--add", out)
    assert (code, said in error) == (1, True), error
    assert out.read_text() == before


def test_options_that_do_not_fit_are_refused(server, expmap, tmp_path):
    out = tmp_path / "services.json"
    assert "belong together" in expmap(f"{server.url}/wmts", "--layer", "kvp")[2]
    assert "does not have this layer" in expmap(f"{server.url}/wmts", "--layer", "x", "--add", out)[2]
    assert "use png" in expmap(f"{server.url}/wmts", "--layer", "kvp", "--picture", "jpeg", "--add", out)[2]
    out.write_text("[]")
    code, _, error = expmap(f"{server.url}/wmts", "--layer", "kvp", "--add", out)
    assert (code, "does not hold a list of services" in error) == (2, True)


@pytest.mark.parametrize(
    ("given", "asked"),
    [
        ("https://a.test/wms", "https://a.test/wms?SERVICE=WMS&REQUEST=GetCapabilities&VERSION=1.3.0"),
        ("https://a.test/WMTS?k=%20", "https://a.test/WMTS?k=%20&SERVICE=WMTS&REQUEST=GetCapabilities&VERSION=1.0.0"),
        ("https://a.test/1.0.0/WMTSCapabilities.xml", "https://a.test/1.0.0/WMTSCapabilities.xml"),
        ("https://a.test/?Request=GetCapabilities&x", "https://a.test/?Request=GetCapabilities&x"),
        ("https://a.test/?service=WMTS", "https://a.test/?SERVICE=WMTS&REQUEST=GetCapabilities&VERSION=1.0.0"),
    ],
)  # fmt: skip
def test_addresses_are_completed(given, asked):
    assert capabilities_address(given) == asked


def test_a_hostile_document_costs_little():
    many = b"<WMS_Capabilities>" + b"<a/>" * 1_100_000 + b"</WMS_Capabilities>"
    with pytest.raises(InputError, match="more than 1000000 others inside"):
        parse_capabilities(many, Where("http://a.test/", frozenset()))
