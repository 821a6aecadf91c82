"""Checks an installation and a library, and says what to do; changes and creates nothing."""

from __future__ import annotations

import os
import platform
import re
import shutil
import socket
import stat
import sys
import time
from collections.abc import Generator, Mapping
from contextlib import closing, suppress
from dataclasses import dataclass
from importlib import metadata
from pathlib import Path
from typing import Literal
from urllib.request import getproxies

from sqlalchemy import text

from webapp.errors import ExpMapError, StorageError
from webapp.extras import EXTRAS, install_line, is_installed
from webapp.files.contents import cache_folder
from webapp.files.localize.models import models_folder
from webapp.files.lock import any_alive
from webapp.net.bounded import answering, bounded_session
from webapp.settings import Settings
from webapp.store.clock import now
from webapp.store.database import Database, moment
from webapp.store.library import DATABASE, INNER, Library, has_library, newest_schema, schema_version
from webapp.store.operate.job_views import queue_figures
from webapp.store.schema import MapRecord
from webapp.tasks.operate import models

State = Literal["ok", "warning", "failing"]

_DISTRIBUTION = "experience-map"
_SELDOM = ("demo", "telemetry", "cluster")
"""Extras for which a missing installation is not worth a line."""

_NETWORK_DISKS = frozenset({"nfs", "nfs4", "cifs", "smb3", "smbfs", "9p", "fuse.sshfs"})
"""File systems over a network, whose locks SQLite cannot rely on."""

_DECODING_GB = 0.84
"""Memory for decoding a photo of 120 megapixels; a process decodes two at once (docs/SECURITY.md)."""

_LATE_S = 600.0
"""Waiting time from which on a queue is worth a warning."""

_CLOCK_S = 5.0
"""Difference of clocks that is worth a warning."""

_ANSWER_BYTES = 10_000
_ANSWER_S = 3.0


@dataclass(frozen=True, slots=True)
class Check:
    name: str
    state: State
    message: str
    hint: str = ""  # What to do; empty where there is nothing to do


Found = Generator[Check]


def check_installation(settings: Settings) -> Found:
    """Check Python, the packages, the extras, the models, memory, processors and proxies."""
    yield _python()
    yield from _packages()
    yield from _extras()
    yield from _guarded("models", _models(settings))
    yield _machine(settings)
    yield from _outgoing_proxy()


def check_library(settings: Settings) -> Found:
    """Check a library's folder, disk, storage, database, clock, queue and maps."""
    folder = settings.library.resolve()
    if not has_library(folder):
        message = "there is no library in this folder" if folder.is_dir() else "the folder does not exist"
        hint = "set it: --library FOLDER, or make one: expmap serve --library FOLDER"
        yield Check("library", "warning", f"{folder}: {message}", hint)
        return
    yield Check("library", "ok", str(folder))
    yield from _guarded("permissions", _permissions(folder / INNER))
    yield from _guarded("disk", _disk(settings))
    yield from _file_system(settings)
    yield from _guarded("object storage", _storage(settings))
    yield from _guarded("database", _database(settings))


def check_address(host: str, port: int, *, settings: Settings) -> Found:
    """Check whether a server could listen at an address, or already answers there."""
    yield from _guarded("port", _port(host, port))
    is_local = host in ("127.0.0.1", "localhost", "::1")
    if not is_local and not settings.web.proxies:
        yield Check(
            "https",
            "warning",
            f"at {host} pages would be sent without encryption, passwords and photos with them",
            "put a proxy with HTTPS before it (docs/operating.md), and set EXPMAP_WEB_PROXIES",
        )


def _guarded(name: str, found: Found) -> Found:
    """Run a check; an error of the program, which commands would print, is its result."""
    try:
        yield from found
    except ExpMapError as error:
        where = f"{error.where}: " if error.where else ""
        yield Check(name, "failing", f"{where}{error.message}", error.hint or "")
    except OSError as error:
        yield Check(name, "failing", f"cannot be checked: {error}")


def _python() -> Check:
    bits = 64 if sys.maxsize > 2**32 else 32
    version = f"{platform.python_version()}, {bits} bits, {platform.system()} {platform.machine()}"
    if sys.version_info >= (3, 11) and bits == 64:
        return Check("python", "ok", f"{version}, {sys.executable}")
    return Check("python", "failing", version, "install a 64-bit Python of at least 3.11")


