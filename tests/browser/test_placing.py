"""Placing photos by hand: thirty photos are thirty clicks, or keys alone."""

import pytest
from playwright.sync_api import expect

from tests.browser.edit_page import spots


def near(there, wanted, within=1.5):
    """Return whether all positions are as placed, to 1.5 pixels."""
    return all(
        abs(a - b) <= within
        for place, want in zip(there, wanted, strict=True)
        for a, b in zip(place, want, strict=True)
    )


@pytest.mark.slow
def test_thirty_photos_are_thirty_clicks(make_page, api):
    edit = make_page(30)
    expect(edit.unplaced).to_have_text("30")
    for x, y in spots(30):
        edit.click(x, y)
    expect(edit.unplaced).to_have_text("0")
    edit.saved()
    placed = api.positions(edit.slug)
    assert near([placed[name] for name in sorted(placed)], spots(30))


def test_thirty_photos_by_keyboard_alone(make_page, api):
    edit = make_page(30)
    expect(edit.unplaced).to_have_text("30")
    keyboard = edit.page.keyboard
    keyboard.press("m")
    for n in range(30):
        keyboard.press(("ArrowRight", "ArrowDown", "ArrowLeft", "ArrowUp")[n // 3 % 4])
        keyboard.press("Enter")
    expect(edit.unplaced).to_have_text("0")
    edit.saved()
    placed = api.positions(edit.slug)
    assert len(placed) == 30
    assert len(set(placed.values())) > 10


def test_the_next_photo_comes_by_itself_and_stays_while_zooming(make_page):
    edit = make_page(3)
    names = edit.tray_names()
    expect(edit.current).to_contain_text(names[0])
    edit.click(200, 200)
    expect(edit.current).to_contain_text(names[1])
    edit.page.keyboard.press("+")
    edit.page.mouse.move(*edit.screen(500, 375))
    edit.page.mouse.wheel(0, -400)
    expect(edit.current).to_contain_text(names[1])


def test_a_click_after_back_to_the_tray_places_nothing(make_page, api):
    edit = make_page(2, placed=True)
    edit.tray.first.click()
    edit.page.locator("#current-tray").click()
    expect(edit.unplaced).to_have_text("1")
    expect(edit.page.locator("#instruction")).to_have_text("Select the photo again to place it.")
    edit.click(300, 400)
    edit.page.wait_for_timeout(300)
    expect(edit.unplaced).to_have_text("1")
    edit.tray.first.click()
    edit.click(300, 400)
    expect(edit.unplaced).to_have_text("0")
