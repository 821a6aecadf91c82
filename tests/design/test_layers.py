"""Imports follow the arrows of docs/design.md; each layer does only its own tasks."""

import ast
from collections import defaultdict

import pytest

BELOW = {
    "core": set(),
    "files": {"core"},
    "store": {"core"},
    "net": {"core"},
    "tasks": {"store", "files", "net"},
    "render": {"tasks"},
    "jobs": {"render"},
    "cli": {"jobs"},
    "web": {"jobs"},
}
"""Each layer and those directly below it; layers below these may be imported, too."""

SUBPACKAGES = {"missions", "sample"}
"""Subpackages with separate layers, imported only by `app`."""

SAMPLE = {"scene": "core", "content": "tasks", "make": "tasks", "job": "jobs", "cli": "cli", "": "tasks"}
"""Layers of the modules of the sample, which is too small for folders."""

COMMON = {"", "errors", "extras", "importing", "logs", "progress", "settings", "telemetry", "threads"}
"""May be imported by all ("" is the version)."""

ALONE = {
    "": set(),
    "configuration": {"errors", "settings"},
    "errors": set(),
    "extras": {"errors"},
    "progress": {"errors"},
    "settings": {"errors"},
    "importing": set(),
    "logs": {"telemetry"},
    "telemetry": {"", "extras"},
    "threads": {"errors"},
    "resources": {"errors"},
    "api": {"core", "files", "tasks", "render", "configuration", "errors", "progress", "settings"},
    "robot": {"errors", "robot"},
    "__main__": {"app"},
}

NOT_IN_CORE = {
    "flask", "apiflask", "sqlalchemy", "click", "jinja2", "requests", "rasterio", "PIL", "pillow_heif",
    "os", "sys", "io", "logging", "pathlib", "shutil", "socket", "subprocess", "tempfile", "threading",
    "urllib",
}  # fmt: skip


SMALL = 50
"""Largest number of lines of a small module."""


def reachable(layer):
    """Return the layer and all below it."""
    return {layer}.union(*(reachable(below) for below in BELOW[layer]))


def place_of(name):
    """Return subpackage and layer of an imported name; None for other packages."""
    parts = name.split(".")
    if parts[0] != "webapp":
        return None
    first, second = [*parts[1:], "", ""][:2]
    if first == "missions":
        return first, second if second in BELOW else "core"
    if first == "sample":
        return first, SAMPLE.get(second, "tasks")
    if first == "connect":
        return first, "" if second[:1].isupper() else second
    return "", first if first in {*BELOW, *ALONE, "app"} else ""


def allowed(subpackage, layer):
    """Return the subpackages and layers that modules of a layer may import from."""
    if layer == "app":
        return None
    if subpackage == "connect":
        below = reachable("cli") | reachable("web") | COMMON | {"robot"}
        return {("connect", ""), ("connect", layer)} | {(p, n) for n in below for p in ("", "missions")}
    if layer in ALONE:
        return {("", name) for name in ALONE[layer]}
    extras = COMMON | ({"resources"} if layer in ("render", "jobs", "cli", "web") else set())
    extras |= {"configuration"} if layer in ("jobs", "cli") else set()
    extras |= {"robot"} if layer == "cli" else set()
    found = {("", name) for name in reachable(layer) | extras}
    return found | ({(subpackage, name) for name in reachable(layer)} if subpackage else set())


FIELDS = "webapp.robot.fields"
"""The only module of the robots' client that the server may import, for missions: the fields of a record."""


def test_every_module_belongs_to_a_layer(modules):
    for module in modules:
        subpackage, layer = place_of(module.name)
        assert layer in {*BELOW, *ALONE, "app"} or subpackage == "connect", module.name
        if subpackage == "missions" and module.name != "webapp.missions":
            assert module.name.split(".")[2] in BELOW, module.name


def test_imports_follow_the_arrows(modules):
    broken = [
        f"{module.name} imports {name}"
        for module in modules
        if (may := allowed(*place_of(module.name))) is not None
        for name in module.imported()
        if name != "webapp" and (place := place_of(name)) is not None and place not in may
        if not (module.name.startswith("webapp.missions.") and f"{name}.".startswith(f"{FIELDS}."))
    ]
    assert broken == []


@pytest.mark.parametrize(
    ("layer", "other"),
    [
        ("cli", "web"),
        ("web", "cli"),
        ("web", "app"),
        ("core", "files"),
        ("files", "tasks"),
        ("files", "net"),
        ("robot", "core"),
    ],
)
def test_the_arrows_are_those_of_the_design(layer, other):
    assert ("", other) not in allowed("", layer)


