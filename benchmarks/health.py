"""Measures health checks of a server while many people edit and localize.

    python -m benchmarks.health [--seconds 60] [--editors 20] [--visitors 10] [--against CHECKOUT]

Starts the program with the sample map in a temporary library. Editors place and move photos and poll for
changes, as `editing_load` does; visitors localize the sample's queries, one after the other. Meanwhile
another process checks `/healthz`, `/livez` and `/readyz` five times a second each, with a new connection for
each check. Prints one JSON object: number of checks and of answers, p50, p95, p99 and the worst time in
seconds of each. With `--against`, the same is first measured with the program in another checkout. The exit
code is 1 if the p99 of a health check exceeds a second, or if a request failed.
"""

from __future__ import annotations

import argparse
import http.client
import itertools
import json
import multiprocessing
import os
import shutil
import tempfile
import threading
import time
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import requests

from benchmarks.client import Client
from benchmarks.editing_client import Editor
from tests.browser.app import App

PATHS = ("/healthz", "/livez", "/readyz")
_MAP = "/maps/sample"
_SLOWEST_S = 1.0
_EVERY_S = 0.2
_GIVE_UP_S = 120.0
_PAUSE_S = 0.3
_HERE = Path(__file__).resolve().parents[1]


@dataclass
class Visitor:
    """A client that localizes one photo after the other.

    Attributes:
    ----------
    busy : int
        Answers that asked to come back later.
    """

    client: Client
    photos: list[Path]
    seconds: list[float] = field(default_factory=list)
    busy: int = 0
    errors: list[str] = field(default_factory=list)

    def work(self, seconds: float) -> None:
        """Localize until the time is over; waiting for a busy server counts as part of the answer."""
        until = time.monotonic() + seconds
        for photo in itertools.cycle(self.photos):
            if time.monotonic() > until:
                return
            started = time.monotonic()
            while not self._localize(photo) and time.monotonic() < until:
                time.sleep(1.0)
            self.seconds.append(time.monotonic() - started)

    def _localize(self, photo: Path) -> bool:
        """Return whether there was an answer, or an error, other than that the server is busy."""
        try:
            with photo.open("rb") as file:
                files = {"file": (photo.name, file)}
                answer = self.client.call("POST", f"{_MAP}/localize", files=files, data={"keep": "false"})
        except requests.RequestException as error:
            self.errors.append(f"localize: {error!r}")
            return True
        if answer.status_code == 503 and "Retry-After" in answer.headers:
            self.busy += 1
            return False
        if not answer.ok:
            self.errors.append(f"localize: {answer.status_code} {answer.text[:200]}")
        return True


def main() -> None:
    """Measure and print."""
    arguments = _arguments()
    report = {}
    if arguments.against is not None:
        report["against"] = measure(arguments, program=arguments.against.resolve())
    report["here"] = measure(arguments, program=_HERE)
    print(json.dumps(report, indent=2))
    slow = any(report["here"][path]["p99"] > _SLOWEST_S for path in PATHS)
    raise SystemExit(1 if slow or report["here"]["errors"] else 0)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--seconds", type=float, default=60)
    parser.add_argument("--editors", type=int, default=20)
    parser.add_argument("--visitors", type=int, default=10)
    parser.add_argument("--against", type=Path, metavar="CHECKOUT", help="another version of the program")
    parser.add_argument(
        "--sample", type=Path, metavar="FOLDER", help="from `expmap sample`, made anew if missing"
    )
    return parser.parse_args()


