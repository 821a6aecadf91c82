"""The program as text and syntax trees, and its commands as a table."""

import ast
import os
import subprocess
import sys
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path

import click
import pytest
from filelock import FileLock

from docs import make_commands

ROOT = Path(__file__).resolve().parents[2]


@dataclass(frozen=True)
class Module:
    """A module of the program."""

    path: Path
    text: str = field(repr=False)
    tree: ast.Module = field(repr=False)

    @property
    def name(self) -> str:
        """As it is imported."""
        parts = self.path.relative_to(ROOT).with_suffix("").parts
        return ".".join(parts[:-1] if parts[-1] == "__init__" else parts)

    @property
    def layer(self) -> str:
        """The folder or module right below the package."""
        return [*self.name.split("."), ""][1]

    def imported(self) -> Iterator[str]:
        """Yield the names of imported modules, and of objects imported from them."""
        for node in ast.walk(self.tree):
            if isinstance(node, ast.Import):
                yield from (alias.name for alias in node.names)
            elif isinstance(node, ast.ImportFrom):
                place = f"{self.path}:{node.lineno}"
                assert node.module, f"{place}: name the module to import from"
                # The robot's client is also a separate distribution, under another package name.
                assert node.level <= (self.layer == "robot"), f"{place}: a relative import"
                source = f"webapp.robot.{node.module}" if node.level else node.module
                yield source
                yield from (f"{source}.{alias.name}" for alias in node.names)


@pytest.fixture(scope="session")
def project() -> Path:
    """The folder of the project."""
    return ROOT


@pytest.fixture(scope="session")
def modules() -> list[Module]:
    """All modules of the program."""
    found = []
    for path in sorted((ROOT / "webapp").rglob("*.py")):
        text = path.read_text("utf-8")
        found.append(Module(path, text, ast.parse(text)))
    return found


@pytest.fixture(scope="session")
def tracked() -> list[Path]:
    """All files under version control, and new ones that are not ignored."""
    if not (ROOT / ".git").exists():
        pytest.skip("this is not a git working copy, so nobody knows which files belong to it")
    command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
    names = subprocess.run(command, cwd=ROOT, capture_output=True, check=True, text=True).stdout
    paths = [ROOT / name for name in names.split("\0") if name]
    return [path for path in paths if path.is_file()]


@pytest.fixture(scope="session")
def commands() -> dict[str, click.Command]:
    """All commands without groups, by their command line."""
    return dict(make_commands.commands())


def run(*command: object, cwd: Path) -> str:
    """Run a program in an environment in which it cannot find the source tree; return its output."""
    kept = {k: v for k, v in os.environ.items() if not k.startswith(("PYTHON", "EXPMAP", "PIP"))}
    words = [str(word) for word in command]
    done = subprocess.run(words, cwd=cwd, env=kept, capture_output=True, text=True, timeout=600)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.fixture(scope="session")
def wheel(project: Path, common_folder: Path) -> Path:
    """The wheel, built from the source tree with installed packages, once for all test processes."""
    folder, part = common_folder / "wheel", common_folder / "wheel.part"
    with FileLock(common_folder / "wheel.lock"):
        if not folder.exists():
            part.mkdir()
            options = ["--wheel", "--no-isolation", "--outdir", part]
            run(sys.executable, "-m", "build", *options, project, cwd=part)
            part.rename(folder)
    (built,) = folder.glob("*.whl")
    return built
