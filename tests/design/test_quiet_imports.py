"""Importing a module has no side effects."""

import json
import os
import subprocess
import sys
from pathlib import Path

PROBE = Path(__file__).with_name("import_probe.py")


def run_probe(names, *, folder, path):
    """Import modules in a separate process, and return the side effects."""
    environment = {
        **os.environ,
        "PYTHONDONTWRITEBYTECODE": "1",
        "PYTHONPATH": os.pathsep.join(map(str, path)),
    }
    command = [sys.executable, "-W", "error", str(PROBE), *names]
    done = subprocess.run(command, cwd=folder, env=environment, capture_output=True, text=True, check=True)
    assert done.stderr == ""
    return json.loads(done.stdout)


def test_importing_has_no_effect(modules, project, tmp_path):
    # Alembic runs its environment module by importing it.
    names = [module.name for module in modules if module.name != "webapp.store.migrations.env"]
    assert run_probe(names, folder=tmp_path, path=[project]) == []
    assert list(tmp_path.iterdir()) == []


def test_the_probe_notices_effects(tmp_path):
    package = tmp_path / "webapp"
    package.mkdir()
    (package / "__init__.py").touch()
    effects = {
        "writes": "open('left_behind', 'w').close()",
        "makes": "import os\nos.mkdir('made')",
        "prints": "print('hello')",
        "moves": "import os\nos.chdir('/')",
        "reads": "import os\nHOME = os.environ.get('HOME')",
        "starts": "import threading\nthreading.Thread(target=threading.Event().wait, daemon=True).start()",
        "runs": "import subprocess, sys\nsubprocess.run([sys.executable, '--version'], stdout=-3)",
    }
    for name, text in effects.items():
        (package / f"{name}.py").write_text(text)
    noticed = run_probe([f"webapp.{name}" for name in effects], folder=tmp_path, path=[tmp_path])
    assert {line.split(":")[0] for line in noticed} == {f"webapp.{name}" for name in effects}
