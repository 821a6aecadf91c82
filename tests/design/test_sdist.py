"""The source distribution is the project: its tests and its documentation can be run and read from it."""

import importlib.util
import sys
import tarfile

import pytest

from tests.design.conftest import run

pytestmark = pytest.mark.skipif(
    importlib.util.find_spec("hatchling") is None,
    reason="hatchling, which builds the archive, is not installed",
)

ELSEWHERE = (".ci/", ".git")
"""What belongs to the place where the project is developed; the archive has one of these: `.gitignore`."""


@pytest.fixture(scope="module")
def names(project, tmp_path_factory):
    """Files in the archive, below its one folder."""
    folder = tmp_path_factory.mktemp("sdist")
    run(sys.executable, "-m", "build", "--sdist", "--no-isolation", "--outdir", folder, project, cwd=folder)
    (built,) = folder.glob("*.tar.gz")
    with tarfile.open(built) as archive:
        return {member.name.partition("/")[2] for member in archive if member.isfile()}


def test_it_holds_the_project(names, tracked, project):
    ours = {path.relative_to(project).as_posix() for path in tracked}
    ours = {name for name in ours if not name.startswith(ELSEWHERE)}
    assert {"Makefile", "constraints.txt", "docs/api.md"} <= ours
    assert ours - names == set(), "name them in pyproject.toml"
    assert names - ours <= {"PKG-INFO", ".gitignore"}
