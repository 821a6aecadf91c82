"""`expmap find`: find the map of a library on which photos were taken."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

import click
from sqlalchemy import select

from webapp.cli import exitcodes
from webapp.cli.library import existing_library, library_option, library_settings
from webapp.cli.localize import percent
from webapp.cli.progressbar import terminal_progress
from webapp.core.hypotheses.jsonform import failure_to_json
from webapp.errors import PhotoError
from webapp.settings import keep_freed_memory
from webapp.store.schema import MapRecord
from webapp.tasks.find.find_map import LibrarySearch, MapRanking, MapSearch, find_map, search_json
from webapp.tasks.localize.map_cache import MapCache
from webapp.tasks.localize.upload import UploadedPhoto


@click.command(short_help="Say which map photos were taken on.")
@click.argument("photos", metavar="PHOTO...", type=click.Path(path_type=Path), nargs=-1, required=True)
@click.option(
    "--top",
    type=click.IntRange(1),
    default=1,
    show_default=True,
    metavar="N",
    help="Maximum number of places on each map.",
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
@library_option
def find(photos: tuple[Path, ...], top: int, as_json: bool, library: Path | None) -> None:
    """Find out on which map of a library each photo was taken.

    Maps without an index are listed but not searched; expmap build or the Localize page makes one.
    """
    settings = library_settings(library)
    keep_freed_memory()
    forms: list[dict[str, Any]] = []
    failed = False
    with existing_library(settings) as opened:
        with opened.database.read() as session:
            there = (
                select(MapRecord).where(MapRecord.binned_at.is_(None)).order_by(MapRecord.changed_at.desc())
            )
            records = list(session.scalars(there))
        search = LibrarySearch(MapCache(opened, settings), MapRanking(opened, settings), settings)
        for photo in photos:
            try:
                with terminal_progress("maps") as progress:
                    asked = UploadedPhoto(photo, str(photo))
                    found = find_map(search, records, photo=asked, top=top, progress=progress)
            except PhotoError as error:
                failed = True
                click.echo(f"expmap: {error}", err=True)
                forms.append(failure_to_json(query=str(photo), error=str(error)))
                continue
            forms.append(search_json(found, query=str(photo)))
            if not as_json:
                click.echo(_text(found, query=str(photo)))
    if as_json:
        click.echo(json.dumps(forms, indent=2))
    sys.exit(exitcodes.SOME_FAILED if failed else exitcodes.DONE)


def _text(search: MapSearch, *, query: str) -> str:
    lines = [f"{query}: {_verdict(search)}"]
    for found in search.maps:
        places = found.answer["hypotheses"]
        where = f"x {places[0]['x_px']:.0f}, y {places[0]['y_px']:.0f}" if places else "nowhere"
        lines.append(f"  {percent(found.probability)}  {found.slug}: {where}")
    is_whole = not search.not_searched and not search.less_alike
    rest = "on none of them" if is_whole else "on none of these: on a map that was not searched, or on no map"
    lines.append(f"  {percent(search.no_map_probability)}  {rest}")
    lines += [f"  not searched: {one.slug}: {one.reason.message}" for one in search.not_searched]
    if search.less_alike:
        lines.append(f"  not searched: {search.less_alike} further maps, whose photos are less alike")
    return "\n".join(lines)


def _verdict(search: MapSearch) -> str:
    best = search.maps[0] if search.maps else None
    if best is None:
        return "no map could be searched"
    if best.probability >= 0.5:
        return f"on the map {best.name}"
    which = "the maps that were searched" if search.not_searched or search.less_alike else "the maps"
    return f"on none of {which}, or uncertain"
