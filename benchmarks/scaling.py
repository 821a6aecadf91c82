"""Measures how the cost of a query grows with the map: real photos and generated distractors.

Each distractor has half of the descriptors of each of two of the map's photos, all of them perturbed. They
are made when they are looked at, from their number, and are never all there: signatures of 100 000 photos fit
on any machine, but the seconds hold the making of descriptors instead of their reading from a disk. The
inverted file is made up to `--most-codes` photos: its training grows with the map. The map's index must have
been built.

    python benchmarks/scaling.py MAP.cfg QUERIES.csv [--features sift] [--fov DEG] [--sizes 1000,3000,...]
        [--limit 50] [--json OUT] [--svg OUT]
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import faiss
import numpy as np
from numpy.typing import NDArray

from webapp.core.features.extract import extract
from webapp.core.features.types import Features
from webapp.core.index import ivf, vlad
from webapp.core.index.ivf import InvertedFile
from webapp.core.index.segment import Segment
from webapp.core.index.twostage import TwoStage
from webapp.core.localize.indexed import IndexedMap
from webapp.core.localize.verified import find_places
from webapp.files.photo import read_gray
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks import open_map, orient_map
from webapp.tasks.open_map import OpenMap, OpenOptions

_CHUNK = 1000
_NOISE = 12.0
"""Of a component, 0 to 255: about what it is between two photos of one thing."""


class Distractors:
    """Rows of photos that are made when they are asked for; `first` tells where each begins."""

    def __init__(self, real: list[NDArray[np.uint8]], count: int) -> None:
        self._real = [r for r in real if len(r) > 1]
        self.first = np.concatenate([[0], np.cumsum([len(self._of(i)[0]) for i in range(count)])])
        self.first = self.first.astype(np.int64)

    def _of(self, number: int) -> tuple[NDArray[np.int64], NDArray[np.uint8], NDArray[np.uint8]]:
        rng = np.random.default_rng(number)
        one, two = (self._real[i] for i in rng.integers(0, len(self._real), 2))
        return (
            np.arange(len(one) // 2 + len(two) // 2),
            one[: len(one) // 2],
            two[len(two) // 2 :][: len(two) // 2],
        )

    def photo(self, number: int) -> NDArray[np.uint8]:
        """Make the descriptors of one."""
        _, one, two = self._of(number)
        rows = np.concatenate([one, two])
        noise = np.random.default_rng((number, 1)).normal(0.0, _NOISE, rows.shape).astype(np.float32)
        return np.clip(rows + noise, 0.0, 255.0).astype(np.uint8)

    def __getitem__(self, rows: slice) -> NDArray[np.uint8]:
        """Make rows of one photo."""
        number = int(np.searchsorted(self.first, rows.start, side="right")) - 1
        begin = int(self.first[number])
        return self.photo(number)[rows.start - begin : rows.stop - begin]


class Zeros:
    """Keypoints of distractors: they are nowhere and not turned."""

    def __init__(self, rows: int, *wide: int) -> None:
        self.shape = (rows, *wide)

    def __len__(self) -> int:
        """Count the rows."""
        return self.shape[0]

    def __getitem__(self, rows: NDArray[np.int64]) -> NDArray[np.float32]:
        """Give as many zeros."""
        return np.zeros((len(rows), *self.shape[1:]), np.float32)


def main() -> None:
    """Measure all sizes and write the results."""
    arguments = _arguments()
    settings = Settings()
    options = OpenOptions(features=arguments.features, map_fov_deg=arguments.fov, build=False)
    opened = open_map.run(arguments.map, options, settings=settings, progress=Progress())
    opened = orient_map.attach(opened, orient_map.newest(opened))
    queries = _queries(arguments, opened, settings)
    rows: list[dict[str, Any]] = []
    for size in map(int, arguments.sizes.split(",")):
        for tier in ("vlad", "ivf") if size <= arguments.most_codes else ("vlad",):
            rows.append(_measure(opened.indexed, tier, size, queries=queries, fov=arguments.fov or 65.0))
            print(json.dumps(rows[-1]), flush=True)
            if arguments.json:
                arguments.json.write_text(json.dumps(rows, indent=1) + "\n")
    if arguments.svg:
        arguments.svg.write_text(plot(rows))


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("map", type=Path)
    parser.add_argument("queries", type=Path)
    parser.add_argument("--features", default="sift")
    parser.add_argument("--fov", type=float)
    parser.add_argument("--sizes", default="1000,3000,10000,30000,100000")
    parser.add_argument("--most-codes", type=int, default=10_000)
    parser.add_argument("--limit", type=int, default=50)
    parser.add_argument("--json", type=Path)
    parser.add_argument("--svg", type=Path)
    return parser.parse_args()


def _queries(
    arguments: argparse.Namespace, opened: OpenMap, settings: Settings
) -> list[tuple[Features, float, float]]:
    with arguments.queries.open(encoding="utf-8") as file:
        lines = list(csv.DictReader(file, delimiter=";"))
    found = []
    for i in range(min(arguments.limit, len(lines))):
        line = lines[i * len(lines) // min(arguments.limit, len(lines))]
        gray = read_gray(
            arguments.queries.parent / line["path"],
            limits=settings.photo,
            max_side=settings.extract.max_side_px,
        )
        features = extract(
            gray.pixels,
            opened.choice,
            keypoints=settings.extract.keypoints,
            scale=gray.scale,
            photo_size=gray.full_size,
        )
        found.append((features, float(line["x"]), float(line["y"])))
    return found


def _measure(
    real: IndexedMap,
    tier: str,
    size: int,
    *,
    queries: list[tuple[Features, float, float]],
    fov: float,
) -> dict[str, Any]:
    photos = [
        np.asarray(s.descriptors[first:stop])
        for s in real.segments
        for first, stop in zip(s.first[:-1], s.first[1:], strict=True)
    ]
    others = Distractors(photos, max(0, size - len(photos)))
    count = len(others.first) - 1
    started = time.perf_counter()
    make = _signatures if tier == "vlad" else _codes
    search, segments, trained, size_bytes = make(real, photos, others)
    built = time.perf_counter() - started
    # Distractors stand far from everything: a place that one of them speaks for is wrong.
    ids = np.arange(len(real.ids) + count)
    themap = replace(
        real,
        ids=ids,
        position=np.concatenate([real.position, np.random.default_rng(0).random((count, 2)) * 1e3 + 1e5]),
        fov_deg=np.concatenate([real.fov_deg, np.full(count, fov)]),
        segments=segments,
        photo_of_entry=np.concatenate([real.photo_of_entry, len(real.ids) + np.arange(count)]),
        search=search,
        orientations=None,
    )
    seconds, errors, stages = [], [], []
    for features, x, y in queries:
        begun = time.perf_counter()
        found = find_places(themap, features, fov_deg=fov)
        seconds.append(time.perf_counter() - begun)
        stages.append(found.answer.seconds)
        best = found.places[0].position if found.places else (math.inf, math.inf)
        errors.append(math.hypot(best[0] - x, best[1] - y))
    return {
        "tier": tier,
        "photos": len(photos) + count,
        "train_seconds": round(trained, 2),
        "encode_seconds": round(built - trained, 2),
        "bytes_a_photo": round(size_bytes / (len(photos) + count), 1),
        "within_50px": float(np.mean(np.array(errors) <= 50.0)),
        "p50_seconds": round(float(np.median(seconds)), 4),
        "p95_seconds": round(float(np.quantile(seconds, 0.95)), 4),
        **{f"{s}_p50": round(float(np.median([t[s] for t in stages])), 4) for s in stages[0]},
    }


def _segment(others: Distractors) -> Segment:
    count, rows = len(others.first) - 1, int(others.first[-1])
    blank: Any = [Zeros(rows, 2), Zeros(rows), Zeros(rows)]
    made: Any = others
    return Segment(
        [""] * count,
        others.first,
        *blank,
        made,
        np.full((count, 2), 640, np.int32),
        np.full(count, np.nan),
    )


def _signatures(real: IndexedMap, photos: list[NDArray[np.uint8]], others: Distractors) -> tuple[Any, ...]:
    started = time.perf_counter()
    codebook = vlad.train([p for p in photos if len(p)][:: max(1, len(photos) // vlad.SAMPLE_PHOTOS)])
    trained = time.perf_counter() - started
    parts = [
        np.array([vlad.signature(codebook, s.entry(i).features.descriptors) for i in range(len(s.content))])
        for s in real.segments
    ]
    count = len(others.first) - 1
    if count:
        parts.append(np.array([vlad.signature(codebook, others.photo(i)) for i in range(count)]))
    segments = [*real.segments, *([_segment(others)] if count else [])]
    return TwoStage(codebook, parts, segments=segments), segments, trained, sum(p.nbytes for p in parts)


def _codes(real: IndexedMap, photos: list[NDArray[np.uint8]], others: Distractors) -> tuple[Any, ...]:
    count = len(others.first) - 1
    total = sum(map(len, photos)) + int(others.first[-1])
    share = min(1.0, ivf.SAMPLE_PER_CELL * ivf.cells_for(total) / total)
    rng = np.random.default_rng(0)
    every = [*photos, *(others.photo(i) for i in range(count))] if count < _CHUNK else None
    source = every or (
        photos[i] if i < len(photos) else others.photo(i - len(photos)) for i in range(len(photos) + count)
    )
    sample = np.concatenate([p[rng.random(len(p)) < share] for p in source])
    started = time.perf_counter()
    codebook = ivf.train(sample, total, kind="float")
    trained = time.perf_counter() - started
    coded = []
    for part in [list(photos), *_chunks(others)]:
        copy = faiss.clone_index(codebook)
        ivf.encode(copy, np.concatenate(part))
        coded.append(copy)
    segments = [*real.segments, *([_segment(others)] if count else [])]
    return InvertedFile(coded), segments, trained, sum(c.ntotal * (c.code_size + 8) for c in coded)


def _chunks(others: Distractors) -> Any:
    count = len(others.first) - 1
    for start in range(0, count, _CHUNK):
        yield [others.photo(i) for i in range(start, min(start + _CHUNK, count))]


_WIDE, _HIGH, _LEFT, _BOTTOM = 560, 320, 60, 270


def plot(rows: list[dict[str, Any]]) -> str:
    """Draw the seconds of a query over the photos of the map, both logarithmic, as SVG."""
    xs = [math.log10(r["photos"]) for r in rows]
    low, high = min(xs) - 0.1, max(xs) + 0.1
    ys = [math.log10(r["p50_seconds"]) for r in rows]
    least, most = math.floor(min(ys) * 3.0) / 3.0, math.ceil(max(ys) * 3.0) / 3.0 + 0.1

    def at(photos: float, seconds: float) -> tuple[float, float]:
        x = _LEFT + (math.log10(photos) - low) / (high - low) * (_WIDE - _LEFT - 90)
        return x, _BOTTOM - (math.log10(seconds) - least) / (most - least) * (_BOTTOM - 20)

    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDE} {_HIGH}" '
        'font-family="sans-serif" font-size="12">'
    ]
    out.append(f'<rect width="{_WIDE}" height="{_HIGH}" fill="#fff"/>')
    for photos in sorted({r["photos"] for r in rows}):
        x, _ = at(photos, 1.0)
        out.append(
            f'<text x="{x:.0f}" y="{_BOTTOM + 18}" text-anchor="middle">{photos:,}</text>'.replace(",", " ")
        )
    for seconds in (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0):
        if least <= math.log10(seconds) <= most:
            _, y = at(10**low, seconds)
            out.append(f'<path d="M{_LEFT} {y:.0f}H{_WIDE - 90}" stroke="#ddd"/>')
            out.append(f'<text x="{_LEFT - 6}" y="{y + 4:.0f}" text-anchor="end">{seconds:g} s</text>')
    for tier, colour in (("ivf", "#c2500a"), ("vlad", "#1f5fa8")):
        points = [at(r["photos"], r["p50_seconds"]) for r in rows if r["tier"] == tier]
        if points:
            line = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
            out.append(f'<polyline points="{line}" fill="none" stroke="{colour}" stroke-width="2"/>')
            out += [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3.5" fill="{colour}"/>' for x, y in points]
            out.append(
                f'<text x="{points[-1][0] + 8:.0f}" y="{points[-1][1] + 4:.0f}" fill="{colour}">{tier}</text>'
            )
    middle = (_LEFT + _WIDE - 90) / 2
    out.append(f'<text x="{middle:.0f}" y="{_HIGH - 8}" text-anchor="middle">photos of the map</text></svg>')
    return "\n".join(out) + "\n"


if __name__ == "__main__":
    main()
