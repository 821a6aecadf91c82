"""Clients of the cluster in `chaos`, which edit and upload, and record what was acknowledged.

If a response is lost, the request may or may not have been executed. Clients then behave like the pages: an
edit is not repeated, but the client polls for changes; an upload is repeated, since the program recognises
photos that it has.
"""

from __future__ import annotations

import hashlib
import http.client
import io
import random
import time
from dataclasses import dataclass, field
from typing import Any

import numpy as np
import requests
from PIL import Image

from benchmarks.client import Client
from benchmarks.editing_client import Editor
from benchmarks.robots_load import Robot

PATIENCE_S = 120.0
_NEAR_PX = 20.0
_PAUSE_S = 0.1
_ANSWER_WITHIN_S = 10.0
"""Time after which a client gives a request up and asks another node."""
_WORKS_FOR_S = 60.0
"""The same for a photo that is uploaded or localized."""
_UNSURE = (429, 500, 502, 503, 504)
"""Statuses after which the outcome is unknown: a database can fail while it commits."""
_AWAY = ("database_unavailable", "storage_unavailable")
"""Error codes in the result of a photo with the same meaning."""


@dataclass
class Refusals:
    """Periods from the first failed request of a client to its next successful one.

    Attributes:
    ----------
    times : list of tuple
        Begin and end by the monotonic clock, and the first failed request with its error.
    errors : list of str
        Responses that are not allowed even while parts of the cluster are down.
    """

    times: list[tuple[float, float, str]] = field(default_factory=list)
    errors: list[str] = field(default_factory=list)


class Streak:
    """Failed requests of a client, one after the other, until one succeeds."""

    def __init__(self, refusals: Refusals) -> None:
        self._refusals = refusals
        self._first: tuple[float, str] | None = None

    def failed(self, what: str, *, since: float) -> None:
        """Note a failed request, and when it was sent."""
        self._first = self._first or (since, what)

    def succeeded(self) -> None:
        """End the streak."""
        if self._first is not None:
            since, what = self._first
            self._refusals.times.append((since, time.monotonic(), what))
            self._first = None


class PatientClient(Client):
    """Client that can repeat requests until they are answered, and records how long that took."""

    def __init__(self, url: str, link: str, refusals: Refusals) -> None:
        super().__init__(url, link)
        self._refusals = refusals
        self._streak = Streak(refusals)

    def call(self, method: str, path: str, **options: Any) -> requests.Response:
        """Send one request to the API; failures are recorded.

        Raises:
        ------
        requests.RequestException
            There was no response, or one that leaves the outcome unknown.
        """
        sent = time.monotonic()
        try:
            answer = super().call(method, path, **{"timeout": _ANSWER_WITHIN_S, **options})
            if answer.status_code == 500:
                self._refusals.errors.append(f"{method} {path}: 500 {answer.text[:300]}")
            if answer.status_code in _UNSURE:
                raise requests.RequestException(f"{answer.status_code} {answer.text[:200]}")
        except requests.RequestException as error:
            self._streak.failed(f"{method} {path}: {str(error)[:200]}", since=sent)
            raise
        self._streak.succeeded()
        return answer

    def repeat(self, method: str, path: str, **options: Any) -> requests.Response:
        """Repeat a request until it is answered."""
        until = time.monotonic() + PATIENCE_S
        while True:
            try:
                return self.call(method, path, **options)
            except requests.RequestException as error:
                if time.monotonic() > until:
                    raise SystemExit(f"{method} {path}: no answer for {PATIENCE_S:.0f} s: {error}") from error
                time.sleep(_PAUSE_S)


class PatientRobot(Robot):
    """A robot that records how long its batches were refused."""

    def __init__(self, url: str, token: str, mission: int, *, refusals: Refusals) -> None:
        super().__init__(url, token, mission)
        self._streak = Streak(refusals)

    def _send(self, server: http.client.HTTPConnection, first: int, last: int) -> float:
        sent = time.monotonic()
        pause_s = super()._send(server, first, last)
        if pause_s:
            self._streak.failed(f"poses of mission {self.mission}", since=sent)
        else:
            self._streak.succeeded()
        return pause_s


class UnsureEditor(Editor):
    """An editor whose responses may be lost.

    Attributes:
    ----------
    lost : int
        Number of edits with unknown outcome.
    """

    client: PatientClient

    def __init__(self, client: PatientClient, slug: str, *, seed: int, pause_s: float) -> None:
        super().__init__(client, slug, seed=seed, pause_s=pause_s)
        self.lost = 0

    def _timed(self, method: str, path: str, *, times: list[float], **body: Any) -> requests.Response | None:
        if method == "GET":
            return self._checked(self.client.repeat(method, self._path + path), path)
        begin = time.monotonic()
        try:
            answer = self.client.call(method, self._path + path, **body)
        except requests.RequestException:
            self.lost += 1
            self._poll()
            return None
        times.append(time.monotonic() - begin)
        return self._checked(answer, path)

    def _checked(self, answer: requests.Response, path: str) -> requests.Response:
        if not answer.ok and answer.status_code not in (409, 412):
            self.log.errors.append(f"{path}: {answer.status_code} {answer.text[:300]}")
        return answer


