"""The web server: gunicorn, configured here and by no configuration file of its own.

The supervisor starts it as `python -m webapp.jobs.webserver` with the name of the application: gunicorn's
master must not import the application, because a process that has loaded OpenCV or faiss cannot be forked
safely.
"""

from __future__ import annotations

import argparse
import mmap
import os
import socket
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

from gunicorn.app.base import BaseApplication  # type: ignore[import-untyped]
from gunicorn.arbiter import Arbiter  # type: ignore[import-untyped]
from gunicorn.glogging import Logger  # type: ignore[import-untyped]

from webapp import telemetry
from webapp.configuration import load_settings
from webapp.importing import import_name
from webapp.jobs.connection_queue import ReceivingEnd
from webapp.jobs.slow_clients import ClientSocket, PatientWorker
from webapp.logs import FORMS, log_to_stderr
from webapp.settings import Settings, let_threads_sleep
from webapp.threads import cores

_CONNECTIONS = 800
"""Maximum number of open connections per process; an idle one costs only a file descriptor."""


class Server(BaseApplication):  # type: ignore[misc]
    """Gunicorn for one application.

    Args:
        app: "module:function", called with the settings in each worker process.
        options: Gunicorn's options.
        parent: Id of the supervisor's process; the server stops when it is gone.
        listeners: Listening sockets; none: those of the options.
    """

    def __init__(
        self,
        app: str,
        *,
        settings: Settings,
        options: dict[str, Any],
        parent: int,
        listeners: Sequence[socket.socket] = (),
    ) -> None:
        self._app = app
        self._listeners = list(listeners)
        self._loaded = mmap.mmap(-1, 1)  # shared with the worker processes
        self._settings = settings
        self._options = options
        self._parent = parent
        super().__init__()

    def load_config(self) -> None:
        """Set gunicorn's options; it reads no others."""
        for name, value in self._options.items():
            self.cfg.set(name, value)

    def load(self) -> Any:
        """Make the application in a worker process, which limits its native threads to its share of cores."""
        import cv2  # not before the fork

        ClientSocket.patience_s = self._settings.serve.patience_s

        cv2.setNumThreads(native_threads(self.cfg.workers))
        telemetry.start(self._settings.traces)  # its threads would not survive the fork
        create: Callable[[Settings], Any] = import_name(self._app)
        made = create(self._settings)
        self._loaded[0] = 1
        return made

    def is_loaded(self) -> bool:
        """Return whether a worker process has made the application."""
        return self._loaded[0] == 1

    def run(self) -> None:
        """Serve until stopped."""
        master = _Master(self, self._parent)
        master.LISTENERS = self._listeners
        master.run()


class _Master(Arbiter):  # type: ignore[misc]
    """Stops when its parent is gone, and lets the first worker start alone, so that it answers sooner."""

    def __init__(self, app: Server, parent: int) -> None:
        self._parent = parent
        super().__init__(app)
        self.num_workers = 1

    def manage_workers(self) -> None:
        """Start workers; gunicorn calls it every second."""
        if self.num_workers == 1 and self.app.is_loaded():
            self.num_workers = self.cfg.workers
        super().manage_workers()

    def murder_workers(self) -> None:
        """Check the parent and the workers; gunicorn calls it every second."""
        if os.getppid() != self._parent:
            self.log.warning("the supervisor is gone: stopping")
            self.handle_quit()
        super().murder_workers()


class Log(Logger):  # type: ignore[misc]
    """Routes gunicorn's messages to the program's log."""

    def setup(self, cfg: Any) -> None:
        """Remove gunicorn's own handlers."""
        super().setup(cfg)
        self.error_log.handlers.clear()
        self.error_log.propagate = True


def native_threads(workers: int) -> int:
    """Return how many threads the native libraries of each worker process may start."""
    return max(cores() // workers, 1)


def gunicorn_options(settings: Settings, *, fd: int, workers: int) -> dict[str, Any]:
    """Choose gunicorn's options.

    Args:
        fd: File descriptor of the listening socket: requests wait there while gunicorn restarts.
        workers: Number of processes.
    """
    return {
        "bind": f"fd://{fd}",
        "workers": workers,
        "worker_class": PatientWorker,
        "threads": settings.serve.threads,
        "graceful_timeout": round(settings.serve.stop_s),
        "timeout": 60,
        "worker_connections": _CONNECTIONS,
        "preload_app": False,
        "control_socket_disable": True,  # it would be in the home folder
        "proc_name": "expmap",
        "loglevel": "warning",
        "logger_class": Log,
    }


def main(arguments: Sequence[str] | None = None) -> None:
    """Serve, with the arguments that the supervisor passes."""
    let_threads_sleep()
    parser = argparse.ArgumentParser()
    parser.add_argument("app")
    parser.add_argument("--library", type=Path, required=True)
    for name in ("--fd", "--workers", "--parent"):
        parser.add_argument(name, type=int, required=True)
    parser.add_argument("--passed", action="store_true", help="--fd is the end of a queue of connections")
    parser.add_argument("--log", choices=FORMS, default="text")
    asked = parser.parse_args(arguments)
    log_to_stderr(asked.log)
    settings = replace(load_settings(), library=asked.library)
    options = gunicorn_options(settings, fd=asked.fd, workers=asked.workers)
    listeners = [ReceivingEnd(fileno=asked.fd)] if asked.passed else []
    Server(asked.app, settings=settings, options=options, parent=asked.parent, listeners=listeners).run()


if __name__ == "__main__":
    main()
