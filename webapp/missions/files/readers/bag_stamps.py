"""The times of messages in bags: those of their headers, unless these cannot be right.

A header may have no stamp, the time since a start, or one in a wrong unit, while the recorder had the right
time. The stamps of a bag that was recorded while another one was played are long before the recording.
"""

from __future__ import annotations

import statistics
from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import pairwise

from webapp.files.exchange.times import utc
from webapp.missions.files.track_chunks import Findings

_FIRST_S = 946_684_800.0
"""2000-01-01: robots with a clock have later times."""

_DAY_S = 86_400.0
_APART_S = 3600.0
"""Stamps this far from the recording are mentioned."""

_JUMP_S = 60.0
"""Change of the time between stamp and recording from one message to the next, of stamps that jump."""

_LEAST_JUMPS = 3
"""Fewer are single odd stamps, each of which makes two, or a clock that was set."""

NO_STAMP = "messages without a time stamp, which have the time of their recording"
BAD_STAMP = "messages whose time stamp cannot be right, which have the time of their recording"
BACK = "time stamps that jump back, while the recording goes on"

Stamp = tuple[float, float]
"""Time of a header, and of the recording: seconds since 1970."""


def _is_possible(stamp_s: float, recorded_s: float) -> bool:
    return recorded_s < _FIRST_S or _FIRST_S <= stamp_s <= recorded_s + _DAY_S


@dataclass(slots=True)
class TopicClock:
    """Decides on the times of a topic's messages."""

    topic: str
    trusts_stamps: bool = True
    last: dict[tuple[str, str], Stamp] = field(default_factory=dict)  # By frames, as of several robots

    def trusts(self, stamp_s: float, recorded_s: float) -> bool:
        return self.trusts_stamps and _is_possible(stamp_s, recorded_s)

    def time(
        self, stamp_s: float | None, recorded_s: float, *, frames: tuple[str, str], findings: Findings
    ) -> float:
        """Return the time of a message; its stamp is None if it has none."""
        if stamp_s is None:
            findings.doubt(NO_STAMP, where=self.topic)
            return recorded_s
        if not self.trusts(stamp_s, recorded_s):
            findings.doubt(BAD_STAMP, where=f"{self.topic}, {utc([stamp_s])[0][:10]}")
            return recorded_s
        before_s, before_recorded_s = self.last.get(frames, (stamp_s, recorded_s))
        if stamp_s < before_s - _JUMP_S and recorded_s >= before_recorded_s:
            findings.doubt(BACK, where=self.topic)
        self.last[frames] = (stamp_s, recorded_s)
        return stamp_s


def clock_of(topic: str, series: Sequence[Sequence[Stamp]], *, findings: Findings) -> TopicClock:
    """Decide by the first stamps of a topic, in a series for each of its pairs of frames."""
    stamps = [stamp for one in series for stamp in one]
    ahead = [stamp_s - recorded_s for stamp_s, recorded_s in stamps]
    if not stamps:
        return TopicClock(topic)
    steps = [abs((b[0] - b[1]) - (a[0] - a[1])) for one in series for a, b in pairwise(one)]
    possible = sum(_is_possible(*stamp) for stamp in stamps)
    jumping = sum(step > _JUMP_S for step in steps)
    if 2 * possible < len(stamps) or (jumping >= _LEAST_JUMPS and 2 * jumping > len(steps)):
        return TopicClock(topic, trusts_stamps=False)
    usual = statistics.median(ahead)
    if abs(usual) > _APART_S:
        side = "after" if usual > 0.0 else "before"
        findings.note(
            f"the time stamps of {topic} are {_span(abs(usual))} {side} the recording: the stamps count"
        )
    return TopicClock(topic)


def _span(seconds: float) -> str:
    hours = seconds / 3600.0
    return f"{hours:.1f} hours" if hours < 48.0 else f"{hours / 24.0:.0f} days"
