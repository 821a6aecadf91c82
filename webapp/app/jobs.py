"""What the background worker does: jobs of maps, of missions, and the sample map."""

from __future__ import annotations

from webapp.jobs import kinds
from webapp.jobs.kinds import Duties
from webapp.missions import jobs as mission_jobs
from webapp.missions.tasks import delete as delete_mission

DUTIES = Duties(
    kinds={**kinds.KINDS, **mission_jobs.KINDS, "sample": "webapp.sample.job:run"},
    sweeps=(delete_mission.sweep,),
)
