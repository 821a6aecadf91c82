"""Finds a browser for the tests of the pages, or installs one from Debian's packages.

Headless Chromium (`chromium-headless-shell`) is preferred: a new context takes a quarter of the time.

python tests/browser/ensure_browser.py
"""

import os
import shutil
import subprocess
import sys
from pathlib import Path

SHELL = "chromium-headless-shell"
COMMANDS = (SHELL, "chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome")
ELSEWHERE = (
    "/Applications/Chromium.app/Contents/MacOS/Chromium",
    "/Applications/Google Chrome.app/Contents/MacOS/Google Chrome",
    "C:/Program Files/Google/Chrome/Application/chrome.exe",
    "C:/Program Files (x86)/Google/Chrome/Application/chrome.exe",
)
MISSING = "the browser tests need the package chromium: install it (Debian: sudo apt-get install chromium)"


def find_browser() -> str | None:
    """Return the path of a chromium or Chrome; None if there is none."""
    found = (shutil.which(command) for command in COMMANDS)
    return next((path for path in found if path), None) or next(filter(os.path.isfile, ELSEWHERE), None)


def install() -> None:
    """Install chromium with apt, as root or by sudo; exit with a message if that fails."""
    if not shutil.which("apt-get"):
        raise SystemExit(MISSING)
    by = []
    if os.geteuid() != 0:
        if not shutil.which("sudo"):
            raise SystemExit(MISSING)
        by = ["sudo"] if sys.stdin.isatty() else ["sudo", "--non-interactive"]
    sys.stderr.write("no browser is here: installing chromium through apt\n")
    if not _apt(by, "update"):
        raise SystemExit(MISSING)
    if not _apt(by, "install", SHELL) and not _apt(by, "install", "chromium"):  # not on Ubuntu
        raise SystemExit(MISSING)


def _apt(by: list[str], verb: str, *packages: str) -> bool:
    command = [*by, "apt-get", verb, "--quiet", "--yes", *packages]
    return subprocess.run(command, stdout=sys.stderr).returncode == 0


def main() -> None:
    """Make sure that a browser is installed, and print its path."""
    if find_browser() is None:
        install()
    elif shutil.which("chromium") and not shutil.which(SHELL) and os.geteuid() == 0:
        _apt([], "install", SHELL)  # only for speed: if it fails, chromium is used
    found = find_browser()
    if found is None:
        raise SystemExit(MISSING)
    sys.stderr.write(f"browser tests use {Path(found)}\n")


if __name__ == "__main__":
    main()
