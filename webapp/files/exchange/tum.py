"""Trajectories in the TUM format: `timestamp tx ty tz qx qy qz qw`, separated by spaces, `#` for comments.

Unit and frame of the positions are the caller's choice; the rotation turns the body's x axis (forward)
about z by `yaw_rad` from the frame's x axis towards its y axis. The format requires a rotation: an unknown
one is written as the identity after a comment line `# heading unknown`, which our reader understands and
others skip.

The format is from Sturm, Engelhard, Endres, Burgard, Cremers, "A benchmark for the evaluation of RGB-D SLAM
systems", IROS 2012.
"""

from __future__ import annotations

import math
from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np
from numpy.typing import NDArray

from webapp.files.atomic import write_text
from webapp.files.text_file import numbered_lines

COLUMNS = 8
_UNKNOWN = "# heading unknown"
_IDENTITY = [0.0, 0.0, 0.0, 1.0]


@dataclass(frozen=True, slots=True)
class PlanarPose:
    timestamp: float  # Seconds, or the number of the pose
    x: float
    y: float
    yaw_rad: float | None = None  # From the frame's x axis towards its y axis; None where it is unknown


def write(path: Path, poses: Iterable[PlanarPose], *, remarks: Iterable[str] = ()) -> None:
    lines = [f"# {remark}" for remark in (*remarks, "timestamp tx ty tz qx qy qz qw")]
    for pose in poses:
        if pose.yaw_rad is None:
            lines.append(_UNKNOWN)
        half = (pose.yaw_rad or 0.0) / 2
        numbers = (pose.timestamp, pose.x, pose.y, 0.0, 0.0, 0.0, math.sin(half), math.cos(half))
        lines.append(" ".join(repr(float(number)) for number in numbers))
    write_text(path, "\n".join(lines) + "\n")


def read_rows(file: BinaryIO, *, columns: int = COLUMNS) -> Iterator[tuple[int, list[float] | None]]:
    """Read a trajectory, or another text file of numbers and comments, row by row.

    Args:
        columns: Numbers per row: 8, or 12 for KITTI's matrices.

    Yields:
        Number of the line, from 1.
        None for a line that does not hold `columns` finite numbers. After the comment `# heading unknown` the
            quaternion is zero, for which `yaw_of` returns NaN.

    Raises:
        TrackError: A line is too long, or the file is UTF-16.
    """
    unknown = False
    for number, line in numbered_lines(file):
        text = line.strip()
        if not text or text.startswith("#"):
            unknown = text == _UNKNOWN
            continue
        row = parse_numbers(text)
        if row is not None and len(row) != columns:
            row = None
        if row is not None and unknown and row[4:] == _IDENTITY:
            row[4:] = [0.0] * 4
        unknown = False
        yield number, row


def parse_numbers(line: str) -> list[float] | None:
    """Parse finite numbers separated by white space; None if any is invalid."""
    try:
        values = [float(word) for word in line.split()]
    except ValueError:
        return None
    return values if all(map(math.isfinite, values)) else None


def yaw_of(quaternion: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compute the rotation about z.

    Args:
        quaternion: (n, 4) float64. x, y, z, w; need not be normalised.

    Returns:
        (n,) float64: Radians from x towards y; NaN for a zero quaternion.
    """
    x, y, z, w = quaternion.T
    sin, cos = 2.0 * (w * z + x * y), w * w + x * x - y * y - z * z
    return np.where((quaternion != 0.0).any(axis=1), np.arctan2(sin, cos), math.nan)
