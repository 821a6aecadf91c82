"""The edit page, operated as by a user."""

import math
import re
from collections.abc import Sequence
from pathlib import Path

from playwright.sync_api import Page, expect

ZOOM_STEPS = 4
"""Steps per zoom level: the zoom of the whole image is rounded down to quarters."""

HANDLE_PX = 46
"""Distance from a photo to its rotation handle."""


def spots(count: int) -> list[tuple[int, int]]:
    """Return map pixels on the sample's image, well apart, in rows of six, above the card of jobs."""
    return [(100 + 150 * (n % 6), 60 + 90 * (n // 6)) for n in range(count)]


class EditPage:
    """A page with a map open.

    Parameters
    ----------
    page : Page
    slug : str
    """

    def __init__(self, page: Page, slug: str) -> None:
        self.page = page
        self.slug = slug
        self.canvas = page.get_by_test_id("map-canvas")
        self.current = page.get_by_test_id("current-photo")
        self.tray = page.get_by_test_id("tray-photo")
        """Only photos in view have elements in the list."""
        self.unplaced = page.get_by_test_id("tray-count")
        self.placed = page.get_by_test_id("placed-count")
        self.undo = page.get_by_test_id("undo")
        self.redo = page.get_by_test_id("redo")
        self.error = page.get_by_test_id("error-message")
        self.turn_deg = 0.0
        """Rotation of the drawn image, clockwise."""

    def open(self) -> "EditPage":
        """Open the page, and wait until it is ready."""
        self.page.goto(f"/maps/{self.slug}/edit")
        canvas = self.canvas.locator("canvas")
        expect(canvas).to_be_visible()
        expect(canvas).to_have_attribute("style", re.compile("width"))  # its photos are drawn
        self.size = self._size()
        return self

    def _size(self) -> tuple[int, int] | None:
        answer = self.page.request.get(f"/api/v1/maps/{self.slug}").json()
        satellite = answer["satellite"]
        return None if satellite is None else (satellite["width"], satellite["height"])

    def screen(self, x: float, y: float) -> tuple[float, float]:
        """Return the screen position of a map pixel while the view shows the whole image."""
        assert self.size is not None
        box = self.canvas.bounding_box()
        assert box is not None
        width, height = self.size
        sine, cosine = (f(math.radians(self.turn_deg)) for f in (math.sin, math.cos))
        around = (
            width * abs(cosine) + height * abs(sine),
            width * abs(sine) + height * abs(cosine),
        )
        zoom = math.log2(min(box["width"] / around[0], box["height"] / around[1]))
        scale = 2 ** (math.floor(zoom * ZOOM_STEPS) / ZOOM_STEPS)
        middle = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
        right, down = (x - width / 2) * scale, (y - height / 2) * scale
        return middle[0] + right * cosine - down * sine, middle[1] + right * sine + down * cosine

    def click(self, x: float, y: float, *, shift: bool = False) -> None:
        """Click on a map pixel."""
        if shift:
            self.page.keyboard.down("Shift")
        self.page.mouse.click(*self.screen(x, y))
        if shift:
            self.page.keyboard.up("Shift")

    def drag(self, start: Sequence[float], end: Sequence[float], *, shift: bool = False) -> None:
        """Drag from a map pixel to another."""
        if shift:
            self.page.keyboard.down("Shift")
        self.page.mouse.move(*self.screen(*start))
        self.page.mouse.down()
        self.page.mouse.move(*self.screen(*end), steps=4)
        self.page.mouse.up()
        if shift:
            self.page.keyboard.up("Shift")

    def choose_photos(self, paths: Sequence[Path]) -> None:
        """Set the files of the photo input, as the file dialog does."""
        self.page.get_by_test_id("photo-input").set_input_files(list(paths))

    def saved(self) -> None:
        """Wait until the server has every edit."""
        expect(self.page.locator("#saved")).to_have_attribute("data-waiting", "0")

    def uploaded(self) -> None:
        """Wait until all chosen files are processed."""
        self.page.get_by_test_id("upload-summary").wait_for()

    def tray_names(self) -> list[str]:
        """Return the file names of the photos in the tray, in order."""
        state = self.page.request.get(f"/api/v1/maps/{self.slug}").json()
        names = {str(photo["id"]): photo["name"] for photo in state["photos"]}
        self.tray.first.wait_for(state="attached")
        return [names[id] for id in self.tray.evaluate_all("all => all.map(one => one.dataset.id)")]

    def turn_by_hand(self, spot: Sequence[float], *, heading: float, to: float) -> None:
        """Drag the handle of the current photo, at a map pixel, from one heading to another."""
        x, y = self.screen(*spot)
        for angle, act in ((heading, self.page.mouse.down), (to, self.page.mouse.up)):
            turn = math.radians(angle)
            self.page.mouse.move(x + HANDLE_PX * math.sin(turn), y - HANDLE_PX * math.cos(turn), steps=3)
            act()
