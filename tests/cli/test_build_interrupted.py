"""`expmap build` stopped by Ctrl-C and by kill -9: nothing is lost, and no process is left."""

import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import cv2
import pytest

pytestmark = pytest.mark.slow

PHOTOS = 24


@pytest.fixture(scope="module")
def slow_map(make_map: Callable[[Path, int], Path], tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A map whose photos take a while to describe."""
    cfg = make_map(tmp_path_factory.mktemp("slow"), PHOTOS)
    for photo in cfg.parent.glob("photos/*.jpg"):
        cv2.imwrite(str(photo), cv2.resize(cv2.imread(str(photo)), (800, 600)))
    return cfg


def command(cfg: Path, index: Path) -> list[str]:
    options = ["--method", "vote", "--jobs", "2", "--json", "--index", str(index)]
    return [sys.executable, "-m", "webapp", "build", str(cfg), *options]


@contextmanager
def start(cfg: Path, index: Path) -> Iterator[subprocess.Popen]:
    """Start a build as the leader of a new process group, as a shell does."""
    with subprocess.Popen(
        command(cfg, index),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
        start_new_session=True,
        cwd=Path(__file__).resolve().parents[2],
    ) as build:
        try:
            yield build
        except BaseException:
            with suppress(ProcessLookupError):
                os.killpg(build.pid, signal.SIGKILL)
            raise


def finish(cfg: Path, index: Path) -> dict:
    with start(cfg, index) as build:
        out, err = build.communicate(timeout=300)
    assert build.returncode == 0, err
    return json.loads(out)


def finished_photos(index: Path) -> set[str]:
    return {p.name for p in index.glob("*/*/spool/*.features")}


def wait_for(happened: Callable[[], bool], *, seconds: float = 120.0) -> None:
    until = time.monotonic() + seconds
    while not happened():
        assert time.monotonic() < until, "it did not happen"
        time.sleep(0.01)


def alive(group: int) -> list[str]:
    """Return the processes of a group without zombies."""
    table = subprocess.run(["ps", "-A", "-o", "pgid=,pid=,stat="], capture_output=True, text=True, check=True)
    rows = [line.split() for line in table.stdout.splitlines()]
    return [pid for pgid, pid, state in rows if int(pgid) == group and not state.startswith("Z")]


def workers(group: int) -> list[int]:
    """Return the processes of a group that describe photos."""
    table = subprocess.run(
        ["ps", "-A", "-ww", "-o", "pgid=,pid=,args="], capture_output=True, text=True, check=True
    )
    rows = [line.split(maxsplit=2) for line in table.stdout.splitlines()]
    return [int(pid) for pgid, pid, line in rows if int(pgid) == group and "spawn_main" in line]


def lasting(index: Path) -> dict[str, bytes]:
    """Return the files of an index by name; names are hashes of the content, except those of codes."""
    (folder,) = index.glob("*/sift-*")
    return {
        p.name: p.read_bytes() for p in folder.iterdir() if p.suffix in (".features", ".ivf", ".codebook")
    }


@pytest.fixture(scope="module")
def undisturbed(slow_map: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    index = tmp_path_factory.mktemp("undisturbed")
    assert finish(slow_map, index)["extracted"] == PHOTOS
    return index


def test_ctrl_c_keeps_what_is_finished_and_leaves_no_process(slow_map, undisturbed, tmp_path):
    with start(slow_map, tmp_path) as build:
        wait_for(lambda: len(finished_photos(tmp_path)) >= 3)
        os.killpg(build.pid, signal.SIGINT)  # the terminal sends it to every process of the group
        out, err = build.communicate(timeout=300)
    assert build.returncode == 130, err
    assert out == ""
    assert "Traceback" not in err
    assert err.splitlines()[-1] == "expmap: stopped; what was finished is kept"
    wait_for(lambda: not alive(build.pid))
    kept = finished_photos(tmp_path)
    assert 3 <= len(kept) < PHOTOS
    report = finish(slow_map, tmp_path)
    assert (report["extracted"], report["reused"]) == (PHOTOS - len(kept), len(kept))
    assert lasting(tmp_path) == lasting(undisturbed)


def test_ctrl_c_while_the_processes_start_is_no_mess(slow_map, tmp_path):
    with start(slow_map, tmp_path) as build:
        wait_for(lambda: len(alive(build.pid)) >= 3)
        os.killpg(build.pid, signal.SIGINT)
        out, err = build.communicate(timeout=300)
    assert (build.returncode, out) == (130, "")
    assert "Traceback" not in err
    wait_for(lambda: not alive(build.pid))


def test_a_second_ctrl_c_stops_at_once(slow_map, tmp_path):
    with start(slow_map, tmp_path) as build:
        wait_for(lambda: len(finished_photos(tmp_path)) >= 1)
        os.killpg(build.pid, signal.SIGINT)
        assert "press Ctrl-C again" in build.stderr.readline() + build.stderr.readline()
        os.killpg(build.pid, signal.SIGINT)
        _, err = build.communicate(timeout=300)
    assert build.returncode == 130
    assert err.startswith("interrupted\n")
    assert "Traceback" not in err
    wait_for(lambda: not alive(build.pid))


def test_killed_again_and_again_it_ends_with_the_same_index(slow_map, undisturbed, tmp_path):
    rng, kept = random.Random(3), set()
    for _ in range(3):
        target = len(kept) + rng.randint(1, 5)
        with start(slow_map, tmp_path) as build:
            wait_for(lambda: len(finished_photos(tmp_path)) >= target)  # noqa: B023
            build.kill()  # only the parent, as the system does when memory is short
        # The workers were not stopped, but end by themselves.
        wait_for(lambda: not alive(build.pid))
        now = finished_photos(tmp_path)
        assert kept <= now
        kept = now
    assert len(kept) < PHOTOS
    report = finish(slow_map, tmp_path)
    assert (report["extracted"], report["reused"]) == (PHOTOS - len(kept), len(kept))
    assert lasting(tmp_path) == lasting(undisturbed)
    assert not finished_photos(tmp_path)
    assert not list(tmp_path.rglob("*.tmp"))


def test_killed_while_joining_it_ends_with_the_same_index(slow_map, undisturbed, tmp_path):
    with start(slow_map, tmp_path) as build:
        wait_for(lambda: any(tmp_path.glob("*/*/[0-9a-f]*.features")))
        build.kill()
    wait_for(lambda: not alive(build.pid))
    assert not list(tmp_path.rglob("manifest.json"))
    report = finish(slow_map, tmp_path)
    assert (report["extracted"], report["reused"]) == (0, PHOTOS)
    assert lasting(tmp_path) == lasting(undisturbed)


def test_a_second_build_meanwhile_is_reported(slow_map, tmp_path):
    with start(slow_map, tmp_path) as build:
        wait_for(lambda: len(finished_photos(tmp_path)) >= 1)
        with start(slow_map, tmp_path) as second:
            out, err = second.communicate(timeout=300)
        build.kill()
    assert (second.returncode, out) == (1, "")
    assert "another process is building this index" in err


def test_a_killed_worker_is_reported_and_costs_nothing_that_is_finished(slow_map, undisturbed, tmp_path):
    with start(slow_map, tmp_path) as build:
        wait_for(lambda: len(finished_photos(tmp_path)) >= 2)
        os.kill(workers(build.pid)[0], signal.SIGKILL)
        out, err = build.communicate(timeout=300)
    assert (build.returncode, out) == (1, "")
    assert "a worker process was killed" in err
    assert "fewer --jobs" in err
    assert "Traceback" not in err
    kept = finished_photos(tmp_path)
    report = finish(slow_map, tmp_path)
    assert (report["extracted"], report["reused"]) == (PHOTOS - len(kept), len(kept))
    assert lasting(tmp_path) == lasting(undisturbed)
