"""Commands for a whole library: back up, restore, move to another database or storage, check."""

from __future__ import annotations

import json
import sys
from collections.abc import Iterator
from contextlib import ExitStack
from dataclasses import asdict
from pathlib import Path

import click

from webapp.cli.composition import Composition
from webapp.cli.exitcodes import DONE, SOME_FAILED
from webapp.cli.library import existing_library, library_option, library_settings
from webapp.cli.progressbar import terminal_progress
from webapp.errors import UsageError
from webapp.settings import Settings
from webapp.tasks.operate import backup as backup_library
from webapp.tasks.operate import doctor as task
from webapp.tasks.operate import move as move_tasks


@click.command()
@click.argument("file", type=click.Path(dir_okay=False, path_type=Path))
@library_option
@click.pass_obj
def backup(composition: Composition, file: Path, library: Path | None) -> None:
    """Back up a whole library to FILE, a zip archive.

    The library may be served and changed meanwhile. Accounts are part of it: keep FILE where only you can
    read it.
    """
    with (
        existing_library(library_settings(library)) as opened,
        terminal_progress("copying") as progress,
    ):
        report = backup_library.back_up(opened, file, parts=composition.library_parts(), progress=progress)
    for name in report.missing:
        click.echo(f"{name}: the library has lost this file", err=True)
    click.echo(
        f"{file}: {report.maps} maps, {report.photos} photos, {report.files} files, "
        f"{report.size_bytes / 1e6:.1f} MB"
    )
    sys.exit(SOME_FAILED if report.missing else DONE)


@click.command()
@click.argument("file", type=click.Path(dir_okay=False, path_type=Path))
@library_option
@click.option(
    "--force",
    is_flag=True,
    help="Restore even if the folder is not empty; its content is moved to another folder.",
)
@click.pass_obj
def restore(composition: Composition, file: Path, library: Path | None, force: bool) -> None:
    """Restore a library from the backup FILE.

    The whole backup is checked first. With EXPMAP_DATABASE, the records go into that database, which has to
    be empty. Indexes are rebuilt by the first server or worker.
    """
    settings = library_settings(library)
    folder = settings.library
    with terminal_progress("unpacking") as progress:
        report = backup_library.restore(
            file,
            folder,
            parts=composition.library_parts(),
            url=settings.database,
            force=force,
            progress=progress,
        )
    if report.before is not None:
        click.echo(f"the previous content is now in {report.before}", err=True)
    click.echo(
        f"{folder}: {report.maps} maps, {report.photos} photos, {report.files} files, as of {report.made_at}"
    )


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
            report = move_tasks.move_to_storage(opened, settings, progress=progress)
        else:
            progress = stack.enter_context(terminal_progress("moving"))
            report = move_tasks.move_to_folder(settings.library, settings, progress=progress)
    click.echo(f"{settings.library}: {report.files} files, now in {report.place}")
    if to == _FOLDER:
        click.echo("before the next start: unset EXPMAP_STORAGE", err=True)


def _move_records(to: str, settings: Settings) -> None:
    folder = settings.library
    url = settings.database if to in (_SQLITE, _SERVER) else to
    with terminal_progress("moving") as progress:
        if to == _SQLITE:
            report = move_tasks.move_to_file(folder, url, progress=progress)
        elif url is None:
            raise UsageError(
                "the address of the database is needed",
                where="EXPMAP_DATABASE",
                hint="set it: postgresql+psycopg://user:password@host/database",
            )
        else:
            report = move_tasks.move_to_server(folder, url, progress=progress)
    rows = sum(table.rows for table in report.tables)
    copied = f"{len(report.tables)} tables, {rows} rows" if report.tables else "the move is complete"
    click.echo(f"{folder}: {copied}, now in {report.place}")
    click.echo(f"kept, but no longer used: {report.kept}", err=True)
    use = "unset EXPMAP_DATABASE" if to == _SQLITE else "set EXPMAP_DATABASE to the new address"
    click.echo(f"before the next start: {use}", err=True)


_SIGNS = {"ok": "ok     ", "warning": "warning", "failing": "FAILING"}


@click.command()
@library_option
@click.option(
    "--host", default="127.0.0.1", show_default=True, metavar="ADDRESS", help="Address to serve at."
)
@click.option(
    "--port", type=click.IntRange(1, 65535), default=8000, show_default=True, metavar="N", help="Its port."
)
@click.option("--json", "as_json", is_flag=True, help="Print JSON.")
def doctor(library: Path | None, host: str, port: int, as_json: bool) -> None:
    """Check this installation and a library, and say what to do.

    Changes nothing, and may be used while the library is served. The exit code is 1 if something fails.
    """
    checks = []
    settings = library_settings(library)
    for check in _all(settings, host, port):
        checks.append(check)
        if not as_json:
            click.echo(f"{_SIGNS[check.state]}  {check.name}: {check.message}")
            if check.hint:
                click.echo(f"         -> {check.hint}")
    if as_json:
        click.echo(json.dumps([asdict(check) for check in checks], ensure_ascii=False))
    sys.exit(SOME_FAILED if any(check.state == "failing" for check in checks) else DONE)


def _all(settings: Settings, host: str, port: int) -> Iterator[task.Check]:
    yield from task.check_installation(settings)
    yield from task.check_library(settings)
    yield from task.check_address(host, port, settings=settings)
