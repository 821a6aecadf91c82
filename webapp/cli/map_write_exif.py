"""`expmap map write-exif`: copies of photos that say where they were taken."""

from __future__ import annotations

import json
from dataclasses import asdict
from pathlib import Path

import click

from webapp.cli.exitcodes import SOME_FAILED
from webapp.cli.progressbar import terminal_progress
from webapp.configuration import load_settings
from webapp.tasks.exchange.export_source import of_folder
from webapp.tasks.exchange.write_exif import PhotoCopy
from webapp.tasks.exchange.write_exif import write_exif as copy_photos

_PATH = click.Path(path_type=Path)


@click.command("write-exif", short_help="Copy photos with their positions in EXIF.")
@click.argument("cfg", metavar="MAP.cfg", type=_PATH)
@click.option("-o", "--out", type=_PATH, required=True, metavar="FOLDER", help="Where the copies go.")
@click.option("--json", "as_json", is_flag=True, help="Print the list as one JSON object.")
@click.pass_context
def write_exif(ctx: click.Context, cfg: Path, out: Path, as_json: bool) -> None:
    """Copy the photos of a map, with the positions and headings of the map in their EXIF.

    The map needs a georeference. Originals stay as they are, and no file in FOLDER is replaced. Exit code 1
    when a photo could not be copied.
    """
    settings = load_settings()
    with terminal_progress("photos") as progress:
        copies = list(copy_photos(of_folder(cfg), out, limits=settings.photo, progress=progress))
    written = sum(one.position is not None for one in copies)
    if as_json:
        click.echo(json.dumps({"written": written, "photos": [_as_json(one) for one in copies]}, indent=1))
    else:
        for one in copies:
            click.echo(_line(one))
    click.echo(f"{out}: {written} of {len(copies)} photos copied", err=True)
    if written < len(copies):
        ctx.exit(SOME_FAILED)


def _as_json(one: PhotoCopy) -> dict[str, object]:
    lat, lon = one.position or (None, None)
    facts = asdict(one)
    del facts["position"]
    return facts | {"written": one.position is not None, "lat": lat, "lon": lon}


def _line(one: PhotoCopy) -> str:
    facts = []
    if one.position is None:
        facts.append("not copied")
    else:
        facts.append(f"{one.position.lat:.7f}, {one.position.lon:.7f}")
        if one.heading_deg is not None:
            facts.append(f"{one.heading_deg:.1f} degrees")
    if one.reason:
        facts.append(one.reason)
    return f"{one.photo}  {'; '.join(facts)}"
