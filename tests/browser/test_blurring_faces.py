"""A box over a face, drawn or added and moved by keys, blurs every picture of the photo."""

import re

import pytest
from playwright.sync_api import expect

from tests.browser import axe

pytestmark = pytest.mark.slow


def test_boxes_are_drawn_and_kept(make_page, page):
    make_page(2, placed=True)
    page.locator("#current-more").evaluate("more => { more.open = true; }")
    page.locator("#current-blur").click()
    expect(page.get_by_role("dialog")).to_be_visible()
    frame = page.locator(".blur-frame").bounding_box()
    corner = {axis: frame[axis] + 0.2 * frame[side] for axis, side in (("x", "width"), ("y", "height"))}
    page.mouse.move(corner["x"], corner["y"])
    page.mouse.down()
    page.mouse.move(corner["x"] + 0.4 * frame["width"], corner["y"] + 0.4 * frame["height"], steps=4)
    page.mouse.up()
    page.get_by_role("button", name="Add a box").click()
    page.keyboard.press("ArrowDown")
    page.keyboard.press("Shift+ArrowRight")
    expect(page.get_by_text("2 boxes")).to_be_visible()
    assert axe.findings(page) == []
    page.get_by_role("button", name="Save").click()
    expect(page.get_by_role("dialog")).to_have_count(0)
    expect(page.locator("#current-image")).to_have_attribute("src", re.compile("look="))
    page.locator("#current-blur").click()
    expect(page.locator(".blur-box")).to_have_count(2)
    page.get_by_role("button", name="Remove this box").first.click()
    expect(page.locator(".blur-box")).to_have_count(1)


def test_suggested_faces_are_accepted_photo_by_photo(make_page, page, api):
    edit = make_page(3, placed=True)
    face = {"x": 0.4, "y": 0.3, "width": 0.1, "height": 0.2, "kind": "face", "score": 0.9}
    page.route(
        "**/photos/*/blur/suggestions", lambda route: route.fulfill(json={"boxes": [face], "missing": []})
    )
    page.locator("#tray-list").focus()
    page.keyboard.press("Control+a")
    page.locator("#selection-blur").click()
    expect(page.get_by_text("1 of 3")).to_be_visible()
    expect(page.locator(".blur-box")).to_have_count(1)
    assert axe.findings(page) == []
    page.get_by_role("button", name="Remove this box").click()
    page.get_by_role("button", name="Save").click()
    expect(page.get_by_text("2 of 3")).to_be_visible()
    expect(page.locator(".blur-box")).to_have_count(1)
    page.get_by_test_id("blur-rest").click()
    expect(page.get_by_role("dialog")).to_have_count(0)
    assert sorted(len(photo["blurred"]) for photo in api.state(edit.slug)["photos"]) == [0, 1, 1]


def test_nothing_is_accepted_before_it_is_suggested(make_page, page, api):
    edit = make_page(2, placed=True)
    found = {"boxes": [{"x": 0.4, "y": 0.3, "width": 0.1, "height": 0.2, "kind": "face", "score": 0.9}]}
    found["missing"] = []
    waiting = []
    page.route("**/photos/*/blur/suggestions", lambda route: waiting.append(route))
    page.locator("#tray-list").focus()
    page.keyboard.press("Control+a")
    with page.expect_request("**/photos/*/blur/suggestions"):
        page.locator("#selection-blur").click()
    skip, accept = page.get_by_test_id("blur-skip"), page.get_by_test_id("blur-rest")
    expect(skip).to_be_disabled()
    expect(accept).to_be_disabled()
    with page.expect_request("**/photos/*/blur/suggestions"):
        waiting.pop().fulfill(json=found)
        accept.click()
    expect(page.get_by_text("2 of 2")).to_be_visible()
    page.context.watch.expect(429)
    waiting.pop().fulfill(status=429)
    expect(page.get_by_test_id("error-message")).to_be_visible()
    with page.expect_request("**/photos/*/blur/suggestions"):
        accept.click()
    expect(accept).to_be_disabled()
    waiting.pop().fulfill(json=found)
    expect(page.get_by_role("dialog")).to_have_count(0)
    assert [len(photo["blurred"]) for photo in api.state(edit.slug)["photos"]] == [1, 1]


