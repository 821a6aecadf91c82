"""Replays a recorded mission while the network is cut and client and server are killed; checks the poses.

    python -m benchmarks.robot_outage BAG [--speed 20] [--cuts 10] [--kills 5] [--min-move 0] [--seed 1]

Starts the program with a temporary library, and `expmap robot replay` through a proxy that can be
disconnected. At random times during the replay, the connection is cut and restored, or the client or all
processes of the server are killed with SIGKILL and restarted. At the end the track is compared, number by
number, with the one from an import of the same file.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
import urllib.request
from pathlib import Path
from typing import Any

import numpy as np
from pyproj import Geod
from rosbags.highlevel import AnyReader

from benchmarks.killer import descendants
from tests.browser.app import expmap
from tests.ports import reserved_port
from tests.robot.wire import Wire
from webapp.missions.core.trajectory.records import Poses
from webapp.missions.core.trajectory.thinning import parse_min_move
from webapp.missions.store import missions, tracks
from webapp.missions.store.schema import MissionSender, Track
from webapp.missions.tasks import import_file
from webapp.missions.tasks.import_order import Order
from webapp.missions.tasks.place_track import ReadOptions
from webapp.robot.content import has_spool, read_content
from webapp.settings import Settings
from webapp.store.accounts import accounts
from webapp.store.library import Library, open_library
from webapp.store.maps import maps

FINISH_WITHIN_S = 300


def main() -> None:
    """Run the replay and print one JSON object; exit with 1 if there were problems."""
    arguments = _arguments()
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        _make_library(folder / "maps")
        begun = time.monotonic()
        done = _replay(folder, arguments)
        done["seconds"] = round(time.monotonic() - begun, 1)
        library = open_library(folder / "maps")
        found = _compare(library, folder, arguments)
        library.database.close()
    problems = [name for name, right in found.pop("checks").items() if not right]
    if done["after_the_end"]:
        problems.append("the replay had ended before everything was cut and killed: take a lower --speed")
    print(json.dumps({**done, **found, "problems": problems}, indent=2))
    raise SystemExit(1 if problems else 0)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("bag", type=Path)
    parser.add_argument("--speed", type=float, default=20)
    parser.add_argument("--cuts", type=int, default=10, help="of the network")
    parser.add_argument("--kills", type=int, default=5, help="of the client, and as many of the server")
    parser.add_argument("--min-move", default="0")
    parser.add_argument("--seed", type=int, default=1)
    return parser.parse_args()


def _make_library(folder: Path) -> None:
    """Make a library with a map, since an empty one would get the sample map at the first start."""
    library = open_library(folder)
    with library.database.write() as session:
        maps.create(session, "Another", account_id=accounts.ensure_owner(session).id)
    library.database.close()


class _Programs:
    """The server and the client, which are killed at the end."""

    def __init__(self, folder: Path, url: str, *, port: int, arguments: argparse.Namespace) -> None:
        library = folder / "maps"
        token = expmap("account", "token", "--name", "rover", library=library).strip()
        self._environ = {**os.environ, "EXPMAP_TOKEN": token}
        self._words = {
            "server": ["serve", "--port", str(port), "--library", str(library), "--workers", "2"],
            "client": [
                *("robot", "replay", str(arguments.bag), "--speed", str(arguments.speed), "--topic", "/fix"),
                *("--min-move", arguments.min_move, "--spool", str(folder / "spool")),
                *("--new", "Outage", "--url", url, "--every", "0.2"),
            ],
        }
        self._log = (folder / "log").open("ab")
        self._running: dict[str, subprocess.Popen[bytes]] = {}

    def start(self, name: str) -> None:
        """Start one of them in its own process group."""
        self._running[name] = subprocess.Popen(
            [sys.executable, "-m", "webapp", *self._words[name]],
            env=self._environ, stdout=self._log, stderr=self._log, start_new_session=True,
        )  # fmt: skip

    def kill(self, name: str) -> None:
        """Kill one of them and all its processes."""
        pid = self._running[name].pid
        for each in (pid, *descendants(pid)):
            with contextlib.suppress(ProcessLookupError):
                os.kill(each, signal.SIGKILL)
        self._running[name].wait()

    def client_runs(self) -> bool:
        """Check whether the client is still running."""
        return self._running["client"].poll() is None

    def end(self) -> int:
        """Wait for the client, and stop the server; return the client's exit code."""
        code = self._running["client"].wait(FINISH_WITHIN_S)
        self._running["server"].terminate()
        self._running["server"].wait()
        return code

    def __enter__(self) -> _Programs:
        return self

    def __exit__(self, *_: object) -> None:
        for name, process in self._running.items():
            if process.poll() is None:
                self.kill(name)
        self._log.close()


