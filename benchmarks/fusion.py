"""Fuses recorded odometry with some of the recorded fixes, and compares the track with the held-out fixes.

    python -m benchmarks.fusion FILE ... [--json OUT] [--picture OUT.jpg]

A file, such as a ROS bag, has odometry and GPS. Nothing is tuned to it. Prints the distances, in metres, of
the held-out fixes from the track of each method: the odometry as recorded (from the first fix, assuming that
the robot then faces east), dead reckoning that uses only the fixes of the first half minute, straight lines
between the fixes that were not held out, and the fused track. For the last one also the share of held-out
fixes within the 95 % region of the track's uncertainty and the fix's own.

Errors of consecutive GPS fixes are correlated, so the rows with every other fix held out only show how well a
method follows the receiver; those with gaps show how well it follows the true path.
"""

from __future__ import annotations

import argparse
import json
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from webapp.core.geo.local import LocalFrame
from webapp.core.geo.types import LatLon
from webapp.missions.core.trajectory.fusion import Fusion, fuse
from webapp.missions.core.trajectory.records import Poses, Source
from webapp.missions.core.trajectory.robotframe import Start
from webapp.missions.core.trajectory.thinning import MinMove
from webapp.missions.render.track_picture import Shown, draw_tracks
from webapp.missions.tasks import read_track
from webapp.missions.tasks.place_track import ReadOptions

CYCLE_S = 60.0
KNOWN_S = 30.0
_95_SQUARED = 5.991


@dataclass(frozen=True)
class HeldOut:
    """A scheme of holding fixes out: its name, and a mask of the held-out fixes."""

    name: str
    fixes: NDArray[np.bool_]


def main() -> None:
    """Evaluate each file and print its table."""
    arguments = _arguments()
    results = {path.name: evaluate(path) for path in arguments.files}
    for name, rows in results.items():
        print(f"\n{name}")
        print(as_text(rows))
    if arguments.json:
        arguments.json.write_text(json.dumps(results, indent=1) + "\n", encoding="utf-8")
    if arguments.picture:
        picture(arguments.files[0]).save(arguments.picture, quality=85)


def evaluate(path: Path) -> list[dict[str, Any]]:
    """Measure all methods on a file; return a row for each, none if it lacks GPS or odometry."""
    odometry, gps = recorded(path)
    if odometry is None or gps is None:
        return []
    rows = []
    for held in ways(gps):
        kept, out = gps.take(~held.fixes), gps.take(held.fixes)
        known = kept.take(kept.times_s < kept.times_s[0] + KNOWN_S)
        fused, reckoned = _fused(odometry, kept), _fused(odometry, known)
        tracks = {"odometry as recorded": odometry, "dead reckoning": reckoned.poses, "between fixes": kept}
        for name, poses in tracks.items():
            rows.append({"held_out": held.name, "method": name, **errors(poses, out)})
        rows.append(
            {"held_out": held.name, "method": "fused", **errors(fused.poses, out), **honesty(fused, out)}
        )
    return rows


def recorded(path: Path) -> tuple[Poses | None, Poses | None]:
    """Read odometry and GPS of a file, not thinned; the odometry starts at the first fix, facing east."""
    gps = _read(path, "gps", LatLon(0.0, 0.0))
    first = LatLon(0.0, 0.0) if gps is None else LatLon(*gps.latlon[0].tolist())
    return _read(path, "odometry", first), gps


def _read(path: Path, source: str, first: LatLon) -> Poses | None:
    read = read_track.read_track(
        path, options=ReadOptions(start=Start(first, 90.0), min_move=MinMove(0.0, "m"))
    )
    return next((track.poses for track in read.tracks if track.source == source), None)


def ways(gps: Poses) -> list[HeldOut]:
    """Return the schemes of holding out: every other fix, and the last seconds of each minute."""
    since = (gps.times_s - gps.times_s[0]) % CYCLE_S
    gaps = [HeldOut(f"{gap:.0f} s of each minute", since >= CYCLE_S - gap) for gap in (20.0, 45.0)]
    return [HeldOut("every other fix", np.arange(len(gps)) % 2 == 1), *gaps]


