"""Check the scripts of the pages with tsc and eslint: `python tests/js/check.py`.

Needs node 20 or newer and npm on the PATH; if they are missing, or npm cannot install the pinned packages of
`package-lock.json`, the check is skipped with a clear message.
"""

import shutil
import subprocess
import sys
from pathlib import Path

HERE = Path(__file__).resolve().parent
PROJECT = HERE.parents[1]
TOOLS = PROJECT / ".venv" / "node"
OLDEST_NODE = 20


def main() -> int:
    """Run both checks and return the exit code."""
    problem = missing_node() or install()
    if problem:
        sys.stderr.write(f"\n*** SKIPPED: tsc and eslint did not check static/js: {problem}\n\n")
        return 0
    from make_api_types import problem as outdated  # loads the program

    if problem := outdated():
        sys.stderr.write(f"{problem}\n")
        return 1
    return max(
        run("typescript/bin/tsc", "--project", str(HERE / "jsconfig.json")),
        run("eslint/bin/eslint.js", "--config", str(HERE / "eslint.config.mjs"), "static/js", "tests/js"),
    )


def missing_node() -> str | None:
    """Return why there is no usable node, or None."""
    for name in ("node", "npm"):
        if shutil.which(name) is None:
            return f"{name} is not installed (Debian: apt install nodejs npm)"
    version = subprocess.run(["node", "--version"], capture_output=True, text=True, check=True).stdout.strip()
    if int(version.lstrip("v").partition(".")[0]) < OLDEST_NODE:
        return f"node {OLDEST_NODE} or newer is needed, this is {version}"
    return None


def install() -> str | None:
    """Install the pinned packages unless they are installed; return why that failed, or None."""
    lock = HERE / "package-lock.json"
    done = TOOLS / "package-lock.json.installed"
    if done.exists() and done.read_bytes() == lock.read_bytes():
        return None
    TOOLS.mkdir(parents=True, exist_ok=True)
    for name in ("package.json", "package-lock.json"):
        shutil.copy(HERE / name, TOOLS / name)
    options = ["--no-audit", "--no-fund", "--ignore-scripts", "--prefix", str(TOOLS)]
    npm = [str(shutil.which("npm")), "ci", *options]
    answer = subprocess.run(npm, capture_output=True, text=True, check=False)
    if answer.returncode:
        return f"npm could not install the tools: {answer.stderr.strip().splitlines()[-1:] or 'no message'}"
    shutil.copy(lock, done)
    return None


def run(script: str, *arguments: str) -> int:
    """Run a tool of the packages in the project's folder."""
    command = ["node", str(TOOLS / "node_modules" / script), *arguments]
    return subprocess.run(command, cwd=PROJECT, check=False).returncode


if __name__ == "__main__":
    sys.exit(main())
