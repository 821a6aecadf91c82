"""All processes of the server: the web server and a background worker, over one library."""

from __future__ import annotations

import errno
import http.client
import logging
import os
import socket
import sys
import time
from collections.abc import Callable
from dataclasses import dataclass

from sqlalchemy import select

from webapp.errors import ExpMapError, MissingPart, UsageError
from webapp.jobs.logs import Form
from webapp.jobs.supervisor import Child, keep_running
from webapp.jobs.webserver import native_threads
from webapp.settings import Settings, environment_for
from webapp.store.accounts import accounts, sign_in
from webapp.store.library import Library, open_library
from webapp.store.operate import jobs
from webapp.store.operate.jobs import ENDED
from webapp.store.schema import MapRecord

_log = logging.getLogger(__name__)

_FREE_WITHIN_S = 4.0
"""A server that was killed frees its port so soon."""

_MOST_FAILURES = 3
_BACKLOG = 512
_SPARE_S = 3.0
_HERE = {"0.0.0.0": "127.0.0.1", "::": "::1"}
"""Where a server that listens everywhere is reached from its own machine."""


@dataclass(frozen=True, slots=True)
class Site:
    """What is served, and where.

    Attributes
    ----------
    app : str
        "module:function" that makes the application.
    port : int
        0 for any that is free.
    workers : int
        Processes that answer requests.
    log : {"text", "json"}
        Form of the log.
    """

    app: str
    host: str
    port: int
    workers: int
    log: Form = "text"


def serve(site: Site, *, settings: Settings, tell: Callable[[str], None]) -> None:
    """Serve a library until the process is told to stop.

    Parameters
    ----------
    tell : callable
        Called once with `listening on URL` and once with `sign in: URL`, when the server answers.

    Raises
    ------
    UsageError
        The address cannot be listened on.
    StorageError
        The library cannot be opened.
    ExpMapError
        The application does not start.
    MissingPart
        On Windows.
    """
    if os.name == "nt":
        raise MissingPart(
            "the server does not run on Windows itself", hint="run it in WSL: wsl --install, then make run"
        )
    with _listen(site.host, site.port) as listener:
        library = open_library(settings.library)
        try:
            start = _Start(library, listener, settings=settings)
            web, worker = _web(site, library, listener=listener), _worker(site, library)
            stop_s = max(settings.serve.stop_s, settings.jobs.stop_s) + _SPARE_S
            keep_running([web, worker], each_tick=lambda: start.look(web, tell=tell), stop_s=stop_s)
        finally:
            library.database.close()


def _listen(host: str, port: int) -> socket.socket:
    """Listen, and wait a little where an earlier server has not ended completely."""
    until = time.monotonic() + _FREE_WITHIN_S
    while True:
        try:
            family, _, _, _, address = socket.getaddrinfo(host, port, type=socket.SOCK_STREAM)[0]
            return socket.create_server(address[:2], family=family, backlog=_BACKLOG)
        except OSError as error:
            if error.errno != errno.EADDRINUSE:
                reason = error.strerror or str(error)
                raise UsageError(
                    f"cannot listen there: {reason}",
                    where=f"{host}:{port}",
                    hint="try another --host or --port",
                ) from error
            if time.monotonic() > until:
                raise UsageError(
                    "another program uses this port",
                    where=f"{host}:{port}",
                    hint=f"stop it, or choose another port: --port {port + 1 if port < 65535 else 0}",
                ) from error
        time.sleep(0.1)


def _web(site: Site, library: Library, *, listener: socket.socket) -> Child:
    numbers = {"--fd": listener.fileno(), "--workers": site.workers, "--parent": os.getpid()}
    return Child(
        "the web server",
        [
            sys.executable, "-m", "webapp.jobs.webserver", site.app, "--library", str(library.folder),
            "--log", site.log,
            *(text for name, number in numbers.items() for text in (name, str(number))),
        ],
        environment=environment_for(native_threads(site.workers)),
        fds=[listener.fileno()],
    )  # fmt: skip


def _worker(site: Site, library: Library) -> Child:
    command = ["worker", "--library", str(library.folder), "--parent", str(os.getpid()), "--log", site.log]
    return Child(
        "the background worker",
        [sys.executable, "-m", "webapp", *command],
        environment=environment_for(),
    )


class _Start:
    """The first start's sample map, a link to sign in, and the two lines that tell that all is ready."""

    def __init__(self, library: Library, listener: socket.socket, *, settings: Settings) -> None:
        self._library = library
        host, port = listener.getsockname()[:2]
        self._address = (_HERE.get(host, host), port)
        self._told = False
        with library.database.write() as session:
            owner = accounts.ensure_owner(session)
            self._token = sign_in.new_link(session, owner, hours=settings.web.link_hours)
            self._sample = None
            if session.scalars(select(MapRecord.id).limit(1)).first() is None:
                _log.info("getting the sample map ready, which can take half a minute")
                self._sample = jobs.enqueue(session, "sample", account_id=owner.id).id

    def look(self, web: Child, *, tell: Callable[[str], None]) -> None:
        """Tell once that the server answers.

        Raises
        ------
        ExpMapError
            It ends again and again instead.
        """
        if self._told:
            return
        if web.failures >= _MOST_FAILURES:
            raise ExpMapError("the web server does not start", hint="the messages above say why")
        if self._sample_is_made() and self._answers():
            host, port = self._address
            url = f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"
            tell(f"listening on {url}")
            tell(f"sign in: {url}/sign-in/{self._token}")
            self._told = True

    def _sample_is_made(self) -> bool:
        if self._sample is None:
            return True
        with self._library.database.read() as session:
            return jobs.find(session, self._sample).state in ENDED

    def _answers(self) -> bool:
        """Tell whether somebody answers; what is not well is for those who watch the server."""
        connection = http.client.HTTPConnection(*self._address, timeout=1.0)
        try:
            connection.request("GET", "/healthz")
            return connection.getresponse().status in (
                http.HTTPStatus.OK,
                http.HTTPStatus.SERVICE_UNAVAILABLE,
            )
        except (OSError, http.client.HTTPException):
            return False
        finally:
            connection.close()
