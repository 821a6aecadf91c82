"""What the wings add to the program: kinds of jobs, sweeps, and parts of a library."""

from __future__ import annotations

from webapp.jobs import kinds
from webapp.jobs.kinds import Duties
from webapp.missions.tasks import delete as delete_mission
from webapp.missions.tasks.backup_part import MissionPart
from webapp.tasks.operate.parts import LibraryPart

PARTS: tuple[LibraryPart, ...] = (MissionPart(),)


_KINDS = {
    **kinds.KINDS,
    "mission-delete": "webapp.missions.jobs:delete_mission",
    "mission-fix": "webapp.missions.jobs:localize_mission_photos",
    "mission-fuse": "webapp.missions.jobs:fuse_mission",
    "mission-import": "webapp.missions.jobs:import_mission_file",
    "mission-pieces": "webapp.missions.jobs:build_track_pieces",
    "sample": "webapp.sample.job:run",
}
"""Name of each kind of job to "module:function", imported when the first job of its kind comes."""

DUTIES = Duties(
    kinds=_KINDS,
    sweeps=(delete_mission.sweep,),
)
