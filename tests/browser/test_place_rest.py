"""Photos place themselves: three are placed by hand, the others are suggested and accepted."""

import math

from playwright.sync_api import expect

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
