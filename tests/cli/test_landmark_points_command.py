"""`expmap landmarks points`: control points from and to a table, in a folder and in a library."""

import json
import shutil

import pytest
from PIL import Image

from webapp.cli import landmark_points
from webapp.core.geo.types import MapPixel
from webapp.core.mapmodel.control_points import GroundControlPoint, PhotoClick, Tag
from webapp.files.maps.folder import read_map
from webapp.store.library import open_library
from webapp.store.maps import edits
from webapp.store.schema import Account
from webapp.tasks.landmarks.control_points import Residual
from webapp.tasks.maps import adopt_map, export

TABLE = """name;x_px;y_px;height_m;accuracy_m;photo;photo_x_px;photo_y_px
gate;20,5;18.25;212.4;0.05;photos/0.jpg;3;4
gate;;;;;1.jpg;6;2
well;3;4;;;;;
"""


@pytest.fixture
def cfg(tmp_path, make_map):
    """A map of three photos in a separate folder."""
    cfg = make_map(tmp_path / "there", 3)
    for number in range(3):
        Image.new("RGB", (12, 8), (80 * number, 0, 0)).save(cfg.parent / "photos" / f"{number}.jpg")
    return cfg


def write(cfg, text, name="points.csv"):
    path = cfg.parent.parent / name
    path.write_text(text)
    return path


def test_points_come_from_a_table_and_go_to_one(expmap, cfg):
    code, out, _ = expmap("landmarks", "points", cfg, "--import", write(cfg, TABLE))
    assert code == 0
    assert out.splitlines()[:2] == [
        "gate  x 20.5, y 18.2, clicked in 2 photos",
        "well  x 3.0, y 4.0, clicked in 0 photos",
    ]
    gate = GroundControlPoint(
        "gate", MapPixel(20.5, 18.25), (PhotoClick(0, 0.25, 0.5), PhotoClick(1, 0.5, 0.25)), 0.05, 212.4
    )
    assert read_map(cfg).control_points == (gate, GroundControlPoint("well", MapPixel(3.0, 4.0)))
    back = cfg.parent.parent / "back.csv"
    assert expmap("landmarks", "points", cfg, "--export", back)[0] == 0
    assert expmap("landmarks", "points", cfg, "--remove", "gate", "--remove", "well")[1].strip() == (
        "the map has no control points"
    )
    assert read_map(cfg).control_points == ()
    assert expmap("landmarks", "points", cfg, "--import", back)[0] == 0
    assert read_map(cfg).control_points == (gate, GroundControlPoint("well", MapPixel(3.0, 4.0)))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("", "the file is empty"),
        ("name;colour\n", "unknown column 'colour'"),
        ("x_px;y_px\n", "has no column name"),
        ("name;x_px;y_px\ngate;;3\n", "only one of x_px and y_px"),
        ("name;x_px;y_px\ngate;a;3\n", "'a' is not a number"),
        ("name;x_px;y_px\ngate;1;3\ngate;2;3\n", "position of the point gate differs"),
        ("name;lat;lon\ngate;50;14\n", "need a map with a georeference"),
        ("name;photo;photo_x_px;photo_y_px\ngate;77.jpg;1;1\n", "no photo of the map is called '77.jpg'"),
        ("name;photo;photo_x_px;photo_y_px\ngate;1.jpg;13;1\n", "outside the photo of 12 x 8 pixels"),
        ("name;photo\ngate;1.jpg\n", "a click needs photo, photo_x_px and photo_y_px"),
        ("name;x_px;y_px\ngate;9000;3\n", "outside the image"),
        ("name;x_px;y_px\na/b;1;3\n", "without /"),
        ("name;accuracy_m\ngate;0\n", "accuracy_m is not above 0"),
        ("name;accuracy_m\ngate;1e160\n", "accuracy_m that is not above 0 and at most 1000"),
    ],
)
def test_a_table_that_is_not_right_changes_nothing(expmap, cfg, text, words):
    code, _, err = expmap("landmarks", "points", cfg, "--import", write(cfg, text))
    assert code != 0
    assert words in err
    assert read_map(cfg).control_points == ()


