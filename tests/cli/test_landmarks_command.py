"""`expmap landmarks build` for people and scripts, with a synthetic reconstruction."""

import json
from pathlib import Path

import numpy as np
import pytest

from webapp.cli import landmarks
from webapp.core.landmarks.submodels import Submodel
from webapp.files.maps.folder import read_map
from webapp.tasks.landmarks.adjust import AdjustedSubmodel
from webapp.tasks.landmarks.reconstruct import Reconstruction
from webapp.tasks.landmarks.stored import ExportedModel


@pytest.fixture
def cfg(tmp_path, make_map, monkeypatch):
    """A map of five photos, three of which are joined and one of which cannot be read."""
    cfg = make_map(tmp_path, 5)
    submodel = Submodel(np.array([0, 2, 3]), np.zeros((3, 3)), np.zeros((3, 3, 3)))
    photos = read_map(cfg).experiences
    found = Reconstruction(
        photos, (submodel,), {4: "it is not an image"}, tmp_path, tmp_path, tmp_path / "matches.db", {}
    )
    monkeypatch.setattr(landmarks, "reconstruct", lambda *_, **__: found)
    report = [
        AdjustedSubmodel((0, 2, 3), "", {0: 1.234, 3: 140.0}),
        AdjustedSubmodel((1,), "none of them is placed", {}),
        AdjustedSubmodel((4,), "none of them is placed", {}),
    ]
    monkeypatch.setattr(landmarks, "adjust_submodels", lambda found, *_, **__: (found, report))
    monkeypatch.setattr(landmarks, "colour_cloud", lambda *_, **__: None)
    monkeypatch.setattr(landmarks, "export_models", lambda _, out, **__: [ExportedModel(out / "0", 3, 700)])
    return cfg


def test_it_says_what_is_joined(expmap, cfg):
    code, out, err = expmap("landmarks", "build", cfg)
    assert code == 0
    assert out.splitlines() == [
        "3 of 5 photos joined; photos of each piece: 3",
        "3 photos on the map",
        "2 photos as they were: none of them is placed",
    ]
    assert "photos/4.jpg (id 4): it is not an image" in err


def test_models_are_written_where_they_are_wanted(expmap, cfg):
    _, out, _ = expmap("landmarks", "build", cfg, "--out", "models")
    assert out.splitlines()[-1] == f"{Path('models') / '0'}: 3 photos, 700 points"


def test_json_has_everything(expmap, cfg):
    _, out, _ = expmap("landmarks", "build", cfg, "--out", "models", "--json")
    told = json.loads(out)
    assert told.pop("seconds") >= 0.0
    assert told == {
        "photos": 5,
        "pieces": [[0, 2, 3]],
        "failed": [{"id": 4, "reason": "it is not an image"}],
        "models": [{"folder": str(Path("models") / "0"), "photos": 3, "points": 700}],
        "adjusted": [
            {
                "photos": 3,
                "problem": None,
                "anchors": [
                    {"id": 3, "photo": "photos/3.jpg", "residual_px": 140.0},
                    {"id": 0, "photo": "photos/0.jpg", "residual_px": 1.23},
                ],
            },
            {"photos": 1, "problem": "none of them is placed", "anchors": []},
            {"photos": 1, "problem": "none of them is placed", "anchors": []},
        ],
    }
