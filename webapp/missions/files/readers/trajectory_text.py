"""Trajectories written by SLAM programs, in a local frame: TUM and KITTI text.

TUM (Sturm et al., IROS 2012): `timestamp tx ty tz qx qy qz qw`, metres; usually x forward, y left, z up.

KITTI odometry (Geiger, Lenz, Urtasun, CVPR 2012): the twelve numbers of a 3 x 4 matrix, row by row, of a
camera that looks along z, x right, y down; without times, 10 poses per second.

Converters between the two keep the axes, so a file in either format may have the axes of the other: they are
detected where the motion shows them (`webapp.missions.core.trajectory.axes`).
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace
from itertools import islice
from typing import BinaryIO, Literal

import numpy as np
from numpy.typing import NDArray

from webapp.errors import TrackError
from webapp.files.exchange import tum
from webapp.missions.core.trajectory.axes import Axes, Frames, detect_frames, rotations_of, to_robot
from webapp.missions.files.readers.time_units import LAST_S, per_second, unit_remark
from webapp.missions.files.track_chunks import CHUNK, Findings, RobotPiece
from webapp.missions.files.track_format import FormatAbout, Selection, TrackFormat, opened

Layout = Literal["tum", "kitti"]

_COLUMNS: dict[Layout, int] = {"tum": tum.COLUMNS, "kitti": 12}
_USUAL: dict[Layout, Axes] = {"tum": "robot", "kitti": "camera"}
_KITTI_HZ = 10.0
_SAMPLED = 100_000
"""Maximum number of lines used to detect the axes."""


def layout_of(line: str) -> Layout | None:
    """Detect the format from a line of numbers; None for neither."""
    count = len(tum.parse_numbers(line) or [])
    return next((layout for layout, columns in _COLUMNS.items() if columns == count), None)


def read(
    file: BinaryIO, layout: Layout, *, findings: Findings, axes: Axes | None = None
) -> Iterator[RobotPiece]:
    """Read a trajectory; lines that begin with `#` are comments.

    Args:
        file: Must be seekable.
        axes: None for those of the format, unless the motion clearly shows others.

    Raises:
        TrackError: The file is not text, or has no pose.
    """
    sample = _sample(file, layout)
    frames = _frames(layout, sample, axes=axes, findings=findings)
    ticks = per_second(sample[:, 0]) if layout == "tum" and len(sample) else 1.0
    findings.note(unit_remark(ticks, sample[0, 0]) if len(sample) else "")
    if layout == "kitti":
        findings.note("the poses have no times: they count as ten a second from 1970-01-01")
    rows: list[list[float]] = []
    given = 0
    file.seek(0)
    for number, row in tum.read_rows(file, columns=_COLUMNS[layout]):
        if row is None:
            findings.skip(f"lines without {_COLUMNS[layout]} numbers", where=f"line {number}")
            continue
        if layout == "tum":
            row[0] /= ticks
            if abs(row[0]) >= LAST_S:
                findings.skip("lines with a time that no calendar has", where=f"line {number}")
                continue
        rows.append(row)
        if len(rows) == CHUNK:
            yield _piece(layout, np.array(rows), given, frames=frames)
            given += len(rows)
            rows = []
    if rows:
        yield _piece(layout, np.array(rows), given, frames=frames)
    elif not given:
        raise TrackError("the file has no pose")


def _sample(file: BinaryIO, layout: Layout) -> NDArray[np.float64]:
    """Return the first rows."""
    lines = tum.read_rows(file, columns=_COLUMNS[layout])
    rows = [row for _, row in islice(lines, _SAMPLED) if row is not None]
    return np.array(rows).reshape(-1, _COLUMNS[layout])


def _frames(layout: Layout, sample: NDArray[np.float64], *, axes: Axes | None, findings: Findings) -> Frames:
    if axes is not None:
        return Frames(axes, axes)
    usual = Frames(_USUAL[layout], _USUAL[layout])
    if not len(sample):
        return usual
    frames, remark = detect_frames(*_parts(layout, sample), usual=usual)
    findings.note(remark)
    return frames


def _parts(layout: Layout, rows: NDArray[np.float64]) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Return the positions (n, 3) and rotations (n, 3, 3) of rows."""
    if layout == "tum":
        return rows[:, 1:4], rotations_of(rows[:, 4:])
    matrix = rows.reshape(-1, 3, 4)
    return matrix[:, :, 3], matrix[:, :, :3]


def _piece(layout: Layout, rows: NDArray[np.float64], given: int, *, frames: Frames) -> RobotPiece:
    xyz, rotation = _parts(layout, rows)
    times = rows[:, 0] if layout == "tum" else (given + np.arange(len(rows))) / _KITTI_HZ
    local = to_robot(times, xyz, rotation=rotation, frames=frames)
    return RobotPiece("", "odometry", "", "", local, layout == "tum")


def _reader(layout: Layout) -> Callable[[BinaryIO, Selection, Findings], Iterator[RobotPiece]]:
    return lambda file, selection, findings: read(file, layout, findings=findings, axes=selection.axes)


_TUM = TrackFormat(
    "tum",
    "TUM trajectory",
    "TUM",
    endings=(".tum", ".txt"),
    is_one=lambda beginning: layout_of(beginning.content) == "tum",
    read=opened(_reader("tum")),
    has_axes=True,
    about=FormatAbout(
        tracks="the poses; [axes](#axes) are detected", written_by="SLAM programs, ORB-SLAM, evo"
    ),
)
_KITTI = replace(
    _TUM,
    name="kitti",
    title="KITTI trajectory",
    called="KITTI",
    endings=(".kitti", ".txt"),
    is_one=lambda beginning: layout_of(beginning.content) == "kitti",
    read=opened(_reader("kitti")),
    about=replace(_TUM.about, tracks="the poses, without times: ten a second; [axes](#axes) are detected"),
)
FORMATS = (_TUM, _KITTI)
