"""`expmap map inspect` shows how photos and plans are understood."""

import json

import numpy as np
import piexif
import pytest
import rasterio
from PIL import Image

from webapp.app.main import main
from webapp.core.geo.types import LatLon
from webapp.files.photos.exif_write import Geotag, format_xmp


@pytest.fixture
def inspect(capsys):
    def call(*arguments):
        with pytest.raises(SystemExit) as ended:
            main(["map", "inspect", *map(str, arguments)])
        return ended.value.code, capsys.readouterr().out

    return call


@pytest.fixture
def folder(tmp_path):
    gps = {
        1: b"N",
        2: ((50, 1), (0, 1), (0, 1)),
        3: b"E",
        4: ((14, 1), (0, 1), (0, 1)),
        17: (90, 1),
        31: (4, 1),
    }
    exif = {"0th": {271: b"Canon", 274: 6}, "Exif": {0xA405: 26}, "GPS": gps}
    Image.new("RGB", (40, 30)).save(tmp_path / "a.jpg", exif=piexif.dump(exif))
    Image.new("RGB", (40, 30)).save(tmp_path / "b.png")
    (tmp_path / "b.png.xmp").write_bytes(format_xmp(Geotag(LatLon(50.1, 14.4), heading_deg=45)))
    Image.fromarray(np.linspace(500, 900, 1200).astype(np.uint16).reshape(30, 40)).save(tmp_path / "c.png")
    profile = {
        "driver": "GTiff",
        "dtype": "uint8",
        "count": 1,
        "width": 40,
        "height": 30,
        "crs": "EPSG:32633",
    }
    place = rasterio.Affine(0.5, 0, 458000, 0, -0.5, 5550000)
    with rasterio.open(tmp_path / "plan.tif", "w", transform=place, **profile) as plan:
        plan.write(np.zeros((1, 30, 40), np.uint8))
    Image.new("LAB", (40, 30)).save(tmp_path / "lab.tif")
    (tmp_path / "text.jpg").write_text("no photo")
    return tmp_path


def test_as_text(inspect, folder):
    code, text = inspect(folder / "a.jpg", folder / "b.png", folder / "c.png", folder / "plan.tif")
    assert code == 0
    assert text.splitlines() == [
        "a.jpg: JPEG, 30 x 40 pixels, turned (EXIF orientation 6)",
        "  position: 50.0000000, 14.0000000 from EXIF, within 4 m",
        "  heading: 90.0 degrees from unknown north",
        "  field of view: 53.1 degrees, from FocalLengthIn35mmFilm",
        "  camera: Canon",
        "  as a plan: 30 x 40 pixels",
        "b.png: PNG, 40 x 30 pixels",
        "  position: 50.1000000, 14.4000000 from b.png.xmp",
        "  heading: 45.0 degrees from true north",
        "  field of view: unknown",
        "  as a plan: 40 x 30 pixels",
        "c.png: PNG, 40 x 30 pixels",
        "  position: none: it has no GPS position",
        "  field of view: unknown",
        "  note: its contrast was stretched: nearly all of its 16-bit values are from 500 to 899",
        "  as a plan: 40 x 30 pixels",
        "plan.tif: TIFF, 40 x 30 pixels",
        "  position: none: it has no GPS position",
        "  field of view: unknown",
        "  as a plan: 40 x 30 pixels, georeference in EPSG:32633, 0.5 m per pixel",
    ]


def test_what_cannot_be_read(inspect, folder):
    code, text = inspect(folder / "lab.tif", folder / "text.jpg", folder / "none.jpg")
    assert code == 1
    lines = text.splitlines()
    assert "unsupported colours (CIELab)" in lines[0]
    assert lines[1:] == [
        "text.jpg: not usable as a photo: it is not an image of a known format",
        "none.jpg: not usable as a photo: file not found (check its path)",
    ]


def test_files_beside_photos_are_no_photos(inspect, folder):
    alone, both = inspect(folder / "b.png"), inspect(folder / "b.png", folder / "b.png.xmp")
    assert both == alone
    assert both[0] == 0


def test_as_json(inspect, folder):
    code, text = inspect("--json", folder / "b.png", folder / "text.jpg")
    assert code == 1
    photo, other = (json.loads(line) for line in text.splitlines())
    assert (photo["photo"]["lat"], photo["photo"]["position_from"]) == (50.1, "b.png.xmp")
    assert photo["plan"]["width"] == 40
    assert (other["photo"], other["problem"]) == (None, "it is not an image of a known format")
