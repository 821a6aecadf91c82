"""Uploads a folder of hundreds of photos through the page, as a user does, and checks the resulting map.

    python -m benchmarks.upload_getty MAPFOLDER [--photos 500] [--kill SECONDS] [--queries 300] [--json OUT]

MAPFOLDER holds `map.cfg`, its image and its photos, and `queries.csv` for the evaluation. A new map is made
in the browser: image, photos all at once, positions by file name from `map.cfg`. When the index is built, the
`.cfg` is downloaded and compared, the map is checked by `expmap map check`, and its accuracy is compared with
that of an index that the command line builds from the same photos. With `--kill`, a random process of the
server is killed with SIGKILL every few seconds until the index is ready: the server recovers, the page
continues.
"""

from __future__ import annotations

import argparse
import contextlib
import json
import shutil
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np
from playwright.sync_api import Error, Page, sync_playwright

from benchmarks.killer import Killer
from benchmarks.upload_checks import problems_of
from tests.browser.app import App, expmap
from tests.browser.ensure_browser import MISSING, find_browser
from tests.browser.watch import BROWSER_OPTIONS

PATIENCE_MS = 60_000
UPLOAD_MS = 1_800_000
FIGURES = ("median_px", "within_10px", "within_20px", "within_50px", "within_100px")
COMPARED = ("within_20px", "within_50px", "within_100px")
POINTS = 0.02
"""Maximum difference between the page's index and that of the command line."""

LAGS = """
window.lags = [];
let before = performance.now();
setInterval(() => { const now = performance.now(); window.lags.push(now - before - 50); before = now; }, 50);
"""
"""Records the delay of timers, which equals the delay of responses to clicks."""


def main() -> None:
    """Run the upload and print one JSON object; exit with 1 if there were problems."""
    arguments = _arguments()
    with tempfile.TemporaryDirectory() as folder:
        source = _subset(arguments.folder, Path(folder) / "source", count=arguments.photos)
        library = Path(folder) / "maps"
        with App(library) as app:
            figures, slug, exported = _author(app, source, kill_s=arguments.kill)
        there = library / slug / "map.cfg"
        problems = problems_of(source, there, exported=exported)
        problems += figures.pop("problems")
        expmap("map", "check", there, library=library)
        if arguments.queries:
            figures["evaluate"] = found = _evaluate(arguments, source, there=there)
            problems += [
                f"{name}: {here:.3f} by the page, {own:.3f} by the command line"
                for name, (here, own) in found.items()
                if name in COMPARED and abs(here - own) > POINTS
            ]
    text = json.dumps({**figures, "problems": problems}, indent=2)
    print(text)
    if arguments.json:
        arguments.json.write_text(text)
    raise SystemExit(1 if problems else 0)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folder", type=Path)
    parser.add_argument("--photos", type=int, default=500)
    parser.add_argument("--kill", type=float, default=0, metavar="SECONDS", help="between two kills; 0: none")
    parser.add_argument("--queries", type=int, default=300, help="of the evaluation; 0 for none")
    parser.add_argument("--json", type=Path, help="write the figures there too")
    return parser.parse_args()


def _subset(folder: Path, target: Path, *, count: int) -> Path:
    """Copy the first photos of a map and their lines; return the new `.cfg`."""
    lines = (folder / "map.cfg").read_text("utf-8").splitlines()[: count + 1]
    for path in _named(lines):
        (target / path).parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(folder / path, target / path)
    (target / "map.cfg").write_text("\n".join(lines) + "\n", encoding="utf-8")
    return target / "map.cfg"


def _named(lines: list[str]) -> list[str]:
    """Return the paths in the lines of a `.cfg`: of the image, then of the photos."""
    return [lines[0].split(";")[0], *(line.split(";")[1] for line in lines[1:])]


