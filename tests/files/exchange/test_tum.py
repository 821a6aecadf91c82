import io
import math
from pathlib import Path

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from webapp.files.exchange import tum
from webapp.files.exchange.tum import PlanarPose

NUMBERS = st.floats(-1e7, 1e7)
ANGLES = st.none() | st.floats(-3.14, 3.14)


@given(st.lists(st.builds(PlanarPose, NUMBERS, NUMBERS, NUMBERS, ANGLES), max_size=8))
def test_round_trip(tmp_path_factory: pytest.TempPathFactory, poses: list[PlanarPose]) -> None:
    path = tmp_path_factory.getbasetemp() / "poses.tum"
    tum.write(path, poses, remarks=["metres"])
    with path.open("rb") as file:
        rows = [row for _, row in tum.read_rows(file)]
    again = np.array(rows, dtype=np.float64).reshape(-1, 8)
    assert again[:, :3].tolist() == [[p.timestamp, p.x, p.y] for p in poses]
    yaw = [math.nan if p.yaw_rad is None else p.yaw_rad for p in poses]
    np.testing.assert_allclose(tum.yaw_of(again[:, 4:]), yaw, atol=1e-12, rtol=0)


def test_lines_are_what_other_programs_read(tmp_path: Path) -> None:
    path = tmp_path / "poses.tum"
    tum.write(path, [PlanarPose(0, 1.5, -2, math.pi / 2), PlanarPose(1, 3, 4)], remarks=["metres"])
    lines = path.read_text(encoding="utf-8").splitlines()
    assert lines[:2] == ["# metres", "# timestamp tx ty tz qx qy qz qw"]
    assert [float(n) for n in lines[2].split()] == pytest.approx(
        [0, 1.5, -2, 0, 0, 0, math.sqrt(0.5), math.sqrt(0.5)]
    )
    assert lines[3] == "# heading unknown"
    assert [float(n) for n in lines[4].split()] == [1, 3, 4, 0, 0, 0, 0, 1]


@pytest.mark.parametrize("line", ["1 2 3", "a b c d e f g h", "0 nan 0 0 0 0 0 1", "1 2 3 4 5 6 7 8 9"])
def test_a_bad_line_has_its_number_and_no_pose(line: str) -> None:
    text = f"# remark\n\n{line}\n0 1 2 3 0 0 0 1\n"
    assert list(tum.read_rows(io.BytesIO(text.encode()))) == [(3, None), (4, [0, 1, 2, 3, 0, 0, 0, 1])]


def test_a_remark_marks_one_heading_as_unknown() -> None:
    text = "# heading unknown\n0 1 2 0 0 0 0 1\n1 1 2 0 0 0 0 1\n"
    rows = np.array([row for _, row in tum.read_rows(io.BytesIO(text.encode()))])
    np.testing.assert_array_equal(tum.yaw_of(rows[:, 4:]), [math.nan, 0.0])
