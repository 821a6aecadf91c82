"""Remote PMTiles and cloud-optimised GeoTIFFs as layers and as images of maps, read in parts."""

import io
import json
from dataclasses import replace

import numpy as np
import pytest
from PIL import Image

from tests.files.test_tile_archive import write_pmtiles
from tests.net.range_server import serving
from webapp.core.geo.tilegrid import Tile, tile_box, tile_metres
from webapp.errors import InputError, UsageError
from webapp.net.ranges import BLOCK
from webapp.net.tiles import TileService, tile_services
from webapp.progress import Progress
from webapp.settings import RemoteSettings, Settings
from webapp.store.maps import maps
from webapp.tasks.satellite.tile_files import opened_archive
from webapp.tasks.satellite.tiles import TileRequest, fetch_tiles

ZOOM, X, Y = 17, 71300, 44300
LOCAL = RemoteSettings(enabled="yes", private_hosts="127.0.0.0/8")
ADDRESS = f"/api/v1/tile-services/Town/tiles/{ZOOM}/{X}/{Y}"


def png(colour):
    file = io.BytesIO()
    Image.new("RGB", (256, 256), colour).save(file, "PNG")
    return file.getvalue()


@pytest.fixture
def pmtiles(tmp_path):
    """A file of four tiles, the first of them red; the rest are far away."""
    path = tmp_path / "a.pmtiles"
    colours = [(255, 0, 0), (0, 255, 0), (0, 0, 255), (90, 90, 90)]
    tiles = [(ZOOM, X + n % 2, Y + n // 2, png(colour)) for n, colour in enumerate(colours)]
    noise = np.random.default_rng(1).bytes(4 * BLOCK)
    write_pmtiles(path, [*tiles, (ZOOM, X + 500, Y + 500, b"\x89PNG\r\n\x1a\n" + noise)])
    return path.read_bytes()


def write_tiff(path, *, bands=3, plane="EPSG:3857", tiled=True, dtype="uint8", side=1024, **more):
    """Write an image that covers two times two tiles: its left half is red."""
    rasterio = pytest.importorskip("rasterio")
    west, _, _, north = tile_metres(Tile(X, Y), ZOOM)
    _, south, east, _ = tile_metres(Tile(X + 1, Y + 1), ZOOM)
    pixels = np.zeros((bands, side, side), dtype)
    pixels[0, :, : side // 2] = 255
    pixels[3:] = 255
    if plane == "EPSG:4326":
        first, last = tile_box(Tile(X, Y), ZOOM), tile_box(Tile(X + 1, Y + 1), ZOOM)
        west, south, east, north = first.west, last.south, last.east, first.north
    transform = rasterio.Affine((east - west) / side, 0, west, 0, (south - north) / side, north)
    about = {"width": side, "height": side, "count": bands, "dtype": dtype, "crs": plane or None}
    tiles = {"tiled": True, "blockxsize": 256, "blockysize": 256} if tiled else {}
    with rasterio.open(path, "w", driver="GTiff", transform=transform, **about, **tiles, **more) as out:
        out.write(pixels)
        if tiled:
            out.build_overviews([2, 4], rasterio.enums.Resampling.nearest)
    return path.read_bytes()


@pytest.fixture
def offer(tmp_path, library):
    """Offer a file of a server as a tile service, and return the settings."""

    def make(address, remote=LOCAL):
        file = tmp_path / "services.json"
        service = {"name": "Town", "remote": address, "attribution": "© Town", "max_zoom": 19}
        file.write_text(json.dumps([service]))
        return replace(Settings(), library=library.folder, tile_services=file, remote=remote)

    return make


@pytest.fixture
def tile(tmp_path):
    """Read a tile of a remote file, (256, 256, 4), or None."""

    def read(address, *, zoom=ZOOM, x=X, y=Y, settings=LOCAL):
        service = TileService("Town", "", "", 19, remote=address)
        with opened_archive(service, cache=tmp_path / "cache", settings=settings) as archive:
            data = archive.tile(zoom, x, y)
        return None if data is None else np.asarray(Image.open(io.BytesIO(data)).convert("RGBA"))

    return read


def test_tiles_of_pmtiles_are_read_in_parts(pmtiles, tile):
    with serving(pmtiles) as server:
        assert tile(server.address)[0, 0].tolist() == [255, 0, 0, 255]
        assert tile(server.address, x=X + 1)[9, 9].tolist() == [0, 255, 0, 255]
        assert tile(server.address, x=X + 2) is None
        assert len(server.asked) < len(pmtiles) / BLOCK - 1


@pytest.mark.parametrize(
    ("bands", "plane"), [(1, "EPSG:3857"), (3, "EPSG:3857"), (4, "EPSG:3857"), (3, "EPSG:4326")]
)
def test_tiles_of_a_geotiff_are_made_from_parts_of_it(tmp_path, tile, bands, plane):
    content = write_tiff(tmp_path / "a.tif", bands=bands, plane=plane)
    with serving(content) as server:
        found = tile(server.address)
        assert found.shape == (256, 256, 4) and found[:, :, 3].min() == 255
        assert found[128, 100, :3].tolist() == ([255] * 3 if bands == 1 else [255, 0, 0])
        assert tile(server.address, x=X + 1)[128, 100, :3].tolist() == [0, 0, 0]
        assert tile(server.address, x=X + 2) is None
        coarse = tile(server.address, zoom=ZOOM - 2, x=X // 4, y=Y // 4)
        assert 0 < (coarse[:, :, 3] > 0).mean() < 0.3


def test_a_large_geotiff_is_not_fetched_as_a_whole(tmp_path, tile):
    content = write_tiff(tmp_path / "a.tif", side=2048, compress=None)
    with serving(content) as server:
        tile(server.address, zoom=ZOOM - 3, x=X // 8, y=Y // 8)
        assert len(server.asked) * BLOCK < len(content) / 3


@pytest.mark.parametrize(
    ("options", "message"),
    [
        ({"tiled": False}, "not tiled"),
        ({"plane": ""}, "no coordinate system"),
        ({"dtype": "uint16"}, "not bytes"),
        ({"bands": 2}, "neither one, three nor four"),
    ],
)
def test_other_tiffs_are_refused(tmp_path, tile, options, message):
    with serving(write_tiff(tmp_path / "a.tif", **options)) as server:
        with pytest.raises(InputError, match=message) as caught:
            tile(server.address)
        assert caught.value.hint


def test_faults_on_the_way_are_those_of_the_server(tmp_path, tile):
    content = write_tiff(tmp_path / "a.tif", side=2048)
    with serving(content) as server:
        assert tile(server.address) is not None
        server.tag = '"2"'
        with pytest.raises(InputError, match="changed while"):
            tile(server.address, x=X + 1, y=Y + 1)
        with pytest.raises(InputError, match=r"more than 0\.1 MB|at once"):
            tile(server.address, settings=replace(LOCAL, most_mb=0.1, check_s=0.0))
    with serving(b"II*\0" + bytes(100)) as server, pytest.raises(InputError, match="cannot be read"):
        tile(server.address)
    with serving(b"neither of them") as server, pytest.raises(InputError, match="neither PMTiles"):
        tile(server.address)


def test_a_remote_file_is_the_image_of_a_map(pmtiles, library, owner, new_map, offer):
    slug = new_map(owner)
    with serving(pmtiles) as server, library.database.read() as session:
        record = maps.find(session, slug, account=owner)
        box = tile_box(Tile(X, Y), ZOOM)
        request = TileRequest("Town", box, ZOOM)
        settings = offer(server.address)
        found = fetch_tiles(library, record.id, request=request, settings=settings, progress=Progress())
    image = np.asarray(Image.open(library.map_folder(slug) / found.new.path).convert("RGB"))
    assert (image[10, 10].tolist(), found.missing, found.attribution) == ([255, 0, 0], 0, "© Town")


def test_a_remote_file_is_a_layer_only_if_it_is_allowed(pmtiles, client, app, offer):
    with serving(pmtiles) as server:
        allowed = offer(server.address)
        app.extensions["expmap"] = replace(app.extensions["expmap"], settings=allowed)
        assert [one["name"] for one in client.get("/api/v1/tile-services").json["services"]] == ["Town"]
        answer = client.get(ADDRESS)
        assert (answer.status_code, answer.content_type, answer.data) == (200, "image/png", png((255, 0, 0)))
        off = replace(allowed, remote=RemoteSettings())
        app.extensions["expmap"] = replace(app.extensions["expmap"], settings=off)
        assert client.get("/api/v1/tile-services").json["services"] == []
        answer = client.get(ADDRESS)
        assert (answer.status_code, "remote.enabled" in answer.json["error"]["hint"]) == (400, True)


@pytest.mark.parametrize(
    "fields",
    [
        {"remote": "ftp://a.example/b"},
        {"remote": "https://a@b.example/c"},
        {"remote": "https://a.example/b", "file": "c"},
        {"remote": 7},
        {},
    ],
)
def test_wrong_entries_are_refused(tmp_path, fields):
    file = tmp_path / "services.json"
    file.write_text(json.dumps([{"name": "Town", "attribution": "© Town", "max_zoom": 19, **fields}]))
    with pytest.raises(UsageError, match=r"not a web address|invalid value"):
        tile_services(file)
