"""Sends what a spool holds, one request a step, and decides what each answer means.

Where the network or the server is down or busy, it is tried again later. An answer about a record (400, 413,
422 in the shape of the API) is followed up until the one record is found, which is set aside with the reason,
so that it holds up nothing. Any other refusal (a token that is not known, a mission that is gone) concerns
all records: nothing is set aside, and who runs the robot is told.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from typing import Literal

from .database import storage_errors
from .errors import Conflict, ExpMapError, UsageError
from .options import RobotOptions
from .spool import Gap, Run, Spool
from .uplink import Answer, NoAnswer, Uplink

_AT_RECORD = re.compile(r"(?:^|\.)records\.(\d+)(?:\.|$)")
_ABOUT_INPUT = (400, 413, 422)
_LATER = (408, 425, 429)


@dataclass(frozen=True, slots=True)
class Step:
    """What came of a step.

    Attributes
    ----------
    outcome : {"went on", "nothing left", "later", "refused"}
        `later`: the network or the server is down or busy; `refused`: the server wants none of it.
    reason : str
    wait_s : float
        Seconds that the server asked to wait.
    error : ExpMapError or None
        Of `refused`.
    """

    outcome: Literal["went on", "nothing left", "later", "refused"]
    reason: str = ""
    wait_s: float = 0.0
    error: ExpMapError | None = None


_WENT_ON = Step("went on")
_NOTHING_LEFT = Step("nothing left")


class Uploader:
    """Sends a spool to its mission. For one thread.

    Parameters
    ----------
    spool : Spool
    uplink : Uplink
    options : RobotOptions
    """

    def __init__(self, spool: Spool, uplink: Uplink, *, options: RobotOptions) -> None:
        self._spool = spool
        self._uplink = uplink
        self._options = options
        self._limit = options.batch_records
        self._mission = f"/missions/{spool.identity.mission}"

    def step(self) -> Step:
        """Send the next records, or where there are none, the next photo."""
        step = self.send_records()
        return self.send_photo() if step.outcome == "nothing left" else step

    def send_records(self) -> Step:
        """Send the next records."""
        size = int(self._options.batch_kb * 1000)
        found = self._spool.take(records=self._limit, size=size)
        if found is None:
            return _NOTHING_LEFT
        return self._pass_over(found) if isinstance(found, Gap) else self._send(found)

    def send_photo(self) -> Step:
        """Send the photo that has waited longest."""
        photo = self._spool.photos.first()
        if photo is None:
            return _NOTHING_LEFT
        fields = {"time": repr(photo.time)} | ({} if photo.object is None else {"object": photo.object})
        with storage_errors(photo.path):
            answer = self._uplink.post_file(
                f"{self._mission}/photos", photo.path, name=photo.name, fields=fields
            )
        if isinstance(answer, NoAnswer):
            return Step("later", answer.reason)
        if answer.status in (200, 201):
            if answer.body.get("sha256") == photo.sha256:
                self._spool.photos.remove(photo)
            else:
                self._spool.set_photo_aside(photo, reason="the photo is damaged on the disk of the robot")
            return _WENT_ON
        if answer.status in (*_ABOUT_INPUT, 415) and answer.error is not None:
            self._spool.set_photo_aside(photo, reason=_told(answer))
            return _WENT_ON
        return _other(answer)

    def _post(self, texts: tuple[bytes, ...]) -> Answer | NoAnswer:
        state, sender = self._spool.state, self._spool.identity.id
        path = f"{self._mission}/batches"
        return self._uplink.post_batch(path, sender=sender, first=state.wire, texts=texts)

    def _send(self, run: Run) -> Step:
        wire = self._spool.state.wire
        answer = self._post(run.texts)
        if isinstance(answer, NoAnswer):
            return Step("later", answer.reason)
        if answer.status == 200:
            stored = _next(answer.body) - wire
            if stored < 1:
                return _senseless(answer)
            self._spool.acknowledge(min(stored, len(run.texts)))
            self._limit = self._options.batch_records
            return _WENT_ON
        if answer.status in _ABOUT_INPUT and (answer.error is not None or len(run.texts) > 1):
            return self._find_culprit(run, answer)
        return self._go_back(answer) if answer.status == 409 else _other(answer)

    def _find_culprit(self, run: Run, answer: Answer) -> Step:
        """Send less next time, up to the record that the answer names; set it aside when it is alone."""
        count = len(run.texts)
        if count == 1:
            self._spool.set_aside(1, reason=_told(answer), text=run.texts[0])
            self._limit = self._options.batch_records
            return _WENT_ON
        named = _AT_RECORD.search(str((answer.error or {}).get("where")))
        place = int(named[1]) if named else count // 2
        self._limit = max(1, min(place, count - 1))
        return _WENT_ON

    def _go_back(self, answer: Answer) -> Step:
        """Follow a server that has lost records, as one restored from a backup has."""
        wanted = _next(answer.error or {})
        if not 0 <= wanted < self._spool.state.wire:
            return _other(answer)
        if self._spool.rewind(wanted):
            return _WENT_ON
        error = Conflict(
            "the server has lost records that this spool does not hold any more",
            where=f"{wanted} to {self._spool.state.wire - 1}",
            hint="restore a newer backup of the server, or begin a new spool",
        )
        return Step("refused", str(error), error=error)

    def _pass_over(self, gap: Gap) -> Step:
        """Go on behind damaged records: those that the server has are no loss, the others are told."""
        kept = 0
        if gap.first < self._spool.state.sent:
            answer = self._post(())
            if isinstance(answer, NoAnswer):
                return Step("later", answer.reason)
            if answer.status == 409:
                return self._go_back(answer)
            if answer.status != 200:
                return _other(answer)
            kept = min(max(_next(answer.body) - self._spool.state.wire, 0), gap.count)
        if kept:
            self._spool.acknowledge(kept)
        if kept < gap.count:
            self._spool.set_aside(gap.count - kept, reason="damaged on the disk of the robot")
        return _WENT_ON


def _next(told: dict[str, object]) -> int:
    number = told.get("next")
    return number if isinstance(number, int) else -1


def _told(answer: Answer) -> str:
    error = answer.error or {}
    return " ".join(str(error[name]) for name in ("where", "message") if error.get(name)) or str(
        answer.status
    )


def _senseless(answer: Answer) -> Step:
    error = UsageError(
        f"the server answered {answer.status} without a number", hint="is this Experience Map?"
    )
    return Step("refused", str(error), error=error)


def _other(answer: Answer) -> Step:
    """Judge an answer that is not about what was sent."""
    reason = _told(answer)
    if answer.status in _LATER or answer.status >= 500:
        return Step("later", reason, answer.retry_after_s)
    return Step("refused", reason, answer.retry_after_s, answer.refusal())
