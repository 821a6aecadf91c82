"""The files that every page is made of, and their version: what a browser keeps to work without a network."""

from __future__ import annotations

import hashlib
from functools import lru_cache
from pathlib import Path

from flask import Flask, Response, current_app, url_for

VERSION_HEADER = "Expmap-Shell"
"""On each page: by it the service worker knows whether the files that it keeps are those of the page."""

_SUFFIXES = frozenset({".css", ".js", ".png", ".svg"})
_LEFT_OUT = frozenset({"js/sw.js"})

_Facts = tuple[tuple[str, int, int], ...]


def init_app(app: Flask) -> None:
    """Have every page say of which version it is."""
    app.after_request(_add_version)


def version() -> str:
    """Give the version of the files: another content has another one."""
    folder = _folder()
    return _hashed(folder, _facts(folder))


def addresses() -> list[str]:
    """List the addresses of the files."""
    return [url_for("static", filename=name) for name, _size, _time in _facts(_folder())]


def _folder() -> Path:
    folder = current_app.static_folder
    assert folder is not None, "create_app always gives one"
    return Path(folder)


def _facts(folder: Path) -> _Facts:
    """Tell name, size and time of each file: whether the content has to be read again."""
    found = []
    for path in sorted(folder.rglob("*")):
        name = path.relative_to(folder).as_posix()
        if path.suffix in _SUFFIXES and name not in _LEFT_OUT:
            stat = path.stat()
            found.append((name, stat.st_size, stat.st_mtime_ns))
    return tuple(found)


@lru_cache(maxsize=4)
def _hashed(folder: Path, facts: _Facts) -> str:
    total = hashlib.sha256()
    for name, _size, _time in facts:
        total.update(name.encode() + b"\0" + hashlib.sha256((folder / name).read_bytes()).digest())
    return total.hexdigest()[:16]


def _add_version(response: Response) -> Response:
    if response.mimetype == "text/html":
        response.headers[VERSION_HEADER] = version()
    return response
