"""`expmap worker`: does the jobs of a library."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path

import click

from webapp.cli.composition import Composition
from webapp.cli.log import log_option
from webapp.configuration import load_settings
from webapp.jobs.logs import Form, log_to_stderr
from webapp.jobs.worker import Worker
from webapp.store.library import open_library

_POLITENESS = 5
"""A page that somebody waits for goes before work in the background."""


@click.command()
@click.option(
    "--library", type=click.Path(path_type=Path), metavar="FOLDER",
    help="Folder of the maps.  [default: EXPMAP_LIBRARY, or maps]",
)  # fmt: skip
@click.option("--once", is_flag=True, help="End when there is nothing left to do.")
@click.option("--parent", type=int, metavar="PID", help="End when this process, which started it, has ended.")
@log_option
@click.pass_obj
def worker(composition: Composition, library: Path | None, once: bool, parent: int | None, log: Form) -> None:
    """Do the long work of a library in the background, until Ctrl-C.

    `expmap serve` starts one itself. More of them share the work, on this machine or others that see the same
    library.
    """
    log_to_stderr(log)
    settings = load_settings()
    if library is not None:
        settings = replace(settings, library=library)
    if parent is not None and hasattr(os, "nice"):
        os.nice(_POLITENESS)
    opened = open_library(settings.library)
    working = Worker(opened, settings, duties=composition.duties(), parent=parent)
    working.stop_on_signals()
    working.run(once=once)
    opened.database.close()
