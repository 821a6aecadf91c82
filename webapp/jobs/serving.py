"""The supervisor of a server: keeps the web server and background workers of a library running."""

from __future__ import annotations

import errno
import http.client
import logging
import os
import signal
import socket
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass
from tempfile import TemporaryDirectory
from types import FrameType

from sqlalchemy import select

from webapp.errors import ExpMapError, MissingPart, UsageError
from webapp.extras import require
from webapp.jobs.acceptor import CAN_PASS, Acceptor
from webapp.jobs.health import Drain
from webapp.jobs.webserver import native_threads
from webapp.logs import Form
from webapp.progress import Progress
from webapp.settings import METRICS_FOLDER, Settings, environment_for
from webapp.store.accounts import accounts, sign_in
from webapp.store.library import Library, open_library
from webapp.store.operate import jobs
from webapp.store.operate.jobs import ENDED
from webapp.store.schema import MapRecord
from webapp.tasks.operate.open_storage import open_storage

_TICK_S = 0.1
_FIRST_PAUSE_S, _LONGEST_PAUSE_S = 0.25, 5.0
_WELL_S = 5.0
"""A process that has run for this time counts as successfully started."""

_STDERR = 2
_POLL_S, _SAY_S = 0.3, 5.0
"""Intervals at which the progress of the sample map is read, and logged if it is not shown."""

_log = logging.getLogger(__name__)
_FREE_WITHIN_S = 4.0
"""Time within which the port of a killed server becomes free."""

_MOST_FAILURES = 3
_ANSWERS_WITHIN_S = 1.0
_BACKLOG = 512
SPARE_S = 3.0
_HERE = {"0.0.0.0": "127.0.0.1", "::": "::1"}
_OUTSIDE = {socket.AF_INET: "192.0.2.1", socket.AF_INET6: "2001:db8::1"}
"""Addresses for documentation: the system is asked which of its own it would send from."""
"""Loopback addresses of a server that listens on all interfaces."""


@dataclass(frozen=True, slots=True)
class Site:
    """The application to serve, its address and its number of processes."""

    app: str  # "module:function" that makes the application
    host: str
    port: int  # 0 for any free port
    workers: int  # Processes that answer requests
    log: Form = "text"  # "text" or "json". Form of the log.


def serve(
    site: Site, *, settings: Settings, echo: Callable[[str], None], progress: Progress | None = None
) -> None:
    """Serve a library until the process is stopped.

    Args:
        progress: Shows how far the sample map of a first start is; None: the log says it.
        echo: Called once with `listening on URL` and once with `sign in: URL`, when the server answers.

    Raises:
        UsageError: The address cannot be listened on.
        StorageError: The library cannot be opened.
        ExpMapError: The application does not start.
        MissingPart: On Windows.
    """
    if os.name == "nt":
        raise MissingPart(
            "the server does not run natively on Windows", hint="run it in WSL: wsl --install, then make run"
        )
    with ExitStack() as on_end, listen(site.host, site.port) as listener, Drain() as drain:
        library = open_library(settings.library, url=settings.database)
        try:
            open_storage(library, settings)
            start = _Start(library, listener, settings=settings, progress=progress)
            figures = on_end.enter_context(_metrics_folder(settings))
            more = {**figures, **drain.environment}
            acceptor = None
            if CAN_PASS:
                acceptor = on_end.enter_context(
                    Acceptor(listener, library, settings=settings, draining=drain.has_begun)
                )
            end = listener if acceptor is None else acceptor.receiving_end
            web = _web(site, library, fds=(end.fileno(), drain.reading_end), more=more)
            children = [web, *_workers(site, library, settings=settings)]
            keep_running(
                children,
                each_tick=lambda: start.poll(web, echo=echo),
                acceptor=acceptor,
                drain=drain,
                drain_s=settings.serve.drain_s,
                stop_s=max(settings.serve.stop_s, settings.jobs.stop_s) + SPARE_S,
            )
        finally:
            library.database.close()


@contextmanager
def _metrics_folder(settings: Settings) -> Iterator[dict[str, str]]:
    """Make the folder through which web processes share metrics; yields the environment that names it."""
    if settings.serve.metrics_token is None:
        yield {}
        return
    require("cluster")
    with TemporaryDirectory(prefix="expmap-metrics-") as folder:
        yield {METRICS_FOLDER: folder}


def _url(host: str, port: int) -> str:
    return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"


def _network_address(family: int) -> str | None:
    """Return the address of this machine in its network; None without a network. Sends nothing."""
    outside = _OUTSIDE[socket.AddressFamily(family)]
    with socket.socket(family, socket.SOCK_DGRAM) as route, suppress(OSError):
        route.connect((outside, 9))
        return str(route.getsockname()[0])
    return None


