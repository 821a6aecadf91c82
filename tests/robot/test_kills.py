"""Client and server are killed, and the network is cut: every record arrives exactly once, in order."""

import os
import random
import subprocess
import sys
import threading
import time
from pathlib import Path

import pytest

from tests.ports import reserved_port
from tests.robot.stand_in import StandIn
from tests.robot.wire import Wire
from webapp.robot import RobotClient

ROOT = Path(__file__).resolve().parents[2]
KILLS = 10
COUNT = 1500


def run(module, *words):
    environ = {**os.environ, "PYTHONPATH": str(ROOT)}
    return subprocess.Popen(
        [sys.executable, "-m", f"tests.robot.{module}", *map(str, words)], env=environ, cwd=ROOT
    )


def stored(file):
    server = StandIn(file)
    server.http.server_close()
    return [int(record["time"]) for record in server.stored()] if server.records else []


@pytest.fixture
def port():
    with reserved_port() as port:
        yield port


@pytest.mark.parametrize("seed", [1])
def test_client_and_server_are_killed_ten_times(tmp_path, port, seed):
    rng, file = random.Random(seed), tmp_path / "stored"
    programs = {
        "stand_in": lambda: run("stand_in", port, file),
        "walker": lambda: run("walker", f"http://127.0.0.1:{port}", tmp_path / "spool", COUNT),
    }
    running = {name: start() for name, start in programs.items()}
    try:
        for kill in range(KILLS):
            begun = len(stored(file))
            until = time.monotonic() + 60
            while len(stored(file)) == begun < COUNT and time.monotonic() < until:
                time.sleep(0.02)  # until both are working
            time.sleep(rng.uniform(0, 0.15))
            name = ("stand_in", "walker")[kill % 2]
            running[name].kill()
            running[name].wait()
            running[name] = programs[name]()
        assert running["walker"].wait(300) == 0
    finally:
        for process in running.values():
            process.kill()
            process.wait()
    assert stored(file) == list(range(COUNT))


def test_the_network_is_cut_ten_times(tmp_path, server, quick):
    with Wire(server.http.server_address) as wire:
        options = quick(batch_records=10, timeout_s=0.3)
        robot = RobotClient(wire.url, "token", mission=7, spool=tmp_path / "spool", options=options)
        walk = threading.Thread(target=lambda: [send_pose(robot, number) for number in range(300)])
        walk.start()
        rng = random.Random(2)
        for _ in range(10):
            time.sleep(rng.uniform(0.02, 0.08))
            wire.cut()
            time.sleep(rng.uniform(0.02, 0.08))
            wire.mend()
        walk.join()
        assert robot.close(wait_s=60)
    assert wire.cuts == 10 and wire.passed > 10
    assert [record["time"] for record in server.stored()] == list(range(300))


def send_pose(robot, number):
    robot.pose(50, 14, time_s=number)
    time.sleep(0.002)
