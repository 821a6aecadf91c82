"""Reads a file with tracks, of any format, into pieces."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

from webapp.missions.core.trajectory.axes import Axes
from webapp.missions.files import (
    csv_reader,
    fit,
    geojson_reader,
    gpx,
    igc,
    kml_reader,
    nmea,
    rosbag,
    tcx,
    trajectory_text,
)
from webapp.missions.files.track_chunks import Findings, Piece
from webapp.missions.files.track_format import Kind

BAG_SUFFIXES: dict[Kind, str] = {
    "ros1": ".bag",
    "ros2-sqlite": ".db3",
    "ros2-mcap": ".mcap",
    "ros2-folder": "",
}
"""Kinds of bags, and the suffixes of their files."""


@dataclass(frozen=True, slots=True)
class Selection:
    """What to read of a file."""

    topics: tuple[str, ...] = ()  # Only these topics of a bag, or lines of a KML; empty for all
    columns: str | None = None  # Meaning of the columns of a table; None to infer it
    axes: Axes | None = None  # Axes of frames in TUM, KITTI and tables; None to detect them


def read(path: Path, kind: Kind, *, selection: Selection, findings: Findings) -> Iterator[Piece]:
    """Yield the pieces of a file, before they are georeferenced.

    Args:
        path: A file, or the folder of a ROS 2 bag.

    Raises:
        TrackError: The file is damaged, or has no usable content.
        UsageError: The given columns do not fit the table.
    """
    if kind in BAG_SUFFIXES:
        suffix, topics = BAG_SUFFIXES[kind], selection.topics
        yield from rosbag.read(path, suffix=suffix, wanted=topics, findings=findings)
    elif kind == "kmz":
        with kml_reader.opened_kml(path) as packed:
            yield from kml_reader.read(packed, findings=findings, tracks=selection.topics)
    else:
        with path.open("rb") as file:
            match kind:
                case "gpx":
                    yield from gpx.read(file, findings=findings)
                case "kml":
                    yield from kml_reader.read(file, findings=findings, tracks=selection.topics)
                case "nmea":
                    yield from nmea.read(file, findings=findings)
                case "tcx":
                    yield from tcx.read(file, findings=findings)
                case "geojson":
                    yield from geojson_reader.read(file, findings=findings)
                case "fit":
                    yield from fit.read(file, findings=findings)
                case "igc":
                    yield from igc.read(file, findings=findings)
                case "tum" | "kitti":
                    yield from trajectory_text.read(file, kind, findings=findings, axes=selection.axes)
                case "csv":
                    yield from csv_reader.read(
                        file, columns=selection.columns, findings=findings, axes=selection.axes
                    )
                case _:
                    raise AssertionError(f"no reader of {kind}")
