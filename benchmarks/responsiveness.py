"""Measures how soon the program reacts: to work that somebody waits for, and to clicks and keys.

    python -m benchmarks.responsiveness [--only import,area,pages] [--repeat 3] [--json OUT]

- import: a track is imported into a mission on a map of 1400 photos while its index is built. Seconds from
  the request until the job starts, and until it is done
- area: on a new library, whose sample is being indexed, an area of a tile service becomes the image of a
  new map. Seconds from the request until the service is asked for the first tile, and until the image is
  there
- pages: the editor with 300 photos and Localize on a processor slowed down four times: the interaction to
  next paint (INP), which is the time from the slowest click or key to the next frame, and the slowest three

The tile service is a program on this machine. The photos are the sample's, each cropped a little
differently.
"""

from __future__ import annotations

import argparse
import itertools
import json
import shutil
import statistics
import tempfile
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from PIL import Image
from playwright.sync_api import Page, sync_playwright

from benchmarks.client import Client
from tests.browser.app import App, expmap
from tests.browser.edit_page import EditPage
from tests.browser.ensure_browser import find_browser
from tests.browser.watch import BROWSER_OPTIONS
from tests.tile_server import TileServer, serving

MEASURES = ("import", "area", "pages")
INDEXED, EDITED, WAITING = 1400, 300, 60
"""Photos of the map that is indexed, of the one that is edited, and how many of these are in the tray."""

PATIENCE_S = 900.0
POLL_S = 0.02
TRACK_POINTS = 600
AREA = {"north": 50.2040, "south": 50.2020, "west": 15.8280, "east": 15.8320, "zoom": 18}

EVENTS = """
window.slow = [];
new PerformanceObserver((list) => {
  for (const { interactionId, duration, name, target } of list.getEntries()) {
    const what = target?.id || target?.getAttribute?.("class") || "";
    if (interactionId) window.slow.push({ interactionId, duration, name, target: what });
  }
}).observe({ type: "event", durationThreshold: 16, buffered: true });
"""
"""Records the interactions that took longer than a frame; durations are multiples of 8 ms."""

Figures = dict[str, list[float]]


def main() -> None:
    """Measure and print a line for each figure."""
    arguments = _arguments()
    figures: dict[str, Any] = {}
    with tempfile.TemporaryDirectory() as scratch:
        folder = Path(scratch)
        sample = folder / "sample"
        expmap("sample", sample, library=folder / "none")
        if "import" in arguments.only:
            figures |= _imports(sample, folder / "import", repeat=arguments.repeat)
        if "area" in arguments.only:
            for number in range(arguments.repeat):
                for name, times in _area(sample, folder / f"area{number}").items():
                    figures.setdefault(name, []).extend(times)
        for name, times in figures.items():
            print(f"{name}: median {statistics.median(times):.2f} s, most {max(times):.2f} s")
        if "pages" in arguments.only:
            for name, slow in _pages(sample, folder / "pages", arguments).items():
                worst = [max((one["duration"] for one in run), default=0) for run in slow]
                print(f"{name}: INP median {statistics.median(worst):.0f} ms, most {max(worst):.0f} ms")
                for one in sorted(itertools.chain(*slow), key=lambda one: -one["duration"])[:3]:
                    print(f"  {one['duration']:>5.0f} ms  {one['name']} {one['target']}")
                figures[name] = slow
    if arguments.json:
        arguments.json.write_text(json.dumps(figures, indent=1) + "\n")


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--only", type=lambda text: text.split(","), default=list(MEASURES))
    parser.add_argument("--repeat", type=int, default=3)
    parser.add_argument("--slowdown", type=float, default=4.0, help="of the processor, for pages")
    parser.add_argument("--json", type=Path)
    return parser.parse_args()


@contextmanager
def _serving(library: Path, sample: Path, *, environ: dict[str, str] | None = None) -> Iterator[Client]:
    """Run the program on a new library, whose sample is only to be indexed."""
    library.mkdir(parents=True)
    shutil.copytree(sample, library / "sample")
    with App(library, environ=environ) as app:
        yield Client(app.url, app.sign_in)


