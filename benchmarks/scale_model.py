"""Measures the cost per photo and per answer on a map, and extrapolates it to libraries of other sizes.

    python -m benchmarks.scale_model MAP.cfg QUERIES.csv [--queries-used N] [--photo-mb MB] [--open-maps 4]
        [--answers 0.1,5,200] [--core 12] [--gb-memory 2] [--tb-disk 80] [--tb-objects 20]
        [--check LARGER.cfg QUERIES.csv] [--json OUT]

The index is built from scratch in a temporary folder, once with compressed descriptors and once with
signatures. Measures seconds of processor time (of all cores together), which other load on the machine
affects little, bytes, and the peak memory of a process that has the map open.

The model is linear, for maps like this one. Its assumptions are the options: megabytes per photo (default:
those of the map), maps that a process has open at once, answers per second in the busiest hour for each size
of library, prices per month. A core is planned to be busy for 60 % of that hour. Not included: traffic,
backups, the second look of `auto`.

--check measures another map, with more photos of the same kind, and prints it beside what the model says of
it from the first map.
"""

from __future__ import annotations

import argparse
import csv
import json
import math
import os
import statistics
import sys
import tempfile
from collections.abc import Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from benchmarks.processes import run

LIBRARIES = (10_000, 1_000_000, 100_000_000)
BUSY = 0.6
BUILD_DAYS = 30
"""Time allowed for building the first indexes."""
ALL_MAPS_MB = 256.0
"""Memory for searching all maps, per million photos, from `python -m benchmarks.library_search`."""
IN_MEMORY_UP_TO, IN_DATABASE_KB = 100_000, 1.0
"""Number of photos up to which that search is done in memory; beyond, pgvector takes this much per photo (see
the same benchmark), which should fit into the database server's memory."""
COMPRESSED_UP_TO = 9_600
"""Number of photos up to which a map is searched by compressed descriptors; beyond, by signatures."""
TIERS = {"compressed": "500", "signatures": "0"}
"""Values of EXPMAP_RETRIEVAL_MEMORY_MB that select each search method."""
PREVIEWS, ROWS = 40, 5000


@dataclass(frozen=True, slots=True)
class Tier:
    """Cost of a search method.

    Attributes:
    ----------
    build_s : float
        Processor seconds per photo: keypoints, index, orientations and calibration.
    index_kb, process_mb : float
        Disk space per photo; peak memory of a process with the map open, 2^20 bytes.
    answer_s : float
        Processor seconds per query, from its file to the answer.
    """

    build_s: float
    index_kb: float
    process_mb: float
    answer_s: float


@dataclass(frozen=True, slots=True)
class Measured:
    """Figures measured on a map."""

    photos: int
    photo_mb: float
    previews_kb: float
    row_kb: float
    empty_mb: float
    """Peak memory of a process without an open map."""
    compressed: Tier
    signatures: Tier


def main() -> None:
    """Measure, and print both tables."""
    arguments = _arguments()
    with tempfile.TemporaryDirectory() as folder:
        own = arguments.map, arguments.queries
        used = arguments.queries_used
        tiers = [
            _measure_tier(*own, used=used, index=Path(folder) / tier, memory_mb=mb)
            for tier, mb in TIERS.items()
        ]
    empty = run([sys.executable, "-c", "import webapp.api; print(0)"]).peak_rss_mb
    photos = _photos(arguments.map)
    own_mb = statistics.fmean(path.stat().st_size for path in photos) / 1e6
    measured = Measured(len(photos), own_mb, _previews_kb(photos), _row_kb(), empty, *tiers)
    _print_measured(measured)
    planned = replace(measured, photo_mb=arguments.photo_mb or own_mb)
    plans = [
        plan(planned, photos=n, answers_a_second=rate, options=arguments)
        for n, rate in zip(LIBRARIES, arguments.answers, strict=True)
    ]
    _print_plans(plans)
    checked = _check(measured, arguments) if arguments.check else {}
    if arguments.json:
        found = {"measured": asdict(measured), "plans": plans, "check": checked}
        arguments.json.write_text(json.dumps(found, indent=1) + "\n")


