"""Projects of QGIS: their documents, and their sources as GDAL opens them."""

import io
import json
import re
import tempfile
import xml.etree.ElementTree as ET
import zipfile
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from tests.connect.gis.ogr import read_layers
from webapp.app.main import main
from webapp.connect.gis.project_image import images_of
from webapp.missions.store.schema import Mission
from webapp.settings import Settings
from webapp.store.schema import MapRecord
from webapp.tasks.exchange.export_source import of_folder

MEDIA_TYPE = "application/x-qgis-project"


@pytest.fixture
def unpack(tmp_path):
    """Unpack a project as QGIS does, and return its document and the path of each source by title."""

    def read(data):
        folder = Path(tempfile.mkdtemp(dir=tmp_path))
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            archive.extractall(folder)
        (document,) = folder.glob("*.qgs")
        text = document.read_text("utf-8")
        assert text.startswith("<!DOCTYPE qgis ")
        root = ET.fromstring(text.partition("\n")[2])
        sources = {}
        for layer in root.iter("maplayer"):
            file, _, name = layer.findtext("datasource").removeprefix("attachment:").partition("|layername=")
            assert (folder / file).is_file()
            sources[layer.findtext("layername")] = (folder / file, name)
        return root, sources

    return read


def layers_of(root):
    """Return the ids of the layers, the topmost first, and which of them are shown."""
    tree = [(one.get("id"), one.get("checked")) for one in root.iter("layer-tree-layer")]
    ids = [one.findtext("id") for one in root.iter("maplayer")]
    assert [one[0] for one in tree] == ids == [one.get("id") for one in root.iterfind("layerorder/layer")]
    return ids, {id for id, checked in tree if checked == "Qt::Checked"}


def opened(path):
    rasterio = pytest.importorskip("rasterio")
    return rasterio.open(path)


def test_a_map_is_opened_with_its_image_and_layers(client, park, library, unpack):
    with client.get("/api/v1/maps/park-2/export.qgz") as answer:
        assert (answer.status_code, answer.content_type) == (200, MEDIA_TYPE)
        assert "park-2.qgz" in answer.headers["Content-Disposition"]
        root, sources = unpack(answer.data)
    assert [*library.uploads.glob("*")] == []
    assert layers_of(root) == (["notes", "photos", "image-0"], {"notes", "photos", "image-0"})
    title = root.findtext("title")
    file, name = sources[f"{title}: photos"]
    assert [one["id"] for one in read_layers(file)[name]] == ["0", "1", "2", "3", "4"]
    assert len(read_layers(file)[sources[f"{title}: notes"][1]]) == 2
    with opened(sources[title][0]) as image:
        assert (image.width, image.height, image.crs.to_epsg()) == (320, 240, 4326)
        assert image.xy(0, 0, offset="ul") == pytest.approx((14.0, 50.0))
        assert image.xy(20, 10, offset="ul") == pytest.approx((14.0001, 49.9998))
        wanted = Image.open(library.map_folder("park-2") / "plan.png").convert("RGB")
        np.testing.assert_array_equal(np.moveaxis(image.read(), 0, -1), np.asarray(wanted))
    systems = {one.findtext("spatialrefsys/authid") for one in root.iter("srs")}
    assert systems == {"EPSG:4326"}
    assert root.findtext("projectCrs/spatialrefsys/authid") == "EPSG:4326"
    west, south, east, north = (float(one.text) for one in root.find("mapcanvas/extent"))
    assert west < 14.0 < 14.0032 < east < 14.01 and 49.99 < south < 49.9976 < 50.0 < north


def test_layers_have_the_styles_of_the_geopackage(client, park, unpack):
    root, _ = unpack(client.get("/api/v1/maps/park-2/export.qgz").data)
    by_id = {one.findtext("id"): one for one in root.iter("maplayer")}
    photos, notes = by_id["photos"], by_id["notes"]
    assert (photos.get("geometry"), photos.find("renderer-v2").get("type")) == ("Point", "singleSymbol")
    bound = [one.get("value") for one in photos.iter("Option") if one.get("name") == "expression"]
    assert '"heading_deg"' in bound
    assert notes.get("labelsEnabled") == "1"
    assert notes.find("labeling/settings/text-style").get("fieldName") == "title"
    assert photos.find("fieldConfiguration/field").get("name") == "photo"


def test_a_mission_is_opened_on_its_map_with_areas(client, park, search, unpack, library):
    id = search.removeprefix("mission-")
    shape = {"kind": "area", "name": "North", "points": [[50.0, 14.0], [50.1, 14.0], [50.1, 14.1]]}
    assert client.post(f"/api/v1/missions/{id}/drawings", json=shape).status_code == 201
    root, sources = unpack(client.get(f"/api/v1/missions/{id}/export.qgz").data)
    assert layers_of(root)[0] == ["objects", "poses", "tracks", "areas"]
    file, name = sources["Search: areas"]
    (area,) = read_layers(file)[name]
    assert (area["name"], area["searched"]) == ("North", "0")
    tracks = next(one for one in root.iter("maplayer") if one.findtext("id") == "tracks")
    assert tracks.find("renderer-v2").get("type") == "categorizedSymbol"
    with library.database.write() as session:
        record = session.query(MapRecord).filter_by(slug="park-2").one()
        session.get_one(Mission, int(id)).map_id = record.id
    root, sources = unpack(client.get(f"/api/v1/missions/{id}/export.qgz?points=2").data)
    assert layers_of(root)[0][-1] == "image-0"


