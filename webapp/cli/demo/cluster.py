"""All parts of a multi-machine setup on this machine, with a new library and a map."""

from __future__ import annotations

import json
import os
import secrets
import shutil
import signal
import socket
import tempfile
import time
from collections.abc import Callable
from contextlib import ExitStack, suppress
from dataclasses import replace
from http import HTTPStatus
from http.client import HTTPConnection
from pathlib import Path
from types import FrameType, TracebackType
from typing import Self

import click

from webapp.cli.demo.parts import DemoProcess, as_user, module, new_cluster, stop, wait_for_orphans
from webapp.configuration import load_settings
from webapp.errors import ExpMapError, MissingPart, UsageError
from webapp.extras import extra, require
from webapp.jobs.serving import listen
from webapp.settings import environment_for
from webapp.store.accounts import accounts
from webapp.store.library import open_library
from webapp.tasks.maps.adopt_map import adopt_map

_BUCKET, _REGION, _KEY = "photos", "us-east-1", "demo"
_STOP_S = 15.0
_HERE = "127.0.0.1"
_DASK = {"DASK_LOGGING__DISTRIBUTED": "warning", "MALLOC_ARENA_MAX": "1"}


class DemoCluster:
    """Context manager that starts all parts and stops them at the end; all listen on loopback only.

    Args:
        folder: New or empty; for the library, caches and logs.
        map_folder: An initial map, which is copied; by default the sample is made.
        port: Port of the proxy; 0 for any free port.

    Attributes:
        parts: In the order in which they were started.
        address, sign_in: Address of the proxy, and the owner's sign-in link.

    Raises:
        MissingPart: A package is not installed.
        UsageError: The port is taken.
        ExpMapError: A part does not start.
    """

    def __init__(
        self, folder: Path, *, map_folder: Path | None, port: int, echo: Callable[[str], None]
    ) -> None:
        for name in ("cluster", "demo"):
            require(name)
        self.parts: list[DemoProcess] = []
        self.address = self.sign_in = ""
        self._folder, self._map, self._port, self._echo = folder, map_folder, port, echo
        self._library = folder / "library"
        self._logs = folder / "logs"
        self._database: Path | None = None
        self._environment = environment_for()

    def __enter__(self) -> Self:
        listen(_HERE, self._port).close()  # fail early if the port is taken
        try:
            self._start()
        except BaseException:
            self._stop()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._stop()

    def _start(self) -> None:
        for path in (self._library, self._logs):
            path.mkdir(parents=True)
        self._echo("starting the database, the S3 server and Dask")
        objects = self._start_part("S3", "its objects, kept in memory, are lost", "webapp.cli.demo.objects")
        scheduler = self._start_dask(
            "Dask scheduler",
            "jobs wait for it",
            *("scheduler", "--host", _HERE, "--port", 0, "--scheduler-file", self._facts),
        )
        self._environment["EXPMAP_DATABASE"] = self._start_database()
        self._use_objects(objects)
        self._environment["EXPMAP_DASK"] = scheduler.address = self._address_of(scheduler)
        for number in (1, 2):
            self._start_dask(
                f"Dask worker {number}",
                "the other one does its parts",
                *("worker", scheduler.address, "--no-nanny", "--nthreads", 1),
                *("--local-directory", self._logs),
            )
        if self._map is not None:
            self._adopt(self._map)
        self._echo(
            "starting the web servers" + ("" if self._map else "; making the sample takes half a minute")
        )
        self._start_web()

    def _start_database(self) -> str:
        """Start PostgreSQL; returns the address of its database."""
        password, port = secrets.token_urlsafe(16), _free_port()
        self._database, command = new_cluster(password=password)
        part = self._add(
            DemoProcess(
                "PostgreSQL",
                [*command, "-c", f"port={port}"],
                role="no requests are answered",
                folder=self._logs,
                more={"cwd": "/", **as_user()},
                stop_by=signal.SIGINT,  # fast shutdown: does not wait for clients to disconnect
            )
        )
        part.address = f"{_HERE}:{port}"
        with extra("cluster"):
            import psycopg
        for _ in part.attempts():
            try:
                login = f"postgresql://expmap:{password}@{part.address}/postgres"
                with psycopg.connect(login, autocommit=True, connect_timeout=5) as connection:
                    connection.execute("CREATE DATABASE expmap")
                break
            except psycopg.OperationalError:
                continue
        return f"postgresql+psycopg://expmap:{password}@{part.address}/expmap"

    def _use_objects(self, objects: DemoProcess) -> None:
        """Create the bucket, and set the environment of the parts that are started later."""
        objects.address = objects.printed(r"^listening on (\S+)$")
        self._environment |= {
            "AWS_ENDPOINT_URL": objects.address,
            "AWS_ACCESS_KEY_ID": _KEY,
            "AWS_SECRET_ACCESS_KEY": _KEY,
            "AWS_DEFAULT_REGION": _REGION,
            "EXPMAP_STORAGE": f"s3://{_BUCKET}/library",
            "EXPMAP_WEB_PROXIES": "1",
            "NO_PROXY": _HERE,  # the user's network may require a proxy
            "no_proxy": _HERE,
            "EXPMAP_SERVE_JOB_WORKERS": "0",
        }
        connection = HTTPConnection(objects.address.removeprefix("http://"), timeout=_STOP_S)
        connection.request("PUT", f"/{_BUCKET}")  # the server requires no authentication
        if connection.getresponse().status != HTTPStatus.OK:
            raise ExpMapError("the S3 server cannot create a bucket", where=objects.address)
        connection.close()

    def _start_dask(self, name: str, role: str, *arguments: object) -> DemoProcess:
        command = module("dask", *arguments, "--no-dashboard")
        more = {"env": self._environment | _DASK, "cwd": self._logs}
        return self._add(DemoProcess(name, command, role=role, folder=self._logs, more=more))

    @property
    def _facts(self) -> Path:
        return self._logs / "scheduler.json"

    def _address_of(self, scheduler: DemoProcess) -> str:
        """Wait for the scheduler; returns its address."""
        for _ in scheduler.attempts():
            if self._facts.exists() and (text := self._facts.read_text("utf-8")).rstrip().endswith("}"):
                return str(json.loads(text)["address"])
        raise AssertionError("attempts() ends by an error")

    def _adopt(self, map_folder: Path) -> None:
        """Copy a map into the library."""
        library = open_library(self._library, url=self._environment["EXPMAP_DATABASE"])
        try:
            with library.database.write() as session:
                owner = accounts.ensure_owner(session).id
            slug = map_folder.resolve().name
            shutil.copytree(map_folder, library.map_folder(slug))
            settings = replace(load_settings(self._environment), library=self._library)
            adopt_map(library, slug, account_id=owner, settings=settings)
        finally:
            library.database.close()

    def _start_web(self) -> None:
        """Start two web servers, a worker for their jobs, and a reverse proxy in front of them."""
        command = ("serve", "--library", self._library, "--port", 0, "--workers", 1)
        role = "the other one answers"
        nodes = [self._start_part(f"web {n}", role, "webapp", *command, cache=f"web-{n}") for n in (1, 2)]
        self._start_part(
            "jobs",
            "jobs stay queued",
            "webapp",
            "worker",
            "--library",
            self._library,
            cache="jobs",
        )
        for node in nodes:
            node.address = node.printed(r"^listening on (\S+)$")
        link = nodes[0].printed(r"^sign in: http://[^/]+(/\S+)$")
        named = [f"{node.name}={node.address.removeprefix('http://')}" for node in nodes]
        proxy = self._start_part(
            "proxy", "no server can be reached", "webapp.cli.demo.proxy", self._port, *named
        )
        self.address = proxy.address = proxy.printed(r"^listening on (\S+)$")
        self.sign_in = self.address + link

    def _start_part(
        self, name: str, role: str, what: str, *arguments: object, cache: str = ""
    ) -> DemoProcess:
        environment = {**self._environment}
        if cache:  # a separate cache per node, as on separate machines
            environment["EXPMAP_CACHE_FOLDER"] = str(self._folder / "caches" / cache)
        more = {"env": environment}
        return self._add(DemoProcess(name, module(what, *arguments), role=role, folder=self._logs, more=more))

    def _add(self, part: DemoProcess) -> DemoProcess:
        self.parts.append(part)
        return part

    def watch(self) -> None:
        """Report parts that exit, until Ctrl-C (KeyboardInterrupt)."""
        gone: set[str] = set()
        while True:
            for part in self.parts:
                code = part.ended()
                if code is not None and part.name not in gone:
                    gone.add(part.name)
                    self._echo(f"{part.name} (process {part.pid}) has ended: {part.role}")
            time.sleep(0.2)

    def _stop(self) -> None:
        """Stop all parts: first the front ends, then the services that they use."""
        self._echo("stopping")
        for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
            signal.signal(number, signal.SIG_IGN)  # already stopping
        front = [
            part for part in self.parts if part.name in ("proxy", "jobs") or part.name.startswith("web ")
        ]
        behind = [part for part in self.parts if part not in front]
        stop([front], seconds=_STOP_S)
        wait_for_orphans(self._library, seconds=_STOP_S)
        stop([behind], seconds=_STOP_S)
        if self._database is not None:
            shutil.rmtree(self._database)