class Uploader:
    """Uploads photos to its own map, and places each of them.

    Attributes:
    ----------
    tried, uploaded : set of str
        SHA-256 of the photos that it sent, and of those that were acknowledged.
    placed : dict
        Acknowledged positions of placed photos, by id.
    """

    def __init__(self, client: PatientClient, slug: str, *, seed: int, pause_s: float) -> None:
        self.slug = slug
        self.tried: set[str] = set()
        self.uploaded: set[str] = set()
        self.placed: dict[int, tuple[float, float]] = {}
        self.errors: list[str] = []
        self.client = client
        self._pause_s = pause_s
        self._random = random.Random(seed)
        self._draw = np.random.default_rng(seed)

    def work(self, seconds: float) -> None:
        """Upload and place photos for a number of seconds."""
        until = time.monotonic() + seconds
        while time.monotonic() < until and not self.errors:
            data = noise_photo(self._draw)
            sha = hashlib.sha256(data).hexdigest()
            self.tried.add(sha)
            result = self._upload(f"{sha[:8]}.jpg", data)
            if "error" in result:
                self.errors.append(f"{self.slug}: upload: {result['error']}")
                return
            self.uploaded.add(sha)
            self._place(result["id"])
            time.sleep(self._random.expovariate(1 / self._pause_s))

    def _upload(self, name: str, data: bytes) -> dict[str, Any]:
        """Send a photo until database and storage are available; return its result."""
        until = time.monotonic() + PATIENCE_S
        while True:
            files = {"file": (name, data)}
            path = f"/maps/{self.slug}/photos"
            answer = self.client.repeat("POST", path, files=files, timeout=_WORKS_FOR_S)
            if answer.status_code != 207:
                return {"error": answer.text[:300]}
            result: dict[str, Any] = answer.json()[0]
            is_away = result.get("error", {}).get("code") in _AWAY
            if not is_away or time.monotonic() > until:
                return result
            time.sleep(_PAUSE_S)

    def _place(self, id: int) -> None:
        x, y = round(self._random.uniform(0, 1000), 2), round(self._random.uniform(0, 700), 2)
        change = {"id": id, "x_px": x, "y_px": y}
        until = time.monotonic() + PATIENCE_S
        while time.monotonic() < until:
            seen = self.client.repeat("GET", f"/maps/{self.slug}").json()["revision"]
            body = {"seen": seen, "kind": "place", "changes": [change]}
            try:
                answer = self.client.call("PATCH", f"/maps/{self.slug}/experiences", json=body)
            except requests.RequestException:
                continue  # placing it at the same position again changes nothing
            if answer.ok:
                self.placed[id] = (x, y)
                return
            if answer.status_code not in (409, 412):
                break
        self.errors.append(f"{self.slug}: photo {id} is not placed")


class Localizer:
    """Localizes photos of a map, and compares the answers with their places.

    Attributes:
    ----------
    answers : int
        Number of right answers.
    """

    def __init__(
        self,
        client: PatientClient,
        slug: str,
        queries: list[tuple[bytes, float, float]],
        *,
        pause_s: float,
    ) -> None:
        self.slug = slug
        self.answers = 0
        self.errors: list[str] = []
        self._client = client
        self._queries = queries
        self._pause_s = pause_s

    def work(self, seconds: float) -> None:
        """Localize for a number of seconds."""
        until = time.monotonic() + seconds
        while time.monotonic() < until:
            data, x, y = random.choice(self._queries)
            problem = localizing_problem(self._client, self.slug, data, place=(x, y))
            if problem is None:
                self.answers += 1
            else:
                self.errors.append(problem)
            time.sleep(random.expovariate(1 / self._pause_s))


def localizing_problem(
    client: PatientClient, slug: str, data: bytes, *, place: tuple[float, float]
) -> str | None:
    """Localize a photo of a map; describe an answer that is not near its place."""
    files = {"file": ("query.jpg", data)}
    answer = client.repeat("POST", f"/maps/{slug}/localize", files=files, timeout=_WORKS_FOR_S)
    found = answer.json().get("hypotheses", []) if answer.ok else []
    if found and np.hypot(found[0]["x_px"] - place[0], found[0]["y_px"] - place[1]) < _NEAR_PX:
        return None
    return f"{slug} answers {answer.status_code} {answer.text[:300]}"


def noise_photo(draw: np.random.Generator) -> bytes:
    """Draw a photo of coarse noise, which has features."""
    coarse = Image.fromarray(draw.integers(0, 255, (24, 32, 3), np.uint8))
    file = io.BytesIO()
    coarse.resize((320, 240)).save(file, "JPEG")
    return file.getvalue()
