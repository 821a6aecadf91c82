"""Each connection can be removed: the program starts without it."""

import os
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

from webapp.connect import connections

ROOT = Path(__file__).resolve().parents[2]
START = """
from webapp.app.main import main
from webapp.app.web import create_app
from webapp.settings import Settings
from pathlib import Path
from dataclasses import replace
create_app(replace(Settings(), library=Path("library")))
main(["connect", "--help"])
"""


QUICK = ["tests/core", "tests/files", "tests/store", "tests/connect", "tests/cli/test_main.py"]


def copy_without(folder, names):
    """Copy the program and its tests without these connections."""
    for part in ("webapp", "templates", "static", "docs", "tests", "ros"):
        ignored = shutil.ignore_patterns("__pycache__", "node_modules")
        shutil.copytree(ROOT / part, folder / part, ignore=ignored)
    for file in ("pyproject.toml", "README.md"):
        shutil.copy(ROOT / file, folder)
    for part in ("webapp", "tests"):
        for name in names:
            shutil.rmtree(folder / part / "connect" / name)


def run(folder, *arguments):
    environment = {**os.environ, "PYTHONPATH": str(folder)}
    command = [sys.executable, *arguments]
    return subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, timeout=1800)


@pytest.mark.slow
@pytest.mark.parametrize("name", connections())
def test_the_program_starts_without_a_connection(name, tmp_path):
    copy_without(tmp_path, [name])
    done = run(tmp_path, "-c", START)
    assert (done.returncode, done.stderr) == (0, "")
    assert "Usage: expmap connect" in done.stdout
    assert name not in done.stdout.partition("Commands:")[2].split()


@pytest.mark.slow
def test_the_quick_tests_pass_without_connections(tmp_path):
    copy_without(tmp_path, connections())
    words = ("-m", "pytest", "-q", "-m", "not slow", "-n", "2", "--dist", "loadfile", *QUICK)
    done = run(tmp_path, *words)
    assert done.returncode == 0, done.stdout[-3000:]
    assert " passed" in done.stdout
