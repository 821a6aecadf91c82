"""Kinds of jobs: each has a name and a function, which is imported for the first job of its kind.

To add a kind, write a function of a `Context`, and add it to `KINDS` or to the table of a subpackage. It may
be killed at any moment and is then called again: each step must be repeatable, and its result saved.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from webapp.errors import UsageError
from webapp.importing import import_name
from webapp.jobs.context import Context
from webapp.settings import Settings
from webapp.store.library import Library

Function = Callable[[Context], Mapping[str, Any] | None]
"""Does a job and returns its result, as JSON values."""

Sweep = Callable[[Library, Settings], object]
"""Deletes leftovers of interrupted work, or queues jobs that are due."""

KINDS: dict[str, str] = {
    "blur": "webapp.jobs.map_jobs:suggest_blurring",
    "describe-library": "webapp.jobs.map_jobs:describe_all_maps",
    "evaluate": "webapp.jobs.map_jobs:evaluate_map",
    "export": "webapp.jobs.map_jobs:export_map_file",
    "health": "webapp.jobs.map_jobs:find_weak_photos",
    "import": "webapp.jobs.map_jobs:import_map_zip",
    "index": "webapp.jobs.map_jobs:build_map_index",
    "landmarks": "webapp.jobs.map_jobs:build_landmarks",
    "models": "webapp.jobs.model_jobs:fetch_models",
    "place-rest": "webapp.jobs.map_jobs:suggest_places",
    "satellite-pyramid": "webapp.jobs.map_jobs:make_satellite_tiles",
    "satellite-tiles": "webapp.jobs.map_jobs:fetch_satellite_tiles",
    "street-photos": "webapp.jobs.map_jobs:fetch_street_photos",
}
"""Name of each kind to "module:function"."""


@dataclass(frozen=True, slots=True)
class JobRegistry:
    """The kinds of jobs and the sweeps of a worker (all are in `webapp.app.registry`)."""

    kinds: Mapping[str, str]  # Name of each kind of job to "module:function"
    sweeps: tuple[Sweep, ...] = ()  # Run periodically, in addition to those of maps

    def function(self, kind: str) -> Function:
        """Import the function that does a kind of job.

        Raises:
            UsageError: The kind does not exist.
        """
        if kind not in self.kinds:
            raise UsageError(
                f"unknown kind of job: {kind!r}",
                hint="if a newer version queued it, update this one",
            )
        found: Function = import_name(self.kinds[kind])
        return found