def _fused(odometry: Poses, gps: Poses) -> Fusion:
    found = fuse(odometry, {"gps": gps})
    assert isinstance(found, Fusion)
    return found


def errors(track: Poses, out: Poses) -> dict[str, float]:
    """Return statistics of the distances of fixes from a track at their times, metres."""
    distance = np.hypot(*_off(track, out).T)
    return {
        "rms_m": float(np.sqrt((distance**2).mean())),
        "median_m": float(np.median(distance)),
        "p95_m": float(np.percentile(distance, 95)),
        "max_m": float(distance.max()),
    }


def honesty(fused: Fusion, out: Poses) -> dict[str, Any]:
    """Report whether the uncertainty of a fused track is consistent, and how fixes were weighted."""
    off, track = _off(fused.poses, out), fused.poses
    spread = np.column_stack([np.interp(out.times_s, track.times_s, c) for c in track.covariance_m2.T])
    own = out.covariance_m2 * fused.fit.stated["gps"] ** 2
    east, north, both = (spread + own).T
    distance = (off[:, 0] ** 2 * north - 2 * off[:, 0] * off[:, 1] * both + off[:, 1] ** 2 * east) / (
        east * north - both**2
    )
    gating = fused.gating["gps"]
    return {
        "within_95": float((distance < _95_SQUARED).mean()),
        "gated": int(gating.gated.sum()),
        "pieces": len(fused.begins_s),
        "mean_distance": gating.mean_distance,
        "odometry_errors_times": fused.fit.odometry,
        "receiver_errors_times": fused.fit.stated["gps"],
    }


def _off(track: Poses, out: Poses) -> NDArray[np.float64]:
    frame = LocalFrame(LatLon(*out.latlon[0].tolist()))
    enu, wanted = frame.enu_from_latlon(track.latlon), frame.enu_from_latlon(out.latlon)
    order = np.argsort(track.times_s, kind="stable")
    found = [np.interp(out.times_s, track.times_s[order], axis[order]) for axis in enu.T]
    return np.column_stack(found) - wanted


def picture(path: Path) -> Any:
    """Draw the fusion of a file with four outliers added to its GPS fixes."""
    odometry, gps = recorded(path)
    assert odometry is not None
    assert gps is not None
    frame = LocalFrame(LatLon(*gps.latlon[0].tolist()))
    enu = frame.enu_from_latlon(gps.latlon)
    for at, east, north in ((0.15, 30, 12), (0.4, -25, 20), (0.62, 35, -10), (0.85, -20, -28)):
        enu[int(at * len(gps))] += (east, north)
    astray = replace(gps, latlon=frame.latlon_from_enu(enu))
    fused = _fused(odometry, astray)
    gating = fused.gating["gps"]
    gated = [
        (LatLon(*astray.latlon[number].tolist()), LatLon(*expected.tolist()))
        for number, expected in zip(gating.number[gating.gated], gating.expected[gating.gated], strict=True)
    ]
    tracks: list[tuple[Source, Poses]] = [("odometry", odometry), ("gps", astray), ("fused", fused.poses)]
    return draw_tracks(Shown(tracks, gated, fused.begins_s))


def as_text(rows: list[dict[str, Any]]) -> str:
    """Format rows as a table."""
    if not rows:
        return "nothing to compare with: it has no GPS, or no odometry"
    lines = [
        f"{'held out':<22}{'method':<22}{'rms':>8}{'median':>8}{'95 %':>8}{'most':>8}  in 95 %  gated  pieces"
    ]
    for row in rows:
        line = f"{row['held_out']:<22}{row['method']:<22}"
        line += "".join(f"{row[key]:>8.2f}" for key in ("rms_m", "median_m", "p95_m", "max_m"))
        if "gated" in row:
            line += f"{row['within_95']:>9.2f}{row['gated']:>7d}{row['pieces']:>8d}"
        lines.append(line)
    return "\n".join(lines)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("files", nargs="+", type=Path)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--picture", type=Path)
    return parser.parse_args()


if __name__ == "__main__":
    main()
