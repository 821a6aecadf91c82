"""The job `mission-fuse`: the tracks of a mission put together to a corrected one."""

from __future__ import annotations

from typing import Any

from webapp.jobs.context import Context
from webapp.missions.tasks import fuse

_TOLD = 100
"""Fixes that the result of the job tells one by one; the report has more."""


def run(context: Context) -> dict[str, Any]:
    """Fuse the mission that the argument `mission` names; killed, the former fused track stays."""
    report = fuse.run(
        context.library, int(context.arguments["mission"]), write=context.write, progress=context.progress
    )
    return {**report, "gated": report["gated"][:_TOLD]}
