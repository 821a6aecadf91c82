"""The documentation site builds without a warning, lists every page, and loads nothing from another host."""

import re
import subprocess
import sys
from html.parser import HTMLParser

import pytest
import yaml

from docs.site_hooks import OUTSIDE
from tests.design.conftest import ROOT

LOADS = {("script", "src"), ("img", "src"), ("iframe", "src"), ("source", "src"), ("link", "href")}
MOST_WORDS = 1200
"""Limit of a guide."""

MOST_WORDS_IN_ALL = 70_000

HARMLESS = {"canonical", "alternate", "next", "prev"}


class Loaded(HTMLParser):
    """Collects the resources that a page loads."""

    def __init__(self):
        super().__init__()
        self.addresses = []

    def handle_starttag(self, tag, attrs):
        given = dict(attrs)
        for name, value in given.items():
            if (tag, name) in LOADS and given.get("rel") not in HARMLESS:
                self.addresses.append(value)


@pytest.fixture(scope="module")
def site(tmp_path_factory):
    folder = tmp_path_factory.mktemp("site")
    words = ["build", "--strict", "--quiet", "--config-file", ROOT / ".mkdocs.yml", "--site-dir", folder]
    command = [sys.executable, "-m", "mkdocs", *words]
    done = subprocess.run(command, cwd=ROOT, capture_output=True, text=True, timeout=300)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder


def listed(entries):
    """Return the pages of the navigation."""
    for entry in entries:
        for value in entry.values():
            yield from listed(value) if isinstance(value, list) else [value]


def test_every_page_is_in_the_navigation():
    config = yaml.safe_load((ROOT / ".mkdocs.yml").read_text("utf-8"))
    pages = {path.name for path in (ROOT / "docs").glob("*.md")}
    pages |= {target for target in OUTSIDE.values() if target.endswith(".md")}
    found = list(listed(config["nav"]))
    assert sorted(found) == sorted(pages)


def test_guides_are_short():
    """A reader of a guide wants to do one thing. Pages to look something up in may be longer."""
    config = yaml.safe_load((ROOT / ".mkdocs.yml").read_text("utf-8"))
    pages = {part: list(listed(value)) for one in config["nav"][1:] for part, value in one.items()}
    guides = {page for part in ("Maps", "Robots", "Operating") for page in pages[part]} | {"localization.md"}
    words = {page: len((ROOT / "docs" / page).read_text("utf-8").split()) for page in guides}
    assert {page: n for page, n in words.items() if n > MOST_WORDS} == {}


def test_all_pages_together_can_be_read(project_pages):
    """A fact stands in one place, and other pages link to it."""
    texts = [text for _, text in project_pages] + [(ROOT / "README.md").read_text("utf-8")]
    assert sum(len(text.split()) for text in texts) < MOST_WORDS_IN_ALL


def test_pages_load_nothing_from_another_host(site):
    pages = list(site.rglob("*.html"))
    assert len(pages) > 20
    for page in pages:
        parser = Loaded()
        parser.feed(page.read_text("utf-8"))
        assert parser.addresses
        assert [a for a in parser.addresses if re.match(r"(https?:)?//", a)] == [], page.name
    for style in site.rglob("*.css"):
        foreign = re.findall(r"url\(['\"]?(?:https?:)?//[^)]*", style.read_text("utf-8"))
        assert foreign == [], style.name


def test_no_page_needs_a_script_from_another_host(project_pages):
    """The theme's scripts fetch libraries for diagrams and formulas if a page has any."""
    assert [path.name for path, text in project_pages if re.search(r"^```mermaid|^\$\$", text, re.M)] == []


@pytest.fixture
def project_pages():
    return [(path, path.read_text("utf-8")) for path in (ROOT / "docs").glob("*.md")]


def test_pages_from_outside_the_folder_are_there(site):
    index = (site / "index.html").read_text("utf-8")
    assert 'href="first-map.html"' in index and 'href="FORMAT.html"' in index
    assert "pictures/localize.jpg" in index
    assert (site / "LICENSE").is_file() and (site / "CHANGELOG.html").is_file()
    assert not list(site.rglob("*.py"))
