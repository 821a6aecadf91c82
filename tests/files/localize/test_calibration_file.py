"""Stored calibrations: read back, or recomputed if unusable."""

import json

import pytest

from webapp.core.hypotheses.calibration import DEFAULT
from webapp.files.localize import calibration
from webapp.files.localize.calibration import StoredCalibration

STORED = StoredCalibration(DEFAULT, 61.5, 20.0, frozenset({"abababab@1,2", "cdcdcdcd@3,4"}), 2.5)


def test_it_comes_back(tmp_path):
    calibration.write(tmp_path / "c.json", STORED)
    assert calibration.read(tmp_path / "c.json") == STORED


def test_a_missing_one_is_none(tmp_path):
    assert calibration.read(tmp_path / "c.json") is None


@pytest.mark.parametrize("text", ["", "{", "[]", "3", "null", "{}"])
def test_another_file_is_none(tmp_path, text):
    (tmp_path / "c.json").write_text(text)
    assert calibration.read(tmp_path / "c.json") is None


@pytest.mark.parametrize(
    "change",
    [
        lambda raw: raw.update(format=99),
        lambda raw: raw.pop("photos"),
        lambda raw: raw.update(calibration=None),
        lambda raw: raw["calibration"].update(slope=[1.0]),
        lambda raw: raw["calibration"].update(colour=1),
        lambda raw: raw["calibration"].pop("offset"),
        lambda raw: raw.update(seconds="long"),
    ],
)
def test_one_of_another_version_is_none(tmp_path, change):
    path = tmp_path / "c.json"
    calibration.write(path, STORED)
    raw = json.loads(path.read_text())
    change(raw)
    path.write_text(json.dumps(raw))
    assert calibration.read(path) is None
