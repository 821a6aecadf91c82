"""A map is walked through: by keys, along arrows, from a link, and by visitors of a share."""

import json
import re

import pytest
from playwright.sync_api import expect

from benchmarks.page_loads import NEXT_PHOTO_MS
from tests.browser import axe
from tests.browser.polling import until

PHONE = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}
TALL = "image => image.naturalHeight / image.naturalWidth"
LACKING = "least => document.querySelectorAll('#strip img:not([src])').length >= least"
LOADED = "document.getElementById('photo-image')?.naturalWidth > 0"


@pytest.fixture
def view(page, sample_map):
    """The page of the sample map."""
    page.goto(f"/maps/{sample_map}/view")
    until(page, LOADED)
    return page


def photo_in(page):
    """Return the photo in the address; None if there is none."""
    found = re.search(r"[?&]photo=(\d+)", page.url)
    return found and int(found[1])


def place(page):
    """Return the place of the current photo on the way."""
    return int(page.get_by_test_id("place-in-order").inner_text().split()[0])


def test_keys_walk_along_the_way_and_the_address_follows(view):
    assert place(view) == 1
    view.keyboard.press("ArrowRight")
    assert place(view) == 2
    second = photo_in(view)
    view.keyboard.press("End")
    assert photo_in(view) != second
    expect(view.get_by_role("button", name="Next photo")).to_be_disabled()
    view.keyboard.press("Home")
    assert place(view) == 1
    expect(view.get_by_test_id("strip").get_by_role("option", selected=True)).to_have_count(1)


def test_an_arrow_leads_to_its_photo_and_back_returns(view):
    view.keyboard.press("ArrowRight")
    before = photo_in(view)
    arrow = view.get_by_test_id("steps").get_by_role("button").first
    to = int(arrow.get_attribute("data-id"))
    arrow.click()
    assert photo_in(view) == to
    view.go_back()
    expect(view).to_have_url(re.compile(f"photo={before}$"))
    assert place(view) == 2


def test_a_link_opens_its_photo(page, sample_map, api):
    wanted = api.state(sample_map)["photos"][40]
    page.goto(f"/maps/{sample_map}/view?photo={wanted['id']}")
    expect(page.locator("#photo-name")).to_have_text(wanted["name"])
    expect(page.get_by_test_id("strip").get_by_role("option", selected=True)).to_be_in_viewport()


def test_the_photo_fills_the_screen_by_a_key(view):
    view.keyboard.press("f")
    button = view.get_by_role("button", name="Full screen")
    expect(button).to_have_attribute("aria-pressed", "true")
    expect(button.locator("use")).to_have_attribute("href", re.compile("#unfit$"))
    view.keyboard.press("ArrowRight")
    assert place(view) == 2
    view.keyboard.press("f")
    expect(view.get_by_role("button", name="Full screen")).to_have_attribute("aria-pressed", "false")


def test_a_dot_of_the_map_and_a_photo_of_the_strip_lead_to_theirs(view):
    view.get_by_test_id("strip").get_by_role("option").nth(3).click()
    assert place(view) == 4
    assert axe.findings(view) == []


def test_it_fits_a_phone_with_the_photo_first(open_context, owner, sample_map):
    phone = open_context(storage_state=owner, **PHONE).new_page()
    phone.goto(f"/maps/{sample_map}/view")
    until(phone, LOADED)
    assert phone.evaluate("document.documentElement.scrollWidth - innerWidth") <= 0
    photo, canvas = (phone.locator(one).bounding_box() for one in ("#photo-frame", "#map-canvas"))
    assert photo["y"] + photo["height"] <= canvas["y"]
    assert canvas["y"] + canvas["height"] <= PHONE["viewport"]["height"], "the map is in sight, with its dot"
    assert axe.findings(phone) == []


@pytest.fixture
def share(api, sample_map):
    """Share the sample map and return its address."""

    def make(**allows):
        return api.ask("POST", f"/maps/{sample_map}/shares", data={"photos": True, **allows})["url"]

    return make


def test_visitors_walk_too_and_localize_where_they_may(open_context, share):
    visitor = open_context().new_page()
    visitor.goto(share(localize=True))
    until(visitor, LOADED)
    visitor.keyboard.press("ArrowRight")
    assert place(visitor) == 2
    assert axe.findings(visitor) == []
    visitor.get_by_test_id("find-mine").click()
    expect(visitor.get_by_test_id("query-input")).to_be_attached()
    visitor.get_by_role("link", name="View").click()
    until(visitor, LOADED)


