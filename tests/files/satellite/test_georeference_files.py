"""Corners, control points, world files and GeoTIFFs: strict reading, and clear errors."""

import json

import numpy as np
import pytest
import rasterio
from pyproj import CRS, Transformer
from rasterio.control import GroundControlPoint

from webapp.core.geo.crs import parse_crs
from webapp.core.geo.fit import ControlPoint, Corners
from webapp.core.geo.types import LatLon, MapPixel
from webapp.errors import GeoreferenceError, TableError
from webapp.files.satellite.georeference_files import (
    find_worldfile,
    parse_corners,
    read_control_points,
    read_corners,
    read_geotiff,
    read_worldfile,
)

UTM = Transformer.from_crs(32633, 4326, always_xy=True)
EAST, NORTH, METRES = 458_000.0, 5_548_000.0, 0.5
SIZE = {"width": 400, "height": 300}


def latlon_utm(x, y):
    lon, lat = UTM.transform(EAST + METRES * x, NORTH - METRES * y)
    return lat, lon


def check_utm(fit, *, within=1e-8):
    for pixel in ((0, 0), (400, 300), (123.25, 77.5)):
        assert fit.georeference.latlon_of(MapPixel(*pixel)) == pytest.approx(latlon_utm(*pixel), abs=within)


# corners


def test_corners_file(tmp_path, shared_data):
    corners = read_corners(shared_data / "satellite" / "corners.json")
    assert corners == Corners(LatLon(60.405512, 22.467667), LatLon(60.403959, 22.471285))


def corners_json(**changes):
    content = {"top_left": {"lat": 60.5, "lon": 22}, "bottom_right": {"lat": 60.25, "lon": 22.5}, **changes}
    return json.dumps({k: v for k, v in content.items() if v != "drop"}).encode()


def test_four_corners():
    data = corners_json(top_right={"lat": 60.5, "lon": 22.5}, bottom_left={"lat": 60.25, "lon": 22})
    corners = parse_corners(b"\xef\xbb\xbf" + data)
    assert corners.top_right == LatLon(60.5, 22.5)
    assert corners.bottom_left == LatLon(60.25, 22.0)


@pytest.mark.parametrize(
    ("data", "part"),
    [
        (corners_json(top_left="drop"), "$.top_left is missing"),
        (corners_json(bottom_right=[60, 22]), "$.bottom_right must be an object"),
        (corners_json(top_left={"lat": "60", "lon": 22}), "$.top_left.lat must be a number"),
        (corners_json(top_left={"lat": 60}), "$.top_left.lon is missing"),
        (corners_json(top_left={"lat": 60, "lng": 22}), "'lng'"),
        (corners_json(center={}), "'center'"),
        (b'{"top_left": {"lat": NaN, "lon": 1}}', "NaN"),
        (b'{"top_left": {"lat": 1, "lat": 2}}', "duplicate"),
        (b"[]", "must be an object"),
        (b"{", "not JSON"),
        (b"\xff\xfe", "UTF-8"),
    ],
)
def test_a_bad_corners_file_is_refused_with_its_path(data, part):
    with pytest.raises(GeoreferenceError) as caught:
        parse_corners(data, where="c.json")
    assert part in str(caught.value)
    assert caught.value.where.startswith("c.json")


def test_missing_files_are_reported(tmp_path):
    for read in (
        lambda p: read_corners(p),
        lambda p: read_worldfile(p, **SIZE),
        lambda p: read_geotiff(p),
    ):
        with pytest.raises(GeoreferenceError) as caught:
            read(tmp_path / "missing")
        assert caught.value.where == str(tmp_path / "missing")
    with pytest.raises(TableError):
        read_control_points(tmp_path / "missing")


# control points


def test_control_points(tmp_path):
    path = tmp_path / "points.csv"
    path.write_bytes("\ufeffx;y;lat;lon\r\n10;20.5;60.5;22\r\n\r\n1e2; 7 ;-60.25;-22.5\r\n".encode())
    assert read_control_points(path) == [
        ControlPoint(MapPixel(10, 20.5), LatLon(60.5, 22)),
        ControlPoint(MapPixel(100, 7), LatLon(-60.25, -22.5)),
    ]


