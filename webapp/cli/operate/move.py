"""`expmap library move`: the records of a library from one kind of database to the other."""

from __future__ import annotations

from pathlib import Path

import click

from webapp.cli.library import library_option, library_settings
from webapp.cli.progressbar import terminal_progress
from webapp.errors import UsageError
from webapp.tasks.operate import move as move_records

_SQLITE, _SERVER = "sqlite", "postgresql"


@click.command()
@click.option(
    "--to",
    required=True,
    metavar="WHERE",
    help="sqlite; postgresql, at the address of EXPMAP_DATABASE; or an address, postgresql+psycopg://...",
)
@library_option
def move(to: str, library: Path | None) -> None:
    """Move the records of a library from SQLite to PostgreSQL, or back.

    Stop its servers and workers first. All rows are compared before the new database is used. Nothing is
    deleted: the old one is kept, but cannot be opened any more. A move that was killed is completed by the
    same command.
    """
    settings = library_settings(library)
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
    click.echo(f"kept, and not used any more: {report.kept}", err=True)
    use = "unset EXPMAP_DATABASE" if to == _SQLITE else "set EXPMAP_DATABASE to the new address"
    click.echo(f"before the next start: {use}", err=True)
