"""Simulates many people who localize photos on one map at once, and compares with the command line.

    python -m benchmarks.localizing_load MAPFOLDER [--clients 20] [--seconds 120] [--fov 73.7]

MAPFOLDER holds `map.cfg`, its image and its photos, and `queries.csv`. A copy of the map is added to a
temporary library and indexed by the program itself. Every client has its own account and localizes one photo
after the other, without pauses. Prints errors, seconds per answer, answers per second, the memory of all
processes together (proportional set size: shared pages count once), how much of the index is in the memory of
one process and of all together, and the time per query of the command line; on standard error the memory of
each process.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import tempfile
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.client import Client
from benchmarks.editing_load import sign_in_links
from benchmarks.memory import Table, as_text, memory_mb
from tests.browser.app import App, expmap
from webapp.store.accounts import accounts
from webapp.store.library import open_library
from webapp.tasks.maps import adopt_map

SLUG = "crowded"
_BEAT_S = 5.0
_MOMENT_S = 0.01


@dataclass
class Asker:
    """A client with its results."""

    client: Client
    photos: list[Path]
    seconds: list[float] = field(default_factory=list)
    errors: list[str] = field(default_factory=list)

    def work(self, until: float, fov: float | None) -> None:
        """Localize photos until the time is over."""
        options = {} if fov is None else {"fov": str(fov)}
        number = 0
        while time.monotonic() < until:
            photo = self.photos[number % len(self.photos)]
            number += 1
            started = time.perf_counter()
            with photo.open("rb") as file:
                answer = self.client.call(
                    "POST", f"/maps/{SLUG}/localize", files={"file": (photo.name, file)}, data=options
                )
            self.seconds.append(time.perf_counter() - started)
            if not answer.ok or "hypotheses" not in answer.json():
                self.errors.append(f"{answer.status_code} {answer.text[:200]}")


def main() -> None:
    """Run the load and print one JSON object; exit with 1 if there was an error."""
    arguments = _arguments()
    lines = (arguments.folder / "queries.csv").read_text(encoding="utf-8").splitlines()[1:]
    photos = [arguments.folder / line.split(";")[0] for line in lines if line.strip()]
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "maps"
        _copy_map(arguments.folder, library)
        with App(library) as app:
            owner = Client(app.url, app.sign_in)
            _wait_for_index(owner)
            links = sign_in_links(library, arguments.clients)
            askers = [
                Asker(Client(app.url, app.url + link), photos[n :: arguments.clients])
                for n, link in enumerate(links)
            ]
            memory = _work(askers, arguments, pid=app.pid)
        alone = _command_line(library, photos[:: max(1, len(photos) // 40)], fov=arguments.fov)
    print(json.dumps({**_figures(askers, arguments), **memory, **alone}, indent=2))
    raise SystemExit(1 if any(asker.errors for asker in askers) else 0)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folder", type=Path, metavar="MAPFOLDER")
    parser.add_argument("--clients", type=int, default=20)
    parser.add_argument("--seconds", type=float, default=120)
    parser.add_argument("--fov", type=float, help="field of view of the queries, degrees")
    return parser.parse_args()


def _copy_map(source: Path, library: Path) -> None:
    """Add a copy of the map, without derived files, to a library."""
    opened = open_library(library)
    shutil.copytree(source, library / SLUG, ignore=shutil.ignore_patterns("derived"))
    with opened.database.write() as session:
        owner = accounts.ensure_owner(session)
    adopt_map.adopt_map(opened, SLUG, account_id=owner.id)
    opened.database.close()


def _wait_for_index(owner: Client) -> None:
    while True:
        jobs = owner.ask("GET", f"/jobs?map={SLUG}")["jobs"]
        if any(job["state"] == "failed" for job in jobs):
            raise SystemExit(f"a job failed: {jobs}")
        if jobs and all(job["state"] == "done" for job in jobs):
            return
        time.sleep(1.0)


def _work(askers: list[Asker], arguments: argparse.Namespace, *, pid: int) -> dict[str, float]:
    """Run all clients at once; print the memory of each process, return the peak of all, megabytes."""
    print(as_text(memory_mb(pid), title="MB after the start"), file=sys.stderr)
    askers[0].work(time.monotonic() + _MOMENT_S, arguments.fov)
    print(as_text(memory_mb(pid), title="MB after the first answer"), file=sys.stderr)
    askers[0].seconds.clear()
    until = time.monotonic() + arguments.seconds
    threads = [threading.Thread(target=asker.work, args=(until, arguments.fov)) for asker in askers]
    for thread in threads:
        thread.start()
    highest = 0.0
    while any(thread.is_alive() for thread in threads):
        highest = max(highest, memory_mb(pid)["all"]["Pss"])
        time.sleep(_BEAT_S)
    end = memory_mb(pid)
    print(as_text(end, title="MB at the end"), file=sys.stderr)
    parts = {f"end_{name.lower()}_mb": round(end["all"][name]) for name in ("Pss", "Pss_Anon", "Pss_File")}
    return {"highest_pss_mb": round(highest), **parts, **_index_mb(end)}


def _index_mb(table: Table) -> dict[str, float]:
    """Return how much of the index is in memory: the maximum of one process, and of all together."""
    most = max(sizes["index_Rss"] for who, sizes in table.items() if who != "all")
    return {"index_in_one_mb": round(most), "index_in_all_mb": round(table["all"]["index_Pss"])}


def _command_line(library: Path, photos: list[Path], *, fov: float | None) -> dict[str, float]:
    """Time queries by the command line, one after the other."""
    options = [] if fov is None else ["--fov", str(fov)]
    printed = expmap("localize", library / SLUG / "map.cfg", *photos, "--json", *options, library=library)
    seconds = np.array([answer["seconds"]["total"] for answer in json.loads(printed)])
    return {f"command_line_p{p}": round(float(np.percentile(seconds, p)), 3) for p in (50, 95)}


def _figures(askers: list[Asker], arguments: argparse.Namespace) -> dict[str, Any]:
    seconds = np.array([s for asker in askers for s in asker.seconds])
    errors = [error for asker in askers for error in asker.errors]
    return {
        "clients": arguments.clients,
        "answers": len(seconds),
        "answers_per_second": round(len(seconds) / arguments.seconds, 2),
        "errors": len(errors),
        "first_errors": errors[:5],
        **{f"answer_p{p}": round(float(np.percentile(seconds, p)), 3) for p in (50, 95)},
    }


if __name__ == "__main__":
    main()
