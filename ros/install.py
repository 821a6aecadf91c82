"""Installs the wheels of ROS 2 into `.venv-ros`, and builds the messages that have no wheels.

    python3 ros/install.py .venv

The wheels slow down every start of Python, so they are not in `.venv`. `.venv-ros` has them, and uses the
other packages of the given environment. This script needs only the standard library and nothing of that
environment, since `make test` creates both at the same time.
"""

from __future__ import annotations

import os
import platform
import shutil
import subprocess
import sys
import sysconfig
import venv
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
FOLDER = ROOT / ".venv-ros"
PYTHON = FOLDER / "bin" / "python"
BUILDER = ROOT / "ros" / "build_messages.py"
_STAND_INS = ROOT / "ros" / "expmap_ros" / "test" / "interfaces"
MESSAGES = (ROOT / "ros" / "expmap_msgs", _STAND_INS / "tf2_msgs", _STAND_INS / "vision_msgs")
PYTHONS = ((3, 11), (3, 12), (3, 13))
"""Versions for which there are wheels, on Linux with glibc and x86-64."""


def main() -> int:
    """Install unless `.venv-ros` is up to date; if there are no wheels for this machine, say so."""
    if len(sys.argv) != 2:
        sys.stderr.write("usage: install.py ENVIRONMENT\n")
        return 2
    here = (platform.system(), platform.machine(), platform.libc_ver()[0])
    if sys.version_info[:2] not in PYTHONS or here != ("Linux", "x86_64", "glibc"):
        version = platform.python_version()
        sys.stdout.write(
            f"\n***** SKIPPED: the ROS 2 nodes are NOT TESTED: no wheels for Python {version} on {here}\n\n"
        )
        shutil.rmtree(FOLDER, ignore_errors=True)  # of another Python version
        return 0
    _install(Path(sys.argv[1]).resolve())
    return 0


def _install(environment: Path) -> None:
    """Create `.venv-ros`, unless it has these packages and this base already."""
    import tomllib  # here, since older versions of Python lack it: `main` reports those

    declared = tomllib.loads((ROOT / "pyproject.toml").read_text("utf-8"))["project"]
    optional = declared["optional-dependencies"]
    packages = [*optional["ros"], *optional["ros-build"]]
    base = sysconfig.get_path("purelib", "venv", {"base": str(environment)})
    sources = [ROOT / "constraints.txt", BUILDER, *(p for m in MESSAGES for p in sorted(m.rglob("*.*")))]
    compilers = f"{shutil.which('cmake')} {shutil.which(os.environ.get('CXX', 'c++'))}"
    texts = (path.read_text("utf-8") for path in sources)
    wanted = "\n".join([sys.version, base, compilers, *packages, *texts])
    stamp = FOLDER / ".installed"
    if stamp.exists() and stamp.read_text("utf-8") == wanted:
        return
    sys.stdout.write("installing the wheels of ROS 2 into .venv-ros\n")
    venv.create(FOLDER, clear=True, with_pip=True)
    pip = [PYTHON, "-m", "pip", "install", "--quiet", "--no-compile", "--disable-pip-version-check"]
    subprocess.run([*pip, "--constraint", ROOT / "constraints.txt", *packages], check=True)
    if subprocess.run([PYTHON, BUILDER, *MESSAGES]).returncode:
        sys.stdout.write(
            "\n***** SKIPPED: messages without a wheel are not built: nodes with them are NOT TESTED\n\n"
        )
    own = sysconfig.get_path("purelib", "venv", {"base": str(FOLDER)})
    Path(own, "experience_map_base.pth").write_text(f"import site; site.addsitedir({base!r})\n", "utf-8")
    stamp.write_text(wanted, "utf-8")


if __name__ == "__main__":
    sys.exit(main())
