"""One running program and one browser shared by all tests of the pages."""

import json
import shutil
import threading
import time
from collections.abc import Callable, Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from pathlib import Path

import pytest
from PIL import Image
from playwright.sync_api import Browser, BrowserContext, Page, expect, sync_playwright

from tests.browser.api import Api
from tests.browser.app import App, expmap
from tests.browser.edit_page import EditPage, spots
from tests.browser.ensure_browser import MISSING, find_browser
from tests.browser.watch import BROWSER_OPTIONS, Watch
from tests.geocoder_server import GeocoderServer, geocoding
from tests.ports import reserved_port
from tests.street_server import StreetServer, street
from tests.tile_server import TileServer, serving

WIDE = {"width": 1280, "height": 800}
SAMPLE_WITHIN_S = 180
PATIENCE_MS = 60_000
WORK_MS = 600_000
"""Timeout for results of the worker, which may be busy."""
expect.set_options(timeout=PATIENCE_MS)


@pytest.fixture(scope="session")
def tiles() -> Iterator[TileServer]:
    """The only map tile service that the program offers."""
    with serving() as server:
        yield server


@pytest.fixture(scope="session")
def geocoder() -> Iterator[GeocoderServer]:
    """The geocoder that the program uses."""
    with geocoding() as server:
        yield server


@pytest.fixture(scope="session")
def street_service() -> Iterator[StreetServer]:
    """The only street-level service that the program uses; it has no photos."""
    with street() as server:
        yield server


@pytest.fixture
def streets(street_service: StreetServer) -> Iterator[StreetServer]:
    """The same for one test, which sets its photos; the counts of requests are cleared."""
    street_service.clear()
    yield street_service
    street_service.clear()


@pytest.fixture(scope="session")
def app(
    tmp_path_factory: pytest.TempPathFactory,
    ready_sample: Path,
    tiles: TileServer,
    geocoder: GeocoderServer,
    street_service: StreetServer,
) -> Iterator[App]:
    """The program with a library that already contains the sample and its index, for a quick start."""
    library = tmp_path_factory.mktemp("served") / "maps"
    shutil.copytree(ready_sample, library / "sample")
    services = library.with_name("services.json")
    one = {
        "name": "Local imagery",
        "url": tiles.url,
        "attribution": "© these tests",
        "max_zoom": 19,
        "public": True,
    }
    services.write_text(json.dumps([one]), encoding="utf-8")
    environ = {
        "EXPMAP_TILE_SERVICES": str(services),
        "EXPMAP_GEOCODER_ADDRESS": geocoder.address,
        "EXPMAP_STREET_PANORAMAX": street_service.base,
    }
    with reserved_port() as port, App(library, port=port, environ=environ) as running:
        yield running


@pytest.fixture(scope="session")
def browser() -> Iterator[Browser]:
    """Chromium; if it is missing, tests fail instead of being skipped."""
    path = find_browser()
    if path is None:
        pytest.fail(MISSING)
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=list(BROWSER_OPTIONS))
        yield browser
        browser.close()


def sign_in(page: Page, link: str) -> None:
    """Open a sign-in link and confirm its page."""
    page.goto(link)
    page.locator("main form button").click()
    page.wait_for_url(lambda url: "/sign-in" not in url)


@pytest.fixture(scope="session")
def owner(app: App, browser: Browser) -> dict:
    """Cookies of the owner, signed in by the link printed at the start."""
    context = browser.new_context()
    sign_in(context.new_page(), app.sign_in)
    state = context.storage_state()
    context.close()
    return state


@pytest.fixture(scope="session")
def sample_map(owner: dict, app: App, browser: Browser) -> str:
    """Slug of the sample map, which the first start created in the background."""
    context = browser.new_context(base_url=app.url, storage_state=owner)
    until = time.monotonic() + SAMPLE_WITHIN_S
    while context.request.get("/api/v1/maps/sample").status == 404 and time.monotonic() < until:
        time.sleep(0.3)
    context.close()
    return "sample"