def plan(
    measured: Measured, *, photos: int, answers_a_second: float, options: argparse.Namespace
) -> dict[str, float]:
    """Compute the needs of a library: storage, cores, memory, and cost per month.

    Args:
        photos: Photos in the library, on maps with as many photos as the measured one.
    """
    tier = measured.compressed if measured.photos <= COMPRESSED_UP_TO else measured.signatures
    maps = math.ceil(photos / measured.photos)
    answer_cores = max(1.0, answers_a_second * tier.answer_s / BUSY)
    build_hours = photos * tier.build_s / 3600
    build_cores = max(1.0, build_hours / (BUILD_DAYS * 24))
    open_mb = min(maps, options.open_maps) * (tier.process_mb - measured.empty_mb)
    in_memory = photos <= IN_MEMORY_UP_TO
    process_mb = measured.empty_mb + open_mb + in_memory * photos / 1e6 * ALL_MAPS_MB
    search_gb = 0.0 if in_memory else photos * IN_DATABASE_KB / 1e6
    memory_gb = math.ceil(answer_cores) * process_mb / 1000
    objects_tb = photos * (measured.photo_mb * 1e6 + tier.index_kb * 1000) / 1e12
    folder_tb = photos * measured.previews_kb * 1000 / 1e12
    rows_gb = photos * measured.row_kb * 1000 / 1e9
    money = {
        "cores": (answer_cores + build_cores) * options.core,
        "memory": (memory_gb + search_gb) * options.gb_memory,
        "objects": objects_tb * options.tb_objects,
        "disk": (folder_tb + rows_gb / 1000) * options.tb_disk,
    }
    return {
        "photos": photos,
        "maps": maps,
        "answers a second": answers_a_second,
        "photos and indexes, TB": objects_tb,
        "previews, TB": folder_tb,
        "records, GB": rows_gb,
        "first indexes, core hours": build_hours,
        f"cores for these in {BUILD_DAYS} days": build_cores,
        "cores for answers": answer_cores,
        "memory for answers, GB": memory_gb,
        "search on all maps, GB": search_gb,
        **{f"{name}, a month": value for name, value in money.items()},
        "all, a month": sum(money.values()),
    }


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("map", type=Path)
    parser.add_argument("queries", type=Path)
    parser.add_argument("--queries-used", type=int, default=40)
    parser.add_argument("--photo-mb", type=float, help="megabytes of a photo, instead of those of the map")
    parser.add_argument("--open-maps", type=int, default=4, help="of a process, at once")
    parser.add_argument("--answers", type=_rates, default=[0.1, 5.0, 200.0], help="a second, for each size")
    parser.add_argument("--core", type=float, default=12.0, help="price of a core a month")
    parser.add_argument("--gb-memory", type=float, default=2.0)
    parser.add_argument("--tb-disk", type=float, default=80.0)
    parser.add_argument("--tb-objects", type=float, default=20.0)
    parser.add_argument("--check", type=Path, nargs=2, metavar=("LARGER.cfg", "QUERIES.csv"))
    parser.add_argument("--json", type=Path)
    return parser.parse_args()


def _rates(text: str) -> list[float]:
    rates = [float(part) for part in text.split(",")]
    if len(rates) != len(LIBRARIES):
        raise argparse.ArgumentTypeError(f"{len(LIBRARIES)} numbers are needed, by commas")
    return rates


def _photos(cfg: Path) -> list[Path]:
    with cfg.open(newline="", encoding="utf-8") as file:
        return [
            cfg.parent / line[1] for line in csv.reader(file, delimiter=";") if line and line[0].isdecimal()
        ]


