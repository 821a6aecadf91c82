"""A rejected image leaves no file, and a replaced one is kept for undo."""

import os
import time
from datetime import timedelta

import pytest

from tests.web.satellite.images import png
from webapp.tasks.satellite import files


@pytest.fixture
def images(library, park):
    """Return the names of the images in the map's folder, and of the folders derived from them."""

    def listed():
        folder = library.map_folder(park)
        made = (folder / "derived" / "satellite").iterdir()
        return sorted(path.name for path in folder.glob("satellite-*")), len(list(made))

    return listed


@pytest.mark.parametrize("way", ["upload", "blank"])
def test_a_refused_image_is_gone(client, base, put, add_photos, images, way):
    put(png(400, 200))
    add_photos({"x_px": 390.0, "y_px": 10.0})
    before = images()
    answer = (
        put(png(150, 150, shade=9))
        if way == "upload"
        else client.post(f"{base}/satellite/blank", json={"width": 150, "height": 150})
    )
    assert answer.status_code == 400
    assert images() == before
    found = client.get(f"{base}/findings").json["findings"]
    assert "orphan-photo" not in {problem["code"] for problem in found}


def test_a_refused_image_that_the_map_had_before_stays(client, base, put, add_photos, images):
    put(png(150, 150, shade=9))
    put(png(400, 200))
    add_photos({"x_px": 390.0, "y_px": 10.0})
    before, _ = images()
    assert put(png(150, 150, shade=9)).status_code == 400
    assert images()[0] == before


def test_what_a_killed_upload_has_left_is_swept_after_a_while(
    library, put, record, images, park, monkeypatch
):
    put(png(400, 200))
    put(png(500, 200))
    known, _ = images()
    left = library.map_folder(park) / "satellite-0123abcd.png"
    for path in (left, *(library.map_folder(park) / name for name in known)):
        path.write_bytes(path.read_bytes() if path.exists() else b"left")
        os.utime(path, (time.time() - 7200,) * 2)
    assert files.sweep(library, record().id, keep=timedelta(hours=3)) == 0
    assert files.sweep(library, record().id, keep=timedelta(hours=1)) == 1
    assert images()[0] == known
    monkeypatch.setattr(library.database, "write", None)
    assert files.sweep(library, record().id, keep=timedelta(hours=1)) == 0, "and nobody has to wait for it"
