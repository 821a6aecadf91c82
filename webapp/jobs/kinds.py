"""Kinds of jobs: each has a name and a function, which is imported when the first job of its kind comes.

A new kind is a function that takes a `Context`, and a line in `KINDS`, here or in a wing of its own. It may
be killed at any moment and is then called again: each step must be repeatable, and what is finished stays.
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
"""Does a job and returns its result, plain values."""

Sweep = Callable[[Library, Settings], object]
"""Tidies up: deletes what interrupted work has left behind, or queues what is due."""

KINDS: dict[str, str] = {
    "blur": "webapp.jobs.map_jobs:suggest_blurring",
    "describe-library": "webapp.jobs.map_jobs:describe_all_maps",
    "evaluate": "webapp.jobs.map_jobs:evaluate_map",
    "export": "webapp.jobs.map_jobs:export_map_file",
    "health": "webapp.jobs.map_jobs:find_weak_photos",
    "import": "webapp.jobs.map_jobs:import_map_zip",
    "index": "webapp.jobs.map_jobs:build_map_index",
    "landmarks": "webapp.jobs.map_jobs:build_landmarks",
    "place-rest": "webapp.jobs.map_jobs:suggest_places",
    "satellite-pyramid": "webapp.jobs.map_jobs:make_satellite_tiles",
    "satellite-tiles": "webapp.jobs.map_jobs:fetch_satellite_tiles",
    "street-photos": "webapp.jobs.map_jobs:fetch_street_photos",
}
"""Name of each kind to "module:function"."""


@dataclass(frozen=True, slots=True)
class JobRegistry:
    """The kinds of jobs and the sweeps of a worker (`webapp.app.registry` has all of them).

    Attributes
    ----------
    kinds : mapping of str to str
        Name of each kind of job to "module:function".
    sweeps : tuple of callable
        Done now and then, besides those of maps.
    """

    kinds: Mapping[str, str]
    sweeps: tuple[Sweep, ...] = ()

    def function(self, kind: str) -> Function:
        """Find what does a kind of job.

        Raises
        ------
        UsageError
            The kind does not exist.
        """
        if kind not in self.kinds:
            raise UsageError(
                f"unknown kind of job: {kind!r}",
                hint="if a newer version queued it, update this one",
            )
        found: Function = import_name(self.kinds[kind])
        return found
