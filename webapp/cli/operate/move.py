"""`expmap library move`: move records between SQLite and PostgreSQL, or photos into S3 or back."""

from __future__ import annotations

from contextlib import ExitStack
from pathlib import Path

import click

from webapp.cli.library import existing_library, library_option, library_settings
from webapp.cli.progressbar import terminal_progress
from webapp.errors import UsageError
from webapp.settings import Settings
from webapp.tasks.operate import move as move_records
from webapp.tasks.operate import move_objects

_SQLITE, _SERVER, _STORAGE, _FOLDER = "sqlite", "postgresql", "s3", "folder"


@click.command()
@click.option(
    "--to",
    required=True,
    metavar="WHERE",
    help="For the records: sqlite; postgresql, at the address in EXPMAP_DATABASE; or an address, "
    "postgresql+psycopg://...  For photos and indexes: s3, at the address in EXPMAP_STORAGE; or folder.",
)
@library_option
def move(to: str, library: Path | None) -> None:
    """Move the records of a library from SQLite to PostgreSQL, or its photos into S3, or back.

    Stop its servers and workers first, except for a move to s3. All rows are compared before the new database
    is used, and all files are checked by their hashes. Nothing is deleted: objects are kept, and so is the
    old database, but it can no longer be opened. To complete a move that was killed, run the same command
    again.
    """
    if to not in (_SQLITE, _SERVER, _STORAGE, _FOLDER) and "://" not in to:
        raise UsageError(
            f"cannot move to {to!r}",
            where="--to",
            hint="write sqlite, postgresql, s3, folder, or postgresql+psycopg://user:password@host/database",
        )
    settings = library_settings(library)
    if to in (_STORAGE, _FOLDER):
        _move_objects(to, settings)
    else:
        _move_records(to, settings)


def _move_objects(to: str, settings: Settings) -> None:
    with ExitStack() as stack:
        if to == _STORAGE:
            opened = stack.enter_context(existing_library(settings))
            progress = stack.enter_context(terminal_progress("moving"))
            report = move_objects.move_to_storage(opened, settings, progress=progress)
        else:
            progress = stack.enter_context(terminal_progress("moving"))
            report = move_objects.move_to_folder(settings.library, settings, progress=progress)
    click.echo(f"{settings.library}: {report.files} files, now in {report.place}")
    if to == _FOLDER:
        click.echo("before the next start: unset EXPMAP_STORAGE", err=True)


def _move_records(to: str, settings: Settings) -> None:
    folder = settings.library
    url = settings.database if to in (_SQLITE, _SERVER) else to
    with terminal_progress("moving") as progress:
        if to == _SQLITE:
            report = move_records.move_to_file(folder, url, progress=progress)
        elif url is None:
            raise UsageError(
                "the address of the database is needed",
                where="EXPMAP_DATABASE",
                hint="set it: postgresql+psycopg://user:password@host/database",
            )
        else:
            report = move_records.move_to_server(folder, url, progress=progress)
    rows = sum(table.rows for table in report.tables)
    copied = f"{len(report.tables)} tables, {rows} rows" if report.tables else "the move is complete"
    click.echo(f"{folder}: {copied}, now in {report.place}")
    click.echo(f"kept, but no longer used: {report.kept}", err=True)
    use = "unset EXPMAP_DATABASE" if to == _SQLITE else "set EXPMAP_DATABASE to the new address"
    click.echo(f"before the next start: {use}", err=True)
