"""`expmap serve`: the web application."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import click

from webapp.cli.composition import Composition
from webapp.cli.log import log_option
from webapp.configuration import load_settings
from webapp.jobs import serving
from webapp.jobs.logs import Form, log_to_stderr


@click.command()
@click.option("--host", default="127.0.0.1", show_default=True, metavar="ADDRESS", help="Listen there.")
@click.option(
    "--port",
    type=click.IntRange(0, 65535),
    default=8000,
    show_default=True,
    metavar="N",
    help="Listen there; 0 takes any that is free.",
)
@click.option(
    "--library", type=click.Path(path_type=Path), metavar="FOLDER",
    help="Folder of the maps.  [default: EXPMAP_LIBRARY, or maps]",
)  # fmt: skip
@click.option(
    "--workers", type=click.IntRange(1), metavar="N", help="Processes that answer requests.  [default: 3]"
)
@log_option
@click.pass_obj
def serve(
    composition: Composition, host: str, port: int, library: Path | None, workers: int | None, log: Form
) -> None:
    """Serve the maps of a library as pages, until Ctrl-C.

    The first start makes the library, with the sample map and an owner's account. Once the server answers,
    its address is printed, and a link that signs the owner in once.
    """
    log_to_stderr(log)
    settings = load_settings()
    if library is not None:
        settings = replace(settings, library=library)
    site = serving.Site(composition.web_app, host, port, workers or settings.serve.workers, log)
    serving.serve(site, settings=settings, tell=click.echo)
