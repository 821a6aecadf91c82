"""Topics of robots whose poses are planned or wished for, and were not driven."""

from __future__ import annotations

import re

_ANYWHERE = {"plan", "plans", "planned", "goal", "goals", "setpoint", "setpoints"}
_AT_THE_END = {
    "initialpose",
    "target",
    "targets",
    "desired",
    "waypoint",
    "waypoints",
    "command",
    "cmd",
    "clicked",
}


def is_planned(topic: str) -> bool:
    """Tell by a topic's name: `/plan`, `/move_base_simple/goal`, `/goal_pose`, `/initialpose` ..."""
    *spaces, name = [set(re.findall(r"[a-z]+", part.lower())) for part in topic.split("/")]
    return bool(name & (_ANYWHERE | _AT_THE_END)) or any(space & _ANYWHERE for space in spaces)


def is_planned_track(name: str) -> bool:
    """Tell by the name of an imported track, which has that of its file and of its topic."""
    _, slash, topic = name.partition(" /")
    return is_planned(f"/{topic.partition(' ')[0]}") if slash else name.startswith("/") and is_planned(name)
