"""HTTP client with a user's session, which sends requests to the API as the pages do."""

from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import requests

CSRF = re.compile(r'<meta name="csrf-token" content="([^"]+)"')


class Client:
    """A client that is signed in by a link; sends the CSRF token as the pages do.

    Args:
        url: Address of the program.
        link: Single-use link for signing in.
    """

    def __init__(self, url: str, link: str) -> None:
        self.url = url
        self.session = requests.Session()
        form = {"csrf_token": self._token(self.session.get(link, timeout=60))}
        page = self.session.post(link, data=form, timeout=60)
        self.session.headers["X-CSRFToken"] = self._token(page)

    @staticmethod
    def _token(page: requests.Response) -> str:
        found = CSRF.search(page.text)
        if not page.ok or found is None:
            raise SystemExit(f"{page.status_code}, and no token in the page: {page.url}")
        return found[1]

    def call(self, method: str, path: str, **options: Any) -> requests.Response:
        """Send a request to the API; return the response whatever its status."""
        return self.session.request(method, f"{self.url}/api/v1{path}", **{"timeout": 60, **options})

    def ask(self, method: str, path: str, **options: Any) -> Any:
        """Send a request to the API that must succeed; return its JSON."""
        answer = self.call(method, path, **options)
        if not answer.ok:
            raise SystemExit(f"{method} {path}: {answer.status_code} {answer.text[:500]}")
        return answer.json()

    def make_map(self, name: str, *, satellite: Path, photos: list[Path]) -> str:
        """Make a map with a satellite image and photos; return its slug."""
        slug = self.ask("POST", "/maps", json={"name": name})["slug"]
        with satellite.open("rb") as image:
            self.ask("PUT", f"/maps/{slug}/satellite", files={"file": (satellite.name, image)})
        for path in photos:
            with path.open("rb") as photo:
                (result,) = self.ask("POST", f"/maps/{slug}/photos", files={"file": (path.name, photo)})
            if "error" in result:
                raise SystemExit(f"{path}: {result['error']}")
        return str(slug)
