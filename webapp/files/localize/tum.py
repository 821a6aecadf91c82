"""Trajectories in the TUM format: `timestamp tx ty tz qx qy qz qw`, separated by spaces, `#` for remarks.

Positions are in the unit and frame of whoever writes them; the rotation turns the body's x axis (forward)
about z by `yaw_rad` from the frame's x axis towards its y axis. The format cannot leave a rotation out: an
unknown one is written as the identity under a remark line `# heading unknown`, which the reader here
understands and every other reader skips.

The format is from Sturm, Engelhard, Endres, Burgard, Cremers, "A benchmark for the evaluation of RGB-D SLAM
systems", IROS 2012.
"""

from __future__ import annotations

import math
from collections.abc import Iterable
from dataclasses import dataclass
from pathlib import Path

from webapp.errors import TableError
from webapp.files.atomic import write_text

_UNKNOWN = "# heading unknown"


@dataclass(frozen=True, slots=True)
class PlanarPose:
    """A pose on a plane.

    Attributes
    ----------
    timestamp : float
        Seconds, or whatever counts the poses.
    x, y : float
    yaw_rad : float or None
        From the frame's x axis towards its y axis; None where it is unknown.
    """

    timestamp: float
    x: float
    y: float
    yaw_rad: float | None = None


def write(path: Path, poses: Iterable[PlanarPose], *, remarks: Iterable[str] = ()) -> None:
    """Write a trajectory.

    Parameters
    ----------
    path : Path
    poses : iterable of PlanarPose
    remarks : iterable of str
        Lines for the top of the file: the frame and its unit, say.

    Raises
    ------
    StorageError
        The file cannot be written.
    """
    lines = [f"# {remark}" for remark in (*remarks, "timestamp tx ty tz qx qy qz qw")]
    for pose in poses:
        if pose.yaw_rad is None:
            lines.append(_UNKNOWN)
        half = (pose.yaw_rad or 0.0) / 2
        numbers = (pose.timestamp, pose.x, pose.y, 0.0, 0.0, 0.0, math.sin(half), math.cos(half))
        lines.append(" ".join(repr(float(number)) for number in numbers))
    write_text(path, "\n".join(lines) + "\n")


def read(path: Path) -> list[PlanarPose]:
    """Read a trajectory; heights and rotations out of the plane are dropped.

    Parameters
    ----------
    path : Path

    Returns
    -------
    list of PlanarPose

    Raises
    ------
    TableError
        The file cannot be read, or a line does not hold eight finite numbers with a rotation among them.
    """
    try:
        lines = path.read_text(encoding="utf-8-sig").splitlines()
    except (OSError, UnicodeDecodeError) as error:
        raise TableError(f"the trajectory cannot be read: {error}", where=str(path)) from error
    poses = []
    known = True
    for number, line in enumerate(lines, 1):
        if line.startswith("#") or not line.strip():
            known = line.rstrip() != _UNKNOWN
            continue
        poses.append(_pose(line, known, f"{path}:{number}"))
        known = True
    return poses


def _pose(line: str, known: bool, where: str) -> PlanarPose:
    try:
        values = [float(field) for field in line.split()]
    except ValueError as error:
        raise TableError(str(error), where=where, hint="write numbers separated by spaces") from error
    if len(values) != 8 or not all(map(math.isfinite, values)) or not any(values[4:]):
        raise TableError("not a pose", where=where, hint="write timestamp tx ty tz qx qy qz qw")
    timestamp, x, y, _, qx, qy, qz, qw = values
    yaw = math.atan2(2 * (qw * qz + qx * qy), qw * qw + qx * qx - qy * qy - qz * qz)
    return PlanarPose(timestamp, x, y, yaw if known else None)
