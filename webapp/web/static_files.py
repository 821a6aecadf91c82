"""Static files: bundled, compressed, and cached permanently by browsers.

Their URLs contain the version of all files, so that they change with the content. The scripts of a page are
bundled into one file, and its style sheets into another. Each module becomes a block with its own scope,
placed after its imports. No parser is needed, as the scripts of pages are simple: imports are named, exports
are declared in place and never reassigned, imports have no cycles, and no line of a string looks like a
comment. Other forms of import and export are rejected. Bare specifiers are libraries, and remain imports.
Comments on lines of their own and indentation are removed, the latter also in multi-line strings (shaders):
together they would be a fifth of the bundle.
"""

from __future__ import annotations

import gzip
import hashlib
import json
import mimetypes
import posixpath
import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path
from typing import Any, cast

from flask import Blueprint, Flask, Response, current_app, g, send_file, send_from_directory, url_for
from markupsafe import Markup
from werkzeug.exceptions import NotFound

from webapp.web.accounts.security import allow_inline_script
from webapp.web.compression import accepts_gzip, is_text
from webapp.web.context import public

_blueprint = Blueprint("static_files", __name__)
_ADDRESS = "/static/<string(length=16):version>"
_IMMUTABLE = "public, max-age=31536000, immutable"
_SUFFIXES = frozenset({".css", ".js", ".png", ".svg"})
_LEFT_OUT = frozenset({"js/sw.js"})

EVERY_SCRIPT = ("shared/shell",)
"""Scripts of every page, relative to `static/js/`."""
_EVERY_SHEET = ("tokens", "base", "controls", "components", "print")
LIBRARIES = {
    "three": "vendor/three/three.module.min.js",
    "three/orbit-controls": "vendor/three/OrbitControls.js",
}
"""Names by which scripts import vendored modules, with the files."""
_MIME = {"js": "text/javascript", "css": "text/css"}
_MOST_KEPT = 100
"""Maximum number of compressed files, and of bundles, in the cache."""
_DAY_S = 86400


def init_app(app: Flask) -> None:
    """Register the routes, and the template functions that return their URLs."""
    app.add_url_rule(f"{_ADDRESS}/<path:filename>", "static", _file)
    app.register_blueprint(_blueprint)
    app.url_defaults(_add_version)
    app.add_template_global(script_bundle)
    app.add_template_global(sheet_bundle)
    app.add_template_global(import_map)


def version() -> str:
    """Return the version of the files, a hash of their contents."""
    return _present().version


def files() -> list[str]:
    """List the files that belong to pages, relative to the folder of static files."""
    return [name for name, _size, _time in _present().facts]


def script_bundle(scripts: Sequence[str] = ()) -> str:
    """Return the URL of the bundle of all scripts of a page.

    Args:
        scripts: Scripts of the page, relative to `static/js/`, without `.js`; those of every page precede
            them.
    """
    return _bundle_address("js", [f"js/{name}" for name in (*EVERY_SCRIPT, *scripts)])


def sheet_bundle(sheets: Sequence[str] = (), *, leaflet: bool = False) -> str:
    """Return the URL of the bundle of all style sheets of a page.

    Args:
        sheets: Sheets of the page, relative to `static/css/`, without `.css`; those of every page precede
            them.
    """
    library = ["vendor/leaflet/leaflet"] if leaflet else []
    common, own = ([f"css/{name}" for name in some] for some in (_EVERY_SHEET, sheets))
    return _bundle_address("css", [*common, *library, *own])


def import_map() -> Markup:
    """Return the import map for a page whose scripts import vendored modules.

    The page may contain it inline: its hash is added to the content security policy of this request.
    """
    addresses = {name: url_for("static", filename=file) for name, file in LIBRARIES.items()}
    text = json.dumps({"imports": addresses})
    allow_inline_script(text)
    return Markup(text)


def _bundle_address(kind: str, names: Sequence[str]) -> str:
    return url_for("static_files.bundle", names=",".join(names), kind=kind)


def _add_version(endpoint: str, values: dict[str, Any]) -> None:
    if endpoint in ("static", "static_files.bundle"):
        values.setdefault("version", version())


@public
def _file(version: str, filename: str) -> Response:
    mime = mimetypes.guess_type(filename)[0]
    if filename not in files() or not is_text(mime) or not accepts_gzip():
        return _kept(send_from_directory(_present().folder, filename), version)
    return _gzipped(_compressed_file(_present(), filename), mime, version)


@_blueprint.get(f"{_ADDRESS}/bundles/<path:names>.<kind>")
@public
def bundle(version: str, names: str, kind: str) -> Response:
    """Send a bundle of scripts or style sheets."""
    wanted = tuple(f"{name}.{kind}" for name in names.split(","))
    if kind not in _MIME or not set(wanted) <= set(files()):
        raise NotFound
    base = url_for("static", filename="")
    if accepts_gzip():
        return _gzipped(_compressed_bundle(_present(), wanted, base=base), _MIME[kind], version)
    return _kept(Response(_made_bundle(_present(), wanted, base=base), mimetype=_MIME[kind]), version)


@_blueprint.get("/favicon.ico")
@public
def favicon() -> Response:
    """Send the icon at the traditional path, which some clients request."""
    return send_file(_present().folder / "img" / "icon-192.png", max_age=_DAY_S)


def _gzipped(data: bytes, mime: str | None, of: str) -> Response:
    response = Response(data, mimetype=mime, headers={"Content-Encoding": "gzip"})
    return _kept(response, of)


def _kept(response: Response, of: str) -> Response:
    """Allow permanent caching under the current version only; under an old one the content may differ."""
    response.vary.add("Accept-Encoding")
    response.headers["Cache-Control"] = _IMMUTABLE if of == version() else "no-cache"
    return response


@dataclass(frozen=True, slots=True)
class _Present:
    """The current files; the content is read again only if a name, size or modification time has changed."""

    folder: Path
    facts: tuple[tuple[str, int, int], ...]
    version: str


def _present() -> _Present:
    """Return the current files, which are scanned once per request."""
    if "static_files" not in g:
        assert current_app.static_folder is not None, "make_app always gives one"
        folder = Path(current_app.static_folder)
        facts = _facts(folder)
        g.static_files = _Present(folder, facts, _hashed(folder, facts))
    return cast(_Present, g.static_files)


def _facts(folder: Path) -> tuple[tuple[str, int, int], ...]:
    found = []
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.suffix in _SUFFIXES and name not in _LEFT_OUT:
            stat = path.stat()
            found.append((name, stat.st_size, stat.st_mtime_ns))
    return tuple(found)


@lru_cache(maxsize=4)
def _hashed(folder: Path, facts: tuple[tuple[str, int, int], ...]) -> str:
    total = hashlib.sha256()
    for name, _size, _time in facts:
        total.update(name.encode() + b"\0" + hashlib.sha256((folder / name).read_bytes()).digest())
    return total.hexdigest()[:16]


@lru_cache(maxsize=_MOST_KEPT)
def _compressed_file(present: _Present, name: str) -> bytes:
    return gzip.compress((present.folder / name).read_bytes(), mtime=0)


@lru_cache(maxsize=_MOST_KEPT)
def _compressed_bundle(present: _Present, names: tuple[str, ...], *, base: str) -> bytes:
    return gzip.compress(_made_bundle(present, names, base=base).encode(), mtime=0)


def _made_bundle(present: _Present, names: tuple[str, ...], *, base: str) -> str:
    if names[0].endswith(".js"):
        return bundle_scripts(present.folder, names)
    return bundle_sheets(present.folder, names, base=base)


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