def _packages() -> Found:
    try:
        needed = metadata.requires(_DISTRIBUTION) or []
        own = metadata.version(_DISTRIBUTION)
    except metadata.PackageNotFoundError:
        yield Check("packages", "failing", f"{_DISTRIBUTION} is not installed", "run make install")
        return
    names = [re.split(r"[^\w.-]", line, maxsplit=1)[0] for line in needed if "extra ==" not in line]
    absent = [name for name in names if _version(name) is None]
    if absent:
        yield Check(
            "packages", "failing", f"not installed: {', '.join(absent)}", f"pip install {' '.join(absent)}"
        )
    else:
        shown = ", ".join(f"{name} {_version(name)}" for name in ("numpy", "opencv-python-headless", "flask"))
        yield Check("packages", "ok", f"{_DISTRIBUTION} {own}; {len(names)} packages, {shown}")
    twins = [
        name
        for name in ("opencv-python", "opencv-contrib-python", "opencv-contrib-python-headless")
        if _version(name)
    ]
    if twins:
        both = " and ".join((*twins, "opencv-python-headless"))
        yield Check(
            "opencv",
            "warning",
            f"{both} are installed into the same folder, where one overwrites a part of the other",
            f"pip uninstall {' '.join(twins)}; then pip install --force-reinstall opencv-python-headless",
        )


def _version(name: str) -> str | None:
    try:
        return metadata.version(name)
    except metadata.PackageNotFoundError:
        return None


def _extras() -> Found:
    here = [name for name in EXTRAS if is_installed(name)]
    yield Check("extras", "ok", f"installed: {', '.join(here) or 'none'}")
    absent = [name for name in EXTRAS if name not in here and name not in _SELDOM]
    if absent:
        line = " or ".join(install_line(name) for name in absent)
        yield Check("extras", "warning", f"not installed: {', '.join(absent)}", f"if you need one: {line}")


def _models(settings: Settings) -> Found:
    folder = models_folder(settings.models)
    states = models.states(settings)
    here = sorted({state.model for state in states if state.state == "here"})
    yield Check("models", "ok", f"in {folder}: {', '.join(here) or 'none'}")
    for state in states:
        if state.state in ("damaged", "unusable"):
            why = f": {state.problem}" if state.problem else ""
            yield Check(
                "models",
                "failing",
                f"{state.file.name} is {state.state}{why}",
                f"expmap models fetch {state.model}",
            )
    if advice := models.advice(settings):
        message, _, hint = advice.rpartition("; ")
        yield Check("models", "warning", message, hint)


def _machine(settings: Settings) -> Check:
    line, memory_gb = f"{os.cpu_count()} processors", _memory_gb()
    if memory_gb is None:
        return Check("machine", "ok", line)
    line = f"{line}, {memory_gb:.1f} GB of memory"
    per_process_gb = 2 * _DECODING_GB * settings.photo.max_megapixels / 120
    if settings.serve.workers * per_process_gb <= memory_gb:
        return Check("machine", "ok", line)
    return Check(
        "machine",
        "warning",
        f"{line}; two photos of the largest size allowed take {per_process_gb:.1f} GB in each of "
        f"{settings.serve.workers} processes",
        "lower serve.workers or photo.max_megapixels (docs/settings.md)",
    )


def _memory_gb() -> float | None:
    with suppress(ValueError, OSError, AttributeError):  # Windows has no such function
        return os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 1e9
    return None


def _outgoing_proxy() -> Found:
    named = sorted(
        {*getproxies()} - {"no"}
    )  # those of the environment, and on Windows and macOS of the system
    if named:
        yield Check(
            "outgoing proxy",
            "ok",
            f"for {', '.join(named)}: used for map tiles, places and models, not for street-level photos",
        )


def _permissions(inner: Path) -> Found:
    closed = [str(path) for path in (inner.parent, inner) if not os.access(path, os.R_OK | os.W_OK | os.X_OK)]
    if closed:
        yield Check(
            "permissions",
            "failing",
            f"not writable for this user: {', '.join(closed)}",
            "run as the user that owns the library, or change the owner: chown -R USER FOLDER",
        )
        return
    foreign = [str(path) for path in inner.iterdir() if path.is_file() and not os.access(path, os.W_OK)]
    if foreign:
        yield Check(
            "permissions",
            "failing",
            f"{len(foreign)} files are not writable for this user, such as {foreign[0]}",
            "a command has been run as another user: chown them to the one that serves",
        )
        return
    yield from _open_to_others(inner)


