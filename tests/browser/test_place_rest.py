"""Photos place themselves: three are placed by hand, the others are suggested and accepted."""

import math
import re
from pathlib import Path

import numpy as np
from playwright.sync_api import expect

from tests.browser import axe
from tests.browser.edit_page import EditPage
from tests.tasks.landmarks.rendered import make_court

BY_HAND = (0, 4, 8)
JOINED_WITHIN_MS = 240_000


def test_the_rest_is_suggested_and_accepted(page, api, tmp_path):
    cfg, at, _ = make_court(tmp_path / "court", photos=9, placed=BY_HAND)
    photos = sorted((cfg.parent / "photos").iterdir())
    slug = api.make_map("Court", satellite=cfg.with_name("plan.png"), photos=photos)
    edit = EditPage(page, slug).open()
    for number in BY_HAND:
        page.locator(f'[data-testid="tray-photo"][data-id="{number}"]').click()
        edit.click(*at[number])
        edit.saved()
    expect(edit.unplaced).to_have_text("6")
    page.locator("#place-menu summary").click()
    page.locator("#place-the-rest").click()
    page.get_by_test_id("rest-find").click()
    suggested = page.get_by_test_id("suggested-photo")
    expect(suggested).to_have_count(6, timeout=JOINED_WITHIN_MS)
    assert len(api.positions(slug)) == 3, "so far it is only suggested"
    suggested.first.get_by_role("button", name="Place ").click()
    expect(suggested).to_have_count(5)
    expect(edit.unplaced).to_have_text("5")
    place = page.get_by_test_id("rest-place")
    expect(place).to_have_text("Place 5 photos")
    place.click()
    expect(edit.unplaced).to_have_text("0")
    placed = api.positions(slug)
    for number, position in enumerate(at):
        assert math.dist(placed[f"{number:02}.png"], position) < 15.0
    edit.undo.click()
    expect(edit.unplaced).to_have_text("5")
    look_at_the_landmarks(page, api, slug)


def look_at_the_landmarks(page, api, slug):
    """The points that the photos share, and the cameras: a click on one leads to its photo."""
    page.goto(f"/maps/{slug}/landmarks")
    scene = page.get_by_test_id("scene")
    expect(scene).to_have_attribute("data-points", re.compile(r"\d{3,}"))
    assert page.locator("#status").text_content().endswith("9 of 9 photos")
    page.get_by_role("button", name="From above").click()
    cameras = api.ask("GET", f"/maps/{slug}/landmarks")["cameras"]
    camera = max(cameras, key=lambda one: one["at"][0])
    assert (camera["name"], camera["placed"]) == ("00.png", True)
    scene.click(position=spot_from_above(camera["at"], [one["at"] for one in cameras], scene.bounding_box()))
    card = page.get_by_test_id("camera-card")
    expect(card.get_by_role("heading")).to_have_text("00.png")
    assert axe.findings(page, "main") == []
    scene.press("n")
    expect(card.get_by_role("heading")).to_have_text("01.png")
    card.get_by_role("button", name="Look from here").click()
    expect(page.get_by_role("button", name="3D")).to_have_attribute("aria-pressed", "true")
    with page.expect_download() as download:
        page.get_by_label("Download").click()
        page.get_by_test_id("export-ply").click()
    assert Path(download.value.path()).read_bytes().startswith(b"ply\n")
    card.get_by_test_id("open-in-editor").click()
    expect(page.locator("#current-name, [data-testid=current-photo]").first).to_contain_text("01.png")


def spot_from_above(at, everyone, box):
    """Where something is on the canvas that shows all cameras from above, with a margin around them."""
    low, high = np.min(everyone, axis=0), np.max(everyone, axis=0)
    margin = 0.08 * np.linalg.norm(high - low)
    wide, tall = 1.15 * (high - low + 2 * margin)[:2]
    unit = max(wide / box["width"], tall / box["height"])
    x, y = (np.array(at) - (low + high) / 2)[:2] / unit
    return {"x": box["width"] / 2 + x, "y": box["height"] / 2 - y}