@pytest.fixture
def open_context(app: App, browser: Browser) -> Iterator[Callable[..., BrowserContext]]:
    """Open a watched browser context; `context.watch` collects faults."""
    opened: list[BrowserContext] = []

    def open_one(**options: object) -> BrowserContext:
        usual = {"viewport": WIDE, "base_url": app.url, "service_workers": "block"}
        context = browser.new_context(**{**usual, **options})
        context.set_default_timeout(PATIENCE_MS)
        context.watch = Watch(context, app.url)
        opened.append(context)
        return context

    yield open_one
    for context in opened:
        for tab in context.pages:
            tab.unroute_all(behavior="ignoreErrors")  # one that is under way is no fault of the next test
        context.close()
    for context in opened:
        context.watch.check()


@pytest.fixture
def context(open_context: Callable[..., BrowserContext], owner: dict) -> BrowserContext:
    """A context of the signed-in owner, with a wide screen."""
    return open_context(storage_state=owner)


@pytest.fixture
def page(context: BrowserContext) -> Page:
    """A page of the signed-in owner, with a wide screen."""
    return context.new_page()


@pytest.fixture
def api(context: BrowserContext) -> Api:
    """The API as the signed-in owner."""
    return Api(context)


@pytest.fixture(scope="session")
def small_photos(sample_folder: Path, tmp_path_factory: pytest.TempPathFactory) -> list[Path]:
    """Thirty small photos of the sample without EXIF, so without positions."""
    folder = tmp_path_factory.mktemp("small")
    paths = []
    for path in sorted((sample_folder / "photos").glob("*.jpg"))[:30]:
        with Image.open(path) as photo:
            photo.resize((160, 120)).save(folder / path.name, quality=85)
        paths.append(folder / path.name)
    return paths


@pytest.fixture
def elsewhere() -> Iterator[Callable[[str], str]]:
    """Serve a page with given HTML from another site, and return its address."""
    pages: list[str] = []

    class Handler(BaseHTTPRequestHandler):
        def do_GET(self) -> None:
            self.send_response(200)
            self.send_header("Content-Type", "text/html")
            self.end_headers()
            self.wfile.write(
                f'<!doctype html><title>x</title><link rel="icon" href="data:,">{pages[-1]}'.encode()
            )

        def log_message(self, *_args: object) -> None:
            pass

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    threading.Thread(target=server.serve_forever, daemon=True).start()

    def serve(body: str) -> str:
        pages.append(body)
        return f"http://localhost:{server.server_port}"

    yield serve
    server.shutdown()
    server.server_close()


@pytest.fixture
def make_page(
    page: Page, api: Api, sample_folder: Path, small_photos: list[Path], request: pytest.FixtureRequest
) -> Iterator[Callable[..., EditPage]]:
    """Open the edit page of a new map with the sample's image and some of the small photos, placed or not."""
    made: list[str] = []

    def make(photos: int, *, placed: bool = False) -> EditPage:
        satellite = sample_folder / "satellite.png"
        slug = api.make_map(request.node.name[:60], satellite=satellite, photos=small_photos[:photos])
        made.append(slug)
        if placed:
            ids = [photo["id"] for photo in api.state(slug)["photos"]]
            changes = [
                {"id": id, "x_px": x, "y_px": y} for id, (x, y) in zip(ids, spots(photos), strict=True)
            ]
            seen = api.state(slug)["revision"]
            api.ask(
                "PATCH", f"/maps/{slug}/experiences", data={"seen": seen, "kind": "place", "changes": changes}
            )
        return EditPage(page, slug).open()

    yield make
    for slug in made:
        api.cancel_jobs(slug)  # the index of this map is not needed, and the next test needs the processor


@pytest.fixture
def link(app: App) -> str:
    """Return a new one-time sign-in link of the owner."""
    return expmap("account", "link", "--url", app.url, library=app.library).split()[-1]


@pytest.fixture
def fresh_owner(open_context: Callable[..., BrowserContext], link: str) -> Page:
    """A page with a separate session."""
    page = open_context().new_page()
    sign_in(page, link)
    return page
