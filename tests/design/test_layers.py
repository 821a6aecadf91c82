"""Imports follow the arrows of docs/design.md; each layer does only what is its own."""

import ast

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
"""Each layer and those right below it; what is below those may be imported too."""

COMMON = {"", "errors", "extras", "progress", "settings", "threads"}
"""For everyone ("" is the version)."""

ALONE = {
    "": set(),
    "errors": set(),
    "extras": {"errors"},
    "progress": {"errors"},
    "settings": {"errors"},
    "threads": set(),
    "resources": {"errors"},
    "robot": {"errors", "robot"},
    "__main__": {"cli"},
}

NOT_IN_CORE = {
    "flask", "apiflask", "sqlalchemy", "click", "jinja2", "requests", "rasterio", "PIL", "pillow_heif",
    "os", "sys", "io", "logging", "pathlib", "shutil", "socket", "subprocess", "tempfile", "threading",
    "urllib",
}  # fmt: skip


def reachable(layer):
    """The layer itself and all below it."""
    return {layer}.union(*(reachable(below) for below in BELOW[layer]))


def allowed(layer):
    """Layers that a layer may import from."""
    if layer in ALONE:
        return ALONE[layer]
    resources = {"resources"} if layer in ("render", "jobs", "cli", "web") else set()
    robot = {"robot"} if layer == "cli" else set()
    return reachable(layer) | COMMON | resources | robot


def layer_of(name):
    """The layer of an imported name, None for one that is not ours."""
    parts = name.split(".")
    if parts[0] != "webapp":
        return None
    return parts[1] if len(parts) > 1 and parts[1] in {*BELOW, *ALONE} else ""


def test_every_module_belongs_to_a_layer(modules):
    assert {module.layer for module in modules} <= {*BELOW, *ALONE}


def test_imports_follow_the_arrows(modules):
    broken = [
        f"{module.name} imports {name}"
        for module in modules
        for name in module.imported()
        if (layer := layer_of(name)) is not None
        and layer not in allowed(module.layer)
        and not (layer == "" and name == "webapp")
    ]
    assert broken == []


@pytest.mark.parametrize(
    ("layer", "other"),
    [
        ("cli", "web"),
        ("web", "cli"),
        ("core", "files"),
        ("files", "tasks"),
        ("files", "net"),
        ("robot", "core"),
    ],
)
def test_the_arrows_are_those_of_the_design(layer, other):
    assert other not in allowed(layer)


def test_core_is_arrays_and_values(modules):
    broken = [
        f"{module.name} imports {name}"
        for module in modules
        if module.layer == "core"
        for name in module.imported()
        # Paths that never touch a disk are values.
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
        if module.layer not in ("cli", "robot"):
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
        if module.name == "webapp.settings":
            continue
        for node in ast.walk(module.tree):
            by_attribute = (
                isinstance(node, ast.Attribute)
                and node.attr in readers
                and not (
                    isinstance(node.value, ast.Name) and node.value.id == "request"
                )  # WSGI's, not the system's
            )
            by_import = isinstance(node, ast.ImportFrom) and {a.name for a in node.names} & readers
            by_click = isinstance(node, ast.keyword) and node.arg in ("envvar", "auto_envvar_prefix")
            if by_attribute or by_import or by_click:
                broken.append(f"{module.path}:{node.lineno}")
    assert broken == []
