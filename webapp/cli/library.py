"""Helpers of commands on a library: the option `--library`, and opening the library."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path
from typing import TypeVar

import click

from webapp.configuration import load_settings
from webapp.errors import NotFound
from webapp.settings import Settings
from webapp.store.library import Library, has_library, open_library
from webapp.tasks.operate.open_storage import open_storage

Command = TypeVar("Command", bound=Callable[..., object])


def library_option(command: Command) -> Command:
    """Add the option `--library`."""
    return click.option(
        "--library", type=click.Path(path_type=Path), metavar="FOLDER",
        help="Folder of the maps.  [default: EXPMAP_LIBRARY, or maps]",
    )(command)  # fmt: skip


def library_settings(folder: Path | None) -> Settings:
    """Load the settings; the given folder overrides the library."""
    settings = load_settings()
    return settings if folder is None else replace(settings, library=folder)


@contextmanager
def opened_library(settings: Settings) -> Iterator[Library]:
    """Open the library of a command, with its object storage.

    Raises:
        StorageError: The records or the object storage cannot be used, or the library has another storage.
    """
    library = open_library(settings.library, url=settings.database)
    try:
        open_storage(library, settings)
        yield library
    finally:
        library.database.close()


@contextmanager
def existing_library(settings: Settings) -> Iterator[Library]:
    """Open the library of a command that does not create one.

    Raises:
        NotFound: There is no library in the folder.
        StorageError: As for `opened_library`.
    """
    if not has_library(settings.library):
        raise NotFound(
            "there is no library in this folder",
            where=str(settings.library),
            hint="set it: --library FOLDER",
        )
    with opened_library(settings) as library:
        yield library
