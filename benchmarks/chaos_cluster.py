"""The parts of a cluster as processes on this machine, and a thread that kills them at random."""

from __future__ import annotations

import contextlib
import http.client
import os
import random
import signal
import socket
import subprocess
import sys
import threading
import time
import urllib.request
from collections import Counter
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, field
from pathlib import Path
from typing import IO

from benchmarks.killer import descendants
from benchmarks.s3_server import BUCKET, ObjectServer
from tests.cluster.dask_cluster import ROOT, DaskCluster
from tests.postgresql_server import PostgresqlServer

_STARTS_WITHIN_S = 120.0
_PROBES_EVERY_S = 1.0
_DOWN_S = (0.2, 3.0)
"""Range of the random time until a killed part is restarted."""


@dataclass(frozen=True)
class Stores:
    """The database and the storage of a cluster.

    Attributes:
    ----------
    url : str
        URL of the database.
    objects : ObjectServer or None
        The S3 server, if photos are in S3.
    """

    database: PostgresqlServer
    url: str
    objects: ObjectServer | None

    @property
    def storage(self) -> str | None:
        """URL of the storage of photos, unless they are in the library's folder."""
        return f"s3://{BUCKET}/library" if self.objects else None

    @property
    def environ(self) -> dict[str, str]:
        """Environment variables of the program."""
        return {"EXPMAP_DATABASE": self.url} | ({"EXPMAP_STORAGE": self.storage} if self.storage else {})


def start_stores(stack: ExitStack, *, s3: bool) -> Stores:
    """Start PostgreSQL with an empty database, and S3 if wanted, until the end of the context."""
    database = PostgresqlServer()
    stack.callback(database.remove)
    objects = stack.enter_context(ObjectServer(mb_s=100.0, ms=5.0)) if s3 else None
    os.environ.update(objects.environ if objects else {})
    return Stores(database, database.new_database(empty=True), objects)