def listen(host: str, port: int) -> socket.socket:
    """Open a listening socket; wait a little if an earlier server has not yet freed the port."""
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


def _web(site: Site, library: Library, *, fds: tuple[int, int], more: Mapping[str, str]) -> Child:
    """Make the web server, which inherits the acceptor's queue or the listener, and the drain pipe."""
    numbers = {"--fd": fds[0], "--workers": site.workers, "--parent": os.getpid()}
    passed = ["--passed"] if CAN_PASS else []
    return Child(
        "the web server",
        [
            sys.executable, "-m", "webapp.jobs.webserver", site.app, "--library", str(library.folder),
            "--log", site.log, *passed,
            *(text for name, number in numbers.items() for text in (name, str(number))),
        ],
        environment={**environment_for(native_threads(site.workers)), **more},
        fds=fds,
    )  # fmt: skip


def _workers(site: Site, library: Library, *, settings: Settings) -> list[Child]:
    """Make the workers for all jobs, and those for short ones only, which never wait behind long ones."""
    if not settings.serve.job_workers:
        return []
    whole = [worker_child(library, log=site.log, short=False) for _ in range(settings.serve.job_workers)]
    return whole + [
        worker_child(library, log=site.log, short=True) for _ in range(settings.jobs.short_workers)
    ]


def worker_child(library: Library, *, log: Form, short: bool) -> Child:
    """Make a background worker that ends with this process."""
    command = ["worker", "--library", str(library.folder), "--parent", str(os.getpid()), "--log", log]
    return Child(
        "the background worker for short jobs" if short else "the background worker",
        [sys.executable, "-m", "webapp", *command, *(["--short"] if short else [])],
        environment=environment_for(),
    )


@contextmanager
def kept_running(children: Sequence[Child], *, stop_s: float) -> Iterator[None]:
    """Keep processes running during the block, from a thread; then stop them."""
    ended = threading.Event()

    def tend() -> None:
        while not ended.wait(_TICK_S):
            for child in children:
                child.tend()

    thread = threading.Thread(target=tend, name="children", daemon=True)
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()
        for child in children:
            child.ask_to_stop()
        until = time.monotonic() + stop_s
        for child in children:
            child.wait(until)


class _Start:
    """The sample map of a first start, a sign-in link, and the two lines printed when all is ready."""

    def __init__(
        self,
        library: Library,
        listener: socket.socket,
        *,
        settings: Settings,
        progress: Progress | None = None,
    ) -> None:
        self._library = library
        self._progress = progress
        self._shown = (0, 0)  # Steps done and in total, as shown last
        self._poll_at = self._say_at = 0.0
        host, port = listener.getsockname()[:2]
        self._address = (_HERE.get(host, host), port)
        self._elsewhere = _network_address(listener.family) if host in _HERE else None
        self._announced = self._web_answers = False
        self._request: http.client.HTTPConnection | None = None
        with library.database.write() as session:
            owner = accounts.ensure_owner(session)
            self._token = sign_in.new_link(session, owner, hours=settings.web.link_hours)
            self._sample = None
            if session.scalars(select(MapRecord.id).limit(1)).first() is None:
                _log.info("first start: the sample map is made now, then the address is printed")
                sample = jobs.newest(session, None, kind="sample", key="")
                if sample is None or sample.state in ENDED:  # otherwise it is already being made
                    sample = jobs.enqueue(session, "sample", account_id=owner.id)
                self._sample = sample.id

    def poll(self, web: Child, *, echo: Callable[[str], None]) -> None:
        """Report once that the server answers.

        Raises:
            ExpMapError: It keeps exiting instead.
        """
        if self._announced:
            return
        if web.failures >= _MOST_FAILURES:
            raise ExpMapError("the web server did not start", hint="the messages above say why")
        if self._sample_is_made() and self._answers():
            if self._progress is not None:
                self._progress.size(0)
            host, port = self._address
            echo(f"listening on {_url(host, port)}")
            if self._elsewhere is not None:
                there = _url(self._elsewhere, port)
                echo(f"on other machines of this network: {there}/sign-in/{self._token}")
            echo(f"sign in: {_url(host, port)}/sign-in/{self._token}")
            self._announced = True

    def _sample_is_made(self) -> bool:
        if self._sample is None:
            return True
        if time.monotonic() < self._poll_at:
            return False
        self._poll_at = time.monotonic() + _POLL_S
        with self._library.database.read() as session:
            job = jobs.find(session, self._sample)
            self._show(job.done, job.total)
            if job.state in ENDED:
                self._sample = None
        return self._sample is None

    def _show(self, done: int, total: int) -> None:
        """Show how far the sample map is."""
        if self._progress is not None:
            if total != self._shown[1]:
                self._progress.size(total)
                self._shown = (0, total)
            self._progress.advance(done - self._shown[0])
        elif time.monotonic() > self._say_at and total:
            _log.info("making the sample map: %d of %d steps", done, total)
            self._say_at = time.monotonic() + _SAY_S
        self._shown = (done, total)

    def _answers(self) -> bool:
        """Return whether the web processes have answered a request, which waits in their queue meanwhile."""
        if self._web_answers:
            return True
        try:
            if self._request is None:
                self._request = http.client.HTTPConnection(*self._address, timeout=_ANSWERS_WITHIN_S)
                self._request.request("HEAD", "/sign-in")
                self._request.sock.setblocking(False)
            self._request.sock.recv(1, socket.MSG_PEEK)
            self._request.sock.settimeout(_ANSWERS_WITHIN_S)
            self._request.getresponse()
            self._web_answers = True
        except BlockingIOError:
            return False
        except (OSError, http.client.HTTPException) as error:
            _log.debug("the web server does not answer yet: %s", error)
        assert self._request is not None
        self._request.close()
        self._request = None
        return self._web_answers


