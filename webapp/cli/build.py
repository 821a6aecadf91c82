"""`expmap build`: build the index of a map, and print a summary."""

from __future__ import annotations

import json
import sys
import time
from dataclasses import asdict
from pathlib import Path
from typing import Any

import click

from webapp.cli import exitcodes
from webapp.cli.options import MAP_FILE, chosen_settings, index_options, map_options, open_options
from webapp.cli.progressbar import terminal_progress
from webapp.settings import keep_freed_memory
from webapp.tasks.localize import build_map
from webapp.tasks.localize.build_index import count_reasons
from webapp.tasks.localize.open_map import BuildReport


@click.command()
@click.argument("map_file", metavar="MAP.cfg", type=MAP_FILE)
@index_options
@map_options
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def build(map_file: Path, as_json: bool, **chosen: Any) -> None:
    """Build the index of a map, or bring it up to date.

    Only new and changed photos are computed. It can be interrupted at any time; the next build continues
    where this one stopped.
    """
    keep_freed_memory()
    started = time.perf_counter()
    with terminal_progress("photos") as progress:
        report = build_map.build_map(
            map_file, open_options(chosen), settings=chosen_settings(map_file, chosen), progress=progress
        )
    index = report.index
    second = report.second
    report_failed(index, *([second.index] if second else []))
    if as_json:
        raw = asdict(index) | {"folder": str(index.folder), "features": report.features}
        seconds = {
            "orientation_seconds": report.orientation_seconds,
            "calibration_seconds": report.calibration_seconds,
        }
        looks = {
            "second_look": second.features if second else None,
            "global_descriptor": report.global_descriptor,
        }
        click.echo(json.dumps(raw | seconds | looks))
    else:
        click.echo(build_line(index, report.features))
        if second:
            click.echo(build_line(second.index, second.features))
        if report.calibration_seconds is not None:
            click.echo(f"{time.perf_counter() - started:.1f} s in total, including calibration")
    failed = index.failed or (second and second.index.failed)
    sys.exit(exitcodes.SOME_FAILED if failed else exitcodes.DONE)


def report_failed(*reports: BuildReport | None) -> None:
    """Print each map photo that could not be used once, and a count of the reasons, to standard error."""
    failed = dict.fromkeys(photo for report in reports if report for photo in report.failed)
    for number, photo, reason in failed:
        click.echo(f"{photo} (id {number}): {reason}", err=True)
    if len(failed) > 1:
        counted = count_reasons((photo, reason) for _, photo, reason in failed)
        click.echo(f"could not be used: {counted}", err=True)


def build_line(report: BuildReport, features: str) -> str:
    """Summarise a build in one line."""
    return (
        f"{report.folder}: {report.photos} photos with {features}, {report.extracted} computed, "
        f"{report.reused} kept, {report.removed} removed, {len(report.failed)} failed; "
        f"{report.descriptors} descriptors, {report.bytes / 1e6:.1f} MB, {report.seconds:.1f} s"
    )