class Program:
    """A command of the program that runs until it is stopped.

    Attributes:
    ----------
    code : Path
        Checkout that it runs from the next start on.
    log : Path
        File that its standard error is added to from the next start on.
    """

    def __init__(self, words: Sequence[str], *, environ: dict[str, str], log: Path) -> None:
        self.code = ROOT
        self.log = log
        self._words = words
        self._environ = environ
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start it, without waiting until it is ready."""
        with self.log.open("ab") as log:
            self._process = subprocess.Popen(
                [sys.executable, "-m", "webapp", *self._words], cwd=self.code,
                env={**os.environ, "PYTHONPATH": str(self.code), **self._environ},
                stdout=log, stderr=log, start_new_session=True,
            )  # fmt: skip

    def kill(self) -> None:
        """Kill all its processes."""
        process = self._running()
        for pid in (process.pid, *descendants(process.pid)):
            _kill(pid)
        process.wait()

    def end(self) -> None:
        """Stop it by SIGTERM, as a system shutdown does."""
        process = self._running()
        process.terminate()
        try:
            process.wait(_STARTS_WITHIN_S)
        except subprocess.TimeoutExpired:
            self.kill()

    def _running(self) -> subprocess.Popen[bytes]:
        if self._process is None:
            raise RuntimeError("it was not started")
        return self._process


class WebNode(Program):
    """`expmap serve` with its own worker; can be killed as a whole, or one process of it."""

    def __init__(self, library: Path, port: int, *, environ: dict[str, str], log: Path) -> None:
        words = ["serve", "--port", str(port), "--library", str(library), "--workers", "2", "--log", "json"]
        super().__init__(words, environ=environ, log=log)
        self.port = port

    def wait(self) -> None:
        """Wait until it answers."""
        until = time.monotonic() + _STARTS_WITHIN_S
        while True:
            try:
                urllib.request.urlopen(f"http://127.0.0.1:{self.port}/healthz", timeout=20).close()
            except OSError as error:
                if time.monotonic() > until:
                    raise SystemExit(f"a web node does not start, see {self.log}: {error}") from error
                time.sleep(0.1)
            else:
                return

    def kill_one(self, rng: random.Random, *, worker: bool) -> None:
        """Kill its worker, or one of its web processes; it restarts them itself."""
        below = descendants(self._running().pid)
        pids = [pid for pid, command in below.items() if (" worker " in command) is worker]
        if pids:
            _kill(rng.choice(pids))


class Balancer:
    """Forwards connections to the ports in turn, skipping those that do not accept or are not ready."""

    def __init__(self, ports: Iterable[int]) -> None:
        self._ports = list(ports)
        self._ready: set[int] = set()
        self._turn = 0
        self._listener = socket.create_server(("127.0.0.1", 0), backlog=256)

    @property
    def url(self) -> str:
        """Address for clients."""
        return f"http://127.0.0.1:{self._listener.getsockname()[1]}"

    def __enter__(self) -> Balancer:
        threading.Thread(target=self._accept, daemon=True).start()
        for port in self._ports:
            threading.Thread(target=self._probe, args=(port,), daemon=True).start()
        return self

    def __exit__(self, *_: object) -> None:
        self._listener.close()

    def _probe(self, port: int) -> None:
        """Look every second whether a node is ready, as proxies do by `/readyz`."""
        while self._listener.fileno() != -1:
            try:
                urllib.request.urlopen(f"http://127.0.0.1:{port}/readyz", timeout=2).close()
                self._ready.add(port)
            except (OSError, http.client.HTTPException):
                self._ready.discard(port)
            time.sleep(_PROBES_EVERY_S)

    def _accept(self) -> None:
        while True:
            try:
                client, _ = self._listener.accept()
            except OSError:
                return  # the listener was closed
            server = self._connect()
            if server is None:
                client.close()
                continue
            for here, there in ((client, server), (server, client)):
                threading.Thread(target=_pass_on, args=(here, there), daemon=True).start()

    def _connect(self) -> socket.socket | None:
        self._turn += 1
        turn = self._turn % len(self._ports)
        in_turn = [*self._ports[turn:], *self._ports[:turn]]
        for port in sorted(in_turn, key=lambda port: port not in self._ready):
            with contextlib.suppress(OSError):
                server = socket.create_connection(("127.0.0.1", port), 2)
                server.settimeout(None)  # the timeout was only for connecting
                return server
        return None


def _pass_on(here: socket.socket, there: socket.socket) -> None:
    with contextlib.suppress(OSError):
        while data := here.recv(65536):
            there.sendall(data)
    for sock in (here, there):
        with contextlib.suppress(OSError):
            sock.shutdown(socket.SHUT_RDWR)


@dataclass
class Cluster:
    """All parts of the cluster.

    Attributes:
    ----------
    objects : ObjectServer or None
        The S3 server, if photos are in S3.
    outages : list of tuple of float
        Begin and end of the outages of the database, by the monotonic clock.
    """

    database: PostgresqlServer
    dask: DaskCluster
    nodes: list[WebNode]
    objects: ObjectServer | None = None
    outages: list[tuple[float, float]] = field(default_factory=list)

    def start(self) -> None:
        """Start the web nodes, and wait until they answer."""
        for node in self.nodes:
            node.start()
        for node in self.nodes:
            node.wait()

    def restart_database(self) -> None:
        """Stop the database at once, and restart it after a while."""
        begin = time.monotonic()
        self.database.stop(signal.SIGQUIT)
        time.sleep(random.uniform(*_DOWN_S))
        self.database.start()
        self.outages.append((begin, time.monotonic()))

    def end(self) -> None:
        """Stop the nodes and Dask; the database is still needed for the checks."""
        for node in self.nodes:
            node.end()
        self.dask.stop()


class Chaos:
    """Context manager that kills a part of the cluster every few seconds, and restarts it.

    Attributes:
    ----------
    killed : Counter
        Number of kills of each part.
    problems : list of str
        Errors of parts that could not be restarted.
    """

    def __init__(self, cluster: Cluster, *, every_s: float, seed: int) -> None:
        self.killed: Counter[str] = Counter()
        self.problems: list[str] = []
        self._cluster = cluster
        self._every_s = every_s
        self._random = random.Random(seed)
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._work, daemon=True)

    def __enter__(self) -> Chaos:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._end.set()
        self._thread.join()

    def _work(self) -> None:
        parts: dict[str, Callable[[], None]] = {
            "web node": self._kill_node,
            "process of a web node": lambda: self._kill_process(worker=False),
            "worker": lambda: self._kill_process(worker=True),
            "worker of Dask": self._kill_dask_worker,
            "database": self._cluster.restart_database,
        }
        objects = self._cluster.objects
        if objects:
            parts["S3, silent"] = lambda: objects.be_silent(self._random.uniform(*_DOWN_S))
        while not self._end.wait(self._random.uniform(0.3, 1.7) * self._every_s):
            name = self._random.choice(sorted(parts))
            try:
                parts[name]()
            except (OSError, SystemExit, AssertionError) as error:
                self.problems.append(f"{name}: {error}")
            self.killed[name] += 1

    def _kill_node(self) -> None:
        node = self._random.choice(self._cluster.nodes)
        node.kill()
        time.sleep(self._random.uniform(*_DOWN_S))
        node.start()
        node.wait()

    def _kill_process(self, *, worker: bool) -> None:
        self._random.choice(self._cluster.nodes).kill_one(self._random, worker=worker)

    def _kill_dask_worker(self) -> None:
        dask = self._cluster.dask
        process = self._random.choice(dask.workers)
        process.kill()
        process.wait()
        dask.workers.remove(process)
        time.sleep(self._random.uniform(*_DOWN_S))
        dask.start_worker()


def _kill(pid: int) -> None:
    with contextlib.suppress(ProcessLookupError):
        os.kill(pid, signal.SIGKILL)


def tail(log: Path, lines: int = 20) -> str:
    """Read the end of a log."""
    stream: IO[str]
    with log.open(errors="replace") as stream:
        return "".join(stream.readlines()[-lines:])
