"""Simulates many robots and phones that send poses at once, while a page follows one mission.

    python -m benchmarks.robots_load [--robots 50] [--phones 0] [--seconds 120] [--hertz 10] [--beat 1.0]
                                     [--json FILE]

Checks that each pose is stored exactly once. Starts the program with a temporary library. Every robot has its
own mission and makes poses at a constant rate; each beat it sends all unacknowledged ones as a batch, like
the robots' client. Phones send a position a second by their links, like the page for phones, all to the
mission that is followed. Prints poses lost, stored twice or out of order; seconds from an acknowledged
request to its acknowledgement; batches deferred because the server was busy; the memory of all processes of
the server together (proportional set size: shared pages count once), before, at the peak and at the end; the
processor time of the server and of the robots themselves, in cores; and the delay in seconds from the time of
a pose until the follower receives it. On average, a pose waits half a beat before it is sent.
"""

from __future__ import annotations

import argparse
import http.client
import json
import os
import random
import sys
import tempfile
import threading
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any
from urllib.parse import urlsplit

import numpy as np
import requests

from benchmarks.memory import as_text, family, memory_mb
from tests.browser.app import App
from webapp.missions.store import missions, phones, tracks
from webapp.store.accounts import accounts
from webapp.store.library import Library, open_library
from webapp.store.maps import maps

_MEMORY_EVERY_S = 2.0
_PATIENCE_S = 60.0
_STEP_DEGREES = 1e-6
_BATCH = 1000
"""Maximum number of records in one request, as in the robots' client."""


@dataclass
class Robot:
    """A robot: makes poses, and sends them until they are acknowledged."""

    url: str
    token: str
    mission: int
    made: list[float] = field(default_factory=list)
    seconds: list[float] = field(default_factory=list)
    track = ""
    refused: int = 0
    cuts: list[str] = field(default_factory=list)
    errors: list[str] = field(default_factory=list)

    def work(self, begin: float, arguments: argparse.Namespace) -> None:
        """Make poses from a Unix time on, and send all unacknowledged ones."""
        server = http.client.HTTPConnection(urlsplit(self.url).netloc, timeout=_PATIENCE_S)
        total, known, since = int(arguments.seconds * arguments.hertz), 0, time.monotonic()
        due, pause_s = begin, 0.0
        while known < total and time.monotonic() < since + _PATIENCE_S:
            due = max(due + arguments.beat, time.time() + pause_s)
            time.sleep(max(0.0, due - time.time()))
            count = min(total, int((time.time() - begin) * arguments.hertz))
            self.made += [begin + n / arguments.hertz for n in range(len(self.made), count)]
            last = min(count, known + _BATCH)
            if last == known:
                continue
            pause_s = self._send(server, known, last)
            if not pause_s:
                known, since = last, time.monotonic()
            if self.errors:
                return
        if known < total:
            self.errors.append(f"nothing was acknowledged for {_PATIENCE_S:.0f} s")

    def _send(self, server: http.client.HTTPConnection, first: int, last: int) -> float:
        """Send some poses; return the seconds to wait before sending them again, 0 if they are stored."""
        places = [
            {"time": time_s, "lat": 50 + n * _STEP_DEGREES, "lon": 14.0}
            for n, time_s in enumerate(self.made[first:last], first)
        ]
        path, given, headers = self._request(first, places)
        started = time.perf_counter()
        try:
            server.request("POST", path, json.dumps(given), {"Content-Type": "application/json", **headers})
            answer = server.getresponse()
            text = answer.read()
        except (OSError, http.client.HTTPException) as error:
            self.cuts.append(repr(error))  # the caller resends the poses, on a new connection
            server.close()
            return 1.0
        if answer.status == 200:
            self.seconds.append(time.perf_counter() - started)
            return 0.0
        if answer.status in (429, 503):
            self.refused += 1
            return float(answer.headers.get("Retry-After", 1)) * random.uniform(1.0, 1.5)
        self.errors.append(f"{answer.status} {text[:200]!r}")
        return 1.0

    def _request(
        self, first: int, places: list[dict[str, float]]
    ) -> tuple[str, dict[str, Any], dict[str, str]]:
        """Return path, body and headers of a batch."""
        records = [{"type": "pose", "heading_deg": 0.0, **place} for place in places]
        given = {"sender": "robot", "first": first, "records": records}
        return f"/api/v1/missions/{self.mission}/batches", given, {"Authorization": f"Bearer {self.token}"}


