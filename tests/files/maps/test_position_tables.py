"""Tables of photos and positions as other programs and spreadsheets write them."""

import time

import numpy as np
import pytest
from pyproj import CRS, Transformer

from webapp.core.geo.types import LatLon
from webapp.errors import TableError
from webapp.files.maps.control_point_table import read_rows
from webapp.files.maps.position_tables import read_table
from webapp.files.maps.positions import read_positions
from webapp.files.satellite.georeference_files import read_control_points

A, B = LatLon(50.1, 14.4), LatLon(50.101, -14.401)


def read(tmp_path, text, *, encoding="utf-8", columns=None):
    path = tmp_path / "list.txt"
    path.write_bytes(text.encode(encoding))
    return read_positions(path, columns=columns)


def utm(at):
    return Transformer.from_crs(4326, 32633, always_xy=True).transform(at.lon, at.lat)


def near(found, wanted):
    return {n: tuple(at) for n, at in found.items()} == {
        n: pytest.approx(tuple(at), abs=1e-9) for n, at in wanted.items()
    }


HEADERS = {
    "excel": "sep=;\nname;lat;lon",
    "excel quoted": '"sep=;"\nname;lat;lon',
    "pix4d": "imagename;latitude [decimal degrees];longitude [decimal degrees];altitude [meter]",
    "German": "Dateiname;Breite;Länge",
    "German in words": "Bild;Geographische Breite;Geographische Länge (°)",
    "German, ae": "Foto;Breitengrad [Grad];Laengengrad [Grad]",
    "Czech": "Název souboru;Šířka;Délka",
    "Czech in words": "Soubor;Zeměpisná šířka;Zeměpisná délka",
    "Spanish": "Nombre;Latitud;Longitud",
    "Spanish in words": "Archivo;Latitud (grados);Longitud (grados)",
    "French": "Nom du fichier;Latitude;Longitude",
    "French, degrees": "Fichier;Latitude (degrés);Longitude (degrés)",
    "datum": "Photo;Lat (WGS 84);Lon (WGS 84)",
}


@pytest.mark.parametrize("name", HEADERS)
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "page"])
def test_headers_of_spreadsheets_in_all_languages_of_the_pages(tmp_path, name, encoding):
    page = "cp1250" if "Czech" in name else "cp1252"
    text = f"{HEADERS[name]}\na é.jpg;50,1;14,4;200\nb.jpg;50.101;-14.401;200\n"
    found = read(tmp_path, text, encoding=page if encoding == "page" else encoding)
    assert found.by_name == {"a é.jpg": A, "b.jpg": B}


@pytest.mark.parametrize("heading", ["Blickrichtung", "směr", "dirección", "cap", "Yaw [degrees]"])
def test_headings_in_all_languages(tmp_path, heading):
    assert read(tmp_path, f"photo;lat;lon;{heading}\na.jpg;1;2;-90\n").headings_deg == {"a.jpg": 270.0}


def test_quoted_decimal_commas(tmp_path):
    found = read(tmp_path, 'name,lat,lon\na.jpg,"50,1","14,4"\nb.jpg,"50,101","-14,401"\n')
    assert found.by_name == {"a.jpg": A, "b.jpg": B}
    with pytest.raises(TableError, match="is not a number"):
        read(tmp_path, 'name,x,y\na.jpg,"1,234","5,678"\n')  # a thousand pixels, or one?


WGS = 'GEOGCS["WGS 84",DATUM["World Geodetic System 1984",SPHEROID["WGS 84",6378137,298.257223563]]]'


def test_metashape_in_degrees(tmp_path):
    text = f"# CoordinateSystem: {WGS}\n#Label,X/Longitude,Y/Latitude,Z/Altitude,Yaw,Pitch,Roll\n"
    found = read(tmp_path, f"{text}a.jpg,14.4,50.1,200,45,0,0\nb,-14.401,50.101,200,,,\n# end\n")
    assert near(found.by_name, {"a.jpg": A, "b": B})
    assert found.headings_deg == {"a.jpg": 45}
    assert found.find("photos/b.jpg") is not None, "labels may have no suffix"


def test_metashape_in_metres_of_a_stated_system(tmp_path):
    (xa, ya), plane = utm(A), "EPSG:32633"
    text = f"# CoordinateSystem: {plane}\n#Label,X/Easting,Y/Northing,Z/Altitude\na.jpg,{xa!r},{ya!r},200\n"
    assert near(read(tmp_path, text).by_name, {"a.jpg": A})
    with pytest.raises(TableError, match="in metres") as caught:
        read(tmp_path, text.partition("\n")[2])
    assert "WGS 84" in caught.value.hint
    with pytest.raises(TableError, match="coordinate system"):
        read(tmp_path, text.replace(plane, 'LOCAL_CS["Local"]'))