def test_a_map_without_a_georeference_is_refused(client, park, library):
    client.delete("/api/v1/maps/park-2/georeference")
    answer = client.get("/api/v1/maps/park-2/export.qgz")
    assert (answer.status_code, "georeference" in answer.json["error"]["message"]) == (400, True)
    assert [*library.uploads.glob("*")] == []


def test_the_export_menus_lead_to_projects(client, park, search):
    mission = search.removeprefix("mission-")
    pages = {"/maps/park-2/edit": "maps/park-2", f"/missions/{mission}": f"missions/{mission}"}
    for page, address in pages.items():
        found = re.search(rf'href="/api/v1/{address}/export.qgz" download>', client.get(page).text)
        assert found is not None, page


@pytest.fixture
def skewed(tmp_path):
    """A map whose image is projective, and has a floor with another image; the folder."""
    folder = tmp_path / "tower"
    folder.mkdir()
    dots = np.zeros((60, 80, 3), np.uint8)
    dots[20:24, 60:64] = 255
    for name in ("plan.png", "up.png", "0.jpg"):
        Image.fromarray(dots).save(folder / name)
    (folder / "map.cfg").write_text("plan.png;80;60\n0;0.jpg;10;20\n")
    matrix = [[1.0, 0.2, 500000.0 + 0], [0.1, -1.0, 5500000.0], [1e-3, 0, 1]]
    matrix[0][0] += 500.0  # x of the plane is 500000 along the upper edge, too
    matrix[1][0] += 5500.0
    about = {
        "format": "experience-map",
        "version": 1,
        "title": "Tower <1> & more",
        "georeference": {"plane": "EPSG:32633", "plane_from_pixel": matrix, "method": "projective"},
        "floors": [
            {"id": 0, "name": "Ground", "level": 0},
            {"id": 1, "name": "Up", "level": 1, "image": {"path": "up.png", "width": 80, "height": 60,
             "map_from_image": [[1, 0, 2], [0, 1, 3]]}},
        ],
        "experiences": [{"id": 0, "photo": "0.jpg", "x_px": 10.0, "y_px": 20.0}],
    }  # fmt: skip
    (folder / "map.json").write_text(json.dumps(about))
    return folder


@pytest.fixture
def expmap(capsys):
    """Runs `expmap connect gis` and returns exit code, standard output and standard error."""

    def call(*words):
        with pytest.raises(SystemExit) as ended:
            main(["connect", "gis", *map(str, words)])
        return (ended.value.code, *capsys.readouterr())

    return call


def test_a_command_writes_a_projective_map_with_its_floors(skewed, tmp_path, unpack, expmap):
    out = tmp_path / "tower.qgz"
    assert expmap("project", skewed / "map.cfg", out)[:2] == (0, f"wrote {out}: 1 photos, 2 images\n")
    root, sources = unpack(out.read_bytes())
    ids, shown = layers_of(root)
    assert (ids, "image-1" in shown) == (["photos", "floors", "image-1", "image-0"], False)
    assert root.findtext("title") == "Tower <1> & more"
    georeference = of_folder(skewed / "map.cfg").georeference()
    for title, move in (("Tower <1> & more: Ground", (0, 0)), ("Tower <1> & more: Up", (2, 3))):
        with opened(sources[title][0]) as image:
            assert image.crs.to_epsg() == 32633
            u, v = 62.0 + move[0], 22.0 + move[1]
            x, y, w = georeference.matrix @ (u, v, 1.0)
            row, column = image.index(x / w, y / w)
            bands = image.read()
            assert bands[0, row, column] > 200 and bands[3, row, column] == 255
            assert bands[3].min() == 0


def test_other_endings_and_missing_images_are_refused(skewed, tmp_path, expmap):
    code, _, said = expmap("project", skewed / "map.cfg", tmp_path / "a.zip")
    assert (code, ".qgz" in said) == (2, True)
    (skewed / "up.png").unlink()
    assert len(images_of(of_folder(skewed / "map.cfg"), tmp_path, settings=Settings())) == 1
    (skewed / "plan.png").unlink()
    code, _, said = expmap("project", skewed / "map.cfg", tmp_path / "a.qgz")
    assert (code, "plan.png" in said, [*tmp_path.glob("*.qgz")]) == (1, True, [])


def test_a_command_writes_a_mission(search, library, tmp_path, unpack, expmap):
    out = tmp_path / "search.qgz"
    words = ("project-mission", search.removeprefix("mission-"), out, "--library", library.folder)
    assert expmap(*words)[:2] == (0, f"wrote {out}: 2 tracks, 4 poses, 3 objects\n")
    root, _ = unpack(out.read_bytes())
    assert layers_of(root)[0] == ["objects", "poses", "tracks"]
