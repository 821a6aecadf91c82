"""`expmap mission inspect`: shows the content of track files before they are imported."""

from __future__ import annotations

import json
from pathlib import Path
from typing import Any

import click

from webapp.cli.exitcodes import DONE, SOME_FAILED
from webapp.cli.progressbar import terminal_progress
from webapp.errors import InputError
from webapp.files.exchange.times import utc
from webapp.missions.core.trajectory.axes import AXES
from webapp.missions.files.track_reader import with_axes
from webapp.missions.tasks import inspect_file
from webapp.missions.tasks.import_order import order_of
from webapp.missions.tasks.inspect_file import FileReport, FileSource

_SHOWN = 50
"""Maximum number of sources to print."""


@click.command()
@click.argument("files", nargs=-1, required=True, type=click.Path(path_type=Path))
@click.option("--columns", metavar="TEXT", help="Columns of a CSV: time=stamp:ms, lat=Latitude, lon=3 ...")
@click.option("--axes", type=click.Choice(AXES), help=f"Axes of {with_axes()} files.  [default: detected]")
@click.option("--json", "as_json", is_flag=True, help="Print one JSON object per file, one per line.")
def inspect(files: tuple[Path, ...], columns: str | None, axes: str | None, as_json: bool) -> int:
    """Show what FILES contain: each source with its poses, times and extent, and anything odd.

    Nothing is stored, and no library is needed.
    """
    failed = 0
    with terminal_progress("reading") as progress:
        for path in files:
            options = order_of(path, {"name": path.name, "columns": columns, "axes": axes}).options
            try:
                report = inspect_file.inspect_file(path, options=options, progress=progress)
            except InputError as error:
                if as_json:
                    click.echo(json.dumps({"file": path.name, "problem": str(error)}, ensure_ascii=False))
                else:
                    click.echo(f"expmap: {error}", err=True)
                failed += 1
                continue
            failed += bool(report.problem)
            if as_json:
                whole: dict[str, Any] = {"file": path.name, **inspect_file.as_json(report, lines=False)}
                click.echo(json.dumps(whole, ensure_ascii=False))
            else:
                _print(path, report)
    return SOME_FAILED if failed else DONE


def _print(path: Path, report: FileReport) -> None:
    click.echo(f"{path.name}: {report.kind}")
    for source in report.sources[:_SHOWN]:
        name = f" {source.track!r}" if source.track else ""
        click.echo(f"  {source.source}{name}: {_facts(source)}")
    if len(report.sources) > _SHOWN:
        click.echo(f"  and {len(report.sources) - _SHOWN} more")
    if report.objects:
        click.echo(f"  {report.objects} sightings of objects")
    if report.table is not None and report.table.columns:
        click.echo(f"  columns: {', '.join(report.table.named())}")
    for one in report.skipped:
        click.echo(f"  left out: {one}, first: {one.where}")
    for one in report.doubts:
        click.echo(f"  odd: {one}, first: {one.where}")
    for note in report.notes:
        click.echo(f"  note: {note}")
    if report.problem:
        click.echo(f"expmap: {report.problem}", err=True)


def _facts(source: FileSource) -> str:
    facts = [f"{source.poses} poses"]
    if source.first_time_s is None or source.last_time_s is None:
        facts.append("no times")
    else:
        first, last = utc([source.first_time_s, source.last_time_s])
        facts.append(f"{first[:19]}Z to {last[:19]}Z")
    extent = source.extent
    if source.frame == "earth":
        south_north = f"{extent['south']:.6f} to {extent['north']:.6f} north"
        facts.append(f"{south_north}, {extent['west']:.6f} to {extent['east']:.6f} east")
    else:
        facts.append(f"{extent['x']:.1f} m x {extent['y']:.1f} m x {extent['z']:.1f} m in the robot's frame")
    facts.append(f"{source.headings} headings")
    return ", ".join(facts)