def measure(arguments: argparse.Namespace, *, program: Path) -> dict[str, Any]:
    """Run the load against the program of a checkout; return the times."""
    environ = {
        "PYTHONPATH": str(program),
        "PYTHONSAFEPATH": "1",  # otherwise the current folder would come first
        "EXPMAP_WEB_REQUESTS_PER_MINUTE": "1000000",
    }
    with (
        tempfile.TemporaryDirectory() as folder,
        _app(Path(folder) / "maps", arguments.sample, environ=environ) as app,
    ):
        owner = Client(app.url, app.sign_in)
        _wait_for_jobs(owner)
        photos = sorted((app.library / "sample").rglob("query_*.jpg"))
        clients = [Client(app.url, link) for link in _links(owner, arguments.editors + arguments.visitors)]
        editors = [
            Editor(client, "sample", seed=number, pause_s=_PAUSE_S)
            for number, client in enumerate(clients[: arguments.editors])
        ]
        visitors = [
            Visitor(client, photos[number % len(photos) :] + photos[: number % len(photos)])
            for number, client in enumerate(clients[arguments.editors :])
        ]
        if visitors:
            visitors[0].work(0.0)  # opens the map
            visitors[0].seconds.clear()
        checks = _work(app.url, [*editors, *visitors], seconds=arguments.seconds)
    edits = [seconds for editor in editors for seconds in editor.log.edit_seconds]
    localized = [seconds for visitor in visitors for seconds in visitor.seconds]
    errors = [error for client in [*(e.log for e in editors), *visitors] for error in client.errors]
    return {
        "load": round(os.getloadavg()[0], 1),
        **{path: {**times(seconds), "answers": statuses} for path, (seconds, statuses) in checks.items()},
        "edit": times(edits),
        "localize": {**times(localized), "busy": sum(visitor.busy for visitor in visitors)},
        "errors": len(errors),
        "first_errors": errors[:5],
    }


def _app(library: Path, sample: Path | None, *, environ: dict[str, str]) -> App:
    """Make the program with a library, to which it adds the sample map."""
    if sample is not None:
        shutil.copytree(sample, library / "sample")
    return App(library, environ=environ)


def _links(owner: Client, count: int) -> list[str]:
    """Make sign-in links to the owner's account."""
    me = owner.ask("GET", "/account")["id"]
    return [owner.ask("POST", f"/accounts/{me}/link")["url"] for _ in range(count)]


def _wait_for_jobs(owner: Client) -> None:
    while True:
        jobs = owner.ask("GET", "/jobs")["jobs"]
        if any(job["state"] == "failed" for job in jobs):
            raise SystemExit(f"a job failed: {jobs}")
        if jobs and all(job["state"] == "done" for job in jobs):
            return
        time.sleep(0.5)


def _work(
    url: str, clients: Sequence[Editor | Visitor], *, seconds: float
) -> dict[str, tuple[list[float], dict[str, int]]]:
    """Run all clients, and the checks in a process of their own, which the clients do not delay."""
    here, there = multiprocessing.Pipe()
    spawn = multiprocessing.get_context("spawn")
    checker = spawn.Process(target=check, args=(url, there))
    checker.start()
    here.recv()
    threads = [threading.Thread(target=client.work, args=(seconds,)) for client in clients]
    for thread in threads:
        thread.start()
    time.sleep(seconds)
    here.send(None)
    for thread in threads:
        thread.join()
    checks: dict[str, tuple[list[float], dict[str, int]]] = here.recv()
    checker.join()
    return checks


def check(url: str, told: Connection) -> None:
    """Check until told to stop; send the seconds and the answers of each path."""
    over = threading.Event()
    found: dict[str, tuple[list[float], dict[str, int]]] = {}

    def repeat(path: str) -> None:
        seconds: list[float] = []
        statuses: Counter[str] = Counter()
        while not over.is_set():
            started = time.monotonic()
            statuses[_status(url, path)] += 1
            seconds.append(time.monotonic() - started)
            over.wait(max(_EVERY_S - seconds[-1], 0.0))
        found[path] = seconds, dict(statuses)

    threads = [threading.Thread(target=repeat, args=(path,)) for path in PATHS]
    told.send(None)
    for thread in threads:
        thread.start()
    told.recv()
    over.set()
    for thread in threads:
        thread.join()
    told.send(found)


def _status(url: str, path: str) -> str:
    connection = http.client.HTTPConnection(urlsplit(url).netloc, timeout=_GIVE_UP_S)
    try:
        connection.request("GET", path)
        response = connection.getresponse()
        response.read()
        return str(response.status)
    except OSError as error:
        return type(error).__name__
    finally:
        connection.close()


def times(seconds: Sequence[float]) -> dict[str, float]:
    """Return the number of times, and their percentiles."""
    if not seconds:
        return {"count": 0}
    ranks = {f"p{rank}": round(float(np.percentile(seconds, rank)), 3) for rank in (50, 95, 99)}
    return {"count": len(seconds), **ranks, "worst": round(max(seconds), 3)}


if __name__ == "__main__":
    main()
