"""Collects the points of a line on the Earth into pieces: all of its points have times, or none."""

from __future__ import annotations

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np

from webapp.missions.core.trajectory.records import Source, make_poses
from webapp.missions.files.track_chunks import CHUNK, FEW_TIMES, NO_TIME, UNTIMED, Findings, WorldPiece


class LinePoint(NamedTuple):
    """A point; unknown values are NaN. The covariance is that of `Poses`."""

    time_s: float
    lat: float
    lon: float
    height_m: float = math.nan
    heading_deg: float = math.nan
    var_e: float = math.nan
    var_n: float = math.nan
    cov_en: float = math.nan


def mostly_timed(points: Sequence[LinePoint]) -> bool:
    """Return whether at least half of the points of a line have times."""
    return is_mostly_timed(sum(not math.isnan(point.time_s) for point in points), len(points))


def is_mostly_timed(timed: int, count: int) -> bool:
    """Return whether a line of `count` points, of which `timed` have times, counts as timed."""
    return timed > 0 and 2 * timed >= count


@dataclass(slots=True)
class LineBuffer:
    """The points of a line that are not yet in a piece."""

    name: str
    # Whether at least half of the points have a time: then those without one are left out. Otherwise the
    # times are dropped, and only the order of the points is kept.
    timed: bool
    source: Source = "gps"
    points: list[LinePoint] = field(default_factory=list)
    count: int = 0

    def add(self, point: LinePoint, *, findings: Findings) -> Iterator[WorldPiece]:
        """Add the next point; yield a piece when one is complete."""
        if not self.timed:
            findings.note(UNTIMED)
            findings.skip(FEW_TIMES, where=self.name, count=int(not math.isnan(point.time_s)))
            point = point._replace(time_s=float(self.count))
        elif math.isnan(point.time_s):
            findings.skip(NO_TIME, where=self.name)
            return
        self.count += 1
        self.points.append(point)
        if len(self.points) == CHUNK:
            yield self._piece()

    def flush(self, findings: Findings) -> Iterator[WorldPiece]:
        if self.points:
            yield self._piece()
        if not self.count:
            findings.skip("lines without a point", where=self.name)

    def _piece(self) -> WorldPiece:
        table = np.array(self.points)
        self.points = []
        poses = make_poses(
            table[:, 0],
            table[:, 1:3],
            height_m=table[:, 3],
            heading_deg=table[:, 4],
            covariance_m2=table[:, 5:8],
        )
        return WorldPiece(self.name, self.source, poses, self.timed)