@pytest.mark.parametrize("plane", ["EPSG:32633", "WGS84 UTM 33N", "+proj=utm +zone=33 +datum=WGS84 +units=m"])
def test_geo_txt_of_odm(tmp_path, plane):
    x, y = utm(A)
    found = read(tmp_path, f"{plane}\na.jpg {x!r} {y!r} 200 90 0 0 1 1\n")
    assert near(found.by_name, {"a.jpg": A})
    assert found.headings_deg == {"a.jpg": 90}


def test_geo_txt_in_degrees_has_longitude_first(tmp_path):
    assert read(tmp_path, "EPSG:4326\na.jpg 14.4 50.1\nb.jpg -14.401 50.101 7\n").by_name == {
        "a.jpg": A,
        "b.jpg": B,
    }


@pytest.mark.parametrize(
    ("text", "why"),
    [
        ("EPSG:4326\n14.4 50.1 200 100 200 a.jpg gcp1\n", "gcp_list"),
        ("EPSG:4326\na.jpg 14.4\n", "name, x and y"),
        ("EPSG:4326\na.jpg 514.4 500.1\n", "latitude|outside|degrees|range"),
        ("EPSG:999999\na.jpg 14.4 50.1\n", "unknown coordinate system"),
        ("+proj=utm +zone=33 +nadgrids=/etc/passwd\na.jpg 1 2\n", "unknown coordinate system"),
        ("mapX,mapY,sourceX,sourceY,enable\n1,2,3,-4,1\n", "ground control points"),
        ("a.jpg,50.1,14.4,200\n", "recognised"),
        ("sep=;\n", "no rows"),
    ],
)
def test_what_is_no_list_of_photos_is_refused_by_name(tmp_path, text, why):
    with pytest.raises(TableError, match=why):
        read(tmp_path, text)


def test_a_table_without_a_header_needs_columns(tmp_path):
    found = read(tmp_path, "a.jpg,50.1,14.4,200\n", columns="name=1, lat=2, lon=3")
    assert found.by_name == {"a.jpg": A}


GPX = '<gpx version="1.1" xmlns="http://www.topografix.com/GPX/1/1">{}</gpx>'


def test_waypoints_with_links_to_photos(tmp_path):
    points = (
        '<wpt lat="50.1" lon="14.4"><name>Bridge</name><link href="file:///sd/My%20photos/a.jpg"/>'
        '<link href="c.jpg"><text>c</text></link><link href="https://example.org/"/></wpt>'
        '<wpt lat="50.101" lon="-14.401"><name>b.jpg</name><url>https://example.org/b</url></wpt>'
    )
    found = read(tmp_path, GPX.format(points))
    assert found.by_name == {"sd/My photos/a.jpg": A, "c.jpg": A, "b.jpg": B}
    assert found.find("a.jpg") == A


def test_points_of_qgis_are_control_points(tmp_path):
    x, y = utm(A)
    path = tmp_path / "plan.points"
    path.write_text(
        "#CRS: EPSG:32633\nmapX,mapY,sourceX,sourceY,enable,dX,dY,residual\n"
        f"{x!r},{y!r},120.5,-80.25,1,0,0,0\n1,1,1,-1,0,0,0,0\n"
    )
    (point,) = read_control_points(path)
    assert tuple(point.pixel) == (120.5, 80.25)
    assert tuple(point.position) == pytest.approx(tuple(A), abs=1e-9)
    path.write_text(f"mapX,mapY,pixelX,pixelY,enable\n{x!r},{y!r},120.5,-80.25,1\n")
    with pytest.raises(TableError, match="no coordinate system"):
        read_control_points(path)
    path.write_text("mapX,mapY,pixelX,pixelY,enable\n14.4,50.1,1,-2,1\n")
    assert tuple(read_control_points(path)[0].position) == tuple(A)


def test_gcp_list_of_odm_is_a_table_of_control_points(tmp_path):
    x, y = utm(A)
    path = tmp_path / "gcp_list.txt"
    path.write_text(
        f"EPSG:32633\n{x!r} {y!r} 200 10 20 a.jpg\n{x!r} {y!r} 200 30 40 b.jpg\n{x!r} {y!r} 1 5 6 b.jpg P\n"
    )
    rows = read_rows(path)
    assert [(row.name, row.photo, row.click_px, row.height_m) for row in rows] == [
        ("GCP 1", "a.jpg", (10, 20), 200), ("GCP 1", "b.jpg", (30, 40), 200), ("P", "b.jpg", (5, 6), 1),
    ]  # fmt: skip
    assert np.allclose([row.position for row in rows], tuple(A))
    path.write_text("EPSG:32633\n1 2 3\n")
    with pytest.raises(TableError, match="too few"):
        read_rows(path)


def test_many_comments_take_little_time():
    text = "#\n" * 150_000 + "# CoordinateSystem: EPSG:4326\nname;x;y\na.jpg;14.4;50.1"
    before = time.process_time()
    (found,) = read_table(text.encode(), None, where="list.txt", formats="a table")
    assert (found.name, found.position) == ("a.jpg", A)
    assert time.process_time() - before < 4