class Child:
    """A process that is restarted whenever it exits.

    Args:
        environment: Environment of the process; None: that of this process.
    """

    def __init__(
        self,
        name: str,
        command: Sequence[str],
        *,
        environment: Mapping[str, str] | None = None,
        fds: Sequence[int] = (),
    ) -> None:
        self.name = name
        self.failures = 0
        self._command = list(command)
        self._environment = environment
        self._fds = tuple(fds)
        self._process: subprocess.Popen[bytes] | None = None
        self._started_at = self._start_at = 0.0

    def tend(self) -> None:
        """Start the process if it is not running, after a pause that grows with repeated failures."""
        now = time.monotonic()
        if self._process is not None:
            code = self._process.poll()
            if code is None:
                return
            self._signal_all(self._process, signal.SIGTERM)  # its own children may finish their requests
            self._process = None
            self.failures = 1 if now - self._started_at > _WELL_S else self.failures + 1
            pause = min(_FIRST_PAUSE_S * 2 ** (self.failures - 1), _LONGEST_PAUSE_S)
            self._start_at = now + pause
            _log.warning("%s ended (%s); it is started again", self.name, _reason(code))
        if now >= self._start_at:
            self._start()

    def _start(self) -> None:
        # A new session: Ctrl-C in the terminal reaches only the supervisor, which then stops all processes.
        # Standard output is reserved for the supervisor.
        self._process = subprocess.Popen(
            self._command,
            stdin=subprocess.DEVNULL,
            stdout=_STDERR,
            env=self._environment,
            pass_fds=self._fds,
            start_new_session=True,
        )
        self._started_at = time.monotonic()

    def ask_to_stop(self) -> None:
        if self._process is not None:
            self._process.terminate()

    def wait(self, until: float) -> None:
        """Wait for the process to exit, and kill it at the given time (monotonic, seconds)."""
        if self._process is None:
            return
        try:
            self._process.wait(max(until - time.monotonic(), 0.0))
        except subprocess.TimeoutExpired:
            _log.warning("%s does not stop, and is killed", self.name)
        self._signal_all(self._process, signal.SIGKILL)
        self._process.wait()

    @staticmethod
    def _signal_all(process: subprocess.Popen[bytes], number: signal.Signals) -> None:
        """Send a signal to the process group: the process, if still running, and its children."""
        with suppress(ProcessLookupError):
            os.killpg(process.pid, number)


def keep_running(
    children: Sequence[Child],
    *,
    each_tick: Callable[[], None],
    acceptor: Acceptor | None,
    drain: Drain,
    drain_s: float,
    stop_s: float,
) -> None:
    """Keep processes running until SIGINT, SIGTERM or SIGHUP.

    Args:
        each_tick: Called ten times a second; an error in it stops all processes.
        acceptor: Stopped before the processes.
        drain: Begun by the signal.
        drain_s: Seconds from then until the processes get SIGTERM; a second signal ends the wait.
        stop_s: Seconds that the processes have to stop before they are killed.
    """
    stopping = threading.Event()

    def stop(_signal: int, _frame: FrameType | None) -> None:
        stopping.set()

    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, stop)
    try:
        while not stopping.wait(_TICK_S):
            for child in children:
                child.tend()
            each_tick()
            if acceptor is not None and not acceptor.is_running():
                raise ExpMapError("connections are no longer accepted", hint="the messages above say why")
        stopping.clear()
        drain.begin()
        stopping.wait(drain_s)
    finally:
        if acceptor is not None:
            acceptor.stop()
        for child in children:
            child.ask_to_stop()
        until = time.monotonic() + stop_s
        for child in children:
            child.wait(until)


def _reason(code: int) -> str:
    return f"exit code {code}" if code >= 0 else f"signal {signal.Signals(-code).name}"
