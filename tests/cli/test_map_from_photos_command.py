"""`expmap map from-photos` on the command line."""

import json

import piexif
import pytest
from PIL import Image

from webapp.app.main import main


@pytest.fixture
def expmap(capsys):
    def call(*arguments):
        with pytest.raises(SystemExit) as ended:
            main([str(a) for a in arguments])
        output = capsys.readouterr()
        return ended.value.code, output.out, output.err

    return call


@pytest.fixture
def folder(tmp_path):
    photos = tmp_path / "photos"
    photos.mkdir()
    for name, seconds in (("a.jpg", 1), ("b.jpg", 3)):
        gps = {1: b"N", 2: ((50, 1), (0, 1), (seconds, 1)), 3: b"E", 4: ((14, 1), (0, 1), (2, 1))}
        Image.new("RGB", (8, 6)).save(photos / name, "JPEG", exif=piexif.dump({"GPS": gps}))
    Image.new("RGB", (8, 6)).save(photos / "c.jpg", "JPEG")
    Image.new("RGB", (400, 310)).save(tmp_path / "sat.png")
    (tmp_path / "corners.json").write_text(
        '{"top_left": {"lat": 50.001, "lon": 14.0}, "bottom_right": {"lat": 50.0, "lon": 14.002}}'
    )
    (tmp_path / "sat.pgw").write_text("5e-6\n0\n0\n-3.2258e-6\n14.0000025\n50.0009984\n")
    (tmp_path / "points.csv").write_text(
        "x;y;lat;lon\n0;0;50.001;14\n400;310;50;14.002\n400;0;50.001;14.002\n"
    )
    return tmp_path


def test_a_table_of_all_files(expmap, folder):
    code, out, err = expmap("map", "from-photos", folder / "photos", "--blank", "-o", folder / "map.cfg")
    lines = out.splitlines()
    assert code == 0
    assert [line.split()[:2] for line in lines[:3]] == [
        ["a.jpg", "placed"],
        ["b.jpg", "placed"],
        ["c.jpg", "no"],
    ]
    assert lines[3].startswith("3 files: 2 placed, 1 no position, 0 outside")
    assert err == ""


@pytest.mark.parametrize(
    "source",
    [
        ("--corners", "corners.json"),
        ("--worldfile",),
        ("--worldfile", "sat.pgw"),
        ("--control-points", "points.csv", "--model", "affine"),
    ],
)
def test_sources(expmap, folder, source):
    where = [folder / part if "." in part else part for part in source]
    code, out, err = expmap(
        "map", "from-photos", folder / "photos", "--satellite", folder / "sat.png", *where,
        "--json", "-o", folder / "map.cfg",
    )  # fmt: skip
    report = json.loads(out)
    assert code == 0
    assert report["counts"]["placed"] == 2
    assert report["satellite"] == {"path": "sat.png", "width": 400, "height": 310}
    assert report["files"][0]["x_px"] == pytest.approx(400 * (2 / 3600) / 0.002, abs=0.1)
    assert report["files"][0]["lat"] == pytest.approx(50 + 1 / 3600)
    assert report["files"][2]["x_px"] is None
    assert ("residuals" in err) == ("--control-points" in source)


def test_an_unreadable_photo_is_exit_code_1(expmap, folder):
    (folder / "photos" / "bad.jpg").write_text("no photo")
    code, out, _ = expmap("map", "from-photos", folder / "photos", "--blank", "-o", folder / "map.cfg")
    assert code == 1
    assert "1 unreadable" in out
    assert (folder / "map.cfg").exists()


def test_nothing_placed_is_exit_code_1(expmap, folder):
    (folder / "photos" / "a.jpg").unlink()
    (folder / "photos" / "b.jpg").unlink()
    code, out, err = expmap(
        "map", "from-photos", folder / "photos", "--blank", "--json", "-o", folder / "map.cfg"
    )
    assert code == 1
    assert json.loads(out)["map"] is None
    assert "no map was written" in err


@pytest.mark.parametrize(
    ("options", "part"),
    [
        ([], "--satellite"),
        (["--blank", "--satellite", "sat.png"], "--satellite"),
        (["--satellite", "sat.png", "--corners", "corners.json", "--geotiff"], "cannot be used together"),
        (["--satellite", "sat.png", "--crs", "EPSG:4326"], "--crs"),
        (["--satellite", "sat.png"], "--corners"),
    ],
)
def test_impossible_options_are_exit_code_2(expmap, folder, options, part):
    options = [folder / o if o.endswith((".png", ".json")) else o for o in options]
    code, out, err = expmap("map", "from-photos", folder / "photos", *options, "-o", folder / "map.cfg")
    assert (code, out) == (2, "")
    assert part in err


def test_an_existing_map_is_exit_code_2(expmap, folder):
    arguments = ("map", "from-photos", folder / "photos", "--blank", "-o", folder / "map.cfg")
    assert expmap(*arguments)[0] == 0
    code, _, err = expmap(*arguments)
    assert code == 2
    assert "--force" in err
    assert expmap(*arguments, "--force")[0] == 0


def test_columns_of_a_table_without_a_header(expmap, folder):
    (folder / "list.csv").write_text("a.jpg;50.0001;14.0001\nb.jpg;50.0002;14.0002\n")
    common = ("map", "from-photos", folder / "photos", "--blank", "--json", "-o", folder / "map.cfg")
    code, _, err = expmap(*common, "--positions", folder / "list.csv")
    assert code != 0 and "name=1, lat=2, lon=3" in err
    code, out, _ = expmap(*common, "--positions", folder / "list.csv", "--columns", "name=1, lat=2, lon=3")
    report = json.loads(out)
    assert (code, report["counts"]["placed"]) == (0, 2)
    assert [file["position_from"] for file in report["files"]] == ["list", "list", None]
    code, _, err = expmap(*common, "--columns", "name=1")
    assert code != 0 and "--positions" in err
