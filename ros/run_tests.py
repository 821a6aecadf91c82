"""Runs the tests of the nodes with the wheels of ROS 2, in the environment `.venv-ros` of their own.

`make ros-test` does so. `ros/install.py` makes that environment first, where there are wheels for this
machine.
"""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

ROOT = Path(__file__).resolve().parents[1]
PYTHON = ROOT / ".venv-ros" / "bin" / "python"
PROCESSES = 3
"""That test at once, each in a domain of its own: most of the time nodes wait for each other."""

DOMAINS = 33
"""That runs choose from; further processes of a run have those that are so many higher each."""


def main() -> int:
    """Run pytest with the arguments given, by default all tests; return its exit code."""
    if not PYTHON.exists():
        return 0  # the installation said why
    tests = sys.argv[1:] or ["ros/expmap_ros/test"]
    with _own_domain() as number:
        paths = {"PYTHONPATH": str(ROOT / "ros" / "expmap_ros"), "ROS_DOMAIN_ID": str(number)}
        parallel = ["-n", str(PROCESSES), "--dist", "loadfile"]
        command = [PYTHON, "-m", "pytest", "-q", *parallel, *tests]
        return subprocess.run(command, cwd=ROOT, env={**os.environ, **paths}).returncode


@contextmanager
def _own_domain() -> Iterator[int]:
    """Choose a domain that no other run on this machine has: its nodes would answer."""
    for number in range(1, DOMAINS + 1):
        lock = FileLock(Path(tempfile.gettempdir()) / f"expmap-ros-domain-{number}.lock")
        try:
            lock.acquire(blocking=False)
        except Timeout:
            continue
        with lock:
            yield number
        return
    raise SystemExit("no domain of ROS 2 is free")


if __name__ == "__main__":
    sys.exit(main())
