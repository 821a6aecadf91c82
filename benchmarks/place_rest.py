"""Measures automatic placement: how many photos are placed from a few placed by hand, and with what error.

    python -m benchmarks.place_rest MAP.cfg --clicks 24 --unit 10
    python -m benchmarks.place_rest MAP.cfg --share 0.05 --unit 10
    python -m benchmarks.place_rest DRONE.cfg --clicks 5 --unit 20 --as-clicks

All photos are removed from the map. With `--clicks`, photos are put back at their positions in the order in
which the program proposes them; with `--share`, a share of them, evenly spread over the list. Positions of
the others are suggested from those. Errors are in units of `--unit` pixels: of a metre, or of a frame. Prints
one JSON object. The reconstruction is stored with the map, or in the user's cache if that folder is
read-only.
"""

from __future__ import annotations

import argparse
import json
import resource
import time
from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

import numpy as np

from webapp.configuration import load_settings
from webapp.core.mapmodel.model import Map, UnplacedPhoto
from webapp.files.maps.folder import read_map
from webapp.progress import Progress
from webapp.settings import restrain_threads
from webapp.tasks.landmarks.adjust import adjust_submodels
from webapp.tasks.landmarks.known import AnyPhoto
from webapp.tasks.landmarks.place_rest import RestReport, suggest_from
from webapp.tasks.landmarks.reconstruct import Reconstruction, reconstruct

LIMITS = (1, 2, 4, 5, 10)
"""Error limits for the shares that are printed, in units."""


def with_placed(the_map: Map, ids: Collection[int]) -> Map:
    """Return a map on which only some photos are placed."""
    return replace(
        the_map,
        experiences=tuple(e for e in the_map.experiences if e.id in ids),
        unplaced=tuple(
            UnplacedPhoto(e.id, e.photo, fov_deg=e.fov_deg, taken_at=e.taken_at, name=e.name)
            for e in the_map.experiences
            if e.id not in ids
        ),
    )


def with_photos_of(found: Reconstruction, the_map: Map) -> Reconstruction:
    """Replace the photos of a reconstruction by their current state on a map."""
    everyone: list[AnyPhoto] = [*the_map.experiences, *the_map.unplaced]
    now = {photo.id: photo for photo in everyone}
    return replace(found, photos=tuple(now[photo.id] for photo in found.photos))


def place_as_proposed(found: Reconstruction, the_map: Map, *, clicks: int) -> set[int]:
    """Place proposed photos until `clicks` are placed; return their ids."""
    placed: set[int] = set()
    while len(placed) < clicks:
        given = with_placed(the_map, placed)
        proposed = suggest_from(with_photos_of(found, given), given).place_next[: clicks - len(placed)]
        if not proposed:
            break
        placed |= set(proposed)
    return placed


def figures(report: RestReport, the_map: Map, *, placed: Collection[int], unit: float) -> dict[str, object]:
    """Compare suggestions with the true positions of the photos."""
    truth = {e.id: e.position for e in the_map.experiences}
    error = np.array([np.hypot(*np.subtract(one.position, truth[one.id])) / unit for one in report.suggested])
    radius = np.array([one.radius_px / unit for one in report.suggested])
    rest = len(truth) - len(placed)
    return {
        "photos": len(truth),
        "clicks": len(placed),
        "suggested": len(error),
        "share_placed": round((len(error) + len(placed)) / len(truth), 3),
        "share_of_rest": round(len(error) / rest, 3),
        "median": round(float(np.median(error)), 3),
        **{f"within_{limit}": round(float(np.mean(error <= limit)), 3) for limit in LIMITS},
        "over_10": round(float(np.mean(error > 10.0)), 3),
        "radius_coverage": round(float(np.mean(error <= radius)), 3),
        "median_radius": round(float(np.median(radius)), 3),
    }


def main() -> None:
    """Run as a command."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("map", type=Path)
    which = parser.add_mutually_exclusive_group(required=True)
    which.add_argument("--clicks", type=int)
    which.add_argument("--share", type=float)
    parser.add_argument("--unit", type=float, default=1.0, help="pixels")
    parser.add_argument("--as-clicks", action="store_true", help="GPS positions count as clicked ones")
    options = parser.parse_args()
    restrain_threads()
    the_map, started = read_map(options.map), time.perf_counter()
    if options.as_clicks:
        placed_by_hand = (replace(e, by_gps=False, gps_accuracy_m=None) for e in the_map.experiences)
        the_map = replace(the_map, experiences=tuple(placed_by_hand))
    found = reconstruct(options.map, with_placed(the_map, ()), settings=load_settings(), progress=Progress())
    seconds = time.perf_counter() - started
    if options.clicks:
        placed = place_as_proposed(found, the_map, clicks=options.clicks)
    else:
        ids = [e.id for e in the_map.experiences]
        count = round(options.share * len(ids))
        placed = {ids[round(i)] for i in np.linspace(0, len(ids) - 1, count)}
    given = with_placed(the_map, placed)
    joined, _ = adjust_submodels(with_photos_of(found, given), given, progress=Progress())
    report = suggest_from(joined, given)
    joining = time.perf_counter() - started - seconds
    own, children = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    print(
        json.dumps(
            {
                "pieces": [len(submodel) for submodel in found.submodels],
                "joined": [len(submodel) for submodel in joined.submodels],
                **figures(report, the_map, placed=placed, unit=options.unit),
                "seconds": round(seconds, 1),
                "joining_seconds": round(joining, 1),
                "cpu_seconds": round(sum(u.ru_utime + u.ru_stime for u in (own, children)), 1),
                "peak_mb": round(max(own.ru_maxrss, children.ru_maxrss) / 1000),
            }
        )
    )


if __name__ == "__main__":
    main()
