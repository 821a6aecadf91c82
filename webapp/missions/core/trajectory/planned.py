"""Topics of robots whose poses are planned or wished for, and were not driven."""

from __future__ import annotations

import re
from collections.abc import Iterable

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
_ODOMETRY = {"odom", "odometry"}


def is_planned(topic: str) -> bool:
    """Detect by a topic's name: `/plan`, `/move_base_simple/goal`, `/goal_pose`, `/initialpose` ..."""
    *spaces, name = [set(re.findall(r"[a-z]+", part.lower())) for part in topic.split("/")]
    return bool(name & (_ANYWHERE | _AT_THE_END)) or any(space & _ANYWHERE for space in spaces)


def driven_tracks(names: Iterable[str]) -> set[str]:
    """Choose the odometry that was driven, by the names of tracks.

    The type of the messages is not known any more, as it is while a file is read: odometry such as
    `/goal_tracker/odom` counts as driven, and where there is no other, so does `/plan_a/pose`.
    """
    topics = {name: _topic_of(name) for name in names}
    likely = {name for name, topic in topics.items() if not is_planned(topic) or _is_odometry(topic)}
    return likely or {name for name, topic in topics.items() if not is_planned(topic.rpartition("/")[2])}


def _topic_of(name: str) -> str:
    """Return the topic of an imported track, whose name has that of its file before it; empty without one."""
    _, slash, topic = name.partition(" /")
    if slash:
        return f"/{topic.partition(' ')[0]}"
    return name if name.startswith("/") else ""


def _is_odometry(topic: str) -> bool:
    name = topic.rpartition("/")[2]
    return bool(set(re.findall(r"[a-z]+", name.lower())) & _ODOMETRY) and not is_planned(name)