def _import_map(client: Client, sample: Path, scratch: Path, *, photos: int) -> str:
    """Make a map of many photos and return its slug; its index is queued."""
    image, *rows = (sample / "map.cfg").read_text("utf-8-sig").splitlines()
    (scratch / "photos").mkdir(parents=True)
    shutil.copy(sample / image.split(";")[0], scratch)
    lines = [image]
    for number, row in zip(range(photos), itertools.cycle(rows), strict=False):
        _, path, *place = row.split(";")
        left = number // len(rows)
        name = f"photos/{number:05}.jpg"
        with Image.open(sample / path) as photo:
            photo.crop((left, 0, photo.width, photo.height)).save(scratch / name, exif=photo.getexif())
        lines.append(";".join((str(number), name, *place)))
    (scratch / "map.cfg").write_text("\n".join([*lines, ""]), "utf-8")
    archive = Path(shutil.make_archive(str(scratch), "zip", scratch))
    with archive.open("rb") as file:
        form = {"name": f"Of {photos}"}
        answer = client.ask("POST", "/maps/import", files={"file": file}, data=form, timeout=PATIENCE_S)
    if answer["job"] is not None:
        _until(lambda: client.ask("GET", f"/jobs/{answer['job']}")["state"] == "done")
    return str(answer["slug"])


def _imports(sample: Path, scratch: Path, *, repeat: int) -> Figures:
    started: list[float] = []
    done: list[float] = []
    with _serving(scratch / "maps", sample) as client:
        _until(lambda: not _busy(client, "sample"))
        slug = _import_map(client, sample, scratch / "large", photos=INDEXED)
        mission = client.ask("POST", "/missions", json={"name": "Track", "map": slug})["id"]
        _until(lambda: _indexing(client, slug))
        for number in range(repeat):
            file = (f"track{number}.gpx", _track(number))
            begin = time.monotonic()
            job = client.ask("POST", f"/missions/{mission}/imports", files={"file": file})["job"]
            state = lambda: client.ask("GET", f"/jobs/{job}")["state"]  # noqa: B023, E731
            started.append(_until(lambda: state() != "queued") - begin)  # noqa: B023
            done.append(_until(lambda: state() == "done") - begin)  # noqa: B023
            if not _indexing(client, slug):
                raise SystemExit("the index was built before the track was imported")
    return {"import: job starts": started, "import: track is there": done}


def _area(sample: Path, scratch: Path) -> Figures:
    with serving() as tiles:
        scratch.mkdir()
        services = scratch / "services.json"
        one = {"name": "Tiles", "url": tiles.url, "attribution": "-", "max_zoom": 19, "public": True}
        services.write_text(json.dumps([one]), encoding="utf-8")
        with _serving(scratch / "maps", sample, environ={"EXPMAP_TILE_SERVICES": str(services)}) as client:
            slug = client.ask("POST", "/maps", json={"name": "Area"})["slug"]
            _until(lambda: _indexing(client, "sample"))
            return _fetch(client, slug, tiles)


def _fetch(client: Client, slug: str, tiles: TileServer) -> Figures:
    begin = time.monotonic()
    job = client.ask("POST", f"/maps/{slug}/satellite/tiles", json={"service": "Tiles", **AREA})["job"]
    first = _until(lambda: bool(tiles.asked)) - begin
    if not _indexing(client, "sample"):
        raise SystemExit("the index was built before the first tile was asked for")
    done = _until(lambda: client.ask("GET", f"/jobs/{job}")["state"] == "done") - begin
    return {"area: first tile": [first], "area: image is there": [done]}


def _busy(client: Client, slug: str) -> bool:
    answer = client.call("GET", f"/jobs?map={slug}")
    return not answer.ok or any(job["state"] in ("queued", "running") for job in answer.json()["jobs"])


def _indexing(client: Client, slug: str) -> bool:
    jobs = client.ask("GET", f"/jobs?map={slug}")["jobs"]
    return any(job["kind"] == "index" and job["state"] == "running" for job in jobs)


def _track(number: int) -> bytes:
    """Return a GPX file, another one for each number."""
    points = "".join(
        f'<trkpt lat="{50.2 + n * 1e-5:.6f}" lon="{15.83 + number * 1e-4:.6f}">'
        f"<time>2026-05-0{number % 9 + 1}T10:{n // 60:02}:{n % 60:02}Z</time></trkpt>"
        for n in range(TRACK_POINTS)
    )
    head = '<gpx version="1.1" creator="-" xmlns="http://www.topografix.com/GPX/1/1"><trk><trkseg>'
    return f"{head}{points}</trkseg></trk></gpx>".encode()


