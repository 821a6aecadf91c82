"""Measures how the cost of a query grows with the map, by adding generated distractors to real photos.

Each distractor combines half of the descriptors of each of two of the map's photos, with noise. They are
written to a temporary file (128 KB per photo with SIFT; in `--folder`) and read from there like those of a
map. The inverted file is measured up to `--most-codes` photos, since its training grows with the map. The
map's index must have been built.

    python -m benchmarks.scaling MAP.cfg QUERIES.csv [--features sift] [--fov DEG] [--sizes 1000,3000,...]
        [--limit 50] [--folder FOLDER] [--json OUT] [--svg OUT]
"""

from __future__ import annotations

import argparse
import json
import math
import tempfile
import time
from dataclasses import replace
from io import FileIO
from pathlib import Path
from typing import Any, NamedTuple

import faiss
import numpy as np
from numpy.typing import NDArray

from webapp.configuration import load_settings
from webapp.core.features.extract import extract
from webapp.core.features.types import Features
from webapp.core.geometry.extrinsics import MapExtrinsics
from webapp.core.localize.verified import find_places
from webapp.core.retrieval.engines import ivf, vlad
from webapp.core.retrieval.engines.ivf import InvertedFile
from webapp.core.retrieval.engines.twostage import TwoStage
from webapp.core.retrieval.engines.types import Segment
from webapp.core.retrieval.indexed import IndexedMap
from webapp.files.localize import queries_csv
from webapp.files.localize.arrays import FileRows, OpenFile
from webapp.files.localize.models import network
from webapp.files.maps.folder import read_map
from webapp.files.photos.photo import read_gray
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.localize import orient_map
from webapp.tasks.localize.open_index import open_index
from webapp.tasks.localize.open_map import OpenMap
from webapp.tasks.localize.open_pipeline import make_plan
from webapp.tasks.localize.plan import OpenOptions
from webapp.threads import in_threads

_CHUNK = 1000
_NOISE = 21
"""Maximum change of a component, 0 to 255; similar to the differences between two photos of one thing."""


