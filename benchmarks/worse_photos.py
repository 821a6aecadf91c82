"""Measures how well degraded photos are localized: dim, in fog, blurred, small, rotated.

Each query is degraded in each of these ways and localized again. Real effects such as motion, lamps, or
colours at night are not simulated, so this is a lower bound of the loss. Degraded photos have no EXIF: if the
field of view of the queries is known only from EXIF, give it with --fov.

    python -m benchmarks.worse_photos MAP.cfg QUERIES.csv [--features sift,xfeat] [--limit N] [--json OUT]

Other options go to `expmap evaluate`. XFeat needs its weights (`expmap models fetch`).
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from benchmarks.processes import ProgramFailed, run
from webapp.files.localize import queries_csv

Photo = NDArray[np.uint8]

GAMMA = 2.2
QUALITY, BAD_QUALITY = 95, 10
NOISE = 3.0
"""Standard deviation of the noise of dim photos, grey values."""

COLUMNS = {
    "right": "right",
    "median_px": "median px",
    "ece": "ECE",
    "answered_at_99_precision": "at 99 %",
    "radius_coverage": "in radius",
    "seconds_per_query_p50": "s",
}


def _as_bytes(values: NDArray[np.floating[Any]]) -> Photo:
    return np.asarray(np.clip(np.rint(values), 0, 255), np.uint8)


def dimmed(photo: Photo, share: float, noise: float) -> Photo:
    """Simulate the photo with a share of its light, with noise."""
    linear = (photo / 255.0) ** GAMMA * share
    grain = np.random.default_rng(photo.shape[0]).normal(0.0, noise, photo.shape) if noise else 0.0
    return _as_bytes(255.0 * np.clip(linear, 0.0, 1.0) ** (1.0 / GAMMA) + grain)


def _small(photo: Photo) -> Photo:
    scale = min(320.0 / max(photo.shape[:2]), 1.0)
    return np.asarray(cv2.resize(photo, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA), np.uint8)


def _saved_badly(photo: Photo) -> Photo:
    data = cv2.imencode(".jpg", photo, [cv2.IMWRITE_JPEG_QUALITY, BAD_QUALITY])[1]
    return np.asarray(cv2.imdecode(data, cv2.IMREAD_COLOR), np.uint8)


def rotated(photo: Photo, degrees: float) -> Photo:
    """Rotate the content of the photo; the frame, and so the field of view, stays the same."""
    height, width = photo.shape[:2]
    turn = cv2.getRotationMatrix2D((width / 2, height / 2), degrees, 1.0)
    return np.asarray(cv2.warpAffine(photo, turn, (width, height)), np.uint8)


CHANGES: dict[str, Callable[[Photo], Photo]] = {
    "as they are": lambda photo: photo,
    "a twentieth of the light": lambda photo: dimmed(photo, 0.05, NOISE),
    "a sixtieth of the light": lambda photo: dimmed(photo, 1 / 60, NOISE),
    "three times the light": lambda photo: dimmed(photo, 3.0, 0.0),
    "fog": lambda photo: _as_bytes(0.25 * photo + 160.0),
    "blurred by 2.5 px": lambda photo: np.asarray(cv2.GaussianBlur(photo, (0, 0), 2.5), np.uint8),
    "320 px wide": _small,
    f"JPEG quality {BAD_QUALITY}": _saved_badly,
    "held askew by 20 degrees": lambda photo: rotated(photo, 20.0),
    "on its side": lambda photo: rotated(photo, 90.0),
}


def main() -> None:
    """Measure each change with each kind of features and print the tables."""
    arguments, options = _parser().parse_known_args()
    table: dict[str, dict[str, dict[str, float | None]]] = {}
    for features in arguments.features.split(","):
        print(features.ljust(28) + "".join(title.rjust(12) for title in COLUMNS.values()))
        table[features] = {}
        for name, change in CHANGES.items():
            with tempfile.TemporaryDirectory() as scratch:
                queries = _changed(arguments.queries, change, folder=Path(scratch), limit=arguments.limit)
                figures = _evaluated(arguments.map, queries, options=["--features", features, *options])
            table[features][name] = {key: figures[key] for key in COLUMNS}
            cells = (_cell(figures[key]) for key in COLUMNS)
            print(name.ljust(28) + "".join(cell.rjust(12) for cell in cells), flush=True)
    if arguments.json:
        arguments.json.write_text(json.dumps(table, indent=2), "utf-8")


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("map", type=Path)
    parser.add_argument("queries", type=Path)
    parser.add_argument("--features", default="sift", help="names, with commas")
    parser.add_argument("--limit", type=int, help="queries, evenly spread")
    parser.add_argument("--json", type=Path, help="write all figures there")
    return parser


def _changed(queries: Path, change: Callable[[Photo], Photo], *, folder: Path, limit: int | None) -> Path:
    """Write the degraded photos and their list; return the path of the list."""
    every = queries_csv.read(queries)
    count = min(limit or len(every), len(every))
    lines = [queries_csv.HEADER]
    for number in range(count):
        query = every[number * len(every) // count]
        photo = cv2.imread(str(query.path), cv2.IMREAD_COLOR)
        if photo is None:
            raise SystemExit(f"{query.path} cannot be read")
        changed = change(np.asarray(photo, np.uint8))
        cv2.imwrite(str(folder / f"{number}.jpg"), changed, [cv2.IMWRITE_JPEG_QUALITY, QUALITY])
        lines.append(f"{number}.jpg;{query.truth.x};{query.truth.y}")
    target = folder / "queries.csv"
    target.write_text("\n".join(lines) + "\n", "utf-8")
    return target


def _evaluated(cfg: Path, queries: Path, *, options: list[str]) -> dict[str, Any]:
    program = [sys.executable, "-m", "webapp.app.main", "evaluate", str(cfg), str(queries), "--json"]
    try:
        figures: dict[str, Any] = run([*program, *options]).printed
    except ProgramFailed as error:
        raise SystemExit(str(error)) from error
    radius = figures["place_radius_px"]
    errors = [query["error_px"] for query in figures["per_query"]]
    right = sum(error is not None and error <= radius for error in errors)
    return figures | {"right": right / len(errors)}


def _cell(value: float | None) -> str:
    return "-" if value is None else f"{value:.3g}"


if __name__ == "__main__":
    main()
