"""Lets many robots send where they are at once, while a page follows one of them.

    python -m benchmarks.robots_load [--robots 50] [--seconds 120] [--hertz 10] [--beat 1.0]

Is each pose there once? Starts the program with a temporary library. Every robot has a mission of its own and
makes poses in even steps; each beat it sends those since the last one as a batch, and sends a batch again
that was not acknowledged. Printed are what is lost, stored twice or out of order; seconds from the first
request to the acknowledgement; the memory of all processes of the server together (proportional set size:
shared pages count once), before, at its highest and at the end; and how late, in seconds after a pose was
made, the follower heard of it. A pose waits for half a beat on average before it is even sent.
"""

from __future__ import annotations

import argparse
import json
import sys
import tempfile
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np
import requests

from benchmarks.memory import as_text, memory_mb
from tests.browser.app import App
from webapp.missions.store import missions, tracks
from webapp.store.accounts import accounts
from webapp.store.library import Library, open_library
from webapp.store.maps import maps

_MEMORY_EVERY_S = 2.0
_PATIENCE_S = 60.0
_STEP_DEGREES = 1e-6


@dataclass
class Robot:
    """A robot: makes poses, and sends them until they are acknowledged."""

    url: str
    token: str
    mission: int
    made: list[float] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    refused: int = 0
    errors: list[str] = field(default_factory=list)

    def work(self, begin: float, arguments: argparse.Namespace) -> None:
        """Make poses and send them, from a Unix time on."""
        session = requests.Session()
        session.headers["Authorization"] = f"Bearer {self.token}"
        total, sent = int(arguments.seconds * arguments.hertz), 0
        beat = max(1, round(arguments.beat * arguments.hertz))
        while sent < total:
            sent = min(sent + beat, total)
            due = begin + sent / arguments.hertz
            time.sleep(max(0.0, due - time.time()))
            first = len(self.made)
            self.made += [begin + n / arguments.hertz for n in range(first, sent)]
            self._send(session, first)

    def _send(self, session: requests.Session, first: int) -> None:
        records = [
            {"type": "pose", "time": time_s, "lat": 50 + n * _STEP_DEGREES, "lon": 14.0, "heading_deg": 0.0}
            for n, time_s in enumerate(self.made[first:], first)
        ]
        given = {"sender": "robot", "first": first, "records": records}
        address = f"{self.url}/api/v1/missions/{self.mission}/batches"
        started = time.perf_counter()
        while time.perf_counter() - started < _PATIENCE_S:
            answer = session.post(address, json=given, timeout=_PATIENCE_S)
            if answer.ok:
                self.seconds.append(time.perf_counter() - started)
                return
            if answer.status_code not in (429, 503):
                break
            self.refused += 1
            time.sleep(float(answer.headers.get("Retry-After", 1)))
        self.errors.append(f"{answer.status_code} {answer.text[:200]}")


@dataclass
class Follower:
    """A page that follows a mission, and how late it hears of its poses."""

    url: str
    token: str
    mission: int
    heard: dict[int, float] = field(default_factory=dict)
    """By the number of a pose: seconds after it was made."""
    streams: int = 0

    def work(self, over: threading.Event) -> None:
        """Follow until it is over; comes back as an `EventSource` does."""
        known: dict[str, str] = {}
        while not over.is_set():
            headers = {"Authorization": f"Bearer {self.token}", **known}
            address = f"{self.url}/api/v1/missions/{self.mission}/events"
            with requests.get(address, headers=headers, stream=True, timeout=_PATIENCE_S) as answer:
                self.streams += 1
                for line in answer.iter_lines(chunk_size=1, decode_unicode=True):
                    kind, _, value = line.partition(": ")
                    if kind == "id":
                        known = {"Last-Event-ID": value}
                    elif kind == "data":
                        self._note(json.loads(value))
            over.wait(1.0)

    def _note(self, data: dict[str, Any]) -> None:
        now = time.time()
        for track in data["tracks"]:
            for number, time_s, *_ in track["new"]:
                self.heard.setdefault(number, now - time_s)


