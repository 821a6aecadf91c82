"""Tools of the editor: spread dots, distances, wrong clocks, and pictures from the clipboard."""

import math
import re

import piexif
import pytest
from PIL import Image
from playwright.sync_api import expect

from tests.browser import axe
from tests.browser.edit_page import EditPage
from tests.browser.test_photos_first import PASTE

pytestmark = pytest.mark.slow

CORNERS = {"top_left": {"lat": 50.001, "lon": 14.0}, "bottom_right": {"lat": 50.0, "lon": 14.002}}


TWO_CLICKS = """
([x, y, down]) => {
  const image = document.querySelector("#map-canvas");
  for (const at of [y, y + down]) {
    const where = { bubbles: true, clientX: x, clientY: at, pointerId: 1, button: 0 };
    for (const type of ["pointerdown", "pointerup"]) image.dispatchEvent(new PointerEvent(type, where));
  }
}
"""
"""Two presses within one frame, the second at an offset below the first."""


def dots_on_each_other(edit, api, at):
    """Place all photos of a map at one position."""
    ids = [photo["id"] for photo in api.state(edit.slug)["photos"]]
    changes = [{"id": id, "x_px": at[0], "y_px": at[1]} for id in ids]
    api.ask("PATCH", f"/maps/{edit.slug}/experiences", data={"kind": "place", "changes": changes})
    edit.open()
    return ids


def test_dots_on_each_other_are_spread_by_a_click(make_page, api):
    edit = make_page(4)
    dots_on_each_other(edit, api, (450, 300))
    name = edit.page.locator("#current-name")
    edit.click(450, 300)
    x, y = edit.screen(450, 300)
    seen = set()
    for n in range(4):
        turn = math.tau * n / 4 - math.pi / 2
        edit.page.mouse.click(x + 34 * math.cos(turn), y + 34 * math.sin(turn))
        expect(name).not_to_have_text(re.compile("|".join(map(re.escape, seen)) or "^$"))
        seen.add(name.inner_text())
    assert len(seen) == 4
    edit.page.mouse.move(x, y - 34)
    edit.page.mouse.down()
    edit.page.mouse.move(*edit.screen(600, 400), steps=4)
    edit.page.mouse.up()
    edit.saved()
    moved = [at for at in api.positions(edit.slug).values() if math.dist(at, (600, 400)) < 3]
    assert len(moved) == 1, "a dot that is dragged out of the circle goes to the pointer"


def test_a_dot_is_where_it_was_spread_to_before_it_is_drawn_there(make_page, api):
    edit = make_page(4)
    ids = dots_on_each_other(edit, api, (450, 300))
    names = {photo["id"]: photo["name"] for photo in api.state(edit.slug)["photos"]}
    edit.page.evaluate(TWO_CLICKS, [*edit.screen(450, 300), 34])
    expect(edit.page.locator("#current-name")).to_have_text(names[ids[2]])


def test_a_distance_is_measured_along_clicks(page, api, sample_folder):
    slug = api.make_map("Measured", satellite=sample_folder / "satellite.png")
    width, height = (api.state(slug)["satellite"][side] for side in ("width", "height"))
    api.ask("PUT", f"/maps/{slug}/georeference", data={"kind": "corners", "corners": CORNERS})
    edit = EditPage(page, slug).open()
    page.get_by_role("button", name="Measure a distance").click()
    bar = page.get_by_test_id("measure-bar")
    for x, y in ((0.25, 0.25), (0.25, 0.75), (0.75, 0.75)):
        edit.click(x * width, y * height)
    south, east = 111_195 * 0.0005, 111_195 * 0.001 * math.cos(math.radians(50.00025))
    shown = float(re.sub(r"[^\d.]", "", page.locator("#measure-length").inner_text()))
    assert shown == pytest.approx(south + east, rel=0.02)
    assert axe.findings(page) == []
    page.get_by_role("button", name="Remove the last point").click()
    shown = float(re.sub(r"[^\d.]", "", page.locator("#measure-length").inner_text()))
    assert shown == pytest.approx(south, rel=0.02)
    page.keyboard.press("Escape")
    expect(bar).to_be_hidden()
    expect(page.locator(".ed-measure-point")).to_have_count(0)


@pytest.fixture
def timed_photos(tmp_path):
    """Three photos, a minute apart."""
    paths = []
    for n in range(3):
        taken = f"2026:05:31 10:0{n}:00".encode()
        exif = piexif.dump({"Exif": {piexif.ExifIFD.DateTimeOriginal: taken}})
        paths.append(tmp_path / f"timed_{n}.jpg")
        Image.new("RGB", (64, 48), (80 * n, 90, 90)).save(paths[-1], exif=exif)
    return paths


def test_a_wrong_clock_is_corrected_and_undone(page, api, timed_photos, sample_folder):
    slug = api.make_map("Wrong clock", satellite=sample_folder / "satellite.png", photos=timed_photos)

    def times():
        return [photo["taken_at"] for photo in api.state(slug)["photos"]]

    before = times()
    edit = EditPage(page, slug).open()
    page.locator("#tray-list").press("Control+a")
    assert axe.findings(page) == []
    page.get_by_role("button", name="Correct the times").click()
    page.get_by_test_id("right-time").fill("2026-06-01T11:30:05")
    dialog = page.get_by_role("dialog")
    expect(dialog).to_contain_text("3 photos are shifted by +1 day 01:30:05")
    assert axe.findings(page) == []
    dialog.get_by_role("button", name="Correct the times").click()
    expect(edit.undo).to_have_attribute("aria-label", "Undo: correcting the times of 3 photos")
    edit.saved()
    assert times() == ["2026-06-01T11:30:05", "2026-06-01T11:31:05", "2026-06-01T11:32:05"]
    edit.undo.click()
    expect(edit.redo).to_be_enabled()
    edit.saved()
    assert times() == before


def test_a_picture_is_pasted(make_page, api):
    edit = make_page(1)
    edit.page.locator("body").evaluate(PASTE)
    edit.uploaded()
    expect(edit.unplaced).to_have_text("2")
    names = [photo["name"] for photo in api.state(edit.slug)["photos"]]
    assert any(re.fullmatch(r"pasted [\d-]+ [\d.]+\.png", name) for name in names), names


def test_the_keys_and_the_manual_are_told_apart(make_page):
    edit = make_page(1)
    toolbar = edit.page.locator("#toolbar")
    expect(toolbar.get_by_role("button", name="Keys")).to_be_visible()
    expect(edit.page.get_by_role("link", name="Help")).to_have_count(1)
    toolbar.get_by_role("button", name="Keys").click()
    expect(edit.page.get_by_role("dialog")).to_contain_text("measure a distance")