class Distractors:
    """Generated photos, whose descriptors are in a file."""

    def __init__(self, real: list[NDArray[np.uint8]], count: int, *, folder: Path) -> None:
        self._real = [r for r in real if len(r) > 1]
        path = folder / "distractors"
        lengths = []
        with path.open("wb") as file:
            for start in range(0, count, _CHUNK):
                for rows in in_threads(self._made, list(range(start, min(start + _CHUNK, count)))):
                    file.write(rows.tobytes())
                    lengths.append(len(rows))
        self.first = np.concatenate([[0], np.cumsum(lengths)]).astype(np.int64)
        shape = (int(self.first[-1]), real[0].shape[1])
        opened = OpenFile(FileIO(path), repair="run it again")
        self.rows = FileRows(opened, 0, dtype=np.dtype(np.uint8), shape=shape)

    def _made(self, number: int) -> NDArray[np.uint8]:
        rng = np.random.default_rng(number)
        one, two = (self._real[i] for i in rng.integers(0, len(self._real), 2))
        rows = np.concatenate([one[: len(one) // 2], two[len(two) // 2 :]]).astype(np.int16)
        rows += rng.integers(-_NOISE, _NOISE + 1, rows.shape, np.int8)
        return np.clip(rows, 0, 255).astype(np.uint8)

    def photo(self, number: int) -> NDArray[np.uint8]:
        """Read the descriptors of a photo."""
        rows: NDArray[np.uint8] = self.rows[int(self.first[number]) : int(self.first[number + 1])]
        return rows


class Zeros:
    """Keypoints of distractors, with position, size and angle 0."""

    def __init__(self, rows: int, *wide: int) -> None:
        self.shape = (rows, *wide)

    def __len__(self) -> int:
        """Return the number of rows."""
        return self.shape[0]

    def __getitem__(self, rows: NDArray[np.int64]) -> NDArray[np.float32]:
        """Return zeros for the given rows."""
        return np.zeros((len(rows), *self.shape[1:]), np.float32)


def main() -> None:
    """Measure all sizes and write the results."""
    arguments = _arguments()
    settings = load_settings()
    options = OpenOptions(
        method="verified", features=arguments.features, map_fov_deg=arguments.fov, build=False
    )
    look = make_plan(arguments.map, options, settings=settings, newest=True).looks[0]
    the_map = read_map(arguments.map)
    opened = open_index(arguments.map, look, the_map=the_map, settings=settings, progress=Progress())
    opened = orient_map.with_orientations(opened, orient_map.newest(opened))
    queries = _queries(arguments, opened, settings)
    sizes = sorted(map(int, arguments.sizes.split(",")))
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory(dir=arguments.folder) as folder:
        real = _descriptors(opened.indexed)
        others = Distractors(real, max(0, sizes[-1] - len(real)), folder=Path(folder))
        signed = _Signed(real, others)
        for size in sizes:
            count = max(0, size - len(real))
            for tier in ("vlad", "ivf") if size <= arguments.most_codes else ("vlad",):
                made = signed.of(opened.indexed, count) if tier == "vlad" else _codes(real, others, count)
                themap = _map(opened.indexed, others, count, search=made.search, fov=arguments.fov or 65.0)
                row = {"tier": tier, "photos": len(real) + count, **made.cost}
                rows.append({**row, **_measure(themap, queries, fov=arguments.fov or 65.0)})
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
    parser.add_argument("--folder", type=Path, help="where the distractors are kept meanwhile")
    parser.add_argument("--json", type=Path)
    parser.add_argument("--svg", type=Path)
    return parser.parse_args()


def _queries(
    arguments: argparse.Namespace, opened: OpenMap, settings: Settings
) -> list[tuple[Features, float, float]]:
    known = network(opened.choice.model, settings.models, weights=opened.choice.weights)
    found = []
    for query in queries_csv.select(queries_csv.read(arguments.queries), arguments.limit):
        gray = read_gray(query.path, limits=settings.photo, max_side=settings.extract.max_side_px)
        features = extract(
            gray.pixels,
            opened.choice,
            keypoints=settings.extract.keypoints,
            scale=gray.scale,
            photo_size=gray.full_size,
            network=known,
        )
        found.append((features, *query.truth))
    return found


def _descriptors(real: IndexedMap) -> list[NDArray[np.uint8]]:
    return [
        np.asarray(s.descriptors[first:stop])
        for s in real.segments
        for first, stop in zip(s.first[:-1], s.first[1:], strict=True)
    ]


def _map(
    real: IndexedMap, others: Distractors, count: int, *, search: InvertedFile | TwoStage, fov: float
) -> IndexedMap:
    """Add distractors to the map, far from all photos, so that votes for them are wrong."""
    there = len(real.ids)
    far = np.random.default_rng(0).random((count, 2)) * 1e3 + 1e5
    known = real.extrinsics
    if known is not None:
        known = MapExtrinsics(
            rotation=np.concatenate([known.rotation, np.broadcast_to(np.eye(3), (count, 3, 3))]),
            height=np.concatenate([known.height, np.zeros(count)]),
            trust=np.concatenate([known.trust, np.zeros(count)]),
            depths=known.depths,
            partner=np.concatenate([known.partner, np.full(count, -1)]),
        )
    return replace(
        real,
        ids=np.arange(there + count),
        position=np.concatenate([real.position, far]),
        fov_deg=np.concatenate([real.fov_deg, np.full(count, fov)]),
        segments=[*real.segments, *([_segment(others, count)] if count else [])],
        photo_of_entry=np.concatenate([real.photo_of_entry, there + np.arange(count)]),
        search=search,
        extrinsics=known,
    )


def _measure(
    themap: IndexedMap, queries: list[tuple[Features, float, float]], *, fov: float
) -> dict[str, Any]:
    seconds, errors, stages = [], [], []
    for features, x, y in queries:
        begun = time.perf_counter()
        found = find_places(themap, features, fov_deg=fov)
        seconds.append(time.perf_counter() - begun)
        stages.append(found.answer.seconds)
        best = found.places[0].position if found.places else (math.inf, math.inf)
        errors.append(math.hypot(best[0] - x, best[1] - y))
    return {
        "within_50px": float(np.mean(np.array(errors) <= 50.0)),
        "p50_seconds": round(float(np.median(seconds)), 4),
        "p95_seconds": round(float(np.quantile(seconds, 0.95)), 4),
        **{f"{s}_p50": round(float(np.median([t[s] for t in stages])), 4) for s in stages[0]},
    }


def _segment(others: Distractors, count: int) -> Segment:
    rows = int(others.first[count])
    xy: Any = Zeros(rows, 2)
    flat: Any = Zeros(rows)
    descriptors: Any = others.rows
    return Segment(
        content=[""] * count,
        first=others.first[: count + 1],
        xy=xy,
        size=flat,
        angle=flat,
        descriptors=descriptors,
        photo_size=np.full((count, 2), 640, np.int32),
        fov_deg=np.full(count, np.nan),
    )


class _Made(NamedTuple):
    search: InvertedFile | TwoStage
    cost: dict[str, float]


class _Signed:
    """Signatures of all photos, computed once."""

    def __init__(self, real: list[NDArray[np.uint8]], others: Distractors) -> None:
        begun = time.perf_counter()
        self._codebook = vlad.train([p for p in real if len(p)][:: max(1, len(real) // vlad.SAMPLE_PHOTOS)])
        self._trained = time.perf_counter() - begun
        begun = time.perf_counter()
        self._real = np.array([vlad.signature(self._codebook, rows) for rows in real])
        self._each = (time.perf_counter() - begun) / len(real)
        self._distractors = others
        count = len(others.first) - 1
        made = in_threads(lambda i: vlad.signature(self._codebook, others.photo(i)), list(range(count)))
        self._others = np.array(made, np.uint8).reshape(count, self._real.shape[1])

    def of(self, real: IndexedMap, count: int) -> _Made:
        """Return the search structure of a map with `count` distractors."""
        # the map's own photos are split into the parts of its segments
        ends = np.cumsum([len(s.content) for s in real.segments])
        parts = [*np.split(self._real, ends[:-1]), *([self._others[:count]] if count else [])]
        segments = [*real.segments]
        if count:
            segments.append(_segment(self._distractors, count))
        size = sum(p.nbytes for p in parts)
        cost = {
            "train_seconds": round(self._trained, 2),
            "encode_seconds": round(self._each * (len(self._real) + count), 2),
            "bytes_a_photo": round(size / (len(self._real) + count), 1),
        }
        return _Made(TwoStage(self._codebook, parts, segments=segments), cost)


def _codes(real: list[NDArray[np.uint8]], others: Distractors, count: int) -> _Made:
    chunks = [
        [others.photo(i) for i in range(start, min(start + _CHUNK, count))]
        for start in range(0, count, _CHUNK)
    ]
    parts = [np.concatenate(part) for part in (real, *chunks)]
    total = sum(map(len, parts))
    share = min(1.0, ivf.SAMPLE_PER_CELL * ivf.cells_for(total) / total)
    rng = np.random.default_rng(0)
    begun = time.perf_counter()
    codebook = ivf.train(np.concatenate([p[rng.random(len(p)) < share] for p in parts]), total, kind="float")
    trained = time.perf_counter() - begun
    begun = time.perf_counter()
    coded: list[Any] = []
    for part in parts:
        coded.append(faiss.clone_index(codebook))
        ivf.encode(coded[-1], part)
    cost = {
        "train_seconds": round(trained, 2),
        "encode_seconds": round(time.perf_counter() - begun, 2),
        "bytes_a_photo": round(sum(c.ntotal * (c.code_size + 8) for c in coded) / (len(real) + count), 1),
    }
    return _Made(InvertedFile(coded), cost)


_WIDE, _HIGH, _LEFT, _BOTTOM = 560, 320, 60, 270
_NAMES = {"ivf": "compressed descriptors (ivf)", "vlad": "signatures (vlad)"}


def plot(rows: list[dict[str, Any]]) -> str:
    """Plot the seconds of a query against the number of photos, both logarithmic, as SVG."""
    xs = [math.log10(r["photos"]) for r in rows]
    low, high = min(xs) - 0.1, max(xs) + 0.1
    ys = [math.log10(r["p50_seconds"]) for r in rows]
    least, most = math.floor(min(ys) * 3.0) / 3.0, math.ceil(max(ys) * 3.0) / 3.0 + 0.1

    def at(photos: float, seconds: float) -> tuple[float, float]:
        x = _LEFT + (math.log10(photos) - low) / (high - low) * (_WIDE - _LEFT - 40)
        return x, _BOTTOM - (math.log10(seconds) - least) / (most - least) * (_BOTTOM - 40)

    out = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {_WIDE} {_HIGH}" '
        'font-family="sans-serif" font-size="12">'
    ]
    out.append(f'<rect width="{_WIDE}" height="{_HIGH}" fill="#fff"/>')
    out.append('<text x="8" y="14">seconds of a query once its keypoints are known, median</text>')
    for photos in sorted({r["photos"] for r in rows}):
        x, _ = at(photos, 1.0)
        out.append(
            f'<text x="{x:.0f}" y="{_BOTTOM + 18}" text-anchor="middle">{photos:,}</text>'.replace(",", " ")
        )
    for seconds in (0.02, 0.05, 0.1, 0.2, 0.5, 1.0, 2.0):
        if least <= math.log10(seconds) <= most:
            _, y = at(10**low, seconds)
            out.append(f'<path d="M{_LEFT} {y:.0f}H{_WIDE - 40}" stroke="#ddd"/>')
            out.append(f'<text x="{_LEFT - 6}" y="{y + 4:.0f}" text-anchor="end">{seconds:g} s</text>')
    for tier, colour in (("ivf", "#c2500a"), ("vlad", "#1f5fa8")):
        points = [at(r["photos"], r["p50_seconds"]) for r in rows if r["tier"] == tier]
        if points:
            line = " ".join(f"{x:.1f},{y:.1f}" for x, y in points)
            out.append(f'<polyline points="{line}" fill="none" stroke="{colour}" stroke-width="2"/>')
            out += [f'<circle cx="{x:.1f}" cy="{y:.1f}" r="3.5" fill="{colour}"/>' for x, y in points]
            x, y = points[-1]
            name = _NAMES[tier]
            out.append(f'<text x="{x:.0f}" y="{y - 12:.0f}" text-anchor="end" fill="{colour}">{name}</text>')
    middle = (_LEFT + _WIDE - 40) / 2
    out.append(f'<text x="{middle:.0f}" y="{_HIGH - 8}" text-anchor="middle">photos of the map</text></svg>')
    return "\n".join(out) + "\n"


if __name__ == "__main__":
    main()
