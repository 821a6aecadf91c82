"""Watches pages during a test: errors that users should never see fail it."""

import re
from collections.abc import Sequence

from playwright.sync_api import BrowserContext, ConsoleMessage, Page, Request, Response

REPORT_VIOLATIONS = """
addEventListener("securitypolicyviolation", ({violatedDirective, blockedURI, sourceFile, lineNumber}) =>
  console.error(`policy: ${violatedDirective} ${blockedURI} ${sourceFile}:${lineNumber}`));
"""
HARMLESS = ("Service Worker registration blocked by Playwright", "GL Driver Message (OpenGL, Performance")
"""The second one comes from WebGL in software."""
STATUS = re.compile(r"Failed to load resource: the server responded with a status of (\d+)")


class Watch:
    """Errors of all pages of a context: foreign requests, the console, scripts, the policy, answers 5xx.

    Attributes
    ----------
    faults : list of str
    expected : set of int
        Status codes 4xx that the test causes on purpose.
    """

    def __init__(self, context: BrowserContext, url: str) -> None:
        self.faults: list[str] = []
        self.expected: set[int] = set()
        self._allowed = [url]
        context.add_init_script(REPORT_VIOLATIONS)
        context.on("request", self._request)
        context.on("console", self._console)
        context.on("weberror", lambda error: self.faults.append(f"script: {error.error}"))
        context.on("response", self._response)
        context.on("page", lambda page: page.on("crash", self._crash))

    def expect(self, *statuses: int) -> None:
        """Allow answers that the test causes on purpose."""
        self.expected |= set(statuses)

    def allow(self, url: str) -> None:
        """Allow requests to another server that the test runs."""
        self._allowed.append(url)

    def check(self) -> None:
        """Raise an error if there were faults."""
        assert not self.faults, "\n".join(self.faults)

    def _ours(self, address: str) -> bool:
        servers = [f"{url}/" for url in self._allowed]
        return address.startswith((*servers, "data:", "blob:", "about:"))

    def _request(self, request: Request) -> None:
        if not self._ours(request.url):
            self.faults.append(f"asks somebody else: {request.url}")

    def _console(self, message: ConsoleMessage) -> None:
        if message.type not in ("error", "warning") or any(text in message.text for text in HARMLESS):
            return
        status = STATUS.search(message.text)
        if status is None or int(status[1]) not in self.expected:
            self.faults.append(f"console, {message.location.get('url')}: {message.text}")

    def _response(self, response: Response) -> None:
        if response.status >= 500:
            self.faults.append(f"{response.status}: {response.request.method} {response.url}")

    def _crash(self, page: Page) -> None:
        self.faults.append(f"the page crashed: {page.url}")


BROWSER_OPTIONS: Sequence[str] = (
    "--no-sandbox",
    "--disable-gpu",
    "--disable-background-networking",
    "--no-first-run",
    "--disable-component-update",
    "--disable-sync",
    "--host-resolver-rules=MAP * ~NOTFOUND, EXCLUDE 127.0.0.1, EXCLUDE localhost",
)
"""Options of chromium that block all network access, of the browser and of pages.

A route for foreign addresses would do so, too, but a context with a route has no cache: each page would load
all scripts again.
"""
