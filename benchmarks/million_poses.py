"""Measures a mission of a million poses: opening, panning and zooming it in a browser, and exporting it.

    python -m benchmarks.million_poses [--poses 1000000] [--loads 5]

Starts the program with a temporary library with one mission: a robot that wanders about for a day. Prints

- seconds to store the poses, and to build their pieces for display, normally a background job;
- for each load of the page, the first with an empty cache: seconds until the track is drawn, and until the
  map has followed the first drag after that;
- milliseconds between two frames while the map is dragged and zoomed with the wheel, zoomed out and in;
- for each export: its size, seconds, and the maximum rise of the server's memory (proportional set size of
  all its processes); a short export of each kind comes first, so that modules are loaded.

The exit code is 1 if the page takes longer than 2 s (median) or an export more than 100 MB.
"""

from __future__ import annotations

import argparse
import json
import statistics
import tempfile
import threading
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import requests
from playwright.sync_api import Browser, Page, sync_playwright

from benchmarks.memory import memory_mb
from tests.browser.app import App
from tests.browser.conftest import sign_in
from tests.browser.ensure_browser import MISSING, find_browser
from tests.browser.watch import BROWSER_OPTIONS
from webapp.missions.core.trajectory.records import Poses, make_poses
from webapp.missions.store import missions, tracks
from webapp.missions.tasks import track_display
from webapp.progress import Progress
from webapp.store.accounts import accounts
from webapp.store.library import Library, open_library
from webapp.store.maps import maps

FORMATS = ("kml", "kmz", "gpx", "geojson", "csv")
MOST_SECONDS, MOST_MB = 2.0, 100.0
_HERTZ = 10.0
_SPEED_MPS = 1.2
_BATCH = 5000
_PATIENCE_S = 300.0
_MEMORY_EVERY_S = 0.1
_DRAWN_PIXELS = 2000

_LOOK = """
addEventListener("DOMContentLoaded", () => {
  const look = () => {
    const canvas = document.querySelector("#map-canvas canvas");
    if (canvas?.width && !document.querySelector("#loading:not([hidden])")) {
      const { width, height } = canvas;
      const copy = new OffscreenCanvas(width, height).getContext("2d", { willReadFrequently: true });
      copy.drawImage(canvas, 0, 0);
      const { data } = copy.getImageData(0, 0, width, height);
      let count = 0;
      for (let n = 0; n < data.length; n += 4) {
        if (data[n] < 60 && data[n + 1] > 90 && data[n + 2] > 150 && data[n + 3] > 200) count += 1;
      }
      if (count >= PIXELS) {
        window.drawnAt = performance.now();
        return;
      }
    }
    setTimeout(look, 50);
  };
  look();
});
"""
"""Records when at least PIXELS pixels of the map have the colour of GPS tracks."""

_RECORD = """
() => {
  window.frames_ms = [];
  let before = performance.now();
  const next = (now) => {
    window.frames_ms.push(now - before);
    before = now;
    window.recording = requestAnimationFrame(next);
  };
  window.recording = requestAnimationFrame(next);
}
"""
_RECORDED = "() => { cancelAnimationFrame(window.recording); return window.frames_ms.slice(1); }"
_PLACE = "() => document.querySelector('#map-canvas .leaflet-map-pane').style.transform"


def main() -> None:
    """Measure and print one JSON object."""
    arguments = _arguments()
    path = find_browser()
    if path is None:
        raise SystemExit(MISSING)
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name) / "maps"
        library = open_library(folder)
        token, mission, stored_s = _fill(library, arguments.poses)
        figures: dict[str, Any] = {"poses": arguments.poses, "stored_s": stored_s}
        figures["prepared_s"] = _prepare(library, mission)
        library.database.close()
        with App(folder) as app:
            with sync_playwright() as playwright:
                browser = playwright.chromium.launch(executable_path=path, args=list(BROWSER_OPTIONS))
                figures |= _in_browser(browser, app, mission=mission, loads=arguments.loads)
                browser.close()
            figures["exports"] = {form: _export(app, mission, token=token, form=form) for form in FORMATS}
    problems = _problems(figures)
    print(json.dumps({**figures, "problems": problems}, indent=2))
    raise SystemExit(1 if problems else 0)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--poses", type=int, default=1_000_000)
    parser.add_argument("--loads", type=int, default=5, help="of the page")
    return parser.parse_args()


def _fill(library: Library, poses: int) -> tuple[str, int, float]:
    """Create a token and the mission; return them, and the seconds to store the poses."""
    with library.database.write() as session:
        owner = accounts.ensure_owner(session)
        maps.create(session, "Another", account_id=owner.id)  # prevents the sample map at the start
        token = accounts.new_token(session, owner, name="benchmark")
        mission = missions.create(session, "A day", account_id=owner.id).id
        tracks.get_or_create(session, mission, source="gps", name="wandering")
    way = _wander(poses)
    begun = time.perf_counter()
    for first in range(0, poses, _BATCH):
        with library.database.write() as session:
            (track,) = tracks.list_tracks(session, mission)
            tracks.append(session, track, way.take(np.s_[first : first + _BATCH]))
    return token, mission, round(time.perf_counter() - begun, 1)


def _wander(count: int) -> Poses:
    """Simulate a robot that turns slowly, its path mirrored at the sides of a square kilometre."""
    rng = np.random.default_rng(1)
    heading = np.cumsum(rng.normal(0, 0.03, count))
    step = _SPEED_MPS / _HERTZ * np.column_stack([np.cos(heading), np.sin(heading)])
    unfolded = np.cumsum(step, axis=0)
    metres = 500 - np.abs((unfolded + 500) % 2000 - 1000)  # mirrored at the sides
    metres += rng.normal(0, 0.05, metres.shape)
    latlon = np.array([50.0, 14.0]) + metres / [111_229.0, 71_696.0]
    times = 1_760_000_000 + np.arange(count) / _HERTZ
    height = 200 + 10 * np.sin(metres[:, 0] / 200)
    return make_poses(times, latlon, height_m=height, heading_deg=np.degrees(heading) % 360)


