"""Simulated user of `editing_load`: edits a map as the page does, and records what was acknowledged."""

from __future__ import annotations

import random
import time
from dataclasses import dataclass, field
from typing import Any

import requests

from benchmarks.client import Client

ASK_EVERY_S = 1.0
CONFLICTS = (409, 412)
KINDS = ("place", "place", "move", "move", "move", "turn", "unplace", "undo", "undo", "redo")


@dataclass(slots=True)
class Log:
    """Record of one client.

    Attributes:
    ----------
    answers : list of dict
        One for each acknowledged edit: its revision and the photos after it; `known`: the revision in which
        the client knew each photo, except for undo and redo, where the server checks.
    """

    slug: str
    answers: list[dict[str, Any]] = field(default_factory=list)
    edit_seconds: list[float] = field(default_factory=list)
    poll_seconds: list[float] = field(default_factory=list)
    conflicts: int = 0
    errors: list[str] = field(default_factory=list)


class Editor:
    """A client with a map open.

    Args:
        pause_s: Mean of the random pauses between edits.
    """

    def __init__(self, client: Client, slug: str, *, seed: int, pause_s: float) -> None:
        self.client = client
        self.log = Log(slug)
        self._random = random.Random(seed)
        self._pause_s = pause_s
        self._path = f"/maps/{slug}"
        self._state = client.ask("GET", self._path)
        self._revision: int = self._state["revision"]
        self._photos: dict[int, dict[str, Any]] = {p["id"]: p for p in self._state["photos"]}

    def work(self, seconds: float) -> None:
        """Edit for a number of seconds; lost connections are recorded as errors."""
        until = time.monotonic() + seconds
        asked = 0.0
        while time.monotonic() < until:
            if time.monotonic() - asked >= ASK_EVERY_S:
                asked = time.monotonic()
                self._poll()
            self._edit(self._random.choice(KINDS))
            time.sleep(self._random.expovariate(1 / self._pause_s))

    def _poll(self) -> None:
        answer = self._timed("GET", f"/changes?since={self._revision}", times=self.log.poll_seconds)
        if answer is not None and answer.ok:
            self._take(answer.json())

    def _edit(self, kind: str) -> None:
        known: dict[int, int] = {}
        if kind in ("undo", "redo"):
            answer = self._timed("POST", f"/{kind}", times=self.log.edit_seconds, json={})
        else:
            changes = [{"id": number, **self._fields(kind)} for number in self._chosen(kind)]
            known = {change["id"]: self._photos[change["id"]]["revision"] for change in changes}
            body = {"seen": self._revision, "kind": kind, "changes": changes}
            answer = self._timed("PATCH", "/experiences", times=self.log.edit_seconds, json=body)
        if answer is None:
            return
        if answer.ok:
            result = answer.json()
            if result["revision"] is not None:
                self.log.answers.append({**result, "known": known})
                self._take_own(result)
        elif answer.status_code in CONFLICTS:
            self.log.conflicts += 1
            self._poll()

    def _chosen(self, kind: str) -> list[int]:
        """Choose one photo, or sometimes a few to be moved together."""
        count = 3 if kind == "move" and self._random.random() < 0.2 else 1
        return self._random.sample(sorted(self._photos), count)

    def _fields(self, kind: str) -> dict[str, float | None]:
        if kind == "turn":
            return {"heading_deg": round(self._random.uniform(0, 360), 2)}
        if kind == "unplace":
            return {"x_px": None, "y_px": None}
        return {
            "x_px": round(self._random.uniform(0, self._state["satellite"]["width"]), 2),
            "y_px": round(self._random.uniform(0, self._state["satellite"]["height"]), 2),
        }

    def _take(self, changes: dict[str, Any]) -> None:
        self._revision = changes["revision"]
        for photo in changes["photos"]:
            self._photos[photo["id"]] = photo

    def _take_own(self, result: dict[str, Any]) -> None:
        """Apply the client's own edit; poll if others made edits just before it."""
        if result["revision"] == self._revision + 1:
            self._take(result)
        else:
            self._poll()

    def _timed(self, method: str, path: str, *, times: list[float], **body: Any) -> requests.Response | None:
        start = time.monotonic()
        try:
            answer = self.client.call(method, self._path + path, **body)
        except requests.RequestException as error:
            self.log.errors.append(f"{method} {path}: {error}")
            return None
        times.append(time.monotonic() - start)
        if not answer.ok and answer.status_code not in CONFLICTS:
            self.log.errors.append(f"{method} {path}: {answer.status_code} {answer.text[:300]}")
        return answer