def _until(holds: Callable[[], bool]) -> float:
    """Wait until something holds; return the time of the monotonic clock."""
    end = time.monotonic() + PATIENCE_S
    while not holds():
        if time.monotonic() > end:
            raise SystemExit(f"it does not hold within {PATIENCE_S:.0f} s")
        time.sleep(POLL_S)
    return time.monotonic()


def _pages(
    sample: Path, scratch: Path, arguments: argparse.Namespace
) -> dict[str, list[list[dict[str, Any]]]]:
    """Use both pages; return the slow interactions of each run."""
    slow: dict[str, list[list[dict[str, Any]]]] = {}
    with _serving(scratch / "maps", sample) as client, sync_playwright() as playwright:
        slug = _import_map(client, sample, scratch / "large", photos=EDITED)
        into_tray = [{"id": id, "x_px": None, "y_px": None} for id in range(WAITING)]
        edit = {"kind": "unplace", "changes": into_tray}
        client.ask("PATCH", f"/maps/{slug}/experiences", json=edit)
        _until(lambda: not _busy(client, slug) and not _busy(client, "sample"))
        browser = playwright.chromium.launch(executable_path=find_browser(), args=list(BROWSER_OPTIONS))
        for (name, use), _ in itertools.product(
            {"editor": _edit, "localize": _localize}.items(), range(arguments.repeat)
        ):
            context = browser.new_context(
                viewport={"width": 1366, "height": 768}, base_url=client.url, service_workers="block"
            )
            context.add_cookies(
                [{"name": c.name, "value": c.value or "", "url": client.url} for c in client.session.cookies]
            )
            context.add_init_script(EVENTS)
            page = context.new_page()
            context.new_cdp_session(page).send("Emulation.setCPUThrottlingRate", {"rate": arguments.slowdown})
            use(page, slug, sample)
            page.wait_for_timeout(500)  # entries come a little after their frame
            slow.setdefault(name, []).append(page.evaluate("window.slow"))
            context.close()
        browser.close()
    return slow


def _edit(page: Page, slug: str, sample: Path) -> None:
    """Place and move photos, undo, redo, select all, filter, look at menus and at the map closely."""
    edit = EditPage(page, slug).open()
    edit.tray.first.click()
    for x, y in ((300, 200), (500, 300), (700, 400)):
        edit.click(x, y)
    edit.saved()
    for press in (edit.undo.click, edit.undo.click, edit.redo.click):
        press()
        edit.saved()
    page.keyboard.press("Control+z")
    page.keyboard.press("Control+y")
    edit.saved()
    edit.drag((300, 200), (360, 260))
    page.keyboard.press("Control+a")
    page.keyboard.press("Escape")
    for menu in ("add-menu", "place-menu", "map-menu", "filter-menu"):
        page.locator(f"#{menu} > summary").click()
        page.keyboard.press("Escape")
    page.locator("#tray-filter [data-filter=placed]").click()
    page.locator("#tray-search").press_sequentially("0012")
    page.locator("#tray-search").fill("")
    for button in ("zoom-in", "zoom-in", "zoom-out", "zoom-fit", "tab-check", "tab-photos"):
        page.locator(f"#{button}").click()


def _localize(page: Page, slug: str, sample: Path) -> None:
    """Localize a photo, and look at the places, matches and options."""
    page.goto(f"/maps/{slug}/localize")
    page.get_by_test_id("query-input").set_input_files(sample / "queries" / "query_02.jpg")
    places = page.get_by_test_id("hypothesis")
    places.first.wait_for()
    page.locator("#busy").wait_for(state="hidden")
    for place in places.filter(visible=True).all():
        place.click()
    page.locator("#matches-all").click()
    page.locator("#matches-large").click()
    page.keyboard.press("Escape")
    page.locator("#options > summary").click()
    page.keyboard.press("Escape")
    page.locator("#panel-answer details > summary").last.click()
    for button in ("tab-history", "tab-answer", "zoom-in", "zoom-out", "zoom-fit"):
        page.locator(f"#{button}").click()


if __name__ == "__main__":
    main()
