"""`expmap backup` and `expmap restore`: save a whole library to one file and restore it."""

from __future__ import annotations

import sys
from pathlib import Path

import click

from webapp.cli.composition import Composition
from webapp.cli.exitcodes import DONE, SOME_FAILED
from webapp.cli.library import existing_library, library_option, library_settings
from webapp.cli.progressbar import terminal_progress
from webapp.tasks.operate import backup as backup_library
from webapp.tasks.operate import restore as restore_library


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
        report = restore_library.restore(
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
