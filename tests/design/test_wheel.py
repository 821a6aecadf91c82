"""The wheel, installed elsewhere, is complete."""

import importlib.util
import os
import sys
import sysconfig
import venv
import zipfile
from pathlib import Path

import pytest
from packaging.metadata import Metadata

from tests.design.conftest import run
from webapp.app.main import root

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        importlib.util.find_spec("hatchling") is None,
        reason="hatchling, which builds the wheel, is not installed",
    ),
]

REPORT = """
from webapp.resources import resource_folder
from jinja2 import Environment, FileSystemLoader, StrictUndefined
import webapp
pages = Environment(loader=FileSystemLoader(resource_folder("templates")), undefined=StrictUndefined)
print(webapp.__file__)
print(resource_folder("templates"))
print(resource_folder("static"))
print(resource_folder("docs"))
print(len(pages.get_template("localize/_report_style.css").render()))
"""

COMMANDS = """
import click
from webapp.app.main import root

def load(group):
    return [group.get_command(click.Context(group), name) for name in group.list_commands(None)]

for command in load(root):
    print(command.name)
    if isinstance(command, click.Group):
        load(command)
"""
"""Script that loads every command, which listing them does not."""


@pytest.fixture(scope="module")
def installed(wheel, tmp_path_factory):
    """The scripts folder of a new environment with only the wheel; libraries come from this one."""
    folder = tmp_path_factory.mktemp("fresh")
    venv.create(folder / "env", with_pip=False)
    scripts = folder / "env" / ("Scripts" if os.name == "nt" else "bin")
    ask = "import sysconfig; print(sysconfig.get_path('purelib'))"
    site = Path(run(scripts / "python", "-c", ask, cwd=folder).strip())
    command = [sys.executable, "-m", "pip", "--python", scripts / "python", "install", "--quiet", "--no-deps"]
    run(*command, "--no-index", "--disable-pip-version-check", wheel, cwd=folder)
    # after the environment's own folder, so that the wheel takes precedence over an editable install
    borrowed = {sysconfig.get_path("purelib"), sysconfig.get_path("platlib")}
    (site / "borrowed.pth").write_text("\n".join(sorted(borrowed)) + "\n")
    return scripts


def test_the_command_runs(installed, tmp_path):
    assert run(installed / "expmap", "--version", cwd=tmp_path).startswith("expmap ")
    assert run(installed / "python", "-m", "webapp", "--version", cwd=tmp_path).startswith("expmap ")
    assert "localize" in run(installed / "expmap", "--help", cwd=tmp_path)
    assert run(installed / "python", "-c", COMMANDS, cwd=tmp_path).split() == [*root.list_commands(None)]


def test_templates_static_files_and_the_manual_are_inside(installed, tmp_path):
    package, templates, static, docs, style = run(installed / "python", "-c", REPORT, cwd=tmp_path).split()
    inside = Path(package).parent
    assert installed.parent in inside.parents
    found = [Path(folder) for folder in (templates, static, docs)]
    assert found == [inside / "templates", inside / "static", inside / "docs"]
    assert int(style) > 100


def test_the_library_is_not_in_the_package(installed, tmp_path):
    printed = run(installed / "expmap", "sample", "--help", cwd=tmp_path)
    assert "[default: EXPMAP_LIBRARY, or maps]" in " ".join(printed.split())
    run(installed / "expmap", "map", "check", "--help", cwd=tmp_path)
    assert list(tmp_path.iterdir()) == []


def test_the_wheel_holds_the_program_and_nothing_else(wheel, modules, project):
    names = set(zipfile.ZipFile(wheel).namelist())
    program = {m.path.relative_to(project).as_posix() for m in modules}
    pages = {
        f"webapp/{path.relative_to(project).as_posix()}"
        for folder in ("templates", "static", "docs")
        for path in (project / folder).rglob("*")
        if path.is_file() and not (folder == "docs" and path.suffix in (".py", ".pyc"))
    }
    translations = (project / "webapp/web/translations").rglob("*.?o")
    pages |= {path.relative_to(project).as_posix() for path in translations} | {"webapp/py.typed"}
    rest = {name for name in names - program - pages if ".dist-info/" not in name}
    assert program | pages <= names
    assert rest == set()


def test_a_package_index_accepts_its_metadata(wheel):
    with zipfile.ZipFile(wheel) as archive:
        (name,) = (n for n in archive.namelist() if n.endswith(".dist-info/METADATA"))
        found = Metadata.from_email(archive.read(name), validate=True)
    assert (found.name, found.license_expression, found.description_content_type) == (
        "experience-map",
        "MIT",
        "text/markdown",
    )
    assert "Framework :: Flask" in found.classifiers
    assert {"learned", "missions", "sfm", "connect", "all"} <= set(found.provides_extra)


def test_built_again_elsewhere_and_later_it_is_the_same_byte_for_byte(wheel, project, tracked, tmp_path):
    for path in tracked:
        copy = tmp_path / "elsewhere" / path.relative_to(project)
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.write_bytes(path.read_bytes())
    options = ["--wheel", "--no-isolation", "--outdir", tmp_path / "dist"]
    run(sys.executable, "-m", "build", *options, tmp_path / "elsewhere", cwd=tmp_path)
    (again,) = (tmp_path / "dist").glob("*.whl")
    assert again.name == wheel.name
    assert again.read_bytes() == wheel.read_bytes()