OTHER_HEADERS = {
    "Čas snímku;Název;Zem. šířka;Zem. délka": "cp1250",
    "zdjęcie;szerokość geograficzna;długość geograficzna": "cp1250",
    "Soubor,Severní šířka,Východní délka": "cp1250",
    "Bildname;Größe;Geogr. Breite;Geogr. Länge": "cp1252",
    "Nom de fichier;Légende;Latitude (degrés);Longitude (degrés)": "cp1252",
}


@pytest.mark.parametrize("header", OTHER_HEADERS)
def test_the_code_page_is_the_one_in_which_the_headers_make_sense(tmp_path, header):
    delimiter = ";" if ";" in header else ","
    name = next(n for n, cell in enumerate(header.split(delimiter)) if cell[0] in "NzSB")
    cells = ["1"] * header.count(delimiter) + ["1"]
    cells[name], cells[-2], cells[-1] = "a.jpg", "50.1", "14.4"
    text = f"{header}\n{delimiter.join(cells)}\n"
    assert read(tmp_path, text, encoding=OTHER_HEADERS[header]).by_name == {"a.jpg": A}


@pytest.mark.parametrize(
    ("names", "page"),
    [
        (["Třebíč náměstí.jpg", "Kroměříž.jpg"], "cp1250"),
        (["Łódź.jpg", "Kraków żółty.jpg"], "cp1250"),
        (["Straße.jpg", "Brücke.jpg"], "cp1252"),
        (["Église.jpg", "forêt à côté.jpg"], "cp1252"),
        (["Peñíscola.jpg", "Avión.jpg"], "cp1252"),
        (["Tromsø.jpg", "Ålesund.jpg"], "cp1252"),
    ],
)
def test_the_code_page_is_the_one_in_which_the_names_are_words_of_a_language(tmp_path, names, page):
    rows = "".join(f"{name};50.1;14.4\n" for name in names)
    assert set(read(tmp_path, f"name;lat;lon\n{rows}", encoding=page).by_name) == set(names)


ON_EARTH = {
    "Pix4D": "imagename,latitude [decimal degrees],longitude [decimal degrees],altitude [meter],accuracy "
    "horizontal [meter],accuracy vertical [meter]\na.jpg,50.1,14.4,230,5,10",
    "Pix4D, parameters": "imageName longitude latitude altitude omega phi kappa\na.jpg 14.4 50.1 230 0 0 0",
    "Pix4D, tabs": "Image Name\tLatitude\tLongitude\tAltitude\tOmega\na.jpg\t50.1\t14.4\t230\t0",
    "Metashape": f"# CoordinateSystem: {CRS.from_epsg(4326).to_wkt('WKT1_GDAL')}\n"
    "#Label,X/Longitude,Y/Latitude,Z/Altitude,Error_(m),X_est,Y_est\na.jpg,14.4,50.1,230,,14,50\n# Total",
    "Metashape, other order": "#Label\tY/Latitude\tX/Longitude\tZ/Altitude\na.jpg\t50.1\t14.4\t230",
    "Metashape, decimal commas": "Label;Longitude;Latitude;Altitude;Yaw\na.jpg;14,4;50,1;230;",
    "system in the first line": "EPSG:4326\nname;x;y;z\na.jpg;14,4;50,1;230",
    "one side of pixels": "name,lat,lon,x\na.jpg,50.1,14.4,7",
}


@pytest.mark.parametrize("program", ON_EARTH)
def test_columns_in_the_orders_of_photogrammetry_programs(tmp_path, program):
    assert read(tmp_path, f"{ON_EARTH[program]}\n").by_name == {"a.jpg": A}


@pytest.mark.parametrize("header", ["name;easting [m];northing [m]", "Label,X/East,Y/North,Z", "name x y"])
def test_a_table_may_begin_with_its_coordinate_system(tmp_path, header):
    mark = next(one for one in ";, " if one in header)
    x, y = utm(A)
    text = f"EPSG:32633\n{header}\n{mark.join(('a.jpg', str(x), str(y), '230'))}\n"
    assert near(read(tmp_path, text).by_name, {"a.jpg": A})


@pytest.mark.parametrize(
    ("header", "message"),
    [
        ("imagename,X [meter],Y [meter],Z [meter]", "in metres, and the table states no coordinate system"),
        ("imagename,easting [m],northing [m],altitude [m]", "in metres, and the table states no coordinate"),
        ("imageName X Y Z Omega Phi Kappa", "x and y with heights or angles are no pixels"),
        ("#name,x,y,alt,heading,pitch,roll", "x and y with heights or angles are no pixels"),
        ("PhotoID, X, Y, Z, Omega, Phi, Kappa", "x and y with heights or angles are no pixels"),
    ],
)
def test_x_and_y_that_are_no_pixels_are_refused_in_a_sentence(tmp_path, header, message):
    mark = "," if "," in header else " "
    with pytest.raises(TableError, match=message):
        read(tmp_path, f"{header}\n{mark.join(('a.jpg', '458000', '5550000', '230', '0', '0', '0'))}\n")
