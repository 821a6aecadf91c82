"""Trajectories as SLAM programs write them, in a robot's frame: TUM and KITTI text.

TUM (Sturm et al., IROS 2012): `timestamp tx ty tz qx qy qz qw`, metres, x forward, y left, z up.

KITTI odometry (Geiger, Lenz, Urtasun, CVPR 2012): the twelve numbers of a 3 x 4 matrix, row by row, of a
camera that looks along z, x right, y down; without times, ten a second.
"""

from __future__ import annotations

import math
from collections.abc import Iterator
from typing import BinaryIO, Literal

import numpy as np
from numpy.typing import NDArray

from webapp.core.trajectory.robotframe import LocalPoses
from webapp.errors import TrackError
from webapp.files.exchange import tum
from webapp.missions.files.track_chunks import CHUNK, Findings, RobotPiece

Layout = Literal["tum", "kitti"]

_COLUMNS: dict[Layout, int] = {"tum": tum.COLUMNS, "kitti": 12}
_KITTI_HZ = 10.0


def layout_of(line: str) -> Layout | None:
    """Detect from a line of numbers which of the two it is; None for neither."""
    count = len(tum.parse_numbers(line) or [])
    return next((layout for layout, columns in _COLUMNS.items() if columns == count), None)


def read(file: BinaryIO, layout: Layout, *, findings: Findings) -> Iterator[RobotPiece]:
    """Read a trajectory; lines that begin with `#` are remarks.

    Raises
    ------
    TrackError
        It is not a text, or has no pose.
    """
    if layout == "kitti":
        findings.note("the poses have no times: they count as ten a second from 1970-01-01")
    rows: list[list[float]] = []
    given = 0
    for number, row in tum.read_rows(file, columns=_COLUMNS[layout]):
        if row is None:
            findings.skip(f"lines without {_COLUMNS[layout]} numbers", where=f"line {number}")
            continue
        rows.append(row)
        if len(rows) == CHUNK:
            yield _piece(layout, np.array(rows), given)
            given += len(rows)
            rows = []
    if rows:
        yield _piece(layout, np.array(rows), given)
    elif not given:
        raise TrackError("the file has no pose")


def _piece(layout: Layout, rows: NDArray[np.float64], given: int) -> RobotPiece:
    if layout == "tum":
        times, xyz, yaw = rows[:, 0], rows[:, 1:4], tum.yaw_of(rows[:, 4:])
    else:
        times = (given + np.arange(len(rows))) / _KITTI_HZ
        matrix = rows.reshape(-1, 3, 4)
        # forward of the robot is z of the camera, left is -x, up is -y
        xyz = matrix[:, [2, 0, 1], 3] * (1.0, -1.0, -1.0)
        yaw = np.arctan2(-matrix[:, 0, 2], matrix[:, 2, 2])
    unknown = np.full((len(rows), 3), math.nan)
    return RobotPiece("", "odometry", "", "", LocalPoses(times, xyz, yaw, unknown), layout == "tum")
