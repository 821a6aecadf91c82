"""Processes storing robots' records are killed at any moment: nothing acknowledged is lost or duplicated."""

import subprocess
import sys
from itertools import islice
from pathlib import Path

import pytest

from webapp.missions.store import missions, tracks
from webapp.store.accounts import accounts

ROOT = Path(__file__).resolve().parents[2]
BATCH = 5
SENDER = """
import os, sys
from pathlib import Path
from webapp.missions.tasks.store_batch import Numbered, store_batch
from webapp.store.library import open_library

library = open_library(Path(sys.argv[1]), url=os.environ.get("EXPMAP_DATABASE"))
mission, sender, number = int(sys.argv[2]), sys.argv[3], int(sys.argv[4])
while True:
    records = [
        {"type": "pose", "source": "gps", "track": sender, "time": 1e9 + n, "lat": 50.0, "lon": 14 + n / 1e6}
        for n in range(number, number + BATCH)
    ]
    number = store_batch(library, mission, place=Numbered(sender, number), records=records)["next"]
    print(number, flush=True)
""".replace("BATCH", str(BATCH))


@pytest.fixture
def mission(library):
    with library.database.write() as session:
        owner = accounts.ensure_owner(session)
        return missions.create(session, "Search", account_id=owner.id).id


def test_two_processes_that_are_killed_lose_and_double_nothing(library, mission):
    acknowledged = {"a": 0, "b": 0}
    for kills in range(2):
        running = {
            sender: subprocess.Popen(
                [sys.executable, "-c", SENDER, library.folder, str(mission), sender, str(next_)],
                cwd=ROOT, stdout=subprocess.PIPE, text=True,
            )
            for sender, next_ in acknowledged.items()
        }  # fmt: skip
        for sender, process in running.items():
            for line in islice(process.stdout, 3 + kills):
                acknowledged[sender] = int(line)
        for sender, process in running.items():
            process.kill()
            acknowledged[sender] = max([acknowledged[sender], *map(int, process.stdout.read().split())])
            process.stdout.close()
            process.wait()
    with library.database.read() as session:
        stored = {track.name: tracks.read(session, track) for track in tracks.list_tracks(session, mission)}
    assert {*stored} == {"a", "b"}
    for sender, poses in stored.items():
        numbers = poses.times_s - 1e9
        assert numbers.tolist() == list(range(len(poses))), "in order, each once"
        # The last batch may be stored without an acknowledgement to its sender.
        assert acknowledged[sender] <= len(poses) <= acknowledged[sender] + BATCH
