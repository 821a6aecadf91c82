"""Uploads a folder of hundreds of photos through the page, as a person does, and checks all that comes of it.

    python -m benchmarks.upload_getty MAPFOLDER [--photos 500] [--kill SECONDS] [--queries 60] [--json OUT]

MAPFOLDER holds `map.cfg`, its image and its photos, and `queries.csv` for the evaluation. A new map is made
in the browser: image, photos in one go, positions by file name from `map.cfg`. Then the index is awaited, the
`.cfg` is taken away, checked by `expmap map check`, and evaluated beside an index that the command line builds
of the same photos. With `--kill`, a random process of the server is killed with SIGKILL every few seconds
until the index is ready; the server mends itself and the page goes on.
"""

from __future__ import annotations

import argparse
import contextlib
import hashlib
import json
import shutil
import tempfile
import threading
import time
from pathlib import Path
from typing import Any

import numpy as np
import requests
from playwright.sync_api import Page, sync_playwright

from benchmarks.killer import Killer
from tests.browser.app import App, expmap
from tests.browser.ensure_browser import MISSING, find_browser
from tests.browser.watch import BROWSER_OPTIONS
from webapp.files.cfg import read_cfg

PATIENCE_S = 1800
FIGURES = ("median_px", "within_10px", "within_20px", "within_50px", "within_100px")
LAGS = """
window.lags = [];
let before = performance.now();
setInterval(() => { const now = performance.now(); window.lags.push(now - before - 50); before = now; }, 50);
"""


def main() -> None:
    """Run it and print one JSON object; exit code 1 when something was wrong."""
    arguments = _arguments()
    browser = find_browser()
    if browser is None:
        raise SystemExit(MISSING)
    with tempfile.TemporaryDirectory() as folder:
        source = _subset(arguments.folder, Path(folder) / "source", count=arguments.photos)
        library = Path(folder) / "maps"
        with App(library) as app, sync_playwright() as playwright:
            chromium = playwright.chromium.launch(executable_path=browser, args=list(BROWSER_OPTIONS))
            page = chromium.new_page(base_url=app.url)
            page.add_init_script(LAGS)
            killer = Killer(app.pid, every_s=arguments.kill) if arguments.kill else None
            times, slug = _author(page, app, source=source, killer=killer)
            exported = _download(page, Path(folder) / "exported.cfg")
            state = page.request.get(f"/api/v1/maps/{slug}").json()
            lags = page.evaluate("window.lags")
            chromium.close()
        figures = {"seconds": times, "page_lag_ms": _spread(lags)}
        if killer is not None:
            figures["killed"] = dict(killer.killed)
        problems = _problems(source, state, library=library / slug, exported=exported)
        expmap("map", "check", library / slug / "map.cfg", library=library)
        if arguments.queries:
            figures["evaluate"] = _evaluate(arguments, source, library=library / slug)
    text = json.dumps({**figures, "problems": problems}, indent=2)
    print(text)
    if arguments.json:
        arguments.json.write_text(text)
    raise SystemExit(1 if problems else 0)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--photos", type=int, default=500)
    parser.add_argument("--kill", type=float, default=0, metavar="SECONDS", help="between two kills; 0 for none")
    parser.add_argument("--queries", type=int, default=60, help="of the evaluation; 0 for none")
    parser.add_argument("--json", type=Path, help="write the figures there too")
    return parser.parse_args()


def _subset(folder: Path, target: Path, *, count: int) -> Path:
    """Copy the first photos of a map and the lines about them; gives the new `.cfg`."""
    lines = (folder / "map.cfg").read_text("utf-8").splitlines()[: count + 1]
    for line, field in zip(lines, [0, *[1] * count], strict=False):
        path = line.split(";")[field]
        (target / path).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(folder / path, target / path)
    (target / "map.cfg").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return target / "map.cfg"


def _author(page: Page, app: App, *, source: Path, killer: Killer | None) -> tuple[dict[str, float], str]:
    """Make the map by hand; gives seconds of each step and the slug."""
    image, *photos = _files(source)
    times: dict[str, float] = {}
    page.goto(app.sign_in)
    page.get_by_test_id("sign-in").click()
    page.get_by_test_id("new-map").click()
    page.get_by_test_id("map-name").fill("Getty")
    page.get_by_test_id("map-name").press("Enter")
    page.wait_for_url("**/maps/*/edit")
    slug = page.url.split("/")[-2]
    page.get_by_test_id("satellite-input").set_input_files(image)
    page.locator("[data-testid=map-canvas] canvas").wait_for()
    with _timed(times, "upload"), contextlib.ExitStack() as killing:
        if killer is not None:
            killing.enter_context(killer)
        page.get_by_test_id("photo-input").set_input_files(photos)
        _wait_for_text(page, "tray-count", str(len(photos)))
        with _timed(times, "positions"):
            _import_positions(page, source)
            _wait_for_text(page, "placed-count", str(len(photos)))
        with _timed(times, "index"):
            _wait_for_jobs(page, slug)
    return times, slug


@contextlib.contextmanager
def _timed(times: dict[str, float], name: str) -> Any:
    start = time.monotonic()
    yield
    times[name] = round(time.monotonic() - start, 1)
