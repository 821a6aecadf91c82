"""The programs in the guide to Python work as described, and the guide lists the public names."""

import os
import re
import shutil
import subprocess
import sys

import cv2
import numpy as np
import pytest

from tests.design.conftest import ROOT
from webapp import api

PAGE = (ROOT / "docs" / "python.md").read_text("utf-8")
PLACES = [(100, 100), (200, 100), (300, 100), (400, 100), (500, 100), (600, 100)]


@pytest.fixture(scope="module")
def survey(tmp_path_factory, save_photo):
    """A folder with photos in a row, a plan, positions, and a query at the third place."""
    folder = tmp_path_factory.mktemp("survey")
    cv2.imwrite(str(folder / "plan.png"), np.full((200, 700), 200, np.uint8))
    rows = ["name;x;y"]
    for number, (x, y) in enumerate(PLACES):
        save_photo(folder / "photos" / f"{number}.jpg", number)
        rows.append(f"{number}.jpg;{x};{y}")
    (folder / "positions.csv").write_text("\n".join(rows) + "\n")
    shutil.copy(folder / "photos" / "2.jpg", folder / "query.jpg")
    (folder / "queries.csv").write_text("path;x;y\nquery.jpg;300;100\n")
    return folder


def run(program, folder):
    script = folder / "script.py"
    script.write_text(program)
    environ = {**os.environ, "PYTHONPATH": str(ROOT)}
    done = subprocess.run(
        [sys.executable, script], cwd=folder, env=environ, capture_output=True, text=True, timeout=300
    )
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.mark.slow
def test_the_programs_place_localize_and_evaluate(survey):
    place, localize, evaluate = re.findall(r"^```python\n(.*?)^```", PAGE, re.M | re.S)
    placed = run(place, survey)
    assert len(placed) == len(PLACES)
    assert placed[2] == "2.jpg MapPixel(x=300.0, y=100.0)"
    assert (survey / "map.cfg").is_file()
    found = [line for line in run(localize, survey) if line.startswith("1: ")]
    x, y = map(int, re.search(r"at (\d+), (\d+)", found[0]).groups())
    assert np.hypot(x - 300, y - 100) < 50
    first, *rest = run(evaluate, survey)
    assert re.match(r"median \d+\.\d px, ECE ", first)
    assert len(rest) == 1 and rest[0].startswith("query.jpg ")


def test_the_interface_is_what_it_exports():
    for name in api.__all__:
        assert hasattr(api, name), name
    used = set(re.findall(r"^from webapp\.api import (.+)$", PAGE, re.M))
    names = {name for line in used for name in line.split(", ")}
    assert names <= set(api.__all__)


@pytest.mark.parametrize("name", ["PlaceOptions", "PhotoMap", "Answer", "Hypothesis"])
def test_tables_name_what_there_is(name):
    (table,) = re.findall(rf"^\| (?:field of|of) `{name}`.*\n((?:\|.*\n)+)", PAGE, re.M)
    cells = [row.split("|")[1] for row in table.splitlines()[1:]]
    names = re.findall(r"`(\w+)[(`]", " ".join(cells))
    assert names
    assert [field for field in names if not hasattr(getattr(api, name), field)] == []


def test_importing_it_loads_no_web_code():
    code = "import sys, webapp.api; print(*{'flask', 'sqlalchemy', 'werkzeug', 'folium'} & set(sys.modules))"
    done = subprocess.run([sys.executable, "-c", code], cwd=ROOT, capture_output=True, text=True, check=True)
    assert done.stdout.split() == []