def test_suggestions_of_one_photo_are_chosen_one_by_one(make_page, page, api):
    edit = make_page(1, placed=True)
    face = {"x": 0.1, "y": 0.3, "width": 0.1, "height": 0.2, "kind": "face", "score": 0.93}
    plate = {"x": 0.6, "y": 0.6, "width": 0.2, "height": 0.1, "kind": "plate", "score": 0.71}
    answer = {"boxes": [face, plate], "missing": []}
    page.route("**/photos/*/blur/suggestions", lambda route: route.fulfill(json=answer))
    page.locator("#current-more").evaluate("more => { more.open = true; }")
    page.locator("#current-blur").click()
    page.get_by_test_id("blur-suggest").click()
    expect(page.get_by_text("2 boxes")).to_be_visible()
    page.get_by_label("Face, 93").uncheck()
    expect(page.locator(".blur-box")).to_have_count(1)
    assert axe.findings(page) == []
    page.get_by_label("Face, 93").check()
    page.get_by_role("button", name="Remove this box").first.click()
    expect(page.get_by_label("Number plate, 71")).not_to_be_checked()
    page.get_by_test_id("blur-suggest").click()  # no duplicate boxes
    expect(page.get_by_text("2 boxes")).to_be_visible()
    page.locator(".blur-box", has_text="Number plate").focus()
    page.keyboard.press("ArrowUp")
    page.get_by_test_id("blur-suggest").click()  # nor of one that was moved a little
    expect(page.get_by_text("2 boxes")).to_be_visible()
    page.get_by_label("Face, 93").uncheck()
    page.get_by_role("button", name="Save").click()
    expect(page.get_by_role("dialog")).to_have_count(0)
    kept = {side: plate[side] for side in ("x", "y", "width", "height")}
    assert api.state(edit.slug)["photos"][0]["blurred"] == [pytest.approx({**kept, "y": plate["y"] - 0.01})]


def test_what_others_blurred_meanwhile_is_not_replaced(make_page, page, api):
    edit = make_page(1, placed=True)
    page.locator("#current-more").evaluate("more => { more.open = true; }")
    page.locator("#current-blur").click()
    page.get_by_role("button", name="Add a box").click()
    face = {"x": 0.1, "y": 0.3, "width": 0.1, "height": 0.2}
    api.ask("PUT", f"/maps/{edit.slug}/photos/0/blur", data={"boxes": [face]})
    page.context.watch.expect(409)
    page.get_by_role("button", name="Save").click()
    expect(page.get_by_test_id("error-message")).to_contain_text("have been blurred meanwhile")
    assert api.state(edit.slug)["photos"][0]["blurred"] == [face]


def test_closed_while_all_are_accepted_nothing_more_is_blurred(make_page, page, api):
    edit = make_page(2, placed=True)
    waiting = []
    page.route("**/photos/*/blur/suggestions", lambda route: waiting.append(route))
    page.locator("#tray-list").focus()
    page.keyboard.press("Control+a")
    answer = {"boxes": [{"x": 0.4, "y": 0.3, "width": 0.1, "height": 0.2, "kind": "face", "score": 0.9}]}
    answer |= {"missing": []}
    with page.expect_request("**/photos/*/blur/suggestions"):
        page.locator("#selection-blur").click()
    with page.expect_request("**/photos/*/blur/suggestions"):
        waiting.pop().fulfill(json=answer)
        page.get_by_test_id("blur-rest").click()
    expect(page.get_by_text("2 of 2")).to_be_visible()
    page.keyboard.press("Escape")
    expect(page.get_by_role("dialog")).to_have_count(0)
    with page.expect_response("**/photos/*/blur/suggestions") as answered:
        waiting.pop().fulfill(json=answer)
    answered.value.finished()
    page.wait_for_timeout(100)
    assert [len(photo["blurred"]) for photo in api.state(edit.slug)["photos"]] == [1, 0]


