"""The job `mission-pieces`: the tracks of a mission, prepared for display."""

from __future__ import annotations

from typing import Any

from webapp.jobs.context import Context
from webapp.missions.tasks import build_pieces


def run(context: Context) -> dict[str, Any]:
    """Prepare what is new of the mission that the argument `mission` names; what is finished stays so."""
    mission_id = int(context.arguments["mission"])
    built = build_pieces.run(context.library, mission_id, write=context.write, progress=context.progress)
    return {"pieces": built}
