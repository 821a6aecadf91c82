"""Writes the tracks of a mission as TUM and KITTI trajectories: a zip with a text file for each track.

All tracks of a mission share one frame, whose origin is the first pose of the first track. In TUM its axes
are x east, y north, z up, and orientations are those of a robot that looks along its x axis. In KITTI its
axes are x east, y down, z north, and orientations are those of a camera that looks along its z axis.
"""

from __future__ import annotations

import math
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from webapp.core.geo.local import LocalFrame
from webapp.core.geo.types import LatLon
from webapp.files.exchange.zip_stream import ZipMember, stream_zip
from webapp.missions.core.trajectory.outgoing import ExportTrack, MissionExport
from webapp.missions.core.trajectory.records import Poses

_TUM_REMARK = "# timestamp tx ty tz qx qy qz qw: x east, y north, z up, metres from {lat:.9f}, {lon:.9f}\n"
_UNTIMED = "# the track has no times: the first column counts its poses\n"
_UNKNOWN = "# heading unknown\n"


def format_tum_zip(mission: MissionExport) -> Iterator[bytes]:
    """Write tracks in TUM format; a pose with unknown heading gets a comment and the identity rotation."""
    origin = _origin(mission)
    return stream_zip(
        ZipMember(name, _encoded(_tum(track, origin))) for name, track in _named(mission, "tum")
    )


def format_kitti_zip(mission: MissionExport) -> Iterator[bytes]:
    """Write tracks in KITTI format; a pose with unknown heading gets the identity rotation."""
    origin = _origin(mission)
    return stream_zip(
        ZipMember(name, _encoded(_kitti(track, origin))) for name, track in _named(mission, "kitti")
    )


def _named(mission: MissionExport, ending: str) -> Iterator[tuple[str, ExportTrack]]:
    for number, track in enumerate(mission.tracks, 1):
        plain = "".join(letter if letter.isalnum() else "-" for letter in track.name)[:60].strip("-")
        yield "-".join(filter(None, (str(number), track.source, plain))) + f".{ending}", track


def _origin(mission: MissionExport) -> tuple[LatLon, float]:
    """Return the position and height of the origin of the frame."""
    for track in mission.tracks:
        for part in track.poses():
            lat, lon = part.latlon[0].tolist()
            height = float(part.height_m[0])
            return LatLon(lat, lon), 0.0 if math.isnan(height) else height
    return LatLon(0.0, 0.0), 0.0


def _encoded(lines: Iterator[str]) -> Iterator[bytes]:
    return (line.encode() for line in lines)


def _metres(poses: Poses, origin: tuple[LatLon, float]) -> NDArray[np.float64]:
    """Return positions (n, 3) east, north and up; an unknown height is that of the origin."""
    flat = LocalFrame(origin[0]).enu_from_latlon(poses.latlon)
    up = np.where(np.isnan(poses.height_m), 0.0, poses.height_m - origin[1])
    return np.column_stack([flat, up])


def _tum(track: ExportTrack, origin: tuple[LatLon, float]) -> Iterator[str]:
    yield _TUM_REMARK.format(lat=origin[0].lat, lon=origin[0].lon)
    if not track.timed:
        yield _UNTIMED
    if track.remark:
        yield f"# {track.remark}\n"
    count = 0
    for part in track.poses():
        times = part.times_s if track.timed else np.arange(count, count + len(part), dtype=np.float64)
        count += len(part)
        half = np.radians(90.0 - part.heading_deg) / 2.0
        rows = np.column_stack([_metres(part, origin), np.sin(half), np.cos(half)]).tolist()
        for time_s, (x, y, z, sin, cos) in zip(times.tolist(), rows, strict=True):
            place = f"{time_s:.6f} {x:.4f} {y:.4f} {z:.4f}"
            known = not math.isnan(sin)
            yield f"{place} 0 0 {sin:.9f} {cos:.9f}\n" if known else f"{_UNKNOWN}{place} 0 0 0 1\n"


def _kitti(track: ExportTrack, origin: tuple[LatLon, float]) -> Iterator[str]:
    for part in track.poses():
        heading = np.radians(np.nan_to_num(part.heading_deg))
        rows = np.column_stack([_metres(part, origin), np.sin(heading), np.cos(heading)]).tolist()
        for x, y, z, sin, cos in rows:
            # columns: right, down and forward of the camera, in axes east, down, north
            yield (f"{cos:.9f} 0 {sin:.9f} {x:.4f} 0 1 0 {-z:.4f} {-sin:.9f} 0 {cos:.9f} {y:.4f}\n")
