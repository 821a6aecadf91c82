"""Sends the content of a spool, one request per step, and interprets each response.

While the network or the server is down or busy, requests are retried later. If a response rejects input (400,
413, 422 in the format of the API), batches are made smaller until the rejected record is alone; it is set
aside with the reason, and the others are sent. Any other refusal (an unknown token, a deleted mission)
concerns all records: nothing is set aside, and the status of the client shows the error.
"""

from __future__ import annotations

import random
import re
import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Literal

from .database import storage_errors
from .errors import Conflict, ExpMapError, NotReady, UsageError
from .options import RobotOptions
from .spool import Gap, RecordRun, Spool
from .uplink import NoResponse, Response, Uplink

_AT_RECORD = re.compile(r"(?:^|\.)records\.(\d+)(?:\.|$)")
_ABOUT_INPUT = (400, 413, 422)
_LATER = (408, 425, 429)
_POLL_S = 0.2


@dataclass(frozen=True, slots=True)
class UploadStep:
    """The result of a step."""

    # `retry`: the network or the server is down or busy; `refused`: the server refuses all requests.
    outcome: Literal["progress", "idle", "retry", "refused"]
    reason: str = ""
    wait_s: float = 0.0  # From the header `Retry-After`
    error: ExpMapError | None = None  # Set if the outcome is `refused`


_PROGRESS = UploadStep("progress")
_IDLE = UploadStep("idle")


class Backoff:
    """Exponential backoff, with jitter so that robots do not retry all at once."""

    def __init__(self, first_s: float, longest_s: float, *, rng: random.Random | None = None) -> None:
        self._first_s = first_s
        self._longest_s = longest_s
        self._rng = rng or random.Random()
        self._failures = 0

    def next_delay(self, *, at_least_s: float = 0.0) -> float:
        """Count a failure; return how many seconds to wait.

        Args:
            at_least_s: Delay that the server asked for; the backoff is added.
        """
        usual = min(self._first_s * 2.0 ** min(self._failures, 30), self._longest_s)
        self._failures += 1
        return at_least_s + usual * self._rng.uniform(0.5, 1.0)

    def reset(self) -> None:
        """Reset to the shortest delay."""
        self._failures = 0


class Uploader:
    """Sends a spool to its mission. Not thread-safe."""

    def __init__(self, spool: Spool, uplink: Uplink, *, options: RobotOptions) -> None:
        self._spool = spool
        self._uplink = uplink
        self._options = options
        self._limit = options.batch_records
        self._mission = f"/missions/{spool.identity.mission}"

    def step(self) -> UploadStep:
        """Send the next records, or if there are none, the next photo."""
        step = self.send_records()
        return self.send_photo() if step.outcome == "idle" else step

    def send_records(self) -> UploadStep:
        """Send the next records."""
        size = int(self._options.batch_kb * 1000)
        found = self._spool.next_batch(records=self._limit, size=size)
        if found is None:
            return _IDLE
        return self._skip_gap(found) if isinstance(found, Gap) else self._send(found)

    def send_photo(self) -> UploadStep:
        """Send the photo that has waited longest."""
        photo = self._spool.photos.first()
        if photo is None:
            return _IDLE
        fields = {"time": repr(photo.time)} | ({} if photo.object is None else {"object": photo.object})
        with storage_errors(photo.path):
            response = self._uplink.post_file(
                f"{self._mission}/photos", photo.path, name=photo.name, fields=fields
            )
        if isinstance(response, NoResponse):
            return UploadStep("retry", response.reason)
        if response.status in (200, 201):
            if response.body.get("sha256") == photo.sha256:
                self._spool.photos.remove(photo)
            else:
                self._spool.set_photo_aside(photo, reason="the photo is damaged on the disk of the robot")
            return _PROGRESS
        if response.status in (*_ABOUT_INPUT, 415) and response.error is not None:
            self._spool.set_photo_aside(photo, reason=_error_text(response))
            return _PROGRESS
        return _classify(response)

    def _post(self, texts: tuple[bytes, ...]) -> Response | NoResponse:
        state, sender = self._spool.state, self._spool.identity.id
        path = f"{self._mission}/batches"
        return self._uplink.post_batch(path, sender=sender, first=state.wire, texts=texts)

    def _send(self, run: RecordRun) -> UploadStep:
        wire = self._spool.state.wire
        response = self._post(run.texts)
        if isinstance(response, NoResponse):
            return UploadStep("retry", response.reason)
        if response.status == 200:
            stored = _next(response.body) - wire
            if stored < 1:
                return _unexpected(response)
            self._spool.acknowledge(min(stored, len(run.texts)))
            self._limit = self._options.batch_records
            return _PROGRESS
        if response.status in _ABOUT_INPUT and (response.error is not None or len(run.texts) > 1):
            return self._bisect_rejected(run, response)
        return self._rewind(response) if response.status == 409 else _classify(response)

    def _bisect_rejected(self, run: RecordRun, response: Response) -> UploadStep:
        """Send fewer records next time: those before the rejected one, or half; set it aside when alone."""
        count = len(run.texts)
        if count == 1:
            self._spool.set_aside(1, reason=_error_text(response), text=run.texts[0])
            self._limit = self._options.batch_records
            return _PROGRESS
        named = _AT_RECORD.search(str((response.error or {}).get("where")))
        place = int(named[1]) if named else count // 2
        self._limit = max(1, min(place, count - 1))
        return _PROGRESS

    def _rewind(self, response: Response) -> UploadStep:
        """Resend records that the server has lost, as after a restore from a backup."""
        wanted = _next(response.error or {})
        if not 0 <= wanted < self._spool.state.wire:
            return _classify(response)
        if self._spool.rewind(wanted):
            return _PROGRESS
        error = Conflict(
            "the server has lost records that this spool no longer holds",
            where=f"{wanted} to {self._spool.state.wire - 1}",
            hint="restore a newer backup of the server, or begin a new spool",
        )
        return UploadStep("refused", str(error), error=error)

    def _skip_gap(self, gap: Gap) -> UploadStep:
        """Skip damaged records: acknowledge those that the server already has, set the others aside."""
        kept = 0
        if gap.first < self._spool.state.sent:
            response = self._post(())
            if isinstance(response, NoResponse):
                return UploadStep("retry", response.reason)
            if response.status == 409:
                return self._rewind(response)
            if response.status != 200:
                return _classify(response)
            kept = min(max(_next(response.body) - self._spool.state.wire, 0), gap.count)
        if kept:
            self._spool.acknowledge(kept)
        if kept < gap.count:
            self._spool.set_aside(gap.count - kept, reason="damaged on the disk of the robot")
        return _PROGRESS