@pytest.mark.parametrize("subpackage", sorted(SUBPACKAGES))
@pytest.mark.parametrize("layer", [*BELOW, "errors", "settings", "robot"])
def test_nothing_but_the_application_imports_a_subpackage(subpackage, layer):
    others = SUBPACKAGES - {subpackage}
    assert all(place[0] != subpackage for place in allowed("", layer))
    assert all(place[0] != subpackage for other in others for place in allowed(other, "tasks"))


def test_nothing_imports_a_connection(modules):
    """The application finds the folders itself, so that each can be removed."""
    importing = [
        f"{module.name} imports {name}"
        for module in modules
        for name in module.imported()
        if name.startswith("webapp.connect.") and place_of(name) != place_of(module.name)
        if name not in ("webapp.connect.Registration", "webapp.connect.connections")
    ]
    assert importing == []


def test_packages_of_core_have_an_order(modules):
    """The packages of `core` have no circular imports, also not through others."""
    imports = defaultdict(set)
    for module in modules:
        if module.layer == "core":
            own = ".".join(module.name.split(".")[:3])
            found = {
                ".".join(name.split(".")[:3]) for name in module.imported() if name.startswith("webapp.core.")
            }
            imports[own] |= found - {own}
    left = {package: set(below) for package, below in imports.items()}
    while done := {package for package, below in left.items() if not below & left.keys()}:
        left = {package: below for package, below in left.items() if package not in done}
    assert left == {}, "these import each other"


def test_a_small_module_has_several_users_or_one_of_another_layer(modules):
    """A small module used by only one other module should be part of that module."""
    names = {module.name for module in modules if module.path.name != "__init__.py"}
    users = defaultdict(set)
    for module in modules:
        for name in names.intersection(module.imported()) - {module.name}:
            users[name].add(module.name)
    broken = [
        f"{module.name} <- {user}"
        for module in modules
        if len(users[module.name]) == 1 and len(module.text.splitlines()) < SMALL
        for user in users[module.name]
        if place_of(user) == place_of(module.name)
    ]
    assert broken == []


def test_the_fields_of_a_record_need_nothing(modules):
    (fields,) = [module for module in modules if module.name == FIELDS]
    assert {name for name in fields.imported() if place_of(name) is not None} == set()


def test_core_is_arrays_and_values(modules):
    broken = [
        f"{module.name} imports {name}"
        for module in modules
        if module.layer == "core"
        for name in module.imported()
        # pure paths are values, which never touch a disk
        if name.split(".")[0] in NOT_IN_CORE and name not in ("pathlib", "pathlib.PurePosixPath")
    ]
    assert broken == []


def test_core_opens_and_prints_nothing(modules):
    forbidden = {"open", "print", "input", "exec", "eval", "breakpoint"}
    on_disk = {
        "imread", "imwrite", "read_bytes", "write_bytes", "read_text", "write_text", "tofile", "fromfile",
        "memmap", "savez", "loadtxt", "savetxt", "write_index", "read_index",
    }  # fmt: skip
    broken = []
    for module in modules:
        if module.layer == "core":
            for node in ast.walk(module.tree):
                if isinstance(node, ast.Name) and node.id in forbidden:
                    broken.append(f"{module.path}:{node.lineno}: {node.id}")
                if isinstance(node, ast.Attribute) and node.attr in on_disk | {"environ", "getenv"}:
                    broken.append(f"{module.path}:{node.lineno}: {node.attr}")
    assert broken == []


def test_only_the_command_line_writes_to_the_terminal(modules):
    broken = []
    for module in modules:
        if place_of(module.name)[1] not in ("cli", "robot", "app"):
            for node in ast.walk(module.tree):
                if isinstance(node, ast.Name) and node.id == "print":
                    broken.append(f"{module.path}:{node.lineno}: print")
                if isinstance(node, ast.Attribute) and node.attr in ("stdout", "stderr"):
                    broken.append(f"{module.path}:{node.lineno}: {node.attr}")
    assert broken == []


def test_only_settings_reads_the_environment(modules):
    readers = {"environ", "environb", "getenv", "getenvb", "expandvars"}
    broken = []
    for module in modules:
        if module.name in ("webapp.configuration", "webapp.settings"):
            continue
        for node in ast.walk(module.tree):
            by_attribute = (
                isinstance(node, ast.Attribute)
                and node.attr in readers
                and not (
                    isinstance(node.value, ast.Name) and node.value.id == "request"
                )  # that of WSGI, not of the system
            )
            by_import = isinstance(node, ast.ImportFrom) and {a.name for a in node.names} & readers
            by_click = isinstance(node, ast.keyword) and node.arg in ("envvar", "auto_envvar_prefix")
            if by_attribute or by_import or by_click:
                broken.append(f"{module.path}:{node.lineno}")
    assert broken == []