@pytest.mark.parametrize(
    ("text", "line", "part"),
    [
        ("", 1, "header"),
        ("x;y;lon;lat\n", 1, "header"),
        ("x;y;lat;lon\n1;2;3\n", 2, "3 columns"),
        ("x;y;lat;lon\n1;2;3;4\n1;2;3;4;5\n", 3, "5 columns"),
        ("x;y;lat;lon\n1;2;3,5;4\n", 2, "decimal point"),
        ("x;y;lat;lon\n1;2;nan;4\n", 2, "not a number"),
        ("x;y;lat;lon\n1;2;1e999;4\n", 2, "not a number"),
        ("x;y;lat;lon\n1;2;120.5;49.1\n", 2, "swapped"),
        ("x;y;lat;lon\n", None, "no control point"),
    ],
)
def test_bad_control_points_are_refused_with_their_line(tmp_path, text, line, part):
    path = tmp_path / "points.csv"
    path.write_text(text, encoding="utf-8")
    with pytest.raises(TableError) as caught:
        read_control_points(path)
    assert part in str(caught.value)
    assert caught.value.where == (f"{path}:{line}" if line else str(path))


def test_control_points_in_another_encoding_are_refused(tmp_path):
    (tmp_path / "p.csv").write_bytes("x;y;lat;lon\n".encode("utf-16"))
    with pytest.raises(TableError, match="UTF-8"):
        read_control_points(tmp_path / "p.csv")


# world files


def world(path, numbers):
    path.write_text("\n".join(str(n) for n in numbers) + "\n")
    return path


CENTRED = (METRES, 0, 0, -METRES, EAST + METRES / 2, NORTH - METRES / 2)


def test_a_world_file_counts_from_the_centre_of_the_first_pixel(tmp_path):
    check_utm(read_worldfile(world(tmp_path / "s.pgw", CENTRED), **SIZE, crs="EPSG:32633"))


def test_a_world_file_takes_the_prj_next_to_it(tmp_path):
    (tmp_path / "s.prj").write_text(parse_crs("EPSG:32633").to_wkt("WKT1_ESRI"))
    check_utm(read_worldfile(world(tmp_path / "s.pgw", CENTRED), **SIZE))
    (tmp_path / "s.prj").write_text("nonsense")
    with pytest.raises(GeoreferenceError) as caught:
        read_worldfile(tmp_path / "s.pgw", **SIZE)
    assert caught.value.where == str(tmp_path / "s.prj")


def test_a_world_file_in_degrees(tmp_path):
    fit = read_worldfile(world(tmp_path / "s.wld", (1e-5, 0, 0, -1e-5, 14.0, 50.0)), **SIZE)
    assert fit.georeference.plane == "EPSG:4326"
    assert fit.georeference.latlon_of(MapPixel(0.5, 0.5)) == pytest.approx((50.0, 14.0), abs=1e-12)


def test_a_turned_world_file(tmp_path):
    # lines two and three are the rotations: y over x first, x over y second
    fit = read_worldfile(
        world(tmp_path / "s.wld", (0.4, 0.3, 0.3, -0.4, EAST, NORTH)), **SIZE, crs="EPSG:32633"
    )
    lon, lat = UTM.transform(EAST + 0.4 * 100 + 0.3 * 50, NORTH + 0.3 * 100 - 0.4 * 50)
    assert fit.georeference.latlon_of(MapPixel(100.5, 50.5)) == pytest.approx((lat, lon), abs=1e-9)


@pytest.mark.parametrize(
    ("numbers", "crs", "part"),
    [
        (CENTRED, None, "--crs"),
        (CENTRED[:5], "EPSG:32633", "5 numbers"),
        ((*CENTRED, 1), "EPSG:32633", "7 numbers"),
        (("a", *CENTRED[1:]), "EPSG:32633", "not a number"),
        (("nan", *CENTRED[1:]), "EPSG:32633", "numbers"),
        ((METRES, 0, 0, METRES, EAST, NORTH), "EPSG:32633", "mirrored"),
        ((0, 0, 0, 0, EAST, NORTH), "EPSG:32633", "inverse"),
        (CENTRED, "EPSG:99999", "unknown coordinate system"),
    ],
)
def test_a_bad_world_file_is_refused(tmp_path, numbers, crs, part):
    with pytest.raises(GeoreferenceError) as caught:
        read_worldfile(world(tmp_path / "s.pgw", numbers), **SIZE, crs=crs)
    assert part in str(caught.value)


@pytest.mark.parametrize(
    ("image", "sidecar"),
    [
        ("s.png", "s.pgw"),
        ("s.png", "s.pngw"),
        ("s.PNG", "s.PGW"),
        ("s.jpg", "s.jgw"),
        ("s.jpeg", "s.jgw"),
        ("s.jpeg", "s.jpegw"),
        ("s.tif", "s.tfw"),
        ("s.tiff", "s.tiffw"),
        ("s.png", "s.wld"),
        ("s.png", "s.png.wld"),
        ("a.b.jpg", "a.b.jpgw"),
    ],
)
def test_world_files_are_found_next_to_their_image(tmp_path, image, sidecar):
    (tmp_path / "other.pgw").touch()
    (tmp_path / sidecar).touch()
    assert find_worldfile(tmp_path / image) == tmp_path / sidecar