def _next(body: dict[str, object]) -> int:
    number = body.get("next")
    return number if isinstance(number, int) else -1


def _error_text(response: Response) -> str:
    error = response.error or {}
    return " ".join(str(error[name]) for name in ("where", "message") if error.get(name)) or str(
        response.status
    )


def _unexpected(response: Response) -> UploadStep:
    error = UsageError(
        f"the server answered {response.status} without a number", hint="is this an Experience Map server?"
    )
    return UploadStep("refused", str(error), error=error)


def _classify(response: Response) -> UploadStep:
    """Interpret a response that does not concern the data sent."""
    reason = _error_text(response)
    if response.status in _LATER or response.status >= 500:
        return UploadStep("retry", reason, response.retry_after_s)
    return UploadStep("refused", reason, response.retry_after_s, response.as_error())


def recover(
    spool: Spool,
    token: str,
    *,
    options: RobotOptions,
    patience_s: float,
    on_progress: Callable[[int], None],
) -> None:
    """Upload everything left in a spool.

    Args:
        patience_s: Give up when the server has accepted nothing for this many seconds.
        on_progress: Called with the number of waiting records and photos, after each step and a few times a
            second during delays; an exception that it raises ends the upload.

    Raises:
        NotReady: The network or the server is down.
        ExpMapError: The server refuses all requests: an unknown token, a deleted mission.
    """
    uplink = Uplink(spool.identity.url, token, timeout_s=options.timeout_s)
    uploader = Uploader(spool, uplink, options=options)
    backoff = Backoff(options.backoff_s, options.backoff_max_s)
    until = time.monotonic() + patience_s
    try:
        while (step := uploader.step()).outcome != "idle":
            on_progress(spool.waiting + spool.photos.count)
            if step.error is not None:
                raise step.error
            if step.outcome == "progress":
                backoff.reset()
                until = time.monotonic() + patience_s
                continue
            again = time.monotonic() + backoff.next_delay(at_least_s=step.wait_s)
            if again > until:
                hint = "what is left stays in the spool: try again later"
                raise NotReady(f"the server refuses everything: {step.reason}", hint=hint)
            while time.monotonic() < again:
                time.sleep(_POLL_S)
                on_progress(spool.waiting + spool.photos.count)
    finally:
        uplink.close()
