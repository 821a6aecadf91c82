"""`expmap serve` and `expmap worker`: run the web application, and a worker for background jobs."""

from __future__ import annotations

import logging
import os
import sys
from collections.abc import Callable
from contextlib import suppress
from pathlib import Path
from typing import Any

import click

from webapp import telemetry
from webapp.cli.composition import Composition
from webapp.cli.library import library_option, library_settings
from webapp.cli.progressbar import TerminalProgress
from webapp.configuration import refuse_script_name
from webapp.jobs import serving
from webapp.logs import FORMS, Form, log_to_stderr
from webapp.store.library import open_library
from webapp.tasks.operate.open_storage import open_storage

_log = logging.getLogger(__name__)

_NICENESS = 5
"""Niceness of a background worker: the pages have priority."""

_NICENESS_SHORT = 2
"""The same of one for short jobs, for which somebody waits."""

_AUTOGROUP = Path("/proc/self/autogroup")


def log_option(command: Callable[..., Any]) -> Callable[..., Any]:
    """Add the option `--log`."""
    return click.option(
        "--log", type=click.Choice(FORMS), default="text", show_default=True,
        help="Format of the log on standard error.",
    )(command)  # fmt: skip


@click.command()
@click.option(
    "--host", default="127.0.0.1", show_default=True, metavar="ADDRESS", help="Address to listen on."
)
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    default=8000,
    show_default=True,
    metavar="N",
    help="Port to listen on; 0 picks a free one.",
)
@library_option
@click.option(
    "--workers",
    type=click.IntRange(1),
    metavar="N",
    help="Number of processes that answer requests.  [default: 3]",
)
@log_option
@click.pass_obj
def serve(
    composition: Composition, host: str, port: int, library: Path | None, workers: int | None, log: Form
) -> None:
    """Serve the maps of a library as web pages until Ctrl-C.

    The first start creates the library, with the sample map and an owner's account. Once the server is ready,
    it prints its address and a one-time sign-in link for the owner.
    """
    log_to_stderr(log)
    settings = library_settings(library)
    refuse_script_name()
    telemetry.start(settings.traces)
    site = serving.Site(composition.web_app, host, port, workers or settings.serve.workers, log)
    shown = TerminalProgress("making the sample map") if sys.stderr.isatty() else None
    serving.serve(site, settings=settings, echo=click.echo, progress=shown)


@click.command()
@library_option
@click.option("--once", is_flag=True, help="Exit when there is nothing left to do.")
@click.option(
    "--parent", type=int, metavar="PID", help="Exit when this process, which started it, has ended."
)
@click.option("--short", is_flag=True, help="Do only short jobs, for which people wait.")
@log_option
@click.pass_obj
def worker(
    composition: Composition, library: Path | None, once: bool, parent: int | None, short: bool, log: Form
) -> None:
    """Run the background jobs of a library until Ctrl-C.

    `expmap serve` starts one itself. Further workers share the work, on this machine or on others that can
    access the same library. Each starts a second process for short jobs, which so never wait behind
    long ones.
    """
    if parent is not None:
        _give_way(_NICENESS_SHORT if short else _NICENESS)
    from webapp.jobs.worker import Worker  # loads OpenCV, which the server does not need
    from webapp.tasks.operate.models import advice  # so does this

    log_to_stderr(log)
    settings = library_settings(library)
    telemetry.start(settings.traces)
    opened = open_library(settings.library, url=settings.database)
    open_storage(opened, settings)
    if parent is not None and not short and (said := advice(settings)):
        _log.info(said)
    registry = composition.registry()
    working = Worker(opened, settings, registry=registry, parent=parent, only_short=short)
    working.stop_on_signals()
    alone = once or short or parent is not None
    beside = 0 if alone else settings.jobs.short_workers
    children = [serving.worker_child(opened, log=log, short=True) for _ in range(beside)]
    with serving.kept_running(children, stop_s=settings.jobs.stop_s + serving.SPARE_S):
        working.run(once=once)
    opened.database.close()


def _give_way(niceness: int) -> None:
    """Lower this process's priority, also that of its session: Linux may share the cores between sessions."""
    if hasattr(os, "nice"):
        os.nice(niceness)
    if _AUTOGROUP.exists():
        with suppress(OSError):  # the session belongs to another user, or its priority was just changed
            _AUTOGROUP.write_text(str(niceness))
