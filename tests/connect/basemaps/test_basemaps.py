"""The image of a map as a base map: other programs read the files, and each pixel is where it belongs."""

import io
import json
import math
import sqlite3
from contextlib import closing

import numpy as np
import pmtiles.reader
import pytest
from PIL import Image
from pyproj import Transformer

from webapp.app import main as program
from webapp.files.satellite.tile_archive import opened_tiles

MARK = (130.5, 70.5)
SIZE = (300, 200)
COS, SIN = 0.3 * math.cos(math.radians(30)), 0.3 * math.sin(math.radians(30))
MATRIX = np.array([[COS, SIN, 458000.0], [SIN, -COS, 5548000.0], [0.0, 0.0, 1.0]])


def exact_pixel(lat, lon, zoom):
    """Global pixel at a zoom, by the formula of slippy maps."""
    side = 256 * 2**zoom
    y = (1 - math.asinh(math.tan(math.radians(lat))) / math.pi) / 2
    return (lon + 180) / 360 * side, y * side


@pytest.fixture
def expmap(capsys):
    """Runs a command and returns exit code, standard output and standard error."""

    def call(*words):
        with pytest.raises(SystemExit) as ended:
            program.main([str(word) for word in words])
        output = capsys.readouterr()
        return ended.value.code, output.out, output.err

    return call


@pytest.fixture(params=["plan.png", "plan.jpg"])
def park(request, tmp_path):
    """A map whose image is turned by 30 degrees, 0.3 m per pixel, with a red square around `MARK`."""
    pixels = np.full((SIZE[1], SIZE[0], 3), (40, 160, 60), np.uint8)
    pixels[61:80, 121:140] = (255, 0, 0)
    Image.fromarray(pixels).save(tmp_path / request.param, quality=95)
    (tmp_path / "map.cfg").write_text(f"{request.param};{SIZE[0]};{SIZE[1]}\n")
    georeference = {"plane": "EPSG:32633", "plane_from_pixel": MATRIX.tolist(), "method": "corners"}
    (tmp_path / "map.json").write_text(
        json.dumps({"format": "experience-map", "version": 1, "georeference": georeference})
    )
    return tmp_path / "map.cfg"


def place(pixel):
    """Latitude and longitude of a pixel, by pyproj alone."""
    east, north, _ = MATRIX @ (*pixel, 1.0)
    lon, lat = Transformer.from_crs("EPSG:32633", "EPSG:4326", always_xy=True).transform(east, north)
    return lat, lon


def centre_of_red(pixels):
    """Mean column and row of the red pixels, outer-corner convention; `pixels` are red, green, blue."""
    rows, columns = np.nonzero((pixels[:, :, 0] > 180) & (pixels[:, :, 1] < 90))
    return columns.mean() + 0.5, rows.mean() + 0.5


def mosaic(read, zoom, tiles):
    """Join the tiles of a zoom; return their pixels, and the global pixel of their first."""
    left, top = (min(tile[axis] for tile in tiles) for axis in (0, 1))
    right, bottom = (max(tile[axis] for tile in tiles) for axis in (0, 1))
    joined = np.zeros(((bottom - top + 1) * 256, (right - left + 1) * 256, 4), np.uint8)
    for x, y in tiles:
        picture = Image.open(io.BytesIO(read(zoom, x, y))).convert("RGBA")
        joined[(y - top) * 256 :, (x - left) * 256 :][:256, :256] = np.asarray(picture)
    return joined, (left * 256, top * 256)


def tiles_of_mbtiles(path):
    with closing(sqlite3.connect(path)) as database:
        found = database.execute("SELECT zoom_level, tile_column, tile_row FROM tiles").fetchall()
    return {(zoom, x, (1 << zoom) - 1 - y) for zoom, x, y in found}


def test_tiles_are_where_the_image_is_at_every_zoom(park, expmap, tmp_path):
    out = tmp_path / "park.mbtiles"
    code, said, _ = expmap("connect", "basemaps", park, out)
    assert (code, said) == (0, f"wrote {out}: zoom 17 to 19\n")
    found = tiles_of_mbtiles(out)
    assert {zoom for zoom, _, _ in found} == {17, 18, 19}
    with opened_tiles(out) as archive:
        for zoom in (17, 18, 19):
            tiles = {(x, y) for z, x, y in found if z == zoom}
            pixels, (left, top) = mosaic(archive.tile, zoom, tiles)
            x, y = centre_of_red(pixels)
            expected = exact_pixel(*place(MARK), zoom)
            within = 0.25 if park.with_name("plan.png").exists() else 0.5  # JPEG blurs colours
            assert (x + left, y + top) == pytest.approx(expected, abs=within)
    assert sorted(path.name for path in tmp_path.iterdir() if path.name.startswith(".")) == []


def test_a_map_without_a_georeference_and_unknown_formats_are_refused(park, expmap, tmp_path):
    code, _, err = expmap("connect", "basemaps", park, tmp_path / "park.gpkg")
    assert (code, "use one of .mbtiles, .pmtiles, .tif" in err) == (2, True)
    (tmp_path / "map.json").unlink()
    code, _, err = expmap("connect", "basemaps", park, tmp_path / "park.mbtiles")
    assert (code, "the map has no georeference" in err) == (1, True)
    assert not (tmp_path / "park.mbtiles").exists()


def test_pmtiles_hold_the_same_tiles(park, expmap, tmp_path):
    for name in ("park.mbtiles", "park.pmtiles"):
        assert expmap("connect", "basemaps", park, tmp_path / name)[0] == 0
    with (tmp_path / "park.pmtiles").open("rb") as file:
        reader = pmtiles.reader.Reader(pmtiles.reader.MmapSource(file))
        header = reader.header()
        assert (header["min_zoom"], header["max_zoom"], reader.metadata()["name"]) == (17, 19, tmp_path.name)
        assert header["max_lon_e7"] / 1e7 == pytest.approx(place(SIZE)[1], abs=1e-6)
        read = dict(pmtiles.reader.all_tiles(reader.get_bytes))
    with opened_tiles(tmp_path / "park.mbtiles") as one, opened_tiles(tmp_path / "park.pmtiles") as other:
        for zoom, x, y in tiles_of_mbtiles(tmp_path / "park.mbtiles"):
            assert one.tile(zoom, x, y) == other.tile(zoom, x, y) == read.pop((zoom, x, y))
        assert other.tile(19, 0, 0) is None
    assert read == {}


@pytest.mark.parametrize("name", ["park.mbtiles", "park.tif"])
def test_gdal_reads_what_is_written(park, expmap, tmp_path, name):
    rasterio = pytest.importorskip("rasterio")
    assert expmap("connect", "basemaps", park, tmp_path / name)[0] == 0
    with rasterio.open(tmp_path / name) as opened:
        assert opened.crs.to_epsg() == 3857
        pixels = opened.read([1, 2, 3]).transpose(1, 2, 0)
        x, y = centre_of_red(pixels)
        east, north = opened.transform @ (x, y)
        if name.endswith(".tif"):
            assert opened.tags(ns="IMAGE_STRUCTURE")["LAYOUT"] == "COG"
    lat, lon = place(MARK)
    expected = Transformer.from_crs("EPSG:4326", "EPSG:3857", always_xy=True).transform(lon, lat)
    assert (east, north) == pytest.approx(expected, abs=0.2)


def test_a_zoom_can_be_chosen(park, expmap, tmp_path):
    out = tmp_path / "park.mbtiles"
    assert expmap("connect", "basemaps", park, out, "--zoom", 16)[0] == 0
    assert {zoom for zoom, _, _ in tiles_of_mbtiles(out)} == {16}
