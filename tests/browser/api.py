"""The API for the signed-in user of a browser context: to set up a test, and to check its result."""

import re
import time
from collections.abc import Iterable
from pathlib import Path
from typing import Any

from playwright.sync_api import APIResponse, BrowserContext

TOKEN = re.compile(r'<meta name="csrf-token" content="([^"]+)"')
BUSY = ("queued", "running")
WITHOUT_PROGRESS_S = 600
"""Limit for jobs that do not advance; no other, as a busy machine can take any time for a long one."""


class Api:
    """Sends requests with the cookies of a context.

    Parameters
    ----------
    context : BrowserContext
        Signed in.
    """

    def __init__(self, context: BrowserContext) -> None:
        self.request = context.request
        found = TOKEN.search(self.request.get("/").text())
        assert found, "the page holds no token against forged requests"
        self._headers = {"X-CSRFToken": found[1]}

    def call(self, method: str, path: str, **options: Any) -> APIResponse:
        """Request a path below `/api/v1`; any status is accepted."""
        # The server may close an idle connection just when a request is sent on it, so none is kept alive.
        headers = {**self._headers, "Connection": "close"}
        retries = 1 if method == "GET" else 0  # after a connection reset, as browsers do for safe methods
        return self.request.fetch(
            f"/api/v1{path}", method=method, headers=headers, max_retries=retries, **options
        )

    def ask(self, method: str, path: str, **options: Any) -> Any:
        """Send a request that must succeed, and return its JSON."""
        answer = self.call(method, path, **options)
        assert answer.ok, f"{method} {path}: {answer.status} {answer.text()[:500]}"
        return answer.json() if answer.status != 204 else None

    def state(self, slug: str) -> dict[str, Any]:
        """Return the state of a map, as its page gets it."""
        return self.ask("GET", f"/maps/{slug}")

    def positions(self, slug: str) -> dict[str, tuple[float, float]]:
        """Return the positions of a map's placed photos by file name."""
        photos = self.state(slug)["photos"]
        return {p["name"]: (p["x_px"], p["y_px"]) for p in photos if p["x_px"] is not None}

    def make_map(
        self, name: str, *, satellite: Path | None, photos: Iterable[Path] = (), corners: Path | None = None
    ) -> str:
        """Make a map and return its slug."""
        slug = self.ask("POST", "/maps", data={"name": name})["slug"]
        if satellite is not None:
            parts: dict[str, Any] = {"file": str(satellite)}
            if corners is not None:
                parts["corners"] = corners.read_text("utf-8")
            parts["file"] = {
                "name": satellite.name,
                "mimeType": "image/png",
                "buffer": satellite.read_bytes(),
            }
            self.ask("PUT", f"/maps/{slug}/satellite", multipart=parts)
        for path in photos:
            part = {"name": path.name, "mimeType": "image/jpeg", "buffer": path.read_bytes()}
            (result,) = self.ask("POST", f"/maps/{slug}/photos", multipart={"file": part})
            assert "error" not in result, result
        return slug

    def wait_for_jobs(self, slug: str) -> list[dict[str, Any]]:
        """Wait until no job of a map is active, and return those that ended recently."""
        until, reached = 0.0, None
        while True:
            jobs = self.ask("GET", f"/jobs?map={slug}")["jobs"]
            if not any(job["state"] in BUSY for job in jobs):
                return jobs
            progress = [(job["id"], job["state"], job["note"], job["done"]) for job in jobs]
            if progress != reached:
                until, reached = time.monotonic() + WITHOUT_PROGRESS_S, progress
            assert time.monotonic() < until, f"no job has advanced for {WITHOUT_PROGRESS_S} s: {jobs}"
            time.sleep(0.3)

    def cancel_jobs(self, slug: str) -> None:
        """Cancel all jobs of a map that have not ended."""
        for job in self.ask("GET", f"/jobs?map={slug}")["jobs"]:
            if job["state"] in BUSY:
                self.call("POST", f"/jobs/{job['id']}/cancel")
