"""Loaded packages: no web packages when localizing from Python; on servers only the needed ones."""

import json
import subprocess
import sys

import pytest

from webapp.core import localize
from webapp.extras import EXTRAS
from webapp.tasks import localize as localize_tasks

WEB = {"flask", "apiflask", "sqlalchemy", "alembic", "requests", "urllib3", "werkzeug", "jinja2", "gunicorn"}

IMPORT = """
import importlib, json, sys
for name in sys.argv[1:]:
    importlib.import_module(name)
print(json.dumps(sorted({name.partition(".")[0] for name in sys.modules})))
"""


def loaded_by(names, project):
    """Return the packages that are loaded after importing modules."""
    command = [sys.executable, "-c", IMPORT, *names]
    done = subprocess.run(command, cwd=project, capture_output=True, text=True, check=True)
    return set(json.loads(done.stdout))


def test_importing_the_localizer_loads_no_web(modules, project):
    tasks = [f"{localize_tasks.__name__}.{name}" for name in ("open_pipeline", "pipeline")]
    tasks.append("webapp.tasks.evaluation.evaluate")
    names = [m.name for m in modules if m.name.startswith(localize.__name__)] + tasks
    loaded = loaded_by(names, project)
    assert {"webapp", "cv2", "numpy"} <= loaded
    extras = {package for packages in EXTRAS.values() for package in packages}
    assert loaded & (WEB | extras) == set()


COUNT = """
import sys
import webapp.tasks.localize.pipeline
own = [module for name, module in sys.modules.items() if name.partition(".")[0] == "webapp"]
print(sum(not hasattr(module, "__path__") for module in own))
"""


def test_the_pipeline_takes_few_modules(project):
    done = subprocess.run(
        [sys.executable, "-c", COUNT], cwd=project, capture_output=True, text=True, check=True
    )
    assert 10 < int(done.stdout) <= 104


COMMAND = """
import json, runpy, sys
sys.argv = ["expmap", *sys.argv[1:], "--help"]
try:
    runpy.run_module("webapp", run_name="__main__")
except SystemExit:
    print("\\n" + json.dumps(sorted({name.partition(".")[0] for name in sys.modules})))
"""


@pytest.mark.parametrize("words", [["build"], ["localize"], ["evaluate"], ["landmarks", "build"]])
def test_commands_on_a_map_load_no_database_and_no_web(project, words):
    command = [sys.executable, "-c", COMMAND, *words]
    done = subprocess.run(command, cwd=project, capture_output=True, text=True, check=True)
    loaded = set(json.loads(done.stdout.splitlines()[-1]))
    assert "click" in loaded
    assert loaded & WEB <= {"jinja2"}, "of which reports are made"


def test_a_server_loads_what_writes_pages_for_downloads_when_it_is_needed(project):
    loaded = loaded_by(["webapp.app.web"], project)
    assert "flask" in loaded
    assert loaded & {"folium", "branca"} == set()


OPEN = """
import sys
from pathlib import Path
from webapp.store.library import open_library
open_library(Path(sys.argv[1])).database.close()
print("alembic" in sys.modules)
"""


def test_migrations_are_loaded_where_a_library_is_not_up_to_date(project, tmp_path):
    command = [sys.executable, "-c", OPEN, tmp_path / "library"]
    new, again = (
        subprocess.run(command, cwd=project, capture_output=True, text=True, check=True).stdout.strip()
        for _ in range(2)
    )
    assert (new, again) == ("True", "False")