def _open_to_others(inner: Path) -> Found:
    """Report files with secrets that other users of the machine can read."""
    if os.name != "posix":
        yield Check("permissions", "ok", "readable and writable")
        return
    mode = stat.S_IMODE(inner.stat().st_mode)
    exposed = [
        path
        for path in inner.iterdir()
        if path.is_file()
        and path.name.endswith("-key")
        and path.stat().st_mode & (stat.S_IRGRP | stat.S_IROTH)
    ]
    if exposed and mode & (stat.S_IXGRP | stat.S_IXOTH):
        yield Check(
            "permissions",
            "warning",
            f"other users of this machine can read {exposed[0]}",
            f"chmod 600 {exposed[0]}",
        )
    else:
        yield Check("permissions", "ok", "readable and writable")


def _disk(settings: Settings) -> Found:
    folders = [settings.library.resolve()]
    if settings.storage is not None and cache_folder(settings).is_dir():
        folders.append(cache_folder(settings))
    for folder in folders:
        usage = shutil.disk_usage(folder)
        line = f"{usage.free / 1e9:.1f} GB of {usage.total / 1e9:.0f} GB are free in {folder}"
        if usage.free < settings.upload.reserve_mb * 1e6:
            yield Check(
                "disk",
                "failing",
                f"{line}, less than the reserve of {settings.upload.reserve_mb:g} MB: nothing is accepted",
                "make room, or move the library to a larger disk",
            )
        elif usage.free < usage.total / 20 and usage.free < 20e9:
            yield Check("disk", "warning", line, "make room before it is full")
        else:
            yield Check("disk", "ok", line)


def _file_system(settings: Settings) -> Found:
    kind = _kind_of_disk(settings.library.resolve())
    if kind is None:
        return
    if kind in _NETWORK_DISKS and settings.database is None:
        yield Check(
            "file system",
            "failing",
            f"the database is a SQLite file on a disk in the network ({kind}), whose locks are not reliable",
            "keep the library on a local disk, or its records in PostgreSQL (docs/cluster.md)",
        )
    else:
        yield Check("file system", "ok", kind)


def _kind_of_disk(folder: Path, mounts: Path = Path("/proc/mounts")) -> str | None:
    """Return the type of the file system of a folder; None if the system does not say."""
    with suppress(OSError):
        lines = [line.split() for line in mounts.read_text("utf-8", "surrogateescape").splitlines()]
        points = {fields[1].replace("\\040", " "): fields[2] for fields in lines if len(fields) > 2}
        return next((points[str(at)] for at in (folder, *folder.parents) if str(at) in points), None)
    return None


def _storage(settings: Settings) -> Found:
    if settings.storage is None:
        return
    from webapp.files.contents import connect

    storage = connect(settings)
    if storage is not None and storage.reachable():
        yield Check("object storage", "ok", f"{settings.storage} answers")
    else:
        yield Check(
            "object storage",
            "failing",
            f"{settings.storage} does not answer",
            "is it running, and are the keys right? See EXPMAP_STORAGE",
        )


def _database(settings: Settings) -> Found:
    folder = settings.library.resolve()
    url = settings.database or f"sqlite:///{folder / INNER / DATABASE}"
    with closing(Database(url)) as database:
        version, newest = schema_version(database), newest_schema()
        if version is None:
            yield Check(
                "database", "failing", f"{database.name} has no tables", "restore a backup: expmap restore"
            )
            return
        if version < newest:
            yield Check(
                "database",
                "warning",
                f"{database.name} has schema {version}, this program {newest}",
                "make a backup; the next start migrates it",
            )
            return
        if settings.database is None:
            yield from _intact(database)
        else:
            yield Check("database", "ok", f"{database.name}, schema {version}")
        library = Library(folder, database)
        yield from _clock(database)
        yield from _queue(library)
        yield from _maps(library)