def _author(app: App, source: Path, *, kill_s: float) -> tuple[dict[str, Any], str, bytes]:
    """Make the map in a browser; return figures, its slug, and the downloaded `.cfg`."""
    browser = find_browser()
    if browser is None:
        raise SystemExit(MISSING)
    with sync_playwright() as playwright:
        chromium = playwright.chromium.launch(executable_path=browser, args=list(BROWSER_OPTIONS))
        page = chromium.new_page(base_url=app.url)
        page.set_default_timeout(PATIENCE_MS)
        page.add_init_script(LAGS)
        slug = _new_map(page, app, image=source.parent / _lines(source)[0].split(";")[0])
        killer = Killer(app.pid, every_s=kill_s) if kill_s else None
        with killer or contextlib.nullcontext():
            times = _fill(page, slug, source=source)
        jobs = _jobs(page, slug)
        lags = page.evaluate("window.lags")
        with page.expect_download() as waiting:
            page.get_by_test_id("export-cfg").click()
        exported = Path(waiting.value.path()).read_bytes()
        chromium.close()
    figures = {
        "seconds": times,
        "page_lag_ms": {f"p{q}": round(float(np.percentile(lags, q)), 1) for q in (50, 95, 99, 100)},
        "killed": {} if killer is None else dict(killer.killed),
        "problems": [f"job {job['kind']}: {job['error']}" for job in jobs if job["state"] == "failed"],
    }
    return figures, slug, exported


def _lines(cfg: Path) -> list[str]:
    return cfg.read_text("utf-8").splitlines()


def _new_map(page: Page, app: App, *, image: Path) -> str:
    """Sign in, and make a map with an image; return its slug."""
    page.goto(app.sign_in)
    page.get_by_test_id("sign-in").click()
    page.get_by_test_id("new-map").click()
    page.get_by_test_id("map-name").fill("Hundreds of photos")
    page.get_by_test_id("map-name").press("Enter")
    page.wait_for_url("**/maps/*/edit")
    page.get_by_test_id("satellite-input").set_input_files(image)
    page.locator("#no-satellite").wait_for(state="hidden")
    return page.url.split("/")[-2]


def _fill(page: Page, slug: str, *, source: Path) -> dict[str, float]:
    """Upload, place and wait for the index; return the seconds of each."""
    photos = [source.parent / path for path in _named(_lines(source))[1:]]
    times: dict[str, float] = {}
    with _timed(times, "upload"):
        page.get_by_test_id("photo-input").set_input_files(photos)
        page.get_by_test_id("upload-summary").wait_for(timeout=UPLOAD_MS)
    with _timed(times, "positions"):
        _import_positions(page, source, count=len(photos))
    with _timed(times, "index"):
        _wait_for_jobs(page, slug)
    return times


@contextlib.contextmanager
def _timed(times: dict[str, float], name: str) -> Iterator[None]:
    start = time.monotonic()
    yield
    times[name] = round(time.monotonic() - start, 1)


def _import_positions(page: Page, source: Path, *, count: int) -> None:
    """Choose the file of positions; choose it again, as a user would, if the server was killed meanwhile."""
    placed = page.get_by_test_id("placed-count")
    while placed.inner_text() != str(count):
        page.locator("#place-menu summary").click()
        with page.expect_file_chooser() as choosing:
            page.locator("#place-by-file").click()
        choosing.value.set_files(source)
        for _ in range(100):
            page.wait_for_timeout(100)
            if placed.inner_text() == str(count):
                break


def _wait_for_jobs(page: Page, slug: str) -> None:
    """Wait until the index jobs of the map have ended."""
    while True:
        done = [job["state"] for job in _jobs(page, slug) if job["kind"] == "index"]
        if done and not {"queued", "running"} & set(done):
            return
        page.wait_for_timeout(500)


def _jobs(page: Page, slug: str) -> list[dict[str, Any]]:
    """Get the jobs of the map; retry if the server was killed meanwhile."""
    while True:
        with contextlib.suppress(Error):
            answer = page.request.get(f"/api/v1/jobs?map={slug}")
            if answer.ok:
                return list(answer.json()["jobs"])
        page.wait_for_timeout(500)


def _evaluate(arguments: argparse.Namespace, source: Path, *, there: Path) -> dict[str, tuple[float, float]]:
    """Evaluate the same queries on the page's map and on one that the command line builds."""
    words = [str(arguments.folder / "queries.csv"), "--json", "--limit", str(arguments.queries)]
    here, own = (
        json.loads(expmap("evaluate", cfg, *words, library=there.parents[1])) for cfg in (there, source)
    )
    return {name: (here[name], own[name]) for name in FIGURES}


if __name__ == "__main__":
    main()
