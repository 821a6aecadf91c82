"""`expmap map blur`: output, and changes in a folder and in a library."""

import json

import cv2
import numpy as np
import pytest

from tests.standin_models import install_blur_networks
from webapp.files.maps.folder import read_map
from webapp.store.accounts import accounts
from webapp.store.library import open_library
from webapp.store.schema import MapRecord
from webapp.tasks.maps import adopt_map


@pytest.fixture
def cfg(tmp_path, make_map):
    """A map of two photos; one has a white spot."""
    cfg = make_map(tmp_path / "library" / "park", 2)
    for number in (0, 1):
        pixels = np.zeros((240, 320, 3), np.uint8)
        pixels[96:112, 192 : 192 + 16 * number] = 255
        cv2.imwrite(str(cfg.parent / "photos" / f"{number}.jpg"), pixels)
    return cfg


@pytest.fixture
def models(tmp_path, monkeypatch):
    folder = tmp_path / "models"
    monkeypatch.setenv("EXPMAP_MODELS", str(folder))
    return folder


def test_nothing_is_changed_before_it_is_accepted(expmap, cfg, models, monkeypatch):
    install_blur_networks(models, monkeypatch.setitem)
    code, out, err = expmap("map", "blur", cfg)
    assert code == 0
    assert out.startswith("photos/1.jpg: ") and "face 100%" in out and "number plate 100%" in out
    assert "in 1 of 2 photos searched, nothing changed" in err
    assert not any(e.blurred for e in read_map(cfg).experiences)
    code, _, err = expmap("map", "blur", cfg, "--accept")
    assert (code, "1 photos blurred" in err) == (0, True)
    assert [bool(e.blurred) for e in read_map(cfg).experiences] == [False, True]
    code, out, _ = expmap("map", "blur", cfg, "--json")
    assert json.loads(out) == {"searched": 2, "photos": [], "failed": [], "missing": []}


def test_in_a_library_the_photos_are_blurred_there(expmap, cfg, models, monkeypatch):
    install_blur_networks(models, monkeypatch.setitem, models=["plates"])
    library = open_library(cfg.parent.parent)
    with library.database.write() as session:
        owner = accounts.ensure_owner(session)
    id = adopt_map.adopt_map(library, "park", account_id=owner.id)
    code, out, err = expmap("map", "blur", cfg, "--accept", "--json")
    assert code == 0
    assert "faces will not be searched for: expmap models fetch faces" in err
    answer = json.loads(out)
    assert answer["missing"] == ["faces"]
    assert [(p["id"], p["blurred"], p["boxes"][0]["kind"]) for p in answer["photos"]] == [(1, True, "plate")]
    with library.database.read() as session:
        assert [len(p.blurred or ()) > 0 for p in session.get_one(MapRecord, id).photos] == [False, True]
    library.database.close()


def test_without_networks_it_says_what_to_install(expmap, cfg, models):
    code, out, err = expmap("map", "blur", cfg)
    assert (code, out) == (4, "")
    assert "expmap models fetch faces plates" in err


def test_a_photo_that_cannot_be_read_is_named(expmap, cfg, models, monkeypatch):
    install_blur_networks(models, monkeypatch.setitem)
    (cfg.parent / "photos" / "0.jpg").write_bytes(b"no photo")
    code, out, err = expmap("map", "blur", cfg)
    assert code == 1
    assert "photos/0.jpg (id 0): " in err
    assert out.startswith("photos/1.jpg")