def _replay(folder: Path, arguments: argparse.Namespace) -> dict[str, Any]:
    rng = random.Random(arguments.seed)
    planned = ["cut"] * arguments.cuts + ["client", "server"] * arguments.kills
    rng.shuffle(planned)
    longest, after_the_end = 0, 0
    with (
        reserved_port() as port,
        Wire(("127.0.0.1", port)) as wire,
        _Programs(folder, wire.url, port=port, arguments=arguments) as programs,
    ):
        programs.start("server")
        _wait_for_server(port)
        programs.start("client")
        while not has_spool(folder / "spool"):
            if not programs.client_runs():
                raise SystemExit((folder / "log").read_text())
            time.sleep(0.05)
        for action in planned:
            time.sleep(rng.uniform(0.1, 1.0))
            after_the_end += not programs.client_runs()
            if action == "cut":
                wire.cut()
                time.sleep(rng.uniform(0.2, 1.5))
                longest = max(longest, read_content(folder / "spool").waiting)
                wire.mend()
            else:
                programs.kill(action)
                longest = max(longest, read_content(folder / "spool").waiting)
                programs.start(action)
        code = programs.end()
        cuts = wire.cuts
    return {
        "speed": arguments.speed,
        "network_cut": cuts,
        "client_killed": arguments.kills,
        "server_killed": arguments.kills,
        "after_the_end": after_the_end,
        "longest_queue": longest,
        "client_exit_code": code,
    }


def _wait_for_server(port: int) -> None:
    while True:
        try:
            urllib.request.urlopen(f"http://127.0.0.1:{port}/healthz", timeout=60).close()
        except OSError:
            time.sleep(0.1)
        else:
            return


def _compare(library: Library, folder: Path, arguments: argparse.Namespace) -> dict[str, Any]:
    """Compare the data on the server with an import of the file."""
    spool = read_content(folder / "spool")
    with library.database.write() as session:
        owner = accounts.ensure_owner(session)
        other = missions.create(session, "Imported", account_id=owner.id).id
    options = ReadOptions(min_move=parse_min_move(arguments.min_move), topics=("/fix",))
    order = Order(arguments.bag, arguments.bag.name, options)
    import_file.import_track_file(library, other, order=order, settings=Settings(library=library.folder))
    with library.database.read() as session:
        sent, poses = _track(session, spool.identity.mission)
        imported, expected = _track(session, other)
        sender = session.get_one(MissionSender, (spool.identity.mission, spool.identity.id))
        next_seq = sender.next_seq
    independent = _distance_m(arguments.bag)
    return {
        "poses": len(poses),
        "poses_of_the_import": len(expected),
        "left_out": sent.skipped,
        "distance_m": round(sent.distance_m, 3),
        "distance_of_the_import_m": round(imported.distance_m, 3),
        "distance_by_another_program_m": round(independent, 3),
        "checks": {
            "each pose is there once, in order, as the import has it": _same(poses, expected),
            "the server counts the records of the spool": next_seq == spool.written == len(expected) + 1,
            "nothing waits, nothing was set aside": not spool.waiting and not spool.aside,
            "the distance is that of the fixes within 1 %": abs(sent.distance_m / independent - 1) < 0.01,
        },
    }


def _track(session: Any, mission: int) -> tuple[Track, Poses]:
    (track,) = tracks.list_tracks(session, mission)
    return track, tracks.read(session, track)


def _same(poses: Poses, expected: Poses) -> bool:
    names = ("times_s", "latlon", "height_m", "heading_deg", "covariance_m2", "travelled_m")
    return len(poses) == len(expected) and all(
        np.array_equal(getattr(poses, name), getattr(expected, name), equal_nan=True) for name in names
    )


def _distance_m(bag: Path) -> float:
    """Sum up the geodesics between the fixes of the bag, independently of the program's code."""
    with AnyReader([bag]) as reader:
        wanted = [c for c in reader.connections if c.topic == "/fix"]
        fixes = [reader.deserialize(raw, c.msgtype) for c, _, raw in reader.messages(wanted)]
    lon, lat = [fix.longitude for fix in fixes], [fix.latitude for fix in fixes]
    return float(Geod(ellps="WGS84").line_length(lon, lat))


if __name__ == "__main__":
    main()