@dataclass
class Phone(Robot):
    """A phone, which sends its positions by a link instead of a token."""

    track: str = field(kw_only=True)

    def _request(
        self, first: int, places: list[dict[str, float]]
    ) -> tuple[str, dict[str, Any], dict[str, str]]:
        positions = [{**place, "accuracy_m": 8.0} for place in places]
        given = {"sender": "a phone's page", "first": first, "positions": positions}
        return f"/api/v1/phones/{self.token}/positions", given, {}


@dataclass
class Follower:
    """A page that follows a mission, and the delays of the poses that it receives."""

    url: str
    token: str
    mission: int
    heard: dict[tuple[int, int], float] = field(default_factory=dict)
    """Delay in seconds, by the track and the number of the pose."""
    streams: int = 0

    def work(self, over: threading.Event) -> None:
        """Follow until `over` is set; reconnect like an `EventSource`."""
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
                self.heard.setdefault((track["id"], number), now - time_s)


def main() -> None:
    """Run the load and print one JSON object; exit with 1 if there were problems."""
    arguments = _arguments()
    with tempfile.TemporaryDirectory() as folder:
        token, ids, links = _make_library(Path(folder) / "maps", arguments)
        with App(Path(folder) / "maps") as app:
            robots = [Robot(app.url, token, id) for id in ids]
            robots += [Phone(app.url, link, ids[0], track=name) for name, link in links.items()]
            follower = Follower(app.url, token, ids[0])
            used = _work(robots, follower, arguments, pid=app.pid)
        library = open_library(Path(folder) / "maps")
        problems = [problem for robot in robots for problem in stored_problems(library, robot)]
        library.database.close()
    followed = sum(len(robot.made) for robot in robots if robot.mission == ids[0])
    missed = followed - len(follower.heard)
    if missed:
        problems.append(f"the follower has not heard of {missed} poses")
    figures = {**_figures(robots, follower), **used, "problems": problems}
    if arguments.json is not None:
        arguments.json.write_text(json.dumps(figures, indent=2) + "\n")
    print(json.dumps(figures, indent=2))
    raise SystemExit(1 if problems else 0)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--robots", type=int, default=50)
    parser.add_argument("--phones", type=int, default=0)
    parser.add_argument("--seconds", type=float, default=120)
    parser.add_argument("--hertz", type=float, default=10, help="poses a second of each robot")
    parser.add_argument("--beat", type=float, default=1.0, help="seconds between two batches of a robot")
    parser.add_argument("--json", type=Path, help="write the figures to this file, too")
    return parser.parse_args()


def _make_library(folder: Path, arguments: argparse.Namespace) -> tuple[str, list[int], dict[str, str]]:
    """Make a library with a token, missions, and a map, which prevents the sample map at the start.

    Returns:
        The token, the numbers of the missions, and the tokens of the links of phones by their names.
    """
    library = open_library(folder)
    with library.database.write() as session:
        owner = accounts.ensure_owner(session)
        maps.create(session, "Another", account_id=owner.id)
        token = accounts.new_token(session, owner, name="robots")
        made = [missions.create(session, f"Robot {n}", account_id=owner.id) for n in range(arguments.robots)]
        names = [f"Phone {n}" for n in range(arguments.phones)]
        links = {name: phones.create(session, made[0], name=name, account_id=owner.id)[1] for name in names}
        ids = [mission.id for mission in made]
    library.database.close()
    return token, ids, links