def test_no_world_file(tmp_path):
    (tmp_path / "other.pgw").touch()
    for folder in (tmp_path, tmp_path / "none"):
        with pytest.raises(GeoreferenceError, match="no world file") as caught:
            find_worldfile(folder / "s.png")
        assert "s.pgw" in caught.value.hint


# GeoTIFF


def tiff(path, **options):
    profile = {"driver": "GTiff", "dtype": "uint8", "count": 1, **SIZE, **options}
    with rasterio.open(path, "w", **profile) as dataset:
        dataset.write(np.zeros((1, 300, 400), np.uint8))
    return path


NORTH_UP = rasterio.Affine(METRES, 0, EAST, 0, -METRES, NORTH)


def test_a_geotiff(tmp_path):
    fit = read_geotiff(tiff(tmp_path / "s.tif", crs="EPSG:32633", transform=NORTH_UP))
    check_utm(fit)
    assert (fit.georeference.plane, fit.residuals_m, fit.warnings) == ("EPSG:32633", (), ())


def test_a_geotiff_in_degrees(tmp_path):
    path = tiff(tmp_path / "s.tif", crs="EPSG:4326", transform=rasterio.Affine(1e-5, 0, 14.0, 0, -1e-5, 50.0))
    assert read_geotiff(path).georeference.latlon_of(MapPixel(400, 300)) == pytest.approx((49.997, 14.004))


def test_a_geotiff_with_ground_control_points(tmp_path):
    pixels = [(0, 0), (400, 10), (390, 300), (20, 280), (200, 100)]
    gcps = [GroundControlPoint(y, x, EAST + METRES * x, NORTH - METRES * y) for x, y in pixels]
    fit = read_geotiff(tiff(tmp_path / "s.tif", crs="EPSG:32633", gcps=gcps))
    check_utm(fit)
    assert len(fit.residuals_m) == 5
    assert max(fit.residuals_m) < 1e-3


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_bad_geotiffs_are_refused(tmp_path):
    with pytest.raises(GeoreferenceError, match="no georeference"):
        read_geotiff(tiff(tmp_path / "plain.tif"))
    nameless = tiff(tmp_path / "nameless.tif", transform=NORTH_UP)
    with pytest.raises(GeoreferenceError, match="--crs"):
        read_geotiff(nameless)
    check_utm(read_geotiff(nameless, crs="EPSG:32633"))
    upside_down = tiff(
        tmp_path / "south.tif", crs="EPSG:32633", transform=rasterio.Affine(METRES, 0, EAST, 0, METRES, NORTH)
    )
    with pytest.raises(GeoreferenceError, match="mirrored"):
        read_geotiff(upside_down)
    (tmp_path / "text.tif").write_text("no TIFF")
    with pytest.raises(GeoreferenceError, match="not a readable GeoTIFF"):
        read_geotiff(tmp_path / "text.tif")


@pytest.mark.filterwarnings("ignore::rasterio.errors.NotGeoreferencedWarning")
def test_no_side_files_of_a_geotiff_are_read(tmp_path):
    path = tiff(tmp_path / "plain.tif")
    world(tmp_path / "plain.tfw", CENTRED)
    with pytest.raises(GeoreferenceError, match="no georeference"):
        read_geotiff(path)


def test_a_coordinate_system_in_the_file_next_to_a_geotiff(tmp_path):
    path = tiff(tmp_path / "s.tif", transform=NORTH_UP)
    aux = tmp_path / "s.tif.aux.xml"
    aux.write_text(f"<PAMDataset><SRS>{CRS.from_epsg(32633).to_wkt()}</SRS><Metadata/></PAMDataset>")
    check_utm(read_geotiff(path))
    aux.write_text("<PAMDataset><SRS>EPSG:32634</SRS></PAMDataset>")
    check_utm(read_geotiff(path, crs="EPSG:32633"))
    check_utm(read_geotiff(tiff(tmp_path / "s.tif", crs="EPSG:32633", transform=NORTH_UP)))


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("<PAMDataset><SRS>+proj=utm +nadgrids=/etc/passwd</SRS></PAMDataset>", "unknown coordinate system"),
        ('<!DOCTYPE a [<!ENTITY b "c">]><PAMDataset><SRS>&b;</SRS></PAMDataset>', "entities"),
        ("<PAMDataset><SRS>", "damaged"),
        ("<PAMDataset/>", "states no coordinate system"),
    ],
)
def test_a_bad_file_next_to_a_geotiff_is_refused(tmp_path, text, why):
    path = tiff(tmp_path / "s.tif", transform=NORTH_UP)
    (tmp_path / "s.tif.aux.xml").write_text(text)
    with pytest.raises(GeoreferenceError, match=why):
        read_geotiff(path)
