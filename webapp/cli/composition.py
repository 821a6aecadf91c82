"""The context object of the commands, and the settings that they use.

It must not import the database, the web or OpenCV: servers fork from the process that has loaded it.
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import TYPE_CHECKING

from webapp.configuration import load_settings
from webapp.files.contents import connect, settings_at
from webapp.settings import Settings

if TYPE_CHECKING:
    from webapp.jobs.kinds import JobRegistry
    from webapp.tasks.operate.backup import LibraryPart


@dataclass(frozen=True, slots=True)
class Composition:
    """The object of the root command's context."""

    web_app: str  # "module:function" that makes the web application, in the processes that answer requests
    registry: Callable[[], JobRegistry]  # Returns the kinds of jobs and sweeps of a worker
    library_parts: Callable[[], Sequence[LibraryPart]]  # Returns the parts of a library other than maps


def settings_in_use(cfg: Path) -> Settings:
    """Load the settings, and connect to the object storage of the library that a map is in, if any.

    Raises:
        UsageError, MissingPart: A setting is wrong, or something that it needs is not installed.
        StorageError: The library has another storage than the settings name.
    """
    settings = settings_at(cfg, load_settings())
    connect(settings)
    return settings
