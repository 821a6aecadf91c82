"""Measures page loads over a slow connection: requests, bytes, and times until pages are usable.

    python -m benchmarks.page_loads [--mbit 1.6] [--latency 150] [--repeat 3] [--pages view,editor]
        [--map FOLDER] [--json OUT]

Starts the program with the sample map, or another, and opens its pages in a browser with an empty cache
and an emulated network. `ready` is DOMContentLoaded, after which all scripts have run; `first dot` is
when photos are drawn on the image; `loaded` is when the last visible picture has arrived. Photos are
counted separately from the other files of the page. The last lines are the times from a key on the page
View until a picture of the next photo is shown, and until the large one is: on the way, where it was
loaded ahead; far away, where it comes from the network; and far away after quick steps, whose pictures
have not all arrived.
"""

from __future__ import annotations

import argparse
import json
import shutil
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
NEXT_PHOTO_MS = """
async ({ keys, pause }) => {
  const image = document.getElementById("photo-image");
  const frame = () => new Promise(requestAnimationFrame);
  const steps = [];
  for (const key of keys) {
    const start = performance.now();
    document.dispatchEvent(new KeyboardEvent("keydown", { key, bubbles: true }));
    await frame(); // the filmstrip follows then
    const { id } = document.querySelector("#strip [aria-selected=true]").dataset;
    const shown = async (address) => {
      while (!image.currentSrc.includes(address) || !image.complete || !image.naturalWidth) {
        if (performance.now() - start > 30000) throw new Error(`no ${address}, but ${image.currentSrc}`);
        await frame();
      }
      await image.decode().catch(() => {}); // replaced meanwhile
      await frame();
      return performance.now() - start;
    };
    steps.push({ shown: await shown(`/photos/${id}/`), large: await shown(`/photos/${id}/preview`) });
    await new Promise((resolve) => setTimeout(resolve, pause));
  }
  return steps;
}
"""
"""Milliseconds from each press of a key on View until a picture is shown, and until the large one is."""

HURRY = """
async () => {
  for (let n = 0; n < 4; n += 1) {
    document.dispatchEvent(new KeyboardEvent("keydown", { key: "ArrowRight", bubbles: true }));
    await new Promise((resolve) => setTimeout(resolve, 200));
  }
}
"""
"""Steps too quick for the pictures to arrive."""


def main() -> None:
    """Measure and print a line for each page."""
    arguments = _arguments()
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "maps"
        expmap("sample", library / "sample", library=library)
        with App(library) as app:
            client = Client(app.url, app.sign_in)
            slug = "sample" if arguments.map is None else _import(client, arguments.map, Path(folder))
            _wait_for_jobs(client)
            share = client.ask("POST", f"/maps/{slug}/shares", json={"photos": True})
            pages = {name: app.url + path.format(slug) for name, path in _PAGES.items()}
            pages["shared map"] = share["url"]
            measured = {name: address for name, address in pages.items() if name in arguments.pages}
            rows = _measure(client, measured, arguments)
            walks = _walk(client, pages["view"], arguments)
    header = ("page", "requests", "kB", "photos", "photos kB", "ready s", "first dot s", "loaded s")
    print("".join(f"{word:>12}" for word in header))
    for row in rows:
        print("".join(f"{value if value is not None else '-':>12}" for value in row.values()))
    for name, steps in walks.items():
        times = "; ".join(f"{kind} {_times([step[kind] for step in steps])}" for kind in ("shown", "large"))
        print(f"photo to photo, {name}: {times}")
    if arguments.json:
        arguments.json.write_text(json.dumps({"pages": rows, "photo to photo": walks}, indent=1) + "\n")


_PAGES = {
    "maps": "/",
    "view": "/maps/{}/view",
    "editor": "/maps/{}/edit",
    "localize": "/maps/{}/localize",
    "image": "/maps/{}/image",
    "quality": "/maps/{}/quality",
    "missions": "/missions",
}


def _times(times: list[float]) -> str:
    return f"median {statistics.median(times):.0f} ms, most {max(times):.0f} ms"


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--mbit", type=float, default=1.6, help="per second")
    parser.add_argument("--latency", type=float, default=150.0, help="milliseconds of each request")
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--pages", type=lambda text: text.split(","), default=[*_PAGES, "shared map"])
    parser.add_argument("--map", type=Path, help="folder of a map, which is copied, instead of the sample")
    parser.add_argument("--json", type=Path)
    return parser.parse_args()


def _import(client: Client, folder: Path, scratch: Path) -> str:
    archive = Path(shutil.make_archive(str(scratch / "map"), "zip", folder))
    with archive.open("rb") as file:
        client.ask("POST", "/maps/import", files={"file": file}, data={"name": "walk"}, timeout=600)
    return "walk"


def _wait_for_jobs(client: Client) -> None:
    """Wait until the maps exist and have an index, as building it keeps the processor busy."""
    until = time.monotonic() + 900
    while _is_busy(client) and time.monotonic() < until:
        time.sleep(0.5)


def _is_busy(client: Client) -> bool:
    jobs = client.ask("GET", "/jobs")["jobs"]
    return not jobs or any(job["state"] in ("queued", "running") for job in jobs)


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


def _walk(client: Client, address: str, arguments: argparse.Namespace) -> dict[str, list[dict[str, float]]]:
    """Measure steps from photo to photo."""
    walks: dict[str, list[dict[str, float]]] = {
        "loaded ahead": [],
        "far away": [],
        "far away, in a hurry": [],
    }
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=find_browser(), args=list(BROWSER_OPTIONS))
        for _ in range(arguments.repeat):
            page, _seen = _open(browser, address, (client, arguments))
            ahead = page.evaluate(NEXT_PHOTO_MS, {"keys": ["ArrowRight"] * 5, "pause": 4000})
            far = page.evaluate(NEXT_PHOTO_MS, {"keys": ["End"], "pause": 0})
            page.context.close()
            page, _seen = _open(browser, address, (client, arguments))
            page.evaluate(HURRY)
            hurried = page.evaluate(NEXT_PHOTO_MS, {"keys": ["End"], "pause": 0})
            page.context.close()
            for name, steps in zip(walks, (ahead, far, hurried), strict=True):
                walks[name] += steps
        browser.close()
    return walks


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
