"""Measures page loads over a slow connection: requests, bytes, and times until pages are usable.

    python -m benchmarks.page_loads [--mbit 1.6] [--latency 150] [--repeat 3] [--json OUT]

Starts the program with the sample map and opens its pages in a browser with an empty cache and an emulated
network. `ready` is DOMContentLoaded, after which all scripts have run; `first dot` is when photos are drawn
on the image; `loaded` is when the last visible picture has arrived. Photos are counted separately from the
other files of the page. The last lines are the times from a key on the page View to a picture of the next
photo: on the way, where it was loaded ahead, and far away, where it comes from the network.
"""

from __future__ import annotations

import argparse
import json
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

from playwright.sync_api import Browser, Page, sync_playwright

from benchmarks.client import Client
from benchmarks.large_map import FIRST_DOT
from tests.browser.app import App, expmap
from tests.browser.ensure_browser import find_browser
from tests.browser.watch import BROWSER_OPTIONS

QUIET_S = 2.0
"""A page without new requests for this time has loaded, not counting those that poll every second."""
PHOTO_PARTS = ("/thumb", "/preview", "/thumbnail")
POLLS = ("/changes", "/jobs")
VIEW = "/maps/sample/view"
NEXT_PHOTO_MS = """
async ({ key, count, large }) => {
  const image = document.getElementById("photo-image");
  const times = [];
  for (let n = 0; n < count; n += 1) {
    const start = performance.now();
    document.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true }));
    const { id } = document.querySelector("#strip [aria-selected=true]").dataset;
    const wanted = large ? `/photos/${id}/preview` : `/photos/${id}/`;
    while (!image.currentSrc.includes(wanted) || !image.complete) await new Promise(requestAnimationFrame);
    await image.decode();
    await new Promise(requestAnimationFrame);
    times.push(performance.now() - start);
    await new Promise((resolve) => setTimeout(resolve, 1500));
  }
  return times;
}
"""
"""Milliseconds from each press of a key on View until a picture is shown: the `large` one, or any."""


def main() -> None:
    """Measure and print a line for each page."""
    arguments = _arguments()
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "maps"
        expmap("sample", library / "sample", library=library)
        with App(library) as app:
            client = Client(app.url, app.sign_in)
            _wait_for_sample(client)
            share = client.ask("POST", "/maps/sample/shares", json={"photos": True})
            pages = {name: f"{app.url}{path}" for name, path in _PAGES.items()} | {"shared map": share["url"]}
            rows = _measure(client, pages, arguments)
            steps = _walk(client, f"{app.url}{VIEW}", arguments)
    header = ("page", "requests", "kB", "photos", "photos kB", "ready s", "first dot s", "loaded s")
    print("".join(f"{word:>12}" for word in header))
    for row in rows:
        print("".join(f"{value if value is not None else '-':>12}" for value in row.values()))
    for name, times in steps.items():
        print(f"photo to photo, {name}: median {statistics.median(times):.0f} ms, most {max(times):.0f} ms")
    if arguments.json:
        arguments.json.write_text(json.dumps({"pages": rows, "photo to photo": steps}, indent=1) + "\n")


_PAGES = {
    "maps": "/",
    "view": VIEW,
    "editor": "/maps/sample/edit",
    "localize": "/maps/sample/localize",
    "image": "/maps/sample/image",
    "quality": "/maps/sample/quality",
    "missions": "/missions",
}


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--mbit", type=float, default=1.6, help="per second")
    parser.add_argument("--latency", type=float, default=150.0, help="milliseconds of each request")
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--json", type=Path)
    return parser.parse_args()


def _wait_for_sample(client: Client) -> None:
    """Wait until the map exists and its index is built, which keeps the processor busy."""
    until = time.monotonic() + 300
    while not _is_ready(client) and time.monotonic() < until:
        time.sleep(0.5)


def _is_ready(client: Client) -> bool:
    answer = client.call("GET", "/maps/sample/changes?since=0")
    jobs = answer.json()["jobs"] if answer.ok else []
    return bool(jobs) and all(job["state"] not in ("queued", "running") for job in jobs)