def test_a_point_that_is_not_there_cannot_be_removed(expmap, cfg):
    code, _, err = expmap("landmarks", "points", cfg, "--remove", "gate")
    assert code != 0
    assert "no control point gate" in err


def test_how_far_they_are_off_is_said(expmap, cfg, monkeypatch):
    expmap("landmarks", "points", cfg, "--import", write(cfg, TABLE))
    judged = [
        Residual(None, "gate", MapPixel(20.5, 18.25), MapPixel(23.5, 22.25), True, ("photos/1.jpg",)),
        Residual(2, "photos/2.jpg", MapPixel(1.0, 1.0), MapPixel(1.0, 2.0)),
        Residual(None, "well", MapPixel(3.0, 4.0), problem="it is not clicked in any joined photo"),
    ]
    monkeypatch.setattr(landmark_points, "stored_residuals", lambda *_: judged)
    _, out, _ = expmap("landmarks", "points", cfg)
    assert out.splitlines() == [
        "gate  x 20.5, y 18.2, clicked in 2 photos; 5.0 px off; left out: the others agree on another place; "
        "wrong click in photos/1.jpg",
        "well  x 3.0, y 4.0, clicked in 0 photos; it is not clicked in any joined photo",
    ]
    found = json.loads(expmap("landmarks", "points", cfg, "--json")[1])
    assert found["laid"] is True
    assert [one["residual_px"] for one in found["residuals"]] == [5.0, 1.0, None]
    assert found["points"][1] == {"name": "well", "x_px": 3.0, "y_px": 4.0, "photos": []}


def test_check_points_are_marked_and_their_rmse_is_printed(expmap, cfg, monkeypatch):
    table = TABLE.replace(";photo;", ";check;photo;").replace(";photos/0.jpg", ";no;photos/0.jpg")
    table = table.replace("gate;;;;;", "gate;;;;;;").replace("well;3;4;;;", "well;3;4;;;yes;")
    expmap("landmarks", "points", cfg, "--import", write(cfg, table))
    assert checks(cfg) == {"gate": False, "well": True}
    back = cfg.parent.parent / "back.csv"
    expmap("landmarks", "points", cfg, "--export", back, "--check", "gate", "--no-check", "well")
    assert checks(cfg) == {"gate": True, "well": False}
    expmap("landmarks", "points", cfg, "--no-check", "gate", "--check", "well")
    assert checks(cfg) == {"gate": False, "well": True}
    expmap("landmarks", "points", cfg, "--import", back)
    assert checks(cfg) == {"gate": True, "well": False}
    judged = [
        Residual(
            None, "gate", MapPixel(20.5, 18.25), MapPixel(23.5, 22.25), is_check=True, photos=2, sigma_px=0.5
        ),
        Residual(None, "well", MapPixel(3.0, 4.0), MapPixel(3.0, 6.0)),
    ]
    monkeypatch.setattr(landmark_points, "stored_residuals", lambda *_: judged)
    assert expmap("landmarks", "points", cfg)[1].splitlines() == [
        "gate  x 20.5, y 18.2, clicked in 2 photos; check point; dx +3.0, dy +4.0, 5.0 px off; "
        "seen in 2 photos, itself accurate to 0.5 px",
        "well  x 3.0, y 4.0, clicked in 0 photos; 2.0 px off",
        "RMSE of control points: 2.0 px +- 50 % (of 1, each by all others)",
        "RMSE of check points: 5.0 px +- 50 % (of 1)",
    ]
    found = json.loads(expmap("landmarks", "points", cfg, "--json")[1])
    assert [one["check"] for one in found["residuals"]] == [True, False]
    assert (found["residuals"][0]["dx_px"], found["residuals"][0]["sigma_px"]) == (3.0, 0.5)
    assert found["accuracy"]["check"]["rmse_px"] == 5.0
    assert found["accuracy"]["control"]["points"] == 1
    code, _, err = expmap("landmarks", "points", cfg, "--check", "nowhere")
    assert code != 0
    assert "no control point nowhere" in err