def main() -> None:
    """Run it and print one JSON object; exit code 1 when something was wrong."""
    arguments = _arguments()
    with tempfile.TemporaryDirectory() as folder:
        token, ids = _make_library(Path(folder) / "maps", arguments.robots)
        with App(Path(folder) / "maps") as app:
            robots = [Robot(app.url, token, id) for id in ids]
            follower = Follower(app.url, token, ids[0])
            memory = _work(robots, follower, arguments, pid=app.pid)
        library = open_library(Path(folder) / "maps")
        problems = [problem for robot in robots for problem in _problems(library, robot)]
        library.database.close()
    missed = len(robots[0].made) - len(follower.heard)
    if missed:
        problems.append(f"the follower has not heard of {missed} poses")
    print(json.dumps({**_figures(robots, follower), **memory, "problems": problems}, indent=2))
    raise SystemExit(1 if problems else 0)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--robots", type=int, default=50)
    parser.add_argument("--seconds", type=float, default=120)
    parser.add_argument("--hertz", type=float, default=10, help="poses a second of each robot")
    parser.add_argument("--beat", type=float, default=1.0, help="seconds between two batches of a robot")
    return parser.parse_args()


def _make_library(folder: Path, robots: int) -> tuple[str, list[int]]:
    """Make a library with a token, missions, and a map: else the start makes the sample meanwhile."""
    library = open_library(folder)
    with library.database.write() as session:
        owner = accounts.ensure_owner(session)
        maps.create(session, "Another", account_id=owner.id)
        token = accounts.new_token(session, owner, name="robots")
        ids = [missions.create(session, f"Robot {n}", account_id=owner.id).id for n in range(robots)]
    library.database.close()
    return token, ids


def _work(
    robots: list[Robot], follower: Follower, arguments: argparse.Namespace, *, pid: int
) -> dict[str, float]:
    """Let all work at once; gives the memory of the server, megabytes."""
    before = highest = memory_mb(pid)["all"]["Pss"]
    over = threading.Event()
    following = threading.Thread(target=follower.work, args=(over,))
    begin = time.time() + 1.0
    threads = [
        # Robots do not wait for each other: their beats are spread.
        threading.Thread(target=robot.work, args=(begin + arguments.beat * n / len(robots), arguments))
        for n, robot in enumerate(robots)
    ]
    for thread in (following, *threads):
        thread.start()
    while any(thread.is_alive() for thread in threads):
        highest = max(highest, memory_mb(pid)["all"]["Pss"])
        time.sleep(_MEMORY_EVERY_S)
    time.sleep(_MEMORY_EVERY_S)
    end = memory_mb(pid)
    over.set()
    following.join()
    print(as_text(end, title="MB at the end"), file=sys.stderr)
    return {
        "pss_before_mb": round(before),
        "pss_highest_mb": round(highest),
        "pss_end_mb": round(end["all"]["Pss"]),
    }


def _problems(library: Library, robot: Robot) -> list[str]:
    """Compare what a robot has made with what is stored of it."""
    with library.database.read() as session:
        found = tracks.list_tracks(session, robot.mission)
        times = [tracks.read(session, track).times_s for track in found]
        counted = [track.poses for track in found]
    stored = np.concatenate([np.empty(0), *times])
    problems = [f"mission {robot.mission}: {error}" for error in robot.errors]
    if counted != [len(robot.made)] or not np.array_equal(stored, np.array(robot.made)):
        problems.append(f"mission {robot.mission}: made {len(robot.made)}, stored {len(stored)}")
    return problems


def _figures(robots: list[Robot], follower: Follower) -> dict[str, Any]:
    acknowledged = np.array([second for robot in robots for second in robot.seconds])
    late = np.array(list(follower.heard.values()) or [np.nan])
    return {
        "robots": len(robots),
        "poses": sum(len(robot.made) for robot in robots),
        "batches": len(acknowledged),
        "batches_put_off": sum(robot.refused for robot in robots),
        "acknowledged_s": _quantiles(acknowledged),
        "follower_late_s": _quantiles(late),
        "follower_streams": follower.streams,
    }


def _quantiles(values: np.ndarray) -> dict[str, float]:
    p50, p95 = np.quantile(values, [0.5, 0.95])
    return {"p50": round(p50, 4), "p95": round(p95, 4), "most": round(float(values.max()), 4)}


if __name__ == "__main__":
    main()
