"""Builds message packages with the wheels of ROS 2, and installs them into the running environment.

    ros-env/bin/python ros/build_messages.py ros/expmap_msgs

Needs CMake, a C++ compiler and the headers of Python; the extra `ros-build` installs the rest.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import sysconfig
import tempfile
from pathlib import Path

PREFIX = Path(sys.prefix)


def main() -> int:
    """Build the packages given as arguments; return the exit code, stopping at the first failure."""
    packages = [Path(argument).resolve() for argument in sys.argv[1:]]
    if not packages:
        sys.stderr.write("usage: build_messages.py PACKAGE...\n")
        return 2
    if missing := missing_tools():
        sys.stderr.write(f"messages cannot be built without {' and '.join(missing)}\n")
        return 1
    _correct_include_paths()
    for package in packages:
        try:
            _build(package)
        except subprocess.CalledProcessError as error:
            sys.stderr.write(f"{package.name} cannot be built:\n{error.stdout}")
            return 1
    return 0


def missing_tools() -> list[str]:
    """Return the required system programs that are missing."""
    compiler = os.environ.get("CXX", "c++")
    return [name for name in ("cmake", compiler) if shutil.which(name) is None]


def _build(package: Path) -> None:
    own = {"AMENT_PREFIX_PATH": str(PREFIX), "CMAKE_PREFIX_PATH": str(PREFIX)}
    path = f"{PREFIX / 'bin'}{os.pathsep}{os.environ['PATH']}"
    chosen = {"BUILD_TESTING": "OFF", "CMAKE_INSTALL_PREFIX": PREFIX, "Python3_EXECUTABLE": sys.executable}
    with tempfile.TemporaryDirectory() as folder:
        configure = ["cmake", "-S", package, "-B", folder, *(f"-D{k}={v}" for k, v in chosen.items())]
        for command in (configure, ["cmake", "--build", folder, "--target", "install", "--parallel", "2"]):
            subprocess.run(
                command,
                check=True,
                env={**os.environ, **own, "PATH": path},
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
            )


def _correct_include_paths() -> None:
    """Replace two include paths of the machine that built the wheels by those of this environment."""
    import numpy as np

    python, arrays = sysconfig.get_path("include"), np.get_include()
    for file in (PREFIX / "share").glob("*/cmake/*__rosidl_generator_pyExport.cmake"):
        text = file.read_text("utf-8")
        corrected = re.sub(r'/opt/python/[^;"]*/numpy/_core/include', lambda _: arrays, text)
        corrected = re.sub(r'/opt/python/[^;"]*/include/python[\d.]+', lambda _: python, corrected)
        if corrected != text:
            file.write_text(corrected, "utf-8")


if __name__ == "__main__":
    sys.exit(main())
