"""Dragging, turning, selecting several, removing."""

import math

import pytest
from playwright.sync_api import expect

from tests.browser.edit_page import spots

pytestmark = pytest.mark.slow


def placed(api, slug):
    """Return the positions in the order of the ids."""
    return [(photo["x_px"], photo["y_px"]) for photo in api.state(slug)["photos"]]


def test_a_photo_is_dragged(make_page, api):
    edit = make_page(2, placed=True)
    edit.drag(spots(1)[0], (300, 500))
    edit.saved()
    first, second = placed(api, edit.slug)
    assert math.dist(first, (300, 500)) < 2
    assert second == spots(2)[1]


def test_several_are_chosen_and_moved_as_one_step(make_page, api):
    edit = make_page(4, placed=True)
    for x, y in spots(3):
        edit.click(x, y, shift=True)
    (x, y) = spots(1)[0]
    edit.drag((x, y), (x + 50, y + 200))
    edit.saved()
    after = placed(api, edit.slug)
    for (x, y), there in zip(spots(3), after, strict=False):
        assert math.dist(there, (x + 50, y + 200)) < 2
    assert after[3] == spots(4)[3]
    edit.undo.click()
    edit.saved()
    assert placed(api, edit.slug) == spots(4)


def test_a_photo_is_dragged_while_text_of_the_page_is_selected(make_page, api):
    """If a press is on selected text, browsers drag the text and cancel the pointer."""
    edit = make_page(1, placed=True)
    edit.page.evaluate("getSelection().selectAllChildren(document.body)")
    edit.drag(spots(1)[0], (300, 500))
    edit.saved()
    assert math.dist(placed(api, edit.slug)[0], (300, 500)) < 2


def test_a_press_whose_end_was_lost_takes_no_part_in_the_next(make_page, api):
    """For example, when a system window opens while the button is down."""
    edit = make_page(1, placed=True)
    x, y = edit.screen(*spots(1)[0])
    edit.canvas.dispatch_event(
        "pointerdown", {"pointerId": 1, "pointerType": "mouse", "button": 0, "clientX": x, "clientY": y}
    )
    edit.drag(spots(1)[0], (300, 500))
    edit.saved()
    assert math.dist(placed(api, edit.slug)[0], (300, 500)) < 2


def test_clicks_on_the_image_select_no_text(make_page):
    edit = make_page(2, placed=True)
    for x, y in spots(2):
        edit.click(x, y, shift=True)
    assert edit.page.evaluate("getSelection().rangeCount") == 0


def test_a_box_chooses(make_page, api):
    edit = make_page(4, placed=True)
    edit.drag((50, 40), (450, 160), shift=True)
    edit.page.keyboard.press("Backspace")
    expect(edit.unplaced).to_have_text("3")
    edit.saved()
    assert [x is None for x, _ in placed(api, edit.slug)] == [True, True, True, False]


def test_the_heading_is_turned_by_key_and_by_hand(make_page, api):
    edit = make_page(1, placed=True)
    edit.click(*spots(1)[0])
    edit.page.keyboard.press("]")
    edit.saved()
    (photo,) = api.state(edit.slug)["photos"]
    assert photo["heading_deg"] == pytest.approx(5)
    edit.turn_by_hand(spots(1)[0], heading=photo["heading_deg"], to=90)
    edit.saved()
    (photo,) = api.state(edit.slug)["photos"]
    assert photo["heading_deg"] == pytest.approx(90, abs=3)


def test_a_photo_is_taken_out_and_comes_back(make_page, api):
    edit = make_page(2, placed=True)
    edit.click(*spots(1)[0])
    edit.page.keyboard.press("Delete")
    edit.saved()
    assert len(api.state(edit.slug)["photos"]) == 1
    edit.undo.click()
    edit.saved()
    assert len(api.state(edit.slug)["photos"]) == 2
