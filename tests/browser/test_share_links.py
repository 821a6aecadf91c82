"""A secret link: created by the owner, opened by a visitor, and revoked."""

import re

import pytest
from playwright.sync_api import expect

from tests.browser import axe

PHONE = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}


@pytest.fixture
def visitor(open_context):
    """A page of a visitor without an account."""
    return open_context().new_page()


@pytest.fixture
def make_link(page, sample_map):
    """Share the sample map by the dialog of any of its pages and return the address."""

    def make(*wishes):
        page.goto(f"/maps/{sample_map}/quality")
        page.get_by_test_id("share-map").click()
        for wish in wishes:
            page.get_by_label(wish).check()
        page.get_by_role("button", name="Create the link").click()
        address = page.get_by_test_id("share-url").input_value()
        assert "/embed/" in page.get_by_test_id("share-embed").input_value()
        page.keyboard.press("Escape")
        expect(page.get_by_test_id("share")).not_to_have_count(0)
        return address

    return make


@pytest.mark.parametrize("view", [{"width": 1366, "height": 768}, {"width": 390, "height": 844}])
def test_people_get_and_lose_access_in_the_same_dialog(page, api, sample_map, view):
    name = f"guest {view['width']}"
    api.ask("POST", "/accounts", data={"name": name})
    page.set_viewport_size(view)
    page.goto(f"/maps/{sample_map}/edit")
    page.get_by_test_id("share-map").click()
    dialog = page.get_by_role("dialog", name="Share this map")
    for button in ("Create the link", "Close"):
        expect(dialog.get_by_role("button", name=button)).to_be_in_viewport(ratio=1)
    dialog.get_by_label("Name of an account").fill("nobody of this name")
    page.context.watch.expect(404)
    dialog.get_by_role("button", name="Add").click()
    expect(dialog.get_by_test_id("error-message").first).to_contain_text(
        "The owner of the library creates accounts"
    )
    dialog.get_by_label("Name of an account").fill(name)
    dialog.get_by_role("button", name="Add").click()
    guest = dialog.get_by_test_id("member").filter(has_text=name)
    expect(guest).to_be_visible()
    with page.expect_response(lambda response: response.request.method == "POST"):
        guest.get_by_role("combobox").select_option("editor")
    members = api.ask("GET", f"/maps/{sample_map}/members")["members"]
    assert (name, "editor") in [(member["name"], member["role"]) for member in members]
    assert axe.findings(page) == []
    guest.get_by_role("button", name="Stop sharing").click()
    expect(guest).to_have_count(0)
    assert page.evaluate("document.documentElement.scrollWidth - innerWidth") <= 0


def test_a_secret_link_works_and_stops_working(page, visitor, make_link, sample_folder, api, sample_map):
    api.wait_for_jobs(sample_map)
    address = make_link("Visitors can localize")
    visitor.goto(address)
    expect(visitor.locator("#map-canvas canvas")).to_be_visible()
    visitor.get_by_test_id("find-mine").click()
    visitor.wait_for_url("**/map")
    expect(visitor.locator("#map-canvas canvas")).to_be_visible()
    photo = sample_folder / "queries" / "query_02.jpg"
    visitor.get_by_test_id("query-input").set_input_files(photo)
    expect(visitor.get_by_test_id("hypothesis").first).to_be_visible()
    expect(visitor.get_by_test_id("off-map")).to_be_visible()
    expect(visitor.locator("#answer-facts")).to_contain_text(re.compile(r"Place 1\s*[\d.]+° N"))
    assert axe.findings(visitor) == []
    page.get_by_role("button", name="Revoke the link").first.click()
    page.get_by_role("button", name="Revoke it").click()
    expect(page.get_by_test_id("share")).to_have_count(0)
    visitor.context.watch.expect(404)
    visitor.goto(address)
    expect(visitor.get_by_test_id("error-message")).to_be_visible()


def test_a_second_link_has_a_heading_of_its_own(page, make_link):
    make_link()
    expect(page.get_by_role("heading", name="New link")).to_be_visible()
    while page.get_by_test_id("share").count():
        before = page.get_by_test_id("share").count()
        page.get_by_role("button", name="Revoke the link").first.click()
        page.get_by_role("button", name="Revoke it").click()
        expect(page.get_by_test_id("share")).to_have_count(before - 1)
    expect(page.get_by_role("heading", name="New link")).to_be_hidden()
    expect(page.get_by_test_id("share-new")).to_be_in_viewport(ratio=1)


def test_another_site_shows_it_in_a_frame(visitor, make_link, elsewhere):
    framed = make_link().replace("/s/", "/embed/")
    site = elsewhere(f'<iframe src="{framed}" title="map" width="800" height="600"></iframe>')
    visitor.context.watch.allow(site)
    visitor.goto(f"{site}/")
    frame = visitor.frame_locator("iframe")
    expect(frame.locator("#map-canvas canvas")).to_be_visible()
    expect(frame.locator("header")).to_have_count(0)
    assert visitor.context.cookies() == []


