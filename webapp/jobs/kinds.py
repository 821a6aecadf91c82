"""Kinds of jobs: each has a name and a function, which is imported for the first job of its kind.

To add a kind, write a function of a `Context`, and add it to `KINDS` or to the table of a subpackage. It may
be killed at any moment and is then called again: each step must be repeatable, and its result saved. A kind
is short if it usually takes seconds and little memory, and somebody waits for it.
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
"""Deletes leftovers of interrupted work, or looks for what is due and queues its jobs."""


@dataclass(frozen=True, slots=True)
class Kind:
    function: str  # "module:function"
    short: bool = False  # Does not wait behind long work


KINDS: dict[str, Kind] = {
    "blur": Kind("webapp.jobs.map_jobs:suggest_blurring"),
    "describe-library": Kind("webapp.jobs.map_jobs:describe_all_maps"),
    "evaluate": Kind("webapp.jobs.map_jobs:evaluate_map"),
    "export": Kind("webapp.jobs.map_jobs:export_map_file", short=True),
    "health": Kind("webapp.jobs.map_jobs:find_weak_photos"),
    "import": Kind("webapp.jobs.map_jobs:import_map_zip", short=True),
    "index": Kind("webapp.jobs.map_jobs:build_map_index"),
    "landmarks": Kind("webapp.jobs.map_jobs:build_landmarks"),
    "models": Kind("webapp.jobs.model_jobs:fetch_models", short=True),
    "photo-pieces": Kind("webapp.jobs.map_jobs:check_pieces_of_map", short=True),
    "place-rest": Kind("webapp.jobs.map_jobs:suggest_places"),
    "satellite-pyramid": Kind("webapp.jobs.map_jobs:make_satellite_tiles", short=True),
    "satellite-tiles": Kind("webapp.jobs.map_jobs:fetch_satellite_tiles", short=True),
    "street-photos": Kind("webapp.jobs.map_jobs:fetch_street_photos", short=True),
    "video-photos": Kind("webapp.jobs.map_jobs:cut_map_video"),
}
"""The kinds by their names."""


@dataclass(frozen=True, slots=True)
class JobRegistry:
    """The kinds of jobs and the sweeps of a worker (all are in `webapp.app.registry`)."""

    kinds: Mapping[str, Kind]  # By their names
    sweeps: tuple[Sweep, ...] = ()  # Run periodically, in addition to those of maps
    watches: tuple[Sweep, ...] = ()  # Run every second or so: they look what is due, and are quick

    def short(self) -> frozenset[str]:
        return frozenset(name for name, kind in self.kinds.items() if kind.short)

    def function(self, kind: str) -> Function:
        if kind not in self.kinds:
            raise UsageError(
                f"unknown kind of job: {kind!r}",
                hint="if a newer version queued it, update this one",
            )
        found: Function = import_name(self.kinds[kind].function)
        return found