def test_a_check_that_is_neither_yes_nor_no_is_refused(expmap, cfg):
    code, _, err = expmap("landmarks", "points", cfg, "--import", write(cfg, "name;check\ngate;maybe\n"))
    assert code != 0
    assert "check is not yes or no: 'maybe'" in err


def checks(cfg):
    return {point.name: point.is_check for point in read_map(cfg).control_points}


def test_in_a_library_it_is_an_edit(expmap, make_map, tmp_path):
    library = open_library(tmp_path / "library")
    with library.database.write() as session:
        account = Account(name="ana", is_owner=True)
        session.add(account)
    make_map(library.map_folder("yard"), 2)
    map_id = adopt_map.adopt_map(library, "yard", account_id=account.id)
    table = tmp_path / "points.csv"
    table.write_text("name;x_px;y_px\ngate;2;3\n")
    cfg = library.cfg("yard")
    assert expmap("landmarks", "points", cfg, "--import", table)[0] == 0
    assert read_map(cfg).control_points == (GroundControlPoint("gate", MapPixel(2.0, 3.0)),)
    with library.changing(map_id) as change:
        assert edits.undo(change.session, change.record, account_id=account.id).clash is None
    export.export_map(library, map_id)
    assert read_map(cfg).control_points == ()


def test_they_go_with_a_map_that_is_adopted(expmap, cfg, tmp_path):
    expmap("landmarks", "points", cfg, "--import", write(cfg, TABLE))
    before = read_map(cfg).control_points
    library = open_library(tmp_path / "library")
    with library.database.write() as session:
        account = Account(name="ana", is_owner=True)
        session.add(account)
    shutil.copytree(cfg.parent, library.map_folder("there"))
    map_id = adopt_map.adopt_map(library, "there", account_id=account.id)
    export.export_map(library, map_id, overwrite=True)
    assert read_map(library.cfg("there")).control_points == before


def test_tags_come_from_a_table_and_go_to_one(expmap, cfg):
    head = "name;x_px;y_px;tag;tag_size_mm;tag_mount;tag_heading_deg"
    table = f"{head}\ngate;20;18;36h11 3;150;floor;90\nend;3;4;4x4_50 7;80;;\n"
    code, out, _ = expmap("landmarks", "points", cfg, "--import", write(cfg, table))
    assert code == 0
    assert "gate  x 20.0, y 18.0, tag 36h11 3 of 150 mm, clicked in 0 photos" in out
    tags = (Tag("4x4_50", 7, 80.0), Tag("36h11", 3, 150.0, "floor", 90.0))
    assert tuple(point.tag for point in read_map(cfg).control_points) == tags
    back = cfg.parent.parent / "back.csv"
    expmap("landmarks", "points", cfg, "--export", back)
    expmap("landmarks", "points", cfg, "--remove", "gate", "--remove", "end")
    assert expmap("landmarks", "points", cfg, "--import", back)[0] == 0
    assert tuple(point.tag for point in read_map(cfg).control_points) == tags


@pytest.mark.parametrize(
    ("cells", "problem"),
    [
        ("36h11;150;", "needs tag and tag_size_mm"),
        ("36h11 3;;", "needs tag and tag_size_mm"),
        ("36h11 3;150;roof", "not wall or floor"),
        ("36h11 587;150;", "ids of 36h11 are from 0 to 586"),
    ],
)
def test_a_tag_that_cannot_be_is_refused(expmap, cfg, cells, problem):
    table = write(cfg, f"name;tag;tag_size_mm;tag_mount\ngate;{cells}\n")
    code, _, err = expmap("landmarks", "points", cfg, "--import", table)
    assert code != 0
    assert problem in err
    assert read_map(cfg).control_points == ()


def test_tags_are_printed_as_pdf(expmap, tmp_path):
    out = tmp_path / "tags.pdf"
    assert expmap("landmarks", "tags", out, "--ids", "0-2,9")[:2] == (0, f"{out}: 4 tags of 150 mm\n")
    assert out.read_bytes().startswith(b"%PDF-")
    assert expmap("landmarks", "tags", tmp_path / "tags.png")[0] != 0
