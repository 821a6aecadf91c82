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


@pytest.mark.parametrize("name", connections())
def test_the_program_starts_without_a_connection(name, tmp_path):
    for part in ("webapp", "templates", "static", "docs"):
        ignored = shutil.ignore_patterns("__pycache__")
        shutil.copytree(ROOT / part, tmp_path / part, ignore=ignored)
    shutil.rmtree(tmp_path / "webapp" / "connect" / name)
    environment = {**os.environ, "PYTHONPATH": str(tmp_path)}
    command = [sys.executable, "-c", START]
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=120)
    assert (done.returncode, done.stderr) == (0, "")
    assert "Usage: expmap connect" in done.stdout
    assert name not in done.stdout.partition("Commands:")[2].split()
