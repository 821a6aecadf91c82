"""Derives test maps of other kinds from existing maps: areas, noise, few photos, two sites.

    python -m benchmarks.derived_maps FOLDER OUT

FOLDER holds maps, each a folder with `map.cfg` and `queries.csv`. For each one, OUT gets

- NAME-areas: its positions reduced to 40 clusters by k-means, or to a fifth of its positions if that is less;
- NAME-noise: its positions with noise of 0.7 place radii on each axis, as from a poor GPS receiver;
- NAME-thin: a quarter of its photos;
- NAME-snake: its photos in the order of the file as lanes of 25, a plan that is not to scale;
- NAME-dim: the same map, its queries dimmed and noisy;

and `joined`, which has the first two maps one below the other. Photos are linked, not copied. Random draws
are seeded.
"""

from __future__ import annotations

import csv
import os
import sys
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from numpy.typing import NDArray

from webapp.core.hypotheses.places import place_radius_px

AREAS, PLACES_PER_AREA = 40, 5
NOISE = 0.7
THIN = 4
LANE, STEP, GAP, MARGIN = 25, 40.0, 100.0, 100.0
DIM_GAMMA, DIM_GAIN, DIM_SIGMA = 1.8, 0.18, 3.0

Array = NDArray[np.float64]


@dataclass(frozen=True, slots=True, eq=False)
class Table:
    """A map and its queries: photos and (n, 2) positions of both, map pixels, and the size of the image."""

    size: tuple[int, int]
    photos: Sequence[Path]
    position: Array
    queries: Sequence[Path]
    truth: Array


def main() -> None:
    """Derive all maps."""
    if len(sys.argv) != 3:
        sys.exit(__doc__)
    folder, out = Path(sys.argv[1]), Path(sys.argv[2])
    found = sorted(cfg.parent for cfg in folder.glob("*/map.cfg") if cfg.with_name("queries.csv").exists())
    tables = [read(source) for source in found]
    for source, table in zip(found, tables, strict=True):
        for name, derive in DERIVED.items():
            write(derive(table), out / f"{source.name}-{name}")
        dim(table, out / f"{source.name}-dim")
    if len(tables) > 1:
        write(join(tables[0], tables[1]), out / "joined")


def read(folder: Path) -> Table:
    """Read a map and its queries."""
    head, *lines = (folder / "map.cfg").read_text("utf-8-sig").splitlines()
    _, width, height = head.split(";")[:3]
    rows = [line.split(";") for line in lines if line.strip()]
    with (folder / "queries.csv").open(encoding="utf-8-sig", newline="") as file:
        queries = list(csv.DictReader(file, delimiter=";"))
    return Table(
        (int(width), int(height)),
        [folder / row[1].strip() for row in rows],
        np.array([[float(row[2]), float(row[3])] for row in rows]),
        [folder / query["path"] for query in queries],
        np.array([[float(query["x"]), float(query["y"])] for query in queries]),
    )


def areas(table: Table) -> Table:
    """Replace the positions by the centres of their clusters."""
    places = np.unique(table.position, axis=0).astype(np.float32)
    count = max(2, min(AREAS, len(places) // PLACES_PER_AREA))
    cv2.setRNGSeed(1)
    criteria = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 100, 0.1)
    _, _, centre = cv2.kmeans(places, count, np.zeros(0), criteria, 10, cv2.KMEANS_PP_CENTERS)
    centre = np.round(centre).astype(np.float64)

    def nearest(at: Array) -> Array:
        gathered: Array = centre[((at[:, None] - centre[None]) ** 2).sum(-1).argmin(1)]
        return gathered

    return replace(table, position=nearest(table.position), truth=nearest(table.truth))


def noise(table: Table) -> Table:
    """Add noise to the positions of the map."""
    radius = place_radius_px(table.position, width=table.size[0], height=table.size[1])
    moved = table.position + np.random.default_rng(7).normal(0.0, NOISE * radius, table.position.shape)
    return replace(table, position=np.clip(np.round(moved), 0, table.size))


def thin(table: Table) -> Table:
    """Keep a quarter of the photos, drawn at random."""
    count = len(table.photos)
    kept = np.sort(np.random.default_rng(7).choice(count, max(1, count // THIN), replace=False))
    return replace(table, photos=[table.photos[i] for i in kept], position=table.position[kept])


def snake(table: Table) -> Table:
    """Arrange the photos, in the order of the file, as lanes; move each query to its nearest photo."""
    number = np.arange(len(table.photos))
    row, column = np.divmod(number, LANE)
    column = np.where(row % 2 == 0, column, LANE - 1 - column)
    position = np.column_stack([MARGIN + STEP * column, MARGIN + GAP * row])
    nearest = ((table.truth[:, None] - table.position[None]) ** 2).sum(-1).argmin(1)
    size = int(2 * MARGIN + STEP * LANE), int(2 * MARGIN + GAP * (row.max(initial=0) + 1))
    return replace(table, size=size, position=position, truth=position[nearest])


DERIVED = {"areas": areas, "noise": noise, "thin": thin, "snake": snake}


def join(first: Table, second: Table) -> Table:
    """Put the second map below the first."""
    below = np.array([0.0, float(first.size[1])])
    return Table(
        (max(first.size[0], second.size[0]), first.size[1] + second.size[1]),
        [*first.photos, *second.photos],
        np.concatenate([first.position, second.position + below]),
        [*first.queries, *second.queries],
        np.concatenate([first.truth, second.truth + below]),
    )


def dim(table: Table, folder: Path) -> None:
    """Write the map with queries as at night: darkened, noisy and compressed again."""
    rng = np.random.default_rng(7)
    (folder / "dimmed").mkdir(parents=True, exist_ok=True)
    queries = []
    for number, path in enumerate(table.queries):
        image = cv2.imread(str(path))
        if image is None:
            raise SystemExit(f"{path} is no photo that can be read")
        dark = 255.0 * DIM_GAIN * (image / 255.0) ** DIM_GAMMA + rng.normal(0.0, DIM_SIGMA, image.shape)
        queries.append(folder / "dimmed" / f"{number:05d}.jpg")
        cv2.imwrite(str(queries[-1]), np.clip(dark, 0, 255).astype(np.uint8), [cv2.IMWRITE_JPEG_QUALITY, 80])
    write(replace(table, queries=queries), folder)


def write(table: Table, folder: Path) -> None:
    """Write a map with a blank plan; its photos are hard links."""
    folder.mkdir(parents=True, exist_ok=True)
    width, height = table.size
    cv2.imwrite(str(folder / "plan.png"), np.full((height, width, 3), 235, np.uint8))
    lines = [f"plan.png;{width};{height}"]
    for number, (path, (x, y)) in enumerate(zip(table.photos, table.position, strict=True)):
        name = f"photos/{number:05d}{path.suffix.lower()}"
        _link(path, folder / name)
        lines.append(f"{number};{name};{round(x)};{round(y)}")
    (folder / "map.cfg").write_text("\n".join(lines) + "\n", "utf-8")
    rows = ["path;x;y"]
    for number, (path, (x, y)) in enumerate(zip(table.queries, table.truth, strict=True)):
        name = f"queries/{number:05d}{path.suffix.lower()}"
        _link(path, folder / name)
        rows.append(f"{name};{x:g};{y:g}")
    (folder / "queries.csv").write_text("\n".join(rows) + "\n", "utf-8")


def _link(source: Path, target: Path) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    target.unlink(missing_ok=True)
    os.link(source.resolve(), target)


if __name__ == "__main__":
    main()
