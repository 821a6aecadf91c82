"""`expmap cluster demo`: run a multi-machine setup on one machine."""

from __future__ import annotations

import os
import shutil
import signal
import tempfile
from contextlib import ExitStack, suppress
from pathlib import Path
from types import FrameType

import click

from webapp.cli.demo.cluster import DemoCluster, check_folder
from webapp.errors import MissingPart, UsageError


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
