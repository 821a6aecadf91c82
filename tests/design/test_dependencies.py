"""Imported packages are declared, declared ones are used, and all are pinned in `constraints.txt`."""

import ast
import re
import sys
import tomllib
from importlib.metadata import PackageNotFoundError, packages_distributions, requires

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

from webapp.extras import EXTRAS

SYSTEMS = [
    {"sys_platform": platform, "platform_system": system, "os_name": os_name, "extra": ""}
    for platform, system, os_name in (
        ("linux", "Linux", "posix"), ("darwin", "Darwin", "posix"), ("win32", "Windows", "nt"),
    )
]  # fmt: skip
PYTHONS = [{"python_version": f"3.{minor}", "python_full_version": f"3.{minor}.9"} for minor in range(11, 15)]


COMPLETED_BY = {"psycopg": {"psycopg-binary"}, "moto": {"py-partiql-parser"}}
"""Packages brought by extras of other distributions."""

SHARED = {"opentelemetry": {"opentelemetry-sdk", "opentelemetry-exporter-otlp-proto-http"}}
"""Namespace packages of several distributions: the imported ones, which require the others."""

IN_ALL = {*EXTRAS} - {"cluster", "demo", "telemetry"}


def everywhere(requirement):
    """Return whether a requirement holds on any system and Python that the program runs on."""
    marker = requirement.marker
    return marker is None or any(marker.evaluate({**s, **p}) for s in SYSTEMS for p in PYTHONS)


@pytest.fixture(scope="module")
def declared(project):
    """The project table of pyproject.toml."""
    return tomllib.loads((project / "pyproject.toml").read_text("utf-8"))


@pytest.fixture(scope="module")
def pins(project):
    """The version of each pinned distribution."""
    lines = (project / "constraints.txt").read_text("utf-8").splitlines()
    return {canonicalize_name(name): version for name, version in (line.split("==") for line in lines)}


def names(requirements):
    """Return the canonical names of requirements, without the project itself."""
    return {canonicalize_name(Requirement(text).name) for text in requirements} - {"experience-map"}


def packages_of(imported):
    """Return the canonical names of the distributions of imported modules."""
    providers = packages_distributions()
    tops = {name.split(".")[0] for name in imported} - {*sys.stdlib_module_names, "webapp"}
    shared = {name: SHARED[name] for name in tops & {*SHARED}}
    return {canonicalize_name(d) for name in tops for d in shared.get(name, set(providers[name]))}


def guard_of(block):
    """Return the extra whose import a `with` block guards."""
    match block:
        case ast.With(
            items=[ast.withitem(context_expr=ast.Call(ast.Name("extra"), [ast.Constant(name)])), *_]
        ):
            return name
        case ast.If(test=ast.Name("TYPE_CHECKING")):
            return "types"
    return None


def imports_by_guard(tree):
    """Yield the imported modules, each with the extra that guards it."""

    def visit(node, guard, inside):
        inside = inside or isinstance(node, ast.FunctionDef)
        guard = guard_of(node) or guard
        if isinstance(node, ast.Import):
            yield from ((alias.name, guard, inside) for alias in node.names)
        elif isinstance(node, ast.ImportFrom):
            yield node.module, guard, inside
        for child in ast.iter_child_nodes(node):
            yield from visit(child, guard, inside)

    return visit(tree, None, False)


def test_imports_are_declared_and_used(modules, declared):
    distributions = packages_of(name for module in modules for name in module.imported())
    optional = declared["project"]["optional-dependencies"]
    extras = names(text for name in EXTRAS for text in optional[name])
    wanted = names(declared["project"]["dependencies"])
    assert wanted & extras == set()
    assert distributions - wanted - extras == set(), "imported, but not declared"
    assert (wanted | extras) - distributions == set(), "declared, but not imported"


def test_extras_are_those_that_are_declared(declared):
    optional = declared["project"]["optional-dependencies"]
    assert {*optional} == {*EXTRAS, "all", "ros", "ros-build", "test"}
    assert {Requirement(text).name for text in optional["all"]} == {"experience-map"}
    assert {e for text in optional["all"] for e in Requirement(text).extras} == IN_ALL
    for name, packages in EXTRAS.items():
        assert packages_of(packages) == names(optional[name]), name


def test_packages_of_extras_are_imported_in_guarded_blocks_of_functions_only(modules):
    extra_of = {package: name for name, packages in EXTRAS.items() for package in packages}
    broken = [
        f"{module.name} imports {imported}"
        for module in modules
        for imported, guard, inside in imports_by_guard(module.tree)
        if (wanted := extra_of.get(imported.split(".")[0]))
        and guard != "types"
        and not (guard == wanted and inside)
    ]
    assert broken == []


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
            continue  # not for this system
        todo |= {canonicalize_name(r.name) for r in inner if everywhere(r)} - done
        todo |= COMPLETED_BY.get(name, set()) - done
    assert done - set(pins) == set(), "needed, but not pinned"
    assert set(pins) - done == set(), "pinned, but not needed"


def test_pins_satisfy_what_is_declared(declared, pins):
    extras = [text for group in declared["project"]["optional-dependencies"].values() for text in group]
    for text in [*declared["project"]["dependencies"], *extras, *declared["build-system"]["requires"]]:
        requirement = Requirement(text)
        if requirement.name == "experience-map":
            continue
        assert requirement.specifier.contains(pins[canonicalize_name(requirement.name)]), text
