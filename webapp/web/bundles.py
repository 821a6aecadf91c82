"""Bundling of several scripts or style sheets into one file.

Each module becomes a block with its own scope, placed after its imports. No parser is needed, as the scripts
of pages are simple: imports are named, exports are declared in place and never reassigned, imports have no
cycles, and no line of a string looks like a comment. Other forms of import and export are rejected. Bare
specifiers are libraries, and remain imports. Comments on lines of their own and indentation are removed, the
latter also in multi-line strings (shaders): together they would be a fifth of the bundle.
"""

from __future__ import annotations

import posixpath
import re
from collections.abc import Iterable, Iterator
from pathlib import Path

_IMPORT = re.compile(r'^import\s+(?:\{([^}]*)\}\s+from\s+)?"(\.[^"]+)";', re.M)
_LIBRARY = re.compile(r'^import\s+\{([^}]*)\}\s+from\s+"([a-z][\w/-]*)";', re.M)
_EXPORT = re.compile(r"^export (?=(?:async )?(?:function\*?|class|const) (\w+))", re.M)
_OTHER = re.compile(r"^(?:import|export)\b.*|^(?!\s*(?:/?\*|//)).*\bimport(?:\(|\.meta).*", re.M)
"""Unsupported imports and exports; `import(...)` in comments, which names types, is allowed."""
_COMMENT = re.compile(r"^[ \t]*(?:/\*(?:[^*]|\*(?!/))*\*/|//.*)[ \t]*\n", re.M)
_INDENTATION = re.compile(r"^[ \t]+", re.M)
_SHEET_COMMENT = re.compile(r"^[ \t]*/\*(?:[^*]|\*(?!/))*\*/[ \t]*\n", re.M)
_URL = re.compile(r"url\((?!#|data:|/)([^)]+)\)")


def bundle_scripts(folder: Path, names: Iterable[str]) -> str:
    """Bundle modules and all their imports into one module, in the order of their execution.

    Args:
        folder: Folder of the static files.
        names: Paths of modules relative to it.

    Raises:
        ValueError: A module has an unsupported import or export.
    """
    order: list[str] = []
    sources: dict[str, str] = {}
    for name in names:
        _collect(folder, name, sources=sources, order=order)
    scopes = {name: f"$${number}" for number, name in enumerate(order)}
    libraries = sorted({library for source in sources.values() for _, library in _LIBRARY.findall(source)})
    imports = [f'import * as $lib{number} from "{name}";\n' for number, name in enumerate(libraries)]
    bound = scopes | {name: f"$lib{number}" for number, name in enumerate(libraries)}
    return "".join([*imports, *(_as_block(name, sources[name], bound) for name in order)])


def bundle_sheets(folder: Path, names: Iterable[str], *, base: str) -> str:
    """Bundle style sheets into one.

    Args:
        folder: Folder of the static files.
        names: Paths of style sheets relative to it.
        base: URL of that folder, for the images that they refer to.
    """
    return "".join(_with_addresses(name, (folder / name).read_text("utf-8"), base) for name in names)


def shortened(source: str) -> str:
    """Remove the indentation of a script, and the comments on lines of their own."""
    return _INDENTATION.sub("", _COMMENT.sub("", source))


def _collect(folder: Path, name: str, *, sources: dict[str, str], order: list[str]) -> None:
    """Read a module and, recursively, its imports, which precede it in `order`."""
    if name in sources:
        return
    sources[name] = (folder / name).read_text("utf-8")
    for imported in _imported(name, sources[name]):
        _collect(folder, imported, sources=sources, order=order)
    order.append(name)


def _imported(name: str, source: str) -> Iterator[str]:
    for _names, target in _IMPORT.findall(source):
        yield _module(name, target)


def _module(name: str, target: str) -> str:
    return posixpath.normpath(posixpath.join(posixpath.dirname(name), target))


def _as_block(name: str, source: str, scopes: dict[str, str]) -> str:
    def bind(found: re.Match[str]) -> str:
        names, target = found.groups()
        if names is None:
            return ""
        return _bound(names, scopes[_module(name, target)])

    def bind_library(found: re.Match[str]) -> str:
        return _bound(found[1], scopes[found[2]])

    exported = _EXPORT.findall(source)
    body = _EXPORT.sub("", _IMPORT.sub(bind, _LIBRARY.sub(bind_library, source)))
    if other := _OTHER.search(body):
        raise ValueError(f"{name}: {other[0]!r} cannot be bundled")
    body = shortened(body)
    kept = f"{scopes[name]} = {{ {', '.join(exported)} }};\n" if exported else ""
    return f"// {name}\nlet {scopes[name]};\n{{\n{body}\n{kept}}}\n"


def _bound(names: str, scope: str) -> str:
    bound = ", ".join(part.strip().replace(" as ", ": ") for part in names.split(",") if part.strip())
    return f"const {{ {bound} }} = {scope};"


def _with_addresses(name: str, source: str, base: str) -> str:
    def absolute(found: re.Match[str]) -> str:
        return f"url({base}{_module(name, found[1])})"

    source = _INDENTATION.sub("", _SHEET_COMMENT.sub("", source))
    return f"{_URL.sub(absolute, source)}\n"
