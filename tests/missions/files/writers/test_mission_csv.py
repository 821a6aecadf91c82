"""CSV stores every number exactly."""

import csv
import io

import numpy as np
import pytest

from webapp.files.text_file import cell_text, plain_cell
from webapp.missions.files.csv_writer import (
    OBJECT_COLUMNS,
    POSE_COLUMNS,
    csv_lines,
    format_objects_csv,
    format_poses_csv,
)


def rows(pieces):
    text = b"".join(pieces).decode()
    return list(csv.DictReader(io.StringIO(text, newline="")))


def number(text):
    return float(text) if text else np.nan


def test_poses_read_back_exactly(mission):
    result = rows(format_poses_csv(mission))
    assert tuple(result[0]) == POSE_COLUMNS
    for track in mission.tracks:
        mine = [row for row in result if (row["source"], row["track"]) == (track.source, track.name)]
        assert [int(row["number"]) for row in mine] == list(range(track.count))
        whole = [np.concatenate([getattr(p, f) for p in track.poses()]) for f in ("latlon", "height_m")]
        assert [[number(row["lat"]), number(row["lon"])] for row in mine] == whole[0].tolist()
        np.testing.assert_array_equal([number(row["height_m"]) for row in mine], whole[1])
        assert all(row["time"].endswith("Z") for row in mine)


def test_objects_read_back(mission):
    result = rows(format_objects_csv(mission))
    assert tuple(result[0]) == OBJECT_COLUMNS
    for found, row in zip(mission.objects(), result, strict=True):
        assert (row["id"], row["class"], int(row["sightings"])) == (found.id, found.kind, found.sightings)
        assert (float(row["lat"]), float(row["lon"])) == tuple(found.latlon)
        assert [number(row[name]) for name in ("var_e_m2", "var_n_m2", "cov_en_m2")] == pytest.approx(
            found.covariance_m2 or [np.nan] * 3, nan_ok=True
        )
        assert row["confidence"] == ("" if found.confidence is None else repr(found.confidence))


@pytest.mark.parametrize(
    "text", ["=HYPERLINK(1)", "+1+cmd|' /C calc'!A0", "-2+3", "@SUM(1)", "\t=1", "'=1", "=", "-"]
)
def test_no_text_is_a_formula_and_each_reads_back(text):
    cell = csv_lines([[text]]).decode().strip("\r\n").removeprefix('"').removesuffix('"')
    assert cell.startswith("'")
    assert cell_text(str(plain_cell(text))) == text


@pytest.mark.parametrize("text", ["-1.5", "+3", "-1e-05", "car", "", "'twas", "a=b", None, -3])
def test_numbers_and_usual_texts_stay(text):
    assert plain_cell(text) == text
    assert text is None or cell_text(str(text)) == str(text)
