"""Contributions of the subpackages: kinds of jobs, sweeps, and parts of a library."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from pathlib import Path

from webapp.connect import connections
from webapp.importing import import_name
from webapp.jobs import kinds
from webapp.jobs.kinds import JobRegistry, Kind
from webapp.missions.store import missions
from webapp.missions.tasks import delete as delete_mission
from webapp.missions.tasks import fuse, thin_tracks
from webapp.missions.tasks.silences import note_silences
from webapp.store.library import Library
from webapp.store.operate.snapshot import PartContents
from webapp.tasks.operate.backup import LibraryPart
from webapp.tasks.operate.models import queue_second_looks

_KINDS = {
    **kinds.KINDS,
    "mission-delete": Kind("webapp.missions.jobs:delete_mission", short=True),
    "mission-fix": Kind("webapp.missions.jobs:localize_mission_photos"),
    "mission-fuse": Kind("webapp.missions.jobs:fuse_mission", short=True),
    "mission-import": Kind("webapp.missions.jobs:import_mission_file", short=True),
    "mission-inspect": Kind("webapp.missions.jobs:inspect_mission_file", short=True),
    "mission-pieces": Kind("webapp.missions.jobs:build_track_pieces", short=True),
    thin_tracks.THIN_JOB: Kind("webapp.missions.jobs:thin_old_tracks"),
    "sample": Kind("webapp.sample.job:make_sample_map", short=True),
}
"""The kinds by their names."""

_CONNECTED: tuple[JobRegistry, ...] = tuple(
    import_name(found.jobs) for found in connections().values() if found.jobs is not None
)

REGISTRY = JobRegistry(
    kinds={**_KINDS, **{name: kind for part in _CONNECTED for name, kind in part.kinds.items()}},
    sweeps=(
        *(delete_mission.sweep, thin_tracks.sweep, queue_second_looks),
        *(sweep for part in _CONNECTED for sweep in part.sweeps),
    ),
    watches=(note_silences, *(watch for part in _CONNECTED for watch in part.watches)),
)


class MissionPart:
    name = "missions"
    folder = missions.FOLDER

    def contents(self, database: sqlite3.Connection) -> PartContents:
        """Read the ids and photos of all missions; databases from before version 0.5.0 have none."""
        if database.execute("SELECT 1 FROM sqlite_master WHERE name = 'mission_photo'").fetchone() is None:
            return PartContents(frozenset(), frozenset())
        ids = frozenset(id for (id,) in database.execute("SELECT id FROM mission"))
        return PartContents(ids, frozenset(database.execute("SELECT mission_id, path FROM mission_photo")))

    def locks(self, library: Library) -> Iterator[tuple[Path, str]]:
        """Yield the lock that writers of fused tracks hold."""
        yield library.inner / fuse.LOCK, "the fused track of a mission"

    def replaced(self, library: Library, id: int) -> Iterator[Path]:
        """Yield the path of the report on the fused track."""
        yield missions.folder(library, id) / fuse.REPORT


LIBRARY_PARTS: tuple[LibraryPart, ...] = (MissionPart(),)