def test_a_public_map_is_found_without_an_account(make_link, open_context, page, sample_map):
    make_link("Also list it under public maps")
    phone = open_context(**PHONE).new_page()
    phone.goto("/sign-in")
    phone.get_by_role("link", name="Public maps").click()
    phone.get_by_role("link", name="Sample").click()
    expect(phone.locator("#map-canvas canvas")).to_be_visible()
    assert phone.evaluate("document.documentElement.scrollWidth - innerWidth") <= 0
    assert axe.findings(phone) == []


@pytest.fixture
def asks(visitor, make_link, sample_folder, api, sample_map):
    """Open the map of a link that takes photos; the function asks about one by its number."""
    api.wait_for_jobs(sample_map)
    visitor.goto(f"{make_link('Visitors can localize')}/map")
    expect(visitor.locator("#map-canvas canvas").first).to_be_visible()

    def ask(number):
        visitor.get_by_test_id("query-input").set_input_files(
            sample_folder / "queries" / f"query_{number:02}.jpg"
        )

    return ask


HELD = "**/shared/*/localize"


def test_a_new_photo_cancels_the_one_before(visitor, asks):
    held = []
    visitor.route(HELD, lambda route: held.append(route), times=1)
    asks(2)
    expect(visitor.locator("#busy-words")).to_be_in_viewport()
    with visitor.expect_event("requestfailed"):
        asks(1)
    expect(visitor.get_by_test_id("hypothesis").first).to_be_visible()
    answer = visitor.locator("#answer").inner_text()
    held[0].abort()
    expect(visitor.locator("#query-name")).to_have_text("query_01.jpg")
    expect(visitor.locator("#busy-words")).to_be_hidden()
    assert visitor.locator("#answer").inner_text() == answer
    expect(visitor.get_by_test_id("error-message")).to_have_count(0)


def test_a_photo_waits_until_the_map_is_ready(visitor, asks):
    not_yet = {"code": "not_ready", "message": "photos cannot be localized on this map yet"}
    visitor.context.watch.expect(409)
    visitor.route(HELD, lambda route: route.fulfill(status=409, json={"error": not_yet}), times=1)
    visitor.clock.install()
    asks(1)
    expect(visitor.locator("#notes")).to_contain_text("localized as soon as the map is ready")
    expect(visitor.get_by_test_id("hypothesis")).to_have_count(0)
    visitor.clock.fast_forward(16_000)
    expect(visitor.get_by_test_id("hypothesis").first).to_be_visible()
    expect(visitor.locator("#notes")).to_be_empty()


def test_no_answer_stays_with_the_next_photo(visitor, asks, tmp_path):
    asks(1)
    expect(visitor.get_by_test_id("current-photo")).to_be_visible()
    visitor.locator("#side").evaluate("panel => panel.scrollTop = 1e6")
    held = []
    visitor.route(HELD, lambda route: held.append(route), times=1)
    asks(2)
    expect(visitor.locator("#busy-words")).to_be_in_viewport()
    expect(visitor.locator("#answer")).to_be_hidden()
    expect(visitor.get_by_test_id("current-photo")).to_be_hidden()
    held[0].abort()
    error = visitor.get_by_test_id("error-message")
    expect(error).to_contain_text("query_02.jpg")
    visitor.context.watch.faults.clear()  # the browser names the request that was cut off
    broken = tmp_path / "broken.jpg"
    broken.write_text("no photo", encoding="utf-8")
    visitor.context.watch.expect(400, 415, 422)
    visitor.get_by_test_id("query-input").set_input_files(broken)
    expect(error).to_contain_text("broken.jpg")
    expect(error).to_have_count(1)
    expect(visitor.get_by_text("This browser cannot show the photo")).to_be_visible()
    expect(visitor.locator("#answer")).to_be_hidden()
    assert axe.findings(visitor) == []
    asks(1)
    expect(visitor.get_by_test_id("hypothesis").first).to_be_visible()
    expect(error).to_have_count(0)


@pytest.mark.parametrize(("width", "height"), [(683, 384), (667, 375), (1000, 400)])
def test_a_low_window_scrolls_to_the_panel(visitor, asks, width, height):
    visitor.set_viewport_size({"width": width, "height": height})
    choose = visitor.locator("label[for=query-input]")
    choose.scroll_into_view_if_needed()
    expect(choose).to_be_in_viewport(ratio=1)
    assert visitor.locator("#side").bounding_box()["height"] > 120
    asks(1)
    expect(visitor.get_by_test_id("hypothesis").first).to_be_in_viewport()
    assert visitor.evaluate("document.documentElement.scrollWidth - innerWidth") <= 0