def test_more_than_a_photo_can_have_is_said(make_page, page):
    make_page(1, placed=True)
    face = {"x": 0.4, "y": 0.3, "width": 0.1, "height": 0.2, "kind": "face", "score": 0.9}
    answer = {"boxes": [face], "left": 30, "missing": []}
    page.route("**/photos/*/blur/suggestions", lambda route: route.fulfill(json=answer))
    page.locator("#current-more").evaluate("more => { more.open = true; }")
    page.locator("#current-blur").click()
    page.get_by_test_id("blur-suggest").click()
    expect(page.get_by_text("30 more were found, but the photo cannot have more boxes")).to_be_visible()


def test_what_was_found_before_is_shown_when_the_editor_opens(make_page, page):
    face = {"x": 0.4, "y": 0.3, "width": 0.1, "height": 0.2, "kind": "face", "score": 0.9}
    photos = [{"id": 0, "name": "a", "boxes": [face], "left": 0}]
    found = {"photos": photos, "searched": 1, "total": 1, "missing": [], "job": None}
    page.route("**/maps/*/blur/suggestions?boxes=0", lambda route: route.fulfill(json=found))
    make_page(1, placed=True)
    expect(page.get_by_text("1 photo has something to blur.")).to_be_visible()


def test_what_nobody_asked_for_fails_without_a_word(make_page, page):
    page.context.watch.expect(403)
    refusal = {"error": {"code": "forbidden", "message": "No."}}
    page.route("**/maps/*/blur/suggestions?boxes=0", lambda route: route.fulfill(status=403, json=refusal))
    with page.expect_response("**/maps/*/blur/suggestions?boxes=0"):
        edit = make_page(1)
    edit.click(300, 300)
    edit.saved()
    expect(edit.error).to_have_count(0)


def test_a_server_without_a_network_says_what_is_not_looked_for(make_page, page):
    make_page(1, placed=True)
    answer = {"boxes": [], "missing": ["plates"]}
    page.route("**/photos/*/blur/suggestions", lambda route: route.fulfill(json=answer))
    page.locator("#current-more").evaluate("more => { more.open = true; }")
    page.locator("#current-blur").click()
    page.get_by_test_id("blur-suggest").click()
    expect(page.get_by_text("Nothing was found. Number plates are not detected")).to_be_visible()
    expect(page.get_by_text("expmap models fetch plates")).to_be_visible()


def test_all_photos_are_searched_and_looked_at_from_the_bar(make_page, page, api):
    make_page(2, placed=True)
    face = {"x": 0.4, "y": 0.3, "width": 0.1, "height": 0.2, "kind": "face", "score": 0.9}
    found = {
        "photos": [{"id": 1, "name": "b", "boxes": [face]}],
        "searched": 2,
        "total": 2,
        "missing": [],
        "job": 7,
    }
    asked = []

    def of_map(route):
        asked.append(route.request.method)
        before = {} if "POST" in asked else {"photos": []}  # response to the page's own request at loading
        route.fulfill(json=found | before, status=202 if route.request.method == "POST" else 200)

    def changes(route):
        answer = route.fetch()
        state = answer.json()
        if "POST" in asked:
            job = {"id": 7, "kind": "blur", "state": "done", "done": 2, "total": 2, "seconds_left": None}
            state["jobs"] = [*state.get("jobs", []), {**job, "error": None, "result": {}, "note": ""}]
        route.fulfill(response=answer, json=state)

    page.route("**/blur/suggestions*", of_map)
    page.route("**/changes?*", changes)
    page.route(
        "**/photos/*/blur/suggestions", lambda route: route.fulfill(json={"boxes": [face], "missing": []})
    )
    page.locator("#current-more").evaluate("more => { more.open = true; }")
    page.locator("#current-blur").click()
    page.get_by_test_id("blur-all").click()
    expect(page.get_by_text("1 photo has something to blur.")).to_be_visible()
    assert asked[-1] == "GET"
    page.get_by_test_id("blur-look").click()
    expect(page.get_by_role("dialog")).to_be_visible()
    found["photos"] = []
    page.get_by_role("dialog").get_by_role("button", name="Save").click()
    expect(page.get_by_role("dialog")).to_have_count(0)
    expect(page.get_by_text("1 photo has something to blur.")).to_be_hidden()
    page.unroute_all(behavior="wait")  # the page polls all the time: wait for pending handlers
