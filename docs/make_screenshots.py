"""Make the screenshots of the documentation: `python -m docs.make_screenshots`.

Starts the program with the sample map in a temporary library, and photographs its pages in a browser: wide,
on a phone, and dark. A few photos of the sample are put back into the tray, so that there is something to do.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path
from typing import Any

from playwright.sync_api import Browser, BrowserContext, Page, sync_playwright

from tests.browser.api import Api
from tests.browser.app import App
from tests.browser.ensure_browser import MISSING, find_browser
from tests.browser.watch import BROWSER_OPTIONS

PICTURES = Path(__file__).resolve().parent / "pictures"
WIDE = {"viewport": {"width": 1280, "height": 800}}
PHONE = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}
LOOKS: dict[str, dict[str, Any]] = {
    "": WIDE,
    "-dark": {**WIDE, "color_scheme": "dark"},
    "-phone": {**PHONE, "device_scale_factor": 2},
}
PAGES = {
    "maps": ("/", ("",)),
    "edit": ("/maps/sample/edit", ("", "-dark", "-phone")),
    "image": ("/maps/sample/image", ("",)),
    "localize": ("/maps/sample/localize", ("", "-phone")),
}
QUERY = "queries/query_02.jpg"
"""Photo of the sample that is asked about."""

IN_TRAY = range(40, 46)
"""Photos of the sample that are shown as not placed yet."""


def main() -> None:
    """Write all screenshots."""
    browser = find_browser()
    if browser is None:
        raise SystemExit(MISSING)
    with tempfile.TemporaryDirectory() as folder, App(Path(folder) / "maps") as app, sync_playwright() as p:
        chromium = p.chromium.launch(executable_path=browser, args=list(BROWSER_OPTIONS))
        context = chromium.new_context(base_url=app.url)
        prepare(context, app)
        for name, (path, looks) in PAGES.items():
            for look in looks:
                shoot(
                    chromium, app, context.storage_state(), path=path, name=f"{name}{look}", look=LOOKS[look]
                )
        chromium.close()


def prepare(context: BrowserContext, app: App) -> None:
    """Sign in, wait for the sample and its index, and take a few photos off the image."""
    page = context.new_page()
    page.goto(app.sign_in)
    page.get_by_test_id("sign-in").click()
    page.wait_for_url(f"{app.url}/")
    api = Api(context)
    while api.call("GET", "/maps/sample").status == 404:
        time.sleep(0.5)
    api.wait_for_jobs("sample")
    changes = [{"id": id, "x_px": None, "y_px": None} for id in IN_TRAY]
    api.ask("PATCH", "/maps/sample/experiences", data={"kind": "unplace", "changes": changes})
    api.wait_for_jobs("sample")
    time.sleep(65)  # as long as pages show jobs that have ended


def shoot(browser: Browser, app: App, cookies: Any, *, path: str, name: str, look: dict[str, Any]) -> None:
    """Photograph a page when it has come to rest."""
    context = browser.new_context(base_url=app.url, storage_state=cookies, reduced_motion="reduce", **look)
    page = context.new_page()
    page.goto(path)
    if path.endswith("/edit"):
        page.locator("[data-testid=map-canvas] canvas").wait_for()
    if path.endswith("/localize"):
        page.get_by_test_id("query-input").set_input_files(app.library / "sample" / QUERY)
        page.get_by_test_id("hypothesis").first.wait_for()
    settle(page)
    PICTURES.mkdir(exist_ok=True)
    page.screenshot(path=PICTURES / f"{name}.jpg", type="jpeg", quality=80, scale="css")
    context.close()


def settle(page: Page) -> None:
    """Wait for the pictures in the page."""
    page.wait_for_timeout(1500)
    page.wait_for_function("() => [...document.images].every(one => one.complete || one.loading === 'lazy')")


if __name__ == "__main__":
    main()
