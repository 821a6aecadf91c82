"""`expmap connect forms`: show what an export of a field form has, or add it to a map."""

from __future__ import annotations

from pathlib import Path
from tempfile import TemporaryDirectory

import click

from webapp.cli.library import library_option, library_settings, opened_library
from webapp.connect.forms.importing import FormFile, FormPhoto, GivenExport, import_export, read_export
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.store.accounts import accounts
from webapp.store.maps import maps


@click.command(short_help="Show the photos, positions and notes of an export of ODK, KoboToolbox or QField.")
@click.argument(
    "export", nargs=-1, required=True, type=click.Path(exists=True, dir_okay=False, path_type=Path)
)
@click.option("--all-answers", is_flag=True, help="Write all answers into the notes, not only comments.")
@click.option(
    "--into", metavar="MAP", help="Add the photos to this map of the library, by its name in addresses."
)
@library_option
def forms(export: tuple[Path, ...], all_answers: bool, into: str | None, library: Path | None) -> None:
    """Show what the files EXPORT have: a zip, or a table and a zip with the photos. Nothing is changed."""
    settings = library_settings(library)
    given = GivenExport([FormFile(path, path.name) for path in export], all_answers)
    if into is None:
        _show(given, settings=settings)
    else:
        _add(given, into, settings=settings)


def _show(given: GivenExport, *, settings: Settings) -> None:
    with TemporaryDirectory() as folder:
        found = read_export(given, folder=Path(folder), settings=settings, progress=Progress())
        for photo in found.photos:
            click.echo(_line(photo))
    _echo_rest(found.missing, found.unnamed)


def _add(given: GivenExport, into: str, *, settings: Settings) -> None:
    with opened_library(settings) as opened:
        with opened.database.write() as session:
            record = maps.find(session, into, account=accounts.ensure_owner(session), role="editor")
        report = import_export(opened, record.id, given=given, settings=settings, progress=Progress())
    click.echo(f"{report.added} photos added, {report.placed} of them placed; {report.duplicates} were there")
    for failed in report.failed:
        click.echo(f"{failed['name']}: {failed['reason']}", err=True)
    _echo_rest(report.missing, report.unnamed)


def _line(photo: FormPhoto) -> str:
    at = photo.stated.position
    place = "no position" if at is None else f"{at.lat:.6f} {at.lon:.6f}"
    note = (photo.stated.note or "").replace("\n", " / ")
    return f"{photo.name}: {place}{f', {note}' if note else ''}"


def _echo_rest(missing: list[str], unnamed: list[str]) -> None:
    for name in missing:
        click.echo(f"{name}: not in the export", err=True)
    for name in unnamed:
        click.echo(f"{name}: named in no table, left out", err=True)
