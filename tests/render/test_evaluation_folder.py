import base64
import csv
import io
import json
import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from webapp.errors import StorageError
from webapp.files.exchange import tum
from webapp.render.report import COLUMNS, results_csv, worst_rows, write_evaluation
from webapp.settings import PhotoLimits
from webapp.tasks.evaluation.evaluate import to_json
from webapp.tasks.evaluation.types import Evaluation


@pytest.fixture(scope="session")
def written(evaluation: Evaluation, tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("out") / "new" / "folder"
    write_evaluation(evaluation, folder, limits=PhotoLimits())
    return folder


def test_folder_holds_report_tables_and_poses(written: Path, evaluation: Evaluation) -> None:
    names = {"report.html", "results.csv", "results.json", "estimate.tum", "truth.tum"}
    assert {path.name for path in written.iterdir()} == names
    assert json.loads((written / "results.json").read_text(encoding="utf-8")) == json.loads(
        json.dumps(to_json(evaluation))
    )


def test_report_shows_pictures_of_the_worst_queries(written: Path) -> None:
    html = (written / "report.html").read_text(encoding="utf-8")
    pictures = re.findall(r"data:image/jpeg;base64,([^\"]+)", html)
    assert len(pictures) == 4
    for data in pictures:
        assert Image.open(io.BytesIO(base64.b64decode(data))).width > 500


def test_poses_are_numbered_by_query_and_missing_ones_left_out(written: Path) -> None:
    estimate, truth = (rows(written / f"{name}.tum") for name in ("estimate", "truth"))
    assert estimate[:, 0].tolist() == [0, 1]
    assert truth[:, 0].tolist() == [0, 1, 2, 3]
    assert estimate[0, 1:3].tolist() == [64, 153]
    assert tum.yaw_of(estimate[:1, 4:]) == pytest.approx(0)
    assert np.isnan(tum.yaw_of(truth[:1, 4:])).all()


def rows(path: Path) -> np.ndarray:
    with path.open("rb") as file:
        return np.array([row for _, row in tum.read_rows(file)])


def test_worst_come_first_and_need_a_hypothesis(evaluation: Evaluation) -> None:
    assert [row.result.path for row in worst_rows(evaluation.rows, 8)] == ["q1.jpg", "a & b.jpg"]
    assert [row.result.path for row in worst_rows(evaluation.rows, 1)] == ["q1.jpg"]


def test_csv_has_a_line_a_query(georeferenced: Evaluation) -> None:
    text = results_csv(georeferenced.rows)
    lines = list(csv.DictReader(io.StringIO(text), delimiter=";"))
    assert tuple(lines[0]) == COLUMNS
    first, _, none, failed = lines
    assert (first["path"], first["keypoints"], first["matches_pruned"]) == ("a & b.jpg", "100", "50")
    assert (first["first_px"], first["grade_first"], first["grade_others"]) == (
        "5.0",
        "excellent",
        "insufficient",
    )
    assert float(first["first_m"]) == pytest.approx(2.5, rel=1e-3)
    assert (float(first["worst_m"]), float(first["probability"])) == (pytest.approx(100, rel=1e-3), 0.8)
    assert (none["first_px"], none["off_map_probability"], none["error"]) == ("", "1.0", "")
    assert (failed["keypoints"], failed["error"]) == ("", "the file is <b>no</b> photo")


def test_folder_that_cannot_be_made(evaluation: Evaluation, tmp_path: Path) -> None:
    (tmp_path / "file").write_text("in the way", encoding="utf-8")
    with pytest.raises(StorageError):
        write_evaluation(replace(evaluation, results=()), tmp_path / "file", limits=PhotoLimits())
