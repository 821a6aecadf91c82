"""Prints statistics of the source: files, lines, folders, imports and docstrings.

    python benchmarks/structure.py [CHECKOUT] [--package webapp] [--json OUT]

CHECKOUT is the root of a working copy, by default that of this script, so that two versions can be compared.
Only the source is read: nothing is imported, and nothing has to be installed.

- Each line is of one kind: code, import, docstring, comment or blank. A line with code and a comment is code;
  a blank line inside a docstring is a docstring line.
- "one importer": modules that exactly one other module of the package imports, at any place. Packages
  (`__init__.py`) are not counted, as they are imported with their modules.
- "folder": Python files directly in one folder.
"""

from __future__ import annotations

import argparse
import ast
import io
import json
import re
import statistics
import tokenize
from collections import Counter, defaultdict
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Any

KINDS = ("code", "import", "docstring", "comment", "blank")
SHOWN_FOLDERS = 5

_NO_TEXT = {
    tokenize.NL, tokenize.NEWLINE, tokenize.INDENT, tokenize.DEDENT, tokenize.ENCODING, tokenize.ENDMARKER,
}  # fmt: skip
_PARAMETER = re.compile(r"\*{0,2}\w+(, \*{0,2}\w+)*( :.*)?$")


@dataclass(frozen=True, slots=True)
class Source:
    """A module as text and syntax tree.

    Attributes:
    ----------
    path : Path
        Relative to the checkout.
    """

    path: Path
    text: str
    tree: ast.Module

    @property
    def name(self) -> str:
        """The module's dotted name."""
        parts = self.path.with_suffix("").parts
        return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@dataclass(frozen=True, slots=True)
class Structure:
    """The counts of one package.

    Attributes:
    ----------
    lines : dict of str to int
        Number of lines by kind, one of `KINDS`.
    median_lines : float
        Median length of the files.
    longest : tuple of str and int
        The longest file and its number of lines.
    one_importer : list of str
        Modules that exactly one other imports.
    most_alone : tuple of str and int
        The module that is the only importer of most others, such as a table of views, and their number.
    no_importer : list of str
        Modules that no other imports: entry points, and unused ones.
    folders : list of tuple of str and int
        Folders and the number of Python files directly in them, the largest first.
    """

    files: int
    lines: dict[str, int]
    median_lines: float
    longest: tuple[str, int]
    one_importer: list[str]
    most_alone: tuple[str, int]
    no_importer: list[str]
    folders: list[tuple[str, int]]


def main() -> None:
    """Print the counts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("checkout", type=Path, nargs="?", default=Path(__file__).resolve().parents[1])
    parser.add_argument("--package", default="webapp")
    parser.add_argument("--json", type=Path, help="write all counts there, with the names of the modules")
    arguments = parser.parse_args()
    found = measure(arguments.checkout, package=arguments.package)
    print(as_text(found))
    if arguments.json:
        arguments.json.write_text(json.dumps(as_json(found), indent=2) + "\n", "utf-8")


def measure(checkout: Path, *, package: str = "webapp") -> Structure:
    """Count the source of a package in a working copy."""
    sources = list(_sources(checkout, package))
    if not sources:
        raise SystemExit(f"{checkout / package}: there is no Python file")
    lengths = {source.path.as_posix(): len(source.text.splitlines()) for source in sources}
    longest = max(lengths, key=lambda path: lengths[path])
    kinds: Counter[str] = Counter()
    for source in sources:
        kinds.update(line_kinds(source.text))
    importers = _importers(sources)
    modules = [s.name for s in sources if s.path.name != "__init__.py"]
    one_importer = [name for name in modules if len(importers[name]) == 1]
    alone = Counter(importer for name in one_importer for importer in importers[name])
    folders = Counter(source.path.parent.as_posix() for source in sources)
    return Structure(
        files=len(sources),
        lines={kind: kinds[kind] for kind in KINDS},
        median_lines=statistics.median(lengths.values()),
        longest=(longest, lengths[longest]),
        one_importer=one_importer,
        most_alone=max(alone.items(), key=lambda item: item[1], default=("", 0)),
        no_importer=[name for name in modules if not importers[name]],
        folders=folders.most_common(),
    )


def line_kinds(text: str) -> Counter[str]:
    """Count the lines of a module by kind."""
    kind_of: dict[int, str] = {}
    for token in tokenize.generate_tokens(io.StringIO(text).readline):
        if token.type not in _NO_TEXT:
            kind = "comment" if token.type == tokenize.COMMENT else "code"
            for line in range(token.start[0], token.end[0] + 1):
                kind_of[line] = "code" if kind_of.get(line) == "code" else kind
    for node in ast.walk(ast.parse(text)):
        kind = _kind_of_statement(node)
        if kind:
            assert isinstance(node, ast.stmt)
            kind_of.update(dict.fromkeys(range(node.lineno, (node.end_lineno or node.lineno) + 1), kind))
    counted = Counter(kind_of.values())
    counted["blank"] = len(text.splitlines()) - counted.total()
    return counted


def as_text(found: Structure) -> str:
    """Format the counts as a table."""
    total = sum(found.lines.values())
    parts = ", ".join(f"{found.lines[kind]} {kind}" for kind in KINDS)
    folders = ", ".join(f"{folder} {files}" for folder, files in found.folders[:SHOWN_FOLDERS])
    importer, alone = found.most_alone
    rows = {
        "files": f"{found.files}",
        "lines": f"{total} ({parts})",
        "median file": f"{found.median_lines:g} lines",
        "longest file": f"{found.longest[0]}, {found.longest[1]} lines",
        "one importer": f"{len(found.one_importer)} modules, {alone} of them by {importer}",
        "no importer": f"{len(found.no_importer)} modules",
        "largest folders": folders,
    }
    return "\n".join(f"{name:<18}{value}" for name, value in rows.items())


def as_json(found: Structure) -> dict[str, Any]:
    """Convert the counts to JSON types."""
    return {name: getattr(found, name) for name in Structure.__slots__}


def _sources(checkout: Path, package: str) -> Iterator[Source]:
    for path in sorted((checkout / package).rglob("*.py")):
        text = path.read_text("utf-8")
        yield Source(path.relative_to(checkout), text, ast.parse(text))


def _kind_of_statement(node: ast.AST) -> str:
    if isinstance(node, ast.Import | ast.ImportFrom):
        return "import"
    is_text = isinstance(node, ast.Expr) and isinstance(node.value, ast.Constant)
    return "docstring" if is_text and isinstance(node.value.value, str) else ""


def _importers(sources: list[Source]) -> defaultdict[str, set[str]]:
    """Find for each module those that import it."""
    names = {source.name for source in sources}
    importers: defaultdict[str, set[str]] = defaultdict(set)
    for source in sources:
        for node in ast.walk(source.tree):
            for imported in _imported(node, source, names=names):
                importers[imported].add(source.name)
    return importers


def _imported(node: ast.AST, source: Source, *, names: set[str]) -> Iterator[str]:
    if isinstance(node, ast.Import):
        yield from (alias.name for alias in node.names if alias.name in names)
    elif isinstance(node, ast.ImportFrom):
        module = ".".join([*_base(node.level, source), *filter(None, [node.module])])
        for alias in node.names:
            part = f"{module}.{alias.name}"
            yield from {part if part in names else module} & names


def _base(level: int, source: Source) -> tuple[str, ...]:
    """Return the package that a relative import starts from: with one dot, the module's own."""
    return source.path.parts[:-level] if level else ()


if __name__ == "__main__":
    main()