def test_the_arrows_of_an_upright_phone_are_in_the_picture(open_context, owner, sample_map):
    phone = open_context(storage_state=owner, **PHONE).new_page()
    phone.goto(f"/maps/{sample_map}/view")
    until(phone, LOADED)
    phone.get_by_role("button", name="Full screen").tap()
    expect(phone.locator(".is-whole")).to_be_attached()
    frame = phone.locator("#photo-frame").bounding_box()
    tall = phone.locator("#photo-image").evaluate(TALL)
    end = frame["y"] + (frame["height"] + tall * frame["width"]) / 2
    assert end < frame["height"] - 100
    for arrow in phone.get_by_test_id("steps").get_by_role("button").all():
        box = arrow.bounding_box()
        assert box["y"] + box["height"] <= end + 1


def test_the_order_is_in_the_address_and_a_reload_keeps_it(page, api, sample_map):
    ids = [photo["id"] for photo in api.state(sample_map)["photos"]]
    timed = {"by_time": ids, "by_place": ids[::-1], "steps": {}}

    def with_times(route):
        answer = route.fetch()
        text = re.sub(r'(id="walk">).*?(</script>)', lambda m: m[1] + json.dumps(timed) + m[2], answer.text())
        route.fulfill(response=answer, body=text)

    page.route("**/view*", with_times)
    page.goto(f"/maps/{sample_map}/view")
    page.get_by_role("button", name="By place").click()
    expect(page).to_have_url(re.compile("order=place"))
    page.keyboard.press("Home")
    expect(page).to_have_url(re.compile(f"photo={ids[-1]}"))
    page.reload()
    expect(page.get_by_role("button", name="By place")).to_have_attribute("aria-pressed", "true")
    assert place(page) == 1
    page.get_by_role("button", name="By time").click()
    expect(page).not_to_have_url(re.compile("order="))


def test_a_photo_whose_name_a_share_leaves_out_has_no_other(open_context, share):
    visitor = open_context().new_page()
    visitor.goto(share())
    until(visitor, LOADED)
    expect(visitor.locator("#photo-name")).to_be_empty()
    expect(visitor.get_by_test_id("place-in-order")).to_contain_text("1 of")
    expect(visitor.get_by_test_id("strip").get_by_role("option").first).not_to_contain_text("Photo")


def test_a_swipe_goes_to_the_next_photo(open_context, owner, sample_map):
    phone = open_context(storage_state=owner, **PHONE).new_page()
    phone.goto(f"/maps/{sample_map}/view")
    until(phone, LOADED)
    box = phone.locator("#photo-frame").bounding_box()
    touch = phone.context.new_cdp_session(phone)
    middle = box["y"] + box["height"] / 3
    start, end = ({"x": box["x"] + box["width"] * part, "y": middle} for part in (0.7, 0.3))
    touch.send("Input.dispatchTouchEvent", {"type": "touchStart", "touchPoints": [start]})
    touch.send("Input.dispatchTouchEvent", {"type": "touchMove", "touchPoints": [end]})
    touch.send("Input.dispatchTouchEvent", {"type": "touchEnd", "touchPoints": []})
    expect(phone.get_by_test_id("place-in-order")).to_contain_text("2")


def test_photo_to_photo_is_quick_once_it_is_loaded_ahead(view):
    view.wait_for_load_state("networkidle")
    steps = view.evaluate(NEXT_PHOTO_MS, {"keys": ["ArrowRight"] * 5, "pause": 1500})
    times = sorted(step["large"] for step in steps)
    assert times[len(times) // 2] < 400, f"{times}; benchmarks.page_loads measures it on a quiet machine"


def test_on_a_slow_network_the_photo_comes_before_the_filmstrip(view):
    view.wait_for_load_state("networkidle")
    held, rest = [], []

    def hold_the_first(route):
        (rest if held else held).append(route)
        if rest:
            route.continue_()

    view.route("**/thumb*", hold_the_first)
    view.keyboard.press("End")
    until(view, "document.querySelector('#strip .vw-tile:last-child[aria-selected=true]') !== null")
    until(view, LACKING, 3)
    assert f"/photos/{photo_in(view)}/thumb" in held[0].request.url and not rest
    held[0].continue_()
    until(view, "document.querySelectorAll('#strip img:not([src])').length === 0")


def test_a_jump_stops_what_is_loading_for_another_photo(view):
    view.wait_for_load_state("networkidle")
    view.route("**/preview*", lambda route: None)  # it never arrives
    with view.expect_request("**/preview*") as asked:
        view.keyboard.press("End")
    with view.expect_event("requestfailed", lambda request: request.url == asked.value.url):
        view.keyboard.press("Home")
    assert place(view) == 1
