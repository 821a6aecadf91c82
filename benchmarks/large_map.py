"""Measures a map with very many photos in the web application: edits, undo, state, pages, first dots drawn.

    python -m benchmarks.large_map [--photos 20000] [--bulk 9999] [--repeat 5] [--json OUT]

The photos are records without files, since no measured operation reads a photo. Seconds are medians of
`--repeat` runs; bytes are those on the wire. The first dot is the time at which the page begins to draw
photos on its canvas, from the start of the navigation, in a browser with an empty cache.
"""

from __future__ import annotations

import argparse
import json
import statistics
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import requests
from playwright.sync_api import Browser, Page, sync_playwright
from sqlalchemy import insert

from benchmarks.client import Client
from tests.browser.app import App
from tests.browser.ensure_browser import find_browser
from tests.browser.watch import BROWSER_OPTIONS
from webapp.store.library import open_library
from webapp.store.schema import MapRecord, Photo

PLAN_PX = (4000, 3000)
PATIENCE_S = 120
FIRST_DOT = """
const draw = CanvasRenderingContext2D.prototype.arc;
CanvasRenderingContext2D.prototype.arc = function (...arc) {
  window.firstDot ??= performance.now();
  return draw.apply(this, arc);
};
"""
_FRAMES = """
window.frames_ms = [];
let before = performance.now();
const tick = (now) => { window.frames_ms.push(now - before); before = now; requestAnimationFrame(tick); };
requestAnimationFrame(tick);
"""


def main() -> None:
    """Measure and print a line for each figure."""
    arguments = _arguments()
    with tempfile.TemporaryDirectory() as folder:
        library = Path(folder) / "maps"
        with App(library, environ={"EXPMAP_WEB_REQUESTS_PER_MINUTE": "100000"}) as app:
            client = Client(app.url, app.sign_in)
            slug = client.make_map("Large", satellite=_plan(Path(folder)), photos=[])
            fill(library, slug, count=arguments.photos)
            figures = _measure(client, slug, arguments)
            _wait_for_export(library, slug)
            figures |= _in_browser(client, slug, arguments)
    for name, value in figures.items():
        print(f"{name:28} {value:>12}")
    if arguments.json:
        arguments.json.write_text(json.dumps(figures, indent=1) + "\n")


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--photos", type=int, default=20_000)
    parser.add_argument("--bulk", type=int, default=9_999, help="photos moved in one edit")
    parser.add_argument("--repeat", type=int, default=5)
    parser.add_argument("--json", type=Path)
    return parser.parse_args()


def _plan(folder: Path) -> Path:
    path = folder / "plan.jpg"
    cv2.imwrite(str(path), np.full((PLAN_PX[1], PLAN_PX[0], 3), 200, np.uint8))
    return path


def fill(folder: Path, slug: str, *, count: int) -> None:
    """Add photos to the map as one revision; nine of ten have a position."""
    rng = np.random.default_rng(1)
    at = rng.uniform((0, 0), PLAN_PX, (count, 2)).round(2)
    library = open_library(folder)
    with library.database.write() as session:
        record = session.query(MapRecord).filter_by(slug=slug).one()
        record.revision += 1
        record.next_id = count
        record.photos_revision = record.revision
        rows = [
            {
                "map_id": record.id,
                "id": number,
                "name": f"IMG_{number:05}.jpg",
                "path": f"photos/img_{number:05}-{number:08x}.jpg",
                "sha256": f"{number:064x}",
                "size_bytes": 3_000_000,
                "width": 4000,
                "height": 3000,
                "taken_at": f"2026-05-{number // 1000 + 1:02}T{number % 24:02}:{number % 60:02}:00",
                "fov_deg": 65.0,
                "gps_problem": "the photo has no GPS position",
                "x_px": float(at[number, 0]) if number % 10 else None,
                "y_px": float(at[number, 1]) if number % 10 else None,
                "heading_deg": float(number % 360) if number % 2 else None,
                "removed": False,
                "revision": record.revision,
            }
            for number in range(count)
        ]
        session.execute(insert(Photo), rows)
    library.database.close()


def _wait_for_export(folder: Path, slug: str) -> None:
    library = open_library(folder)
    until = time.monotonic() + 120
    while time.monotonic() < until:
        with library.database.read() as session:
            record = session.query(MapRecord).filter_by(slug=slug).one()
            if record.exported_revision == record.revision:
                break
        time.sleep(0.2)
    library.database.close()


