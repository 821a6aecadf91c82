"""Notes on a position and on a photo: written, shown, undone."""

import pytest
from playwright.sync_api import expect

from tests.browser import axe
from tests.browser.edit_page import spots

pytestmark = pytest.mark.slow

TAP = """([x, y]) => {
  const at = { bubbles: true, clientX: x, clientY: y, pointerType: "touch", pointerId: 7, button: 0 };
  const under = document.elementFromPoint(x, y);
  for (const kind of ["pointerdown", "pointerup"]) under.dispatchEvent(new PointerEvent(kind, at));
}"""
"""Script: pointer events of a tap, before the focus moves."""


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


def test_a_press_on_a_note_is_meant_for_the_note_alone(make_page, page, api):
    edit = make_page(2)
    edit.click(300, 300)
    edit.saved()
    api.ask("POST", f"/maps/{edit.slug}/notes", data={"title": "Here", "x_px": 300, "y_px": 300})
    mark = page.locator(".note-mark")
    mark.click()
    expect(page.get_by_test_id("note-title")).to_have_value("Here")
    page.keyboard.press("Escape")
    expect(mark).to_have_count(1)
    box = mark.bounding_box()
    page.mouse.move(box["x"] + box["width"] / 2, box["y"] + box["height"] - 4)
    page.mouse.down()
    page.mouse.move(*edit.screen(500, 300), steps=4)
    with page.expect_response("**/notes/1") as moved:
        page.mouse.up()
    assert moved.value.ok
    edit.saved()
    state = api.state(edit.slug)
    assert sorted(photo["x_px"] or 0 for photo in state["photos"]) == [0, pytest.approx(300, abs=2)]
    assert state["notes"][0]["x_px"] == pytest.approx(500, abs=5)
    mark.focus()
    page.keyboard.press("Space")
    page.get_by_test_id("note-text").fill("By key.")
    page.get_by_test_id("note-save").click()
    expect(mark).to_be_focused()


def test_a_note_stays_with_the_photo_that_it_was_written_on(make_page, page, api):
    edit = make_page(2, placed=True)
    names = [photo["name"] for photo in api.state(edit.slug)["photos"]]
    edit.click(*spots(2)[0])
    expect(edit.current).to_contain_text(names[0])
    page.locator("#current-more").evaluate("more => { more.open = true; }")
    note = page.get_by_test_id("photo-note")
    note.fill("The first.")
    page.evaluate(TAP, list(edit.screen(*spots(2)[1])))
    expect(edit.current).to_contain_text(names[1])
    expect(note).to_have_value("")
    note.blur()
    edit.saved()
    assert [photo["note"] for photo in api.state(edit.slug)["photos"]] == ["The first.", None]
