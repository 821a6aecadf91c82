"""What is imported is declared, what is declared is used, and everything is pinned for those who want it."""

import re
import sys
import tomllib
from importlib.metadata import PackageNotFoundError, packages_distributions, requires

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

SYSTEMS = [
    {"sys_platform": platform, "platform_system": system, "os_name": os_name, "extra": ""}
    for platform, system, os_name in (
        ("linux", "Linux", "posix"), ("darwin", "Darwin", "posix"), ("win32", "Windows", "nt"),
    )
]  # fmt: skip
PYTHONS = [{"python_version": f"3.{minor}", "python_full_version": f"3.{minor}.9"} for minor in range(11, 15)]


def everywhere(requirement):
    """Tell whether a requirement holds on any system and Python that the program runs on."""
    marker = requirement.marker
    return marker is None or any(marker.evaluate({**s, **p}) for s in SYSTEMS for p in PYTHONS)


@pytest.fixture(scope="module")
def declared(project):
    """The project's table in pyproject.toml."""
    return tomllib.loads((project / "pyproject.toml").read_text("utf-8"))


@pytest.fixture(scope="module")
def pins(project):
    """Version of each pinned distribution."""
    lines = (project / "constraints.txt").read_text("utf-8").splitlines()
    return {canonicalize_name(name): version for name, version in (line.split("==") for line in lines)}


def names(requirements):
    """Canonical names of requirements."""
    return {canonicalize_name(Requirement(text).name) for text in requirements}


def test_imports_are_declared_and_used(modules, declared):
    ours = {*sys.stdlib_module_names, "webapp"}
    imported = {name.split(".")[0] for module in modules for name in module.imported()} - ours
    providers = packages_distributions()
    distributions = {canonicalize_name(d) for name in imported for d in set(providers[name])}
    wanted = names(declared["project"]["dependencies"])
    assert distributions - wanted == set(), "imported, but not declared"
    assert wanted - distributions == set(), "declared, but not imported"


def test_constraints_are_exact_versions_only(project):
    for line in (project / "constraints.txt").read_text("utf-8").splitlines():
        assert re.fullmatch(r"[A-Za-z0-9._-]+==[0-9][A-Za-z0-9.]*", line), line


def test_every_part_is_pinned(declared, pins):
    extras = [text for group in declared["project"]["optional-dependencies"].values() for text in group]
    todo = names([*declared["project"]["dependencies"], *extras, *declared["build-system"]["requires"]])
    done = set()
    while todo:
        name = todo.pop()
        done.add(name)
        try:
            inner = [Requirement(text) for text in requires(name) or []]
        except PackageNotFoundError:
            continue  # only on another system
        todo |= {canonicalize_name(r.name) for r in inner if everywhere(r)} - done
    assert done - set(pins) == set(), "needed, but not pinned"
    assert set(pins) - done == set(), "pinned, but not needed"


def test_pins_satisfy_what_is_declared(declared, pins):
    extras = [text for group in declared["project"]["optional-dependencies"].values() for text in group]
    for text in [*declared["project"]["dependencies"], *extras, *declared["build-system"]["requires"]]:
        requirement = Requirement(text)
        assert requirement.specifier.contains(pins[canonicalize_name(requirement.name)]), text