def _prepare(library: Library, mission: int) -> float:
    """Build the pieces of the track, as the background job does; return seconds."""
    begun = time.perf_counter()
    track_display.build_pieces(library, mission, write=library.database.write, progress=Progress())
    return round(time.perf_counter() - begun, 1)


def _in_browser(browser: Browser, app: App, *, mission: int, loads: int) -> dict[str, Any]:
    context = browser.new_context(viewport={"width": 1280, "height": 800}, base_url=app.url)
    sign_in(context.new_page(), app.sign_in)
    context.add_init_script(_LOOK.replace("PIXELS", str(_DRAWN_PIXELS)))
    drawn, interactive = [], []
    for _ in range(loads):
        page = context.new_page()
        page.goto(f"/missions/{mission}")
        drawn.append(_until(page, "() => window.drawnAt"))
        before = json.dumps(page.evaluate(_PLACE))
        _drag(page, 40)
        interactive.append(_until(page, f"() => ({_PLACE})() !== {before} && performance.now()"))
        if len(drawn) < loads:
            page.close()
    frames = {"whole": _frames(page)}
    for _ in range(5):
        page.locator("#zoom-in").click()
        page.wait_for_timeout(700)
    frames["near"] = _frames(page)
    context.close()
    seconds = {"drawn_s": drawn, "interactive_s": interactive}
    return {
        **{name: [round(value / 1000, 2) for value in values] for name, values in seconds.items()},
        "frames_ms": frames,
    }


def _until(page: Page, expression: str) -> float:
    end = time.monotonic() + _PATIENCE_S
    while not (value := page.evaluate(expression)):
        if time.monotonic() > end:
            raise SystemExit("the page never came to it")
        page.wait_for_timeout(10)
    return float(value)


def _middle(page: Page) -> tuple[float, float]:
    box = page.locator("#map-canvas").bounding_box()
    assert box is not None
    return box["x"] + box["width"] / 2, box["y"] + box["height"] / 2


def _drag(page: Page, by: float) -> None:
    x, y = _middle(page)
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + by, y + by / 2, steps=4)
    page.mouse.up()


def _frames(page: Page) -> dict[str, dict[str, float]]:
    return {"pan": _recorded(page, _pan), "zoom": _recorded(page, _zoom)}


def _recorded(page: Page, move: Callable[[Page], None]) -> dict[str, float]:
    page.wait_for_timeout(1000)
    page.evaluate(_RECORD)
    move(page)
    found = np.array(page.evaluate(_RECORDED))
    p50, p95 = np.quantile(found, [0.5, 0.95])
    return {
        "frames": len(found),
        "p50": round(float(p50), 1),
        "p95": round(float(p95), 1),
        "most": round(float(found.max()), 1),
        "per_s": round(len(found) / (found.sum() / 1000), 1),
    }


def _pan(page: Page) -> None:
    """Drag the map to and fro for some seconds."""
    x, y = _middle(page)
    page.mouse.move(x, y)
    page.mouse.down()
    for n in range(180):
        page.mouse.move(x + 200 * np.sin(n / 15), y + 120 * np.sin(n / 22))
        page.wait_for_timeout(8)
    page.mouse.up()


def _zoom(page: Page) -> None:
    """Zoom in and out with the wheel."""
    page.mouse.move(*_middle(page))
    for n in range(24):
        page.mouse.wheel(0, -120 if n % 8 < 4 else 120)
        page.wait_for_timeout(150)


def _export(app: App, mission: int, *, token: str, form: str) -> dict[str, float]:
    """Fetch an export, and measure the memory of the server meanwhile."""
    address = f"{app.url}/api/v1/missions/{mission}/export.{form}"
    headers = {"Authorization": f"Bearer {token}"}
    requests.get(address, params={"points": 100}, headers=headers, timeout=_PATIENCE_S).raise_for_status()
    before = highest = memory_mb(app.pid)["all"]["Pss"]
    over = threading.Event()

    def watch() -> None:
        nonlocal highest
        while not over.wait(_MEMORY_EVERY_S):
            highest = max(highest, memory_mb(app.pid)["all"]["Pss"])

    watching = threading.Thread(target=watch)
    watching.start()
    begun, size, first_s = time.perf_counter(), 0, 0.0
    with requests.get(address, headers=headers, stream=True, timeout=_PATIENCE_S) as answer:
        answer.raise_for_status()
        for piece in answer.iter_content(1 << 16):
            first_s = first_s or time.perf_counter() - begun
            size += len(piece)
    seconds = time.perf_counter() - begun
    over.set()
    watching.join()
    return {
        "mb": round(size / 1e6, 1),
        "seconds": round(seconds, 1),
        "first_byte_s": round(first_s, 2),
        "memory_before_mb": round(before),
        "memory_rise_mb": round(highest - before, 1),
    }


def _problems(figures: dict[str, Any]) -> list[str]:
    problems = []
    if statistics.median(figures["interactive_s"]) > MOST_SECONDS:
        problems.append(f"the page takes more than {MOST_SECONDS:g} s")
    for form, export in figures["exports"].items():
        if export["memory_rise_mb"] > MOST_MB:
            problems.append(f"{form} takes more than {MOST_MB:g} MB of memory")
    return problems


if __name__ == "__main__":
    main()
