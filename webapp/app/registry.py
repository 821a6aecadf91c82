"""Contributions of the subpackages: kinds of jobs, sweeps, and parts of a library."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from pathlib import Path

from webapp.jobs import kinds
from webapp.jobs.kinds import JobRegistry
from webapp.missions.store import missions
from webapp.missions.tasks import delete as delete_mission
from webapp.missions.tasks import fuse, thin_tracks
from webapp.store.library import Library
from webapp.store.operate.snapshot import PartContents
from webapp.tasks.operate.backup import LibraryPart
from webapp.tasks.operate.second_looks import queue_second_looks

_KINDS = {
    **kinds.KINDS,
    "mission-delete": "webapp.missions.jobs:delete_mission",
    "mission-fix": "webapp.missions.jobs:localize_mission_photos",
    "mission-fuse": "webapp.missions.jobs:fuse_mission",
    "mission-import": "webapp.missions.jobs:import_mission_file",
    "mission-inspect": "webapp.missions.jobs:inspect_mission_file",
    "mission-pieces": "webapp.missions.jobs:build_track_pieces",
    thin_tracks.THIN_JOB: "webapp.missions.jobs:thin_old_tracks",
    "sample": "webapp.sample.job:make_sample_map",
}
"""Name of each kind of job to "module:function", imported for the first job of its kind."""

REGISTRY = JobRegistry(
    kinds=_KINDS,
    sweeps=(delete_mission.sweep, thin_tracks.sweep, queue_second_looks),
)


class MissionPart:
    """The files of missions."""

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


PARTS: tuple[LibraryPart, ...] = (MissionPart(),)
