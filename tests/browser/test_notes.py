"""Notes on a spot and on a photo: written, seen, taken back."""

from playwright.sync_api import expect

from tests.browser import axe


def test_a_note_on_a_spot_is_written_by_a_right_click_and_undone(make_page, page):
    edit = make_page(1, placed=True)
    x, y = edit.screen(300, 300)
    page.mouse.click(x, y, button="right")
    page.get_by_role("menuitem", name="Add a note here").click()
    page.get_by_test_id("note-title").fill("New bench")
    page.get_by_test_id("note-text").fill("Since May.")
    assert axe.findings(page) == []
    page.get_by_test_id("note-save").click()
    mark = page.locator(".note-mark")
    expect(mark).to_have_attribute("title", "New bench")
    mark.click()
    expect(page.get_by_test_id("note-text")).to_have_value("Since May.")
    page.keyboard.press("Escape")
    page.get_by_test_id("undo").click()
    expect(mark).to_have_count(0)


def test_a_photo_is_found_by_its_note(make_page, page, api):
    edit = make_page(2)
    page.locator("#current-more").evaluate("more => { more.open = true; }")
    note = page.get_by_test_id("photo-note")
    note.fill("The gate was blue.")
    note.blur()
    edit.saved()
    noted = [
        photo["name"] for photo in api.state(edit.slug)["photos"] if photo["note"] == "The gate was blue."
    ]
    page.locator("#tray-search").fill("gate was")
    expect(page.get_by_test_id("tray-photo")).to_have_count(1)
    expect(page.locator("#current-name")).to_have_text(noted[0])