def _measure_tier(cfg: Path, listed: Path, *, used: int, index: Path, memory_mb: str) -> Tier:
    """Build the map and localize photos, by command line."""
    os.environ["EXPMAP_RETRIEVAL_MEMORY_MB"] = memory_mb
    with listed.open(newline="", encoding="utf-8") as file:
        names = [line["path"] for line in csv.DictReader(file, delimiter=";")]
    step = max(1, len(names) // used)
    queries = [str(listed.parent / name) for name in names[::step][:used]]
    expmap, where = [sys.executable, "-m", "webapp"], [str(cfg), "--index", str(index), "--json"]
    built = run([*expmap, "build", *where])
    ask = [*expmap, "localize", *where, "--budget", "0"]
    run([*ask, queries[0]])  # the first answer creates files that are missing
    one, every = run([*ask, queries[0]]), run([*ask, *queries])
    count = len(_photos(cfg))
    kept = sum(path.stat().st_size for path in index.rglob("*") if path.is_file())
    return Tier(
        build_s=built.cpu_seconds / count,
        index_kb=kept / 1000 / count,
        process_mb=every.peak_rss_mb,
        answer_s=(every.cpu_seconds - one.cpu_seconds) / (len(queries) - 1),
    )


def _check(measured: Measured, arguments: argparse.Namespace) -> dict[str, dict[str, float]]:
    """Measure the larger map and print its figures beside those that the model computes from the first."""
    cfg, listed = arguments.check
    name = "compressed" if len(_photos(cfg)) <= COMPRESSED_UP_TO else "signatures"
    with tempfile.TemporaryDirectory() as folder:
        larger = _measure_tier(
            cfg, listed, used=arguments.queries_used, index=Path(folder) / name, memory_mb=TIERS[name]
        )
    model: Tier = getattr(measured, name)
    photos = len(_photos(cfg))
    figures = {
        "index, MB": (model.index_kb * photos / 1000, larger.index_kb * photos / 1000),
        "first index, core minutes": (model.build_s * photos / 60, larger.build_s * photos / 60),
        "an answer, CPU seconds": (model.answer_s, larger.answer_s),
        "process with the map open, MB": (model.process_mb, larger.process_mb),
    }
    print(f"\n{f'a map of {photos} photos':32}{'model':>12}{'measured':>12}{'ratio':>8}")
    for what, (said, found) in figures.items():
        print(f"{what:32}{shown(said):>12}{shown(found):>12}{said / found:>8.2f}")
    return {what: {"model": said, "measured": found} for what, (said, found) in figures.items()}


def _previews_kb(photos: Sequence[Path]) -> float:
    """Measure the size of previews per photo, on some photos."""
    from webapp.files.photos.photo import make_previews
    from webapp.settings import PhotoLimits

    some = photos[:: max(1, len(photos) // PREVIEWS)]
    made = [make_previews(path, limits=PhotoLimits()) for path in some]
    return statistics.fmean(sum(map(len, previews.values())) for previews in made) / 1000


def _row_kb() -> float:
    """Measure the growth of the database file per photo, by filling a library with records."""
    from benchmarks.large_map import fill
    from webapp.store.accounts import accounts
    from webapp.store.library import open_library
    from webapp.store.maps import maps

    with tempfile.TemporaryDirectory() as folder:
        library = open_library(Path(folder))
        with library.database.write() as session:
            owner = accounts.ensure_owner(session)
            slug = maps.create(session, "Rows", account_id=owner.id).slug
        library.database.close()
        file = Path(folder) / ".library" / "library.db"
        before = file.stat().st_size
        fill(Path(folder), slug, count=ROWS)
        return (file.stat().st_size - before) / 1000 / ROWS


def _print_measured(measured: Measured) -> None:
    print(
        f"{measured.photos} photos of {measured.photo_mb:.2f} MB; previews {measured.previews_kb:.0f} kB, "
        f"records {measured.row_kb:.2f} kB a photo"
    )
    print(f"{'a photo or an answer':28}{'compressed':>14}{'signatures':>14}")
    for name, value in asdict(measured.compressed).items():
        print(f"{name:28}{value:>14.3g}{asdict(measured.signatures)[name]:>14.3g}")


def _print_plans(plans: Sequence[dict[str, float]]) -> None:
    print()
    for name in plans[0]:
        print(f"{name:28}" + "".join(f"{shown(found[name]):>16}" for found in plans))


def shown(value: float) -> str:
    """Format a number with three significant digits, or as an integer from 100 on."""
    return f"{value:,.0f}".replace(",", " ") if value >= 100 else f"{value:.3g}"


if __name__ == "__main__":
    main()