def _measure(client: Client, pages: dict[str, str], arguments: argparse.Namespace) -> list[dict[str, Any]]:
    rows = []
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=find_browser(), args=list(BROWSER_OPTIONS))
        for name, address in pages.items():
            loads = [_load(browser, address, (client, arguments)) for _ in range(arguments.repeat)]
            medians = {key: _median([load[key] for load in loads]) for key in loads[0]}
            rows.append({"page": name, **medians})
        browser.close()
    return rows


def _median(values: list[float | None]) -> float | None:
    known = [value for value in values if value is not None]
    return round(statistics.median(known), 2) if known else None


def _walk(client: Client, address: str, arguments: argparse.Namespace) -> dict[str, list[float]]:
    """Measure the steps from photo to photo."""
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=find_browser(), args=list(BROWSER_OPTIONS))
        page, _ = _open(browser, address, (client, arguments))
        ahead = page.evaluate(NEXT_PHOTO_MS, {"key": "ArrowRight", "count": 8, "large": True})
        far = page.evaluate(NEXT_PHOTO_MS, {"key": "End", "count": 1, "large": False})
        browser.close()
    return {"loaded ahead": ahead, "far away": far}


def _load(browser: Browser, address: str, who: tuple[Client, argparse.Namespace]) -> dict[str, Any]:
    page, seen = _open(browser, address, who)
    timing = page.evaluate(
        "({ready: performance.getEntriesByType('navigation')[0].domContentLoadedEventEnd,"
        " firstDot: window.firstDot ?? null, loaded: Math.max(...performance.getEntriesByType('resource')"
        ".filter(({name}) => !/changes|jobs/.test(name)).map(({responseEnd}) => responseEnd))})"
    )
    page.context.close()
    seconds = {key: None if value is None else value / 1000 for key, value in timing.items()}
    return {**{key: seen[key] for key in ("requests", "kB", "photos", "photos kB")}, **seconds}


def _open(
    browser: Browser, address: str, who: tuple[Client, argparse.Namespace]
) -> tuple[Page, dict[str, Any]]:
    """Open a page and wait until it is quiet; also return what was counted."""
    client, arguments = who
    context = browser.new_context(viewport={"width": 1366, "height": 768}, service_workers="block")
    context.add_cookies(
        [{"name": c.name, "value": c.value or "", "url": client.url} for c in client.session.cookies]
    )
    context.add_init_script(FIRST_DOT)
    page = context.new_page()
    seen = _watch(page, arguments)
    page.goto(address, wait_until="load", timeout=120_000)
    while time.monotonic() - seen["last"] < QUIET_S:
        page.wait_for_timeout(100)
    return page, seen


def _watch(page: Page, arguments: argparse.Namespace) -> dict[str, Any]:
    """Throttle the network, and count responses."""
    seen: dict[str, Any] = {"requests": 0, "kB": 0.0, "photos": 0, "photos kB": 0.0, "last": time.monotonic()}
    addresses: dict[str, str] = {}
    session = page.context.new_cdp_session(page)
    session.send("Network.enable")
    session.send(
        "Network.emulateNetworkConditions",
        {
            "offline": False,
            "latency": arguments.latency,
            "downloadThroughput": arguments.mbit * 1e6 / 8,
            "uploadThroughput": arguments.mbit * 1e6 / 8,
        },
    )

    def asked(event: dict[str, Any]) -> None:
        addresses[event["requestId"]] = event["request"]["url"].split("?")[0]

    def come(event: dict[str, Any]) -> None:
        address = addresses.get(event["requestId"], "")
        if address.endswith(POLLS) or address.startswith("data:"):
            return
        photo = address.endswith(PHOTO_PARTS)
        seen["photos" if photo else "requests"] += 1
        seen["photos kB" if photo else "kB"] += event["encodedDataLength"] / 1000
        seen["last"] = time.monotonic()

    session.on("Network.requestWillBeSent", asked)
    session.on("Network.loadingFinished", come)
    return seen


if __name__ == "__main__":
    main()
