"""`expmap build`: the index beside a map."""

from __future__ import annotations

import json
import sys
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from webapp.cli import exitcodes
from webapp.cli.build_text import build_line, tell_failed
from webapp.cli.options import MAP_FILE, chosen_settings, index_options, map_options, open_options
from webapp.cli.progressbar import terminal_progress
from webapp.settings import keep_freed_memory
from webapp.tasks.localize import build_map


@click.command()
@click.argument("map_file", metavar="MAP.cfg", type=MAP_FILE)
@index_options
@map_options
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object.")
def build(map_file: Path, as_json: bool, **chosen: Any) -> None:
    """Build the index of a map, or bring it up to date.

    Only photos that are new or changed are computed. It can be interrupted at any moment; the next build
    goes on where it stopped.
    """
    keep_freed_memory()
    with terminal_progress("photos") as progress:
        report = build_map.build_map(
            map_file, open_options(chosen), settings=chosen_settings(chosen), progress=progress
        )
    index = report.index
    tell_failed(index)
    if as_json:
        raw = asdict(index) | {"folder": str(index.folder), "features": report.features}
        seconds = {
            "orientation_seconds": report.orientation_seconds,
            "calibration_seconds": report.calibration_seconds,
        }
        click.echo(json.dumps(raw | seconds))
    else:
        click.echo(build_line(index, report.features))
    sys.exit(exitcodes.SOME_FAILED if index.failed else exitcodes.DONE)
