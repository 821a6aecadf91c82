import math
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from webapp.errors import TableError
from webapp.files.localize import tum
from webapp.files.localize.tum import PlanarPose

NUMBERS = st.floats(-1e7, 1e7)
ANGLES = st.none() | st.floats(-3.14, 3.14)


@given(st.lists(st.builds(PlanarPose, NUMBERS, NUMBERS, NUMBERS, ANGLES), max_size=8))
def test_round_trip(tmp_path_factory: pytest.TempPathFactory, poses: list[PlanarPose]) -> None:
    path = tmp_path_factory.getbasetemp() / "poses.tum"
    tum.write(path, poses, remarks=["metres"])
    again = tum.read(path)
    assert [(p.timestamp, p.x, p.y) for p in again] == [(p.timestamp, p.x, p.y) for p in poses]
    for old, new in zip(poses, again, strict=True):
        assert (old.yaw_rad is None) == (new.yaw_rad is None)
        if old.yaw_rad is not None:
            assert new.yaw_rad == pytest.approx(old.yaw_rad, abs=1e-12)


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


@pytest.mark.parametrize("line", ["1 2 3", "a b c d e f g h", "0 0 0 0 0 0 0 0", "0 nan 0 0 0 0 0 1"])
def test_refuses_what_is_no_pose(tmp_path: Path, line: str) -> None:
    path = tmp_path / "poses.tum"
    path.write_text("# remark\n" + line + "\n", encoding="utf-8")
    with pytest.raises(TableError, match=r"poses\.tum:2"):
        tum.read(path)