def check_folder(folder: Path) -> Path:
    """Check that a folder is new or empty; returns its absolute path. Raises UsageError."""
    if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
        raise UsageError("the folder is not empty", where=str(folder), hint="choose a new or empty folder")
    return folder.resolve()


def _free_port() -> int:
    with socket.socket() as trial:
        trial.bind((_HERE, 0))
        return int(trial.getsockname()[1])


@click.command()
@click.option(
    "--port", type=click.IntRange(0, 65535), default=8000, show_default=True, metavar="N",
    help="Port of the proxy, on 127.0.0.1; 0 picks a free one.",
)  # fmt: skip
@click.option(
    "--map", "map_folder", type=click.Path(exists=True, file_okay=False, path_type=Path), metavar="FOLDER",
    help="A folder with a map.cfg to copy, instead of the sample.",
)  # fmt: skip
@click.option(
    "--folder", type=click.Path(path_type=Path), metavar="FOLDER",
    help="Keep library, caches and logs in this folder, new or empty.  [default: a temporary one]",
)  # fmt: skip
def demo(port: int, map_folder: Path | None, folder: Path | None) -> None:
    """Run all parts of a setup of several machines on this one until Ctrl-C.

    PostgreSQL, an S3 server, a Dask scheduler with two workers, two web servers, a worker for jobs and a
    proxy. Prints the address, a sign-in link, and which process to kill to see what happens then. For trying
    it out only: everybody on this machine can reach its parts.
    """
    if os.name == "nt":
        raise MissingPart("the demo does not run natively on Windows", hint="run it in WSL")
    if map_folder is not None and not (map_folder / "map.cfg").is_file():
        raise UsageError("there is no map.cfg", where=str(map_folder), hint="give the folder of a map")
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, _as_ctrl_c)
    with ExitStack() as at_end:
        if folder is None:
            folder = Path(tempfile.mkdtemp(prefix="expmap-demo-"))
            at_end.callback(shutil.rmtree, folder)
        place = check_folder(folder)
        cluster = at_end.enter_context(
            DemoCluster(place, map_folder=map_folder, port=port, echo=lambda text: click.echo(text, err=True))
        )
        click.echo(f"listening on {cluster.address}\nsign in: {cluster.sign_in}\n")
        for part in cluster.parts:
            click.echo(f"{part.name:16} {part.pid:>8}  {part.address:28} killed: {part.role}")
        click.echo(
            f"\nkill -9 NUMBER to see what happens; logs are in {place / 'logs'}; Ctrl-C stops everything",
            err=True,
        )
        with suppress(KeyboardInterrupt):
            cluster.watch()


def _as_ctrl_c(_number: int, _frame: FrameType | None) -> None:
    raise KeyboardInterrupt
