"""The documentation names existing files, folders and targets, and its tour is short."""

import re

import pytest

from tests.design.conftest import ROOT

PAGES = sorted([*(ROOT / "docs").glob("*.md"), ROOT / "README.md"])
FOLDERS = "webapp|static|templates|tests|docs|benchmarks|maps|ros"
MOST_LINES = 1400
"""Limit of the tour."""


def named_paths(text):
    """Return paths in code: relative to the project, or to the package if they begin with a layer."""
    found = re.findall(rf"`((?:{FOLDERS})/[\w./-]*)`", text)
    layers = re.findall(r"`((?:core|files|store|tasks|jobs|render|net|web|cli|missions)/[\w./-]+)`", text)
    return [*found, *(f"webapp/{path}" for path in layers)]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: page.name)
def test_paths_exist(page):
    made = ("maps/sample", "maps/NAME")  # by the program
    paths = [path for path in named_paths(page.read_text("utf-8")) if not path.startswith(made)]
    assert [path for path in paths if not (ROOT / path).exists()] == []


def test_the_questions_have_answers():
    text = (ROOT / "docs" / "design.md").read_text("utf-8")
    table = text.partition("## Where is ...")[2].partition("\n## ")[0]
    rows = [row for row in table.splitlines() if row.startswith("| where")]
    assert len(rows) > 10
    for wanted in ("relative pose", "calibrated", "click becomes `map.cfg`", "robot's batch"):
        assert any(wanted in row for row in rows), wanted
    assert [row for row in rows if not named_paths(row.split("|")[2])] == []
    for heading in ("an extractor", "an import format", "a page"):
        assert f"## To add {heading}\n" in text


def test_a_file_named_there_is_in_the_folder_named_before():
    text = (ROOT / "docs" / "design.md").read_text("utf-8")
    table = text.partition("## Where is ...")[2].partition("\n## ")[0]
    missing = []
    for row in table.splitlines():
        folder = None
        for name in re.findall(r"`([\w./-]+)`", row):
            if named := named_paths(f"`{name}`"):
                path = ROOT / named[0]
                folder = path if path.is_dir() else path.parent
            elif re.fullmatch(r"[\w-]+\.(py|js)", name) and (folder is None or not (folder / name).exists()):
                missing.append(f"{row.split('|')[1].strip()}: {name} is not in {folder}")
    assert missing == []


def test_the_tour_is_short():
    text = (ROOT / "docs" / "design.md").read_text("utf-8")
    tour = text.partition("## A tour")[2].partition("\n## ")[0]
    files = re.findall(r"^\d\. `([^`]+)`", tour, re.M)
    lines = [len((ROOT / file).read_text("utf-8").splitlines()) for file in files]
    assert len(files) == 6
    assert min(lines) >= 60, "a page too short to show anything"
    assert sum(lines) < MOST_LINES


def test_every_layer_has_its_row():
    text = (ROOT / "docs" / "design.md").read_text("utf-8")
    packages = [path.parent for path in (ROOT / "webapp").glob("*/__init__.py")]
    packages += [path.parent for path in (ROOT / "webapp" / "core").glob("*/__init__.py")]
    rows = set(re.findall(r"^\| `([^`]+)/` \|", text, re.M))
    assert {path.relative_to(ROOT).as_posix() for path in packages} - rows == set()
