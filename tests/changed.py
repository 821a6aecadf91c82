"""Selects the tests of what has changed; `make test-changed` runs them.

A test is selected if it imports a changed module, or one that imports it directly, if it has changed itself,
or if it is in the folder of `tests/` that mirrors that of a changed module, template or script. Slow tests
and those with a browser are left out. It is a selection for daily work: `make test` runs everything.
"""

import argparse
import ast
import subprocess
import sys
from collections.abc import Iterator
from functools import cache
from pathlib import Path

ROOT = Path(__file__).resolve().parents[1]
COMPOSITION = "webapp.app"
"""Imports all parts of the program, so what depends on it says nothing."""


def main() -> int:
    """Print the selected tests, or run them; return the exit code."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("--since", help="commit to compare with, by default where the branch began")
    parser.add_argument("--run", action="store_true", help="run the tests")
    options = parser.parse_args()
    tests = selected(changed_files(options.since or _branch_point()))
    if not options.run:
        sys.stdout.write("".join(f"{test}\n" for test in tests))
        return 0
    if not tests:
        sys.stdout.write("no test is about what has changed\n")
        return 0
    command = [sys.executable, "-m", "pytest", "-q", "-n", "auto", "--dist", "loadfile", "-m", "not slow"]
    return subprocess.run([*command, *tests], cwd=ROOT).returncode


def selected(changed: list[str]) -> list[str]:
    """Return the paths of the tests of changed files, all relative to the project."""
    imports = {_name(path): _imported(path) for path in sorted((ROOT / "webapp").rglob("*.py"))}
    modules = {_name(ROOT / path) for path in changed if path.startswith("webapp/") and path.endswith(".py")}
    affected = modules | {name for name, used in imports.items() if used & modules}
    affected = {name for name in affected if not f"{name}.".startswith(f"{COMPOSITION}.")}
    folders = {folder for path in changed for folder in _mirrors(path)}
    found = []
    for path in sorted((ROOT / "tests").rglob("test_*.py")):
        place = path.relative_to(ROOT).as_posix()
        if place.startswith(("tests/browser/", "tests/cluster/")):
            continue
        if place in changed or path.parent in folders or affected.intersection(_imported(path)):
            found.append(place)
    return found


def changed_files(since: str) -> list[str]:
    """Return the files that differ from a commit, and new ones, relative to the project."""
    differ = _git("diff", "--name-only", since)
    return sorted({*differ, *_git("ls-files", "--others", "--exclude-standard")})


def _branch_point() -> str:
    for other in ("@{upstream}", "main"):
        found = subprocess.run(["git", "merge-base", "HEAD", other], cwd=ROOT, capture_output=True, text=True)
        if found.returncode == 0:
            return found.stdout.strip()
    return "HEAD"


def _git(*words: str) -> list[str]:
    done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True)
    return done.stdout.splitlines()


def _mirrors(path: str) -> Iterator[Path]:
    """Yield the folder of tests for a file, if there is one."""
    top, _, rest = path.partition("/")
    if top == "webapp":
        yield ROOT / "tests" / Path(rest).parent
    elif top == "templates":
        yield ROOT / "tests" / "web" / Path(rest).parent
    elif top in ("benchmarks", "docs"):
        yield ROOT / "tests" / top
    elif path.startswith("static/js/"):
        yield ROOT / "tests" / "js"


def _name(path: Path) -> str:
    parts = path.relative_to(ROOT).with_suffix("").parts
    return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)


@cache
def _imported(path: Path) -> frozenset[str]:
    """Return the names of the modules that a file imports, and of objects imported from them."""
    return frozenset(_named(path))


def _named(path: Path) -> Iterator[str]:
    for node in ast.walk(ast.parse(path.read_text("utf-8"))):
        if isinstance(node, ast.Import):
            yield from (alias.name for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and node.module:
            source = f"webapp.robot.{node.module}" if node.level else node.module
            yield source
            yield from (f"{source}.{alias.name}" for alias in node.names)


if __name__ == "__main__":
    sys.exit(main())