def _measure(client: Client, slug: str, arguments: argparse.Namespace) -> dict[str, Any]:
    """Time the requests one after the other."""
    path = f"/maps/{slug}"
    rng = np.random.default_rng(2)
    placed = [number for number in range(arguments.photos) if number % 10]

    def edit(count: int) -> None:
        ids = rng.choice(placed, count, replace=False)
        at = rng.uniform((0, 0), PLAN_PX, (count, 2))
        changes = [
            {"id": int(i), "x_px": float(x), "y_px": float(y)} for i, (x, y) in zip(ids, at, strict=True)
        ]
        client.ask("PATCH", f"{path}/experiences", json={"kind": "move", "changes": changes})

    def median(run: Callable[[], object]) -> float:
        return round(statistics.median(_seconds(run) for _ in range(arguments.repeat)), 3)

    later = client.ask("GET", path)["revision"] + 10 * arguments.repeat
    answers: list[requests.Response] = []
    figures: dict[str, Any] = {
        "photos": arguments.photos,
        "one edit, s": median(lambda: edit(1)),
        f"{arguments.bulk} in one edit, s": median(lambda: edit(arguments.bulk)),
        "undo of it, s": median(lambda: client.ask("POST", f"{path}/undo", json={})),
        "redo of it, s": median(lambda: client.ask("POST", f"{path}/redo", json={})),
        "changes, nothing new, s": median(lambda: client.ask("GET", f"{path}/changes?since={later}")),
        "state, s": median(lambda: answers.append(client.call("GET", path))),
        "map.cfg, s": median(lambda: client.call("GET", f"{path}/map.cfg")),
    }
    return {**figures, "state, kB": _wire_kb(answers[-1].url, client)}


def _seconds(run: Callable[[], object]) -> float:
    start = time.monotonic()
    run()
    return time.monotonic() - start


def _wire_kb(url: str, client: Client) -> float:
    """Count the bytes of a response on the wire, with the compression that a browser requests."""
    headers = {"Accept-Encoding": "gzip, deflate, br, zstd"}
    with client.session.get(url, headers=headers, stream=True, timeout=60) as answer:
        return round(len(answer.raw.read(decode_content=False)) / 1000, 1)


def _in_browser(client: Client, slug: str, arguments: argparse.Namespace) -> dict[str, Any]:
    share = client.ask("POST", f"/maps/{slug}/shares", json={"photos": True})
    pages = {
        "editor": f"{client.url}/maps/{slug}/edit",
        "localize page": f"{client.url}/maps/{slug}/localize",
        "shared page": share["url"],
    }
    figures: dict[str, Any] = {}
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=find_browser(), args=list(BROWSER_OPTIONS))
        for name, address in pages.items():
            figures[f"{name}, kB"] = _wire_kb(address, client)
            figures[f"{name}, s"] = round(
                statistics.median(
                    _seconds(lambda: client.session.get(address, timeout=60))  # noqa: B023
                    for _ in range(arguments.repeat)
                ),
                3,
            )
            times = [_first_dot(browser, address, client) for _ in range(arguments.repeat)]
            figures[f"{name}, first dot, s"] = round(statistics.median(times) / 1000, 3)
        figures["editor, frame of a drag, ms"] = _frame_ms(browser, pages["editor"], client)
        browser.close()
    return figures


def _first_dot(browser: Browser, address: str, client: Client) -> float:
    page, first = _open(browser, address, client)
    page.context.close()
    return first


def _frame_ms(browser: Browser, address: str, client: Client) -> float:
    """Drag the image about; return the median time between frames (ideally 1/60 s), milliseconds."""
    page, _first = _open(browser, address, client)
    page.wait_for_timeout(5000)
    box = page.locator("#map-canvas").bounding_box()
    assert box is not None
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    page.keyboard.press("Escape")
    page.mouse.move(x, y)
    page.mouse.down(button="left")
    page.evaluate(_FRAMES)
    for step in range(60):
        page.mouse.move(x + 4 * (step % 30), y + 2 * (step % 30))
    page.mouse.up()
    frames = page.evaluate("window.frames_ms")
    page.context.close()
    return round(statistics.median(frames), 1)


def _open(browser: Browser, address: str, client: Client) -> tuple[Page, float]:
    """Open a page, and wait for its first dot; return its time in milliseconds."""
    context = browser.new_context(viewport={"width": 1366, "height": 768}, service_workers="block")
    context.add_cookies(
        [{"name": c.name, "value": c.value or "", "url": client.url} for c in client.session.cookies]
    )
    context.add_init_script(FIRST_DOT)
    page = context.new_page()
    page.goto(address, wait_until="commit", timeout=1000 * PATIENCE_S)
    until = time.monotonic() + PATIENCE_S
    while (first := page.evaluate("window.firstDot ?? null")) is None:
        if time.monotonic() > until:
            raise SystemExit(f"{address}: no photo is drawn")
        time.sleep(0.02)
    return page, float(first)


if __name__ == "__main__":
    main()
