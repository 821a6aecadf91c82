"""The source distribution contains the whole project with its tests and documentation."""

import importlib.util
import sys
import tarfile

import pytest

from tests.design.conftest import run

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(
        importlib.util.find_spec("hatchling") is None,
        reason="hatchling, which builds the archive, is not installed",
    ),
]

ELSEWHERE = (".ci/", ".git")
"""Files of the repository that are not part of the archive, except `.gitignore`."""


@pytest.fixture(scope="module")
def names(project, tmp_path_factory):
    """The files in the archive, below its top folder."""
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