def _intact(database: Database) -> Found:
    with database.read() as session:
        problems = [row[0] for row in session.execute(text("PRAGMA quick_check(3)"))]
    if problems == ["ok"]:
        yield Check("database", "ok", f"{database.name}, schema {schema_version(database)}, intact")
    else:
        yield Check(
            "database",
            "failing",
            f"{database.name} is damaged: {problems[0]}",
            "stop the server and restore the last backup: expmap restore",
        )


def _clock(database: Database) -> Found:
    with database.read() as session:
        off_s = (now() - moment(session)).total_seconds()
        newest = session.execute(text("SELECT max(created_at) FROM job")).scalar()
    if abs(off_s) > _CLOCK_S:
        yield Check(
            "clock",
            "warning",
            f"this machine's clock differs from the database server's by {off_s:.0f} s",
            "let both follow an NTP server",
        )
        return
    ahead = str(newest or "")[:19].replace("T", " ") > now().isoformat(" ", "seconds")[:19]
    if ahead:
        yield Check(
            "clock",
            "warning",
            "there are jobs from the future: the clock has been set back, or was wrong before",
            "check the time of this machine",
        )
    else:
        yield Check("clock", "ok", f"{now():%Y-%m-%d %H:%M:%S} UTC")


def _queue(library: Library) -> Found:
    works = any_alive(library.inner / "workers")
    with library.database.read() as session:
        queue = queue_figures(session)
    line = f"{queue.waiting} jobs wait, {queue.running} run"
    if (queue.waiting or queue.running) and not works:
        yield Check(
            "jobs",
            "warning",
            f"{line}, and this machine has no worker",
            "start expmap serve or worker",
        )
    elif queue.oldest_s > _LATE_S:
        yield Check(
            "jobs",
            "warning",
            f"{line}; the oldest has waited {queue.oldest_s / 60:.0f} minutes",
            "start another worker: expmap worker",
        )
    else:
        yield Check("jobs", "ok", f"{line}; {'a worker is' if works else 'no worker is'} at work")


def _maps(library: Library) -> Found:
    with library.database.read() as session:
        slugs = session.query(MapRecord.slug).filter(MapRecord.binned_at.is_(None)).all()
    lost = sorted(slug for (slug,) in slugs if not library.map_folder(slug).is_dir())
    if lost:
        yield Check(
            "maps",
            "failing",
            f"{len(lost)} of {len(slugs)} maps have lost their folder, such as {lost[0]}",
            "restore a backup into another folder and copy it from there",
        )
    else:
        yield Check("maps", "ok", f"{len(slugs)}, each with its folder")


def _port(host: str, port: int) -> Found:
    """Check a port by listening at it for a moment."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    with socket.socket(family, socket.SOCK_STREAM) as tried:
        tried.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        try:
            tried.bind((host, port))
        except PermissionError:
            yield Check(
                "port",
                "failing",
                f"port {port} is for the system's administrator only",
                "take one from 1024 on: --port 8000",
            )
            return
        except OSError as error:
            yield _taken(host, port, error)
            return
    yield Check("port", "ok", f"{host}:{port} is free")


def _taken(host: str, port: int, error: OSError) -> Check:
    """Find out what answers at a port at which nothing can listen."""
    shown = f"[{host}]" if ":" in host else host
    address = f"http://{shown}:{port}/healthz"
    began = time.monotonic()
    parts: Mapping[str, str] | None = None
    with suppress(OSError, ValueError, StorageError), bounded_session("experience-map") as session:
        session.trust_env = False
        with answering(session, address, most_bytes=_ANSWER_BYTES, timeout_s=_ANSWER_S) as answer:
            parts = answer.json()
    if not isinstance(parts, dict) or not {"status", "database"} <= parts.keys():
        return Check(
            "port",
            "failing",
            f"{host}:{port} cannot be used: {error.strerror or error}",
            "another program listens there, or the address is not this machine's: choose another --port",
        )
    failing = sorted(name for name, state in parts.items() if state != "ok")
    took_ms = (time.monotonic() - began) * 1000
    if failing:
        return Check(
            "server", "failing", f"the server at {address} says: {', '.join(failing)} failing", "see its log"
        )
    return Check("server", "ok", f"a server of Experience Map answers at {address} in {took_ms:.0f} ms")
