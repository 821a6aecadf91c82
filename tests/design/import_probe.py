"""Imports the modules named on its command line and prints the side effects of each as JSON.

Run it in a separate process: its guards cannot be removed.
"""

import contextlib
import importlib
import io
import json
import os
import sys
import threading
from pathlib import Path

WRITING = {
    "os.mkdir",
    "os.rename",
    "os.remove",
    "os.rmdir",
    "os.symlink",
    "os.link",
    "shutil.move",
    "shutil.rmtree",
}
REACHING = {"socket.connect", "socket.bind", "subprocess.Popen", "os.system", "os.posix_spawn", "os.fork"}

noticed: list[str] = []
current = ""


def note(what: str) -> None:
    """Record a side effect of the module being imported."""
    noticed.append(f"{current}: {what}")


def asks_for_ipv6() -> bool:
    """Return whether the caller is urllib3, which binds a socket to check for IPv6, and closes it."""
    frame = sys._getframe(2)
    return frame.f_globals.get("__name__") == "urllib3.util.connection"


def watch(event: str, args: tuple[object, ...]) -> None:
    """Audit hook that notes written files, connections and started processes."""
    if event == "open":
        mode, flags = args[1], args[2]
        writes = any(letter in mode for letter in "wax+") if isinstance(mode, str) else False
        if (writes or (isinstance(flags, int) and flags & (os.O_WRONLY | os.O_RDWR))) and args[
            0
        ] != os.devnull:
            note(f"writes {args[0]}")
    elif event in WRITING | REACHING and not asks_for_ipv6():
        note(f"{event} {args[0] if args else ''}")


class Environment(os._Environ):  # type: ignore[name-defined]
    """An environment that notes when modules of this program read it."""

    def __getitem__(self, key):
        """Give a variable."""
        frame = sys._getframe(1)
        while frame and frame.f_globals.get("__name__") in ("os", "collections.abc", "_collections_abc"):
            frame = frame.f_back
        if frame and str(frame.f_globals.get("__name__")).startswith("webapp"):
            note(f"reads the environment variable {key}")
        return super().__getitem__(key)


def main() -> None:
    """Import all requested modules."""
    global current
    os.environ.__class__ = Environment
    folder = Path.cwd()
    sys.addaudithook(watch)
    for current in sys.argv[1:]:
        printed = io.StringIO()
        threads = threading.active_count()
        with contextlib.redirect_stdout(printed), contextlib.redirect_stderr(printed):
            importlib.import_module(current)
        if printed.getvalue():
            note(f"prints {printed.getvalue()!r}")
        if threading.active_count() > threads:
            note("starts a thread")
        if Path.cwd() != folder:
            note(f"changes to {Path.cwd()}")
            os.chdir(folder)
    sys.stdout.write(json.dumps(noticed))


if __name__ == "__main__":
    main()
