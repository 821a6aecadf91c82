"""`expmap map print`: print a map as PDF or PNG."""

from __future__ import annotations

import json
from datetime import date
from pathlib import Path

import click

from webapp.cli.composition import settings_in_use
from webapp.cli.options import MAP_FILE
from webapp.core.geo.floors import BASE_FLOOR
from webapp.core.mapmodel.model import Map
from webapp.errors import UsageError
from webapp.files.atomic import write_bytes
from webapp.render.sheet.make import print_map
from webapp.render.sheet.options import (
    EXTENTS,
    LABELS,
    LEAST_DPI,
    MOST_DPI,
    ORIENTATIONS,
    PAPERS,
    SHEET_FORMATS,
    USUAL_DPI,
    Extent,
    Labels,
    Orientation,
    Paper,
    SheetAnswer,
    SheetOptions,
    answers_from_json,
    english,
)
from webapp.tasks.exchange.export_source import of_folder

_OUT = click.Path(dir_okay=False, path_type=Path)


@click.command("print", short_help="Print a map as PDF or PNG.")
@click.argument("cfg", metavar="MAP.cfg", type=MAP_FILE)
@click.argument("out", metavar="OUT.pdf|OUT.png", type=_OUT)
@click.option(
    "--paper", type=click.Choice(PAPERS), default="a4", show_default=True, help="Size of the paper."
)
@click.option(
    "--orientation", type=click.Choice(ORIENTATIONS), default="auto", show_default=True,
    help="auto: whichever makes the map larger.",
)  # fmt: skip
@click.option(
    "--dpi", type=click.IntRange(LEAST_DPI, MOST_DPI), default=USUAL_DPI, show_default=True, metavar="N",
    help="Pixels per inch; in a PDF, of the satellite image only.",
)  # fmt: skip
@click.option(
    "--labels", type=click.Choice(LABELS), default="numbers", show_default=True,
    help="What is written next to the photos: nothing, their ids, their names.",
)  # fmt: skip
@click.option("--no-headings", is_flag=True, help="Do not show where the photos look.")
@click.option("--control-points", is_flag=True, help="Show the control points.")
@click.option("--no-notes", is_flag=True, help="Do not show the notes on spots of the map.")
@click.option(
    "--extent", type=click.Choice(EXTENTS), default="image", show_default=True,
    help="The whole image, or the surroundings of the photos.",
)  # fmt: skip
@click.option("--title", metavar="TEXT", help="Title of the sheet, instead of the map's.")
@click.option(
    "--attribution", metavar="TEXT", default="", help="Credit for the image; default: its tile service."
)
@click.option(
    "--floor", metavar="NAME", help="Name or level of the floor; default: that of the map's own image."
)
@click.option(
    "--all-floors", is_flag=True, help="Print each floor on its own page, the lowest first; PDF only."
)
@click.option(
    "--answers", type=click.Path(exists=True, dir_okay=False, path_type=Path), metavar="FILE",
    help="Output of `expmap localize --json`: show the best place of each photo.",
)  # fmt: skip
def print_command(
    cfg: Path,
    out: Path,
    paper: Paper,
    orientation: Orientation,
    dpi: int,
    labels: Labels,
    no_headings: bool,
    control_points: bool,
    no_notes: bool,
    extent: Extent,
    title: str | None,
    attribution: str,
    floor: str | None,
    all_floors: bool,
    answers: Path | None,
) -> None:
    """Print a map on one sheet of paper: its image with the photos on it, legend, scale, north and date.

    If a map has several floors, one is printed, or all of them, each on its own page.

    The scale and north are those of the map's georeference; without one the sheet says so. In a PDF
    text and marks are sharp at any size.
    """
    form = out.suffix[1:].lower()
    if form not in SHEET_FORMATS:
        raise UsageError("the name of the file must end with .pdf or .png", where=str(out))
    if all_floors and floor is not None:
        raise UsageError("--floor and --all-floors cannot be used together", hint="give one of them")
    source = of_folder(cfg)
    options = SheetOptions(
        paper,
        orientation,
        dpi,
        labels,
        not no_headings,
        control_points,
        not no_notes,
        extent,
        title,
        attribution,
        None if all_floors else _floor(source.map, floor),
    )
    data = print_map(
        source,
        form=form,
        options=options,
        words=english(date.today().isoformat()),
        settings=settings_in_use(cfg),
        answers=() if answers is None else _answers(answers),
    )
    write_bytes(out, data)
    click.echo(str(out))


def _floor(map_: Map, wanted: str | None) -> int:
    """Find a floor by its name or level."""
    if wanted is None:
        return BASE_FLOOR
    for floor in map_.floors:
        if wanted in (floor.name, f"{floor.level:g}"):
            return floor.id
    names = ", ".join(f"{floor.name} ({floor.level:g})" for floor in map_.floors) or "none"
    raise UsageError(f"the map has no floor {wanted!r}", hint=f"its floors are: {names}")


def _answers(file: Path) -> tuple[SheetAnswer, ...]:
    try:
        return answers_from_json(json.loads(file.read_text("utf-8")))
    except (ValueError, KeyError, TypeError, AttributeError) as error:
        raise UsageError(
            "the file does not contain answers", where=str(file), hint="run expmap localize --json"
        ) from error
