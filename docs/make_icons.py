"""Draw the icons of the installed application from its logo: `python docs/make_icons.py`.

Needs what the browser tests need: playwright, and a chromium.
"""

from __future__ import annotations

import sys
from pathlib import Path

from playwright.sync_api import sync_playwright

ROOT = Path(__file__).resolve().parents[1]
IMAGES = ROOT / "static" / "img"
GROUND = "#0b665c"
ICONS = (
    ("icon-180.png", 180, 1.0, GROUND),
    ("icon-192.png", 192, 1.0, "transparent"),
    ("icon-512.png", 512, 1.0, "transparent"),
    ("icon-maskable-512.png", 512, 0.8, GROUND),
)
"""Name, side, the part of it that the logo fills, and what is around it: a phone cuts the masked ones."""

_PAGE = """<!doctype html><style>
body {{ margin: 0; width: {side}px; height: {side}px; background: {ground}; }}
body {{ display: grid; place-items: center; }}
svg {{ width: {part}%; height: {part}%; display: block; }}
</style>{logo}"""


def main() -> None:
    """Draw all of them."""
    sys.path.insert(0, str(ROOT))
    from tests.browser.ensure_browser import MISSING, find_browser

    path = find_browser()
    if path is None:
        sys.exit(MISSING)
    logo = (IMAGES / "logo.svg").read_text("utf-8")
    with sync_playwright() as playwright:
        browser = playwright.chromium.launch(executable_path=path, args=["--no-sandbox", "--disable-gpu"])
        for name, side, part, ground in ICONS:
            page = browser.new_page(viewport={"width": side, "height": side})
            page.set_content(_PAGE.format(side=side, ground=ground, part=100 * part, logo=logo))
            page.screenshot(path=str(IMAGES / name), omit_background=True)
        browser.close()


if __name__ == "__main__":
    main()
