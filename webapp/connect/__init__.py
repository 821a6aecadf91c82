"""Connections to other programs: each folder is one, registers by its `CONNECTION`, and can be removed."""

from __future__ import annotations

import pkgutil
from typing import NamedTuple

from webapp.importing import import_name


class Registration(NamedTuple):
    """What a folder contributes: a command `expmap connect NAME`, NAME being the folder's; routes; jobs."""

    command: str  # "module:object"
    summary: str  # First sentence of its help
    web: str | None = (
        None  # "module:object" of the `webapp.web.state.Parts` that it adds to the web application
    )
    jobs: str | None = None  # "module:object" of the `webapp.jobs.kinds.JobRegistry` that it adds


def connections() -> dict[str, Registration]:
    """Find the connections that are installed, by name."""
    folders = sorted(found.name for found in pkgutil.iter_modules(__path__) if found.ispkg)
    return {name: import_name(f"{__name__}.{name}:CONNECTION") for name in folders}
