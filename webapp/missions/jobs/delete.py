"""The job `mission-delete`: a mission in the bin, deleted for good."""

from __future__ import annotations

from webapp.jobs.context import Context
from webapp.missions.tasks import delete


def run(context: Context) -> None:
    """Delete the mission that the argument `mission` names; what is deleted stays so."""
    mission_id = int(context.arguments["mission"])
    delete.run(context.library, mission_id, write=context.write, progress=context.progress)
