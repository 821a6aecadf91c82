"""A panorama in the pages: placed with one click, turned by hand, masked; and one as a query."""

import io
import math

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import expect

from tests.browser import axe
from tests.browser.edit_page import EditPage, spots
from tests.browser.polling import until
from tests.tasks.localize.test_panorama_query import WIDE, save, texture


def seen(view):
    """Return what a view shows, grey."""
    return np.asarray(Image.open(io.BytesIO(view.screenshot())).convert("L"), float)


def drag(page, view, *, by):
    """Drag the content of a view to the right."""
    box = view.bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + 0.6 * box["height"]
    page.mouse.move(x, y)
    page.mouse.down()
    page.mouse.move(x + by, y, steps=4)
    page.mouse.up()


@pytest.mark.slow
def test_panoramas_are_placed_turned_masked_and_found(page, api, sample_folder, tmp_path):
    slug = api.make_map("Panoramas", satellite=sample_folder / "satellite.png")
    edit = EditPage(page, slug).open()
    edit.choose_photos([save(tmp_path / f"{n}.jpg", texture(n)) for n in range(3)])
    edit.uploaded()
    for x, y in spots(3):
        edit.click(x, y)
    expect(edit.placed).to_have_text("3")
    edit.saved()

    view = page.locator("#current-frame .panorama__canvas")
    expect(view).to_have_attribute("aria-valuenow", "0")
    before = seen(view)
    assert before.std() > 10.0, "it is drawn"
    drag(page, view, by=-60)
    expect(view).not_to_have_attribute("aria-valuenow", "0")
    assert 5 <= int(view.get_attribute("aria-valuenow")) <= 90, "what is on the right comes into sight"
    assert np.abs(seen(view) - before).mean() > 5.0
    view.press("Home")
    expect(view).to_have_attribute("aria-valuenow", "0")
    view.press("ArrowLeft")
    expect(view).to_have_attribute("aria-valuetext", "354°")

    page.locator("#current-more").evaluate("more => { more.open = true; }")
    page.locator("#current-panorama").click()
    dialog = page.get_by_role("dialog")
    expect(dialog.get_by_label("The same for the 2 other panoramas")).to_be_visible()
    until(page, "() => document.querySelector('.mask-frame img').naturalWidth")
    assert dialog.evaluate("one => one.scrollHeight - one.clientHeight") == 0, "all of it is in sight"
    mask = np.full((180, 360), 255, np.uint8)
    for row in range(8):
        mask[100 + row, 200 : 210 + 20 * row] = 0
    Image.fromarray(mask).save(tmp_path / "mask.png")
    dialog.locator("input[type=file]").set_input_files(tmp_path / "mask.png")
    expect(dialog.get_by_text("Mask: 1% of the picture")).to_be_visible()
    expect(dialog.locator(".blur-box")).to_have_count(0)
    assert axe.findings(page) == []
    dialog.get_by_role("button", name="Remove this mask").click()
    dialog.get_by_label("Used from").fill("45")
    dialog.get_by_label("Used from").press("Tab")
    expect(dialog.get_by_text("1 masked part")).to_be_visible()
    dialog.get_by_role("button", name="Save").click()
    expect(dialog).to_be_hidden()
    robot = {"x": 0, "y": 0.75, "width": 1, "height": 0.25}
    assert [photo["panorama"] for photo in api.state(slug)["photos"]] == [{"masked": [robot]}] * 3
    page.get_by_test_id("undo").click()
    expect(page.get_by_text("Undone: changing 3 panoramas")).to_be_visible()

    api.wait_for_jobs(slug)
    query = save(tmp_path / "query.jpg", np.roll(texture(1), WIDE // 4, axis=1))
    page.goto(f"/maps/{slug}/localize")
    page.locator("#query-input").set_input_files(query)
    first = page.get_by_test_id("hypothesis").first
    expect(first).to_be_visible()
    there = next(p for p in api.state(slug)["photos"] if p["name"] == "1.jpg")
    place = float(first.get_attribute("data-x")), float(first.get_attribute("data-y"))
    assert math.dist(place, (there["x_px"], there["y_px"])) < 40.0
    expect(page.locator("#query-frame .panorama__canvas")).to_be_visible()
    expect(page.locator("#matches-around .panorama__canvas")).to_be_visible()
    expect(page.locator("#matches-photo option")).to_have_count(1)
