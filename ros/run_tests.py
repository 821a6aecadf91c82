"""Runs the tests of the nodes with the wheels of ROS 2, in the separate environment `.venv-ros`.

Called by `make ros-test`, after `ros/install.py`, which creates that environment if there are wheels for this
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
"""Number of parallel test processes, each in its own domain; nodes mostly wait for each other."""

DOMAINS = 33
"""Number of domains that runs choose from; each further process of a run adds this to its domain."""


def main() -> int:
    """Run pytest with the arguments given, by default all tests; return its exit code."""
    if not PYTHON.exists():
        return 0  # the installation has printed why
    tests = sys.argv[1:] or ["ros/expmap_ros/test"]
    with _own_domain() as number:
        paths = {"PYTHONPATH": str(ROOT / "ros" / "expmap_ros"), "ROS_DOMAIN_ID": str(number)}
        parallel = ["-n", str(PROCESSES), "--dist", "loadfile"]
        command = [PYTHON, "-m", "pytest", "-q", *parallel, *tests]
        return subprocess.run(command, cwd=ROOT, env={**os.environ, **paths}).returncode


@contextmanager
def _own_domain() -> Iterator[int]:
    """Reserve a domain that no other run on this machine uses, since its nodes would interfere."""
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