def _work(
    robots: list[Robot], follower: Follower, arguments: argparse.Namespace, *, pid: int
) -> dict[str, Any]:
    """Run all robots and the follower at once; return memory (megabytes) and processor use (cores)."""
    before = highest = memory_mb(pid)["all"]["Pss"]
    busy_s, own_s, clock_s = _processor_s(pid), time.process_time(), time.monotonic()
    over = threading.Event()
    following = threading.Thread(target=follower.work, args=(over,))
    begin = time.time() + 1.0
    of_phones = argparse.Namespace(**{**vars(arguments), "hertz": 1.0, "beat": 1.0})
    threads = []
    for n, robot in enumerate(robots):
        pace = of_phones if isinstance(robot, Phone) else arguments
        # real robots are not synchronised, so the beats are spread
        threads.append(threading.Thread(target=robot.work, args=(begin + pace.beat * n / len(robots), pace)))
    for thread in (following, *threads):
        thread.start()
    while any(thread.is_alive() for thread in threads):
        highest = max(highest, memory_mb(pid)["all"]["Pss"])
        time.sleep(_MEMORY_EVERY_S)
    worked_s = time.monotonic() - clock_s
    busy_s, own_s = _processor_s(pid) - busy_s, time.process_time() - own_s
    time.sleep(_MEMORY_EVERY_S)
    end = memory_mb(pid)
    over.set()
    following.join()
    print(as_text(end, title="MB at the end"), file=sys.stderr)
    return {
        "pss_before_mb": round(before),
        "pss_highest_mb": round(highest),
        "pss_end_mb": round(end["all"]["Pss"]),
        "seconds": round(worked_s, 1),
        "server_cores": round(busy_s / worked_s, 3),
        "robots_cores": round(own_s / worked_s, 3),
        "cores": os.cpu_count(),
        "load": round(os.getloadavg()[0], 1),
    }


def _processor_s(pid: int) -> float:
    """Sum up the processor time of a process and its descendants."""
    ticks = 0
    for process in family(pid):
        try:
            stat = Path(f"/proc/{process}/stat").read_text()
        except (FileNotFoundError, ProcessLookupError):
            continue
        ticks += sum(map(int, stat.rpartition(")")[2].split()[11:13]))
    return ticks / os.sysconf("SC_CLK_TCK")


def stored_times(library: Library, robot: Robot) -> list[float]:
    """List the times of the stored poses of a robot."""
    with library.database.read() as session:
        found = [track for track in tracks.list_tracks(session, robot.mission) if track.name == robot.track]
        return [float(time_s) for track in found for time_s in tracks.read(session, track).times_s]


def stored_problems(library: Library, robot: Robot) -> list[str]:
    """Compare the poses that a robot has made with those stored."""
    with library.database.read() as session:
        found = tracks.list_tracks(session, robot.mission)
        counted = [track.poses for track in found if track.name == robot.track]
    stored = stored_times(library, robot)
    problems = [f"mission {robot.mission}: {error}" for error in robot.errors]
    if counted != [len(robot.made)] or stored != robot.made:
        problems.append(f"mission {robot.mission}: made {len(robot.made)}, stored {len(stored)}")
    return problems


def _figures(robots: list[Robot], follower: Follower) -> dict[str, Any]:
    phones_ = [robot for robot in robots if isinstance(robot, Phone)]
    acknowledged = np.array([second for robot in robots for second in robot.seconds])
    of_phones = np.array([second for phone in phones_ for second in phone.seconds])
    late = np.array(list(follower.heard.values()) or [np.nan])
    return {
        "robots": len(robots) - len(phones_),
        "phones": len(phones_),
        "poses": sum(len(robot.made) for robot in robots),
        "batches": len(acknowledged),
        "batches_put_off": sum(robot.refused for robot in robots),
        "connections_lost": sum(len(robot.cuts) for robot in robots),
        "acknowledged_s": _quantiles(acknowledged),
        **({"acknowledged_phones_s": _quantiles(of_phones)} if phones_ else {}),
        "follower_late_s": _quantiles(late),
        "follower_streams": follower.streams,
    }


def _quantiles(values: np.ndarray) -> dict[str, float]:
    p50, p95 = np.quantile(values, [0.5, 0.95])
    return {"p50": round(p50, 4), "p95": round(p95, 4), "most": round(float(values.max()), 4)}


if __name__ == "__main__":
    main()
