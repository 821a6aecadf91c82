"""A visitor gives a photo; the owner finds it with a place, accepts it with one click, and undoes that."""

import re

import pytest
from playwright.sync_api import expect

from tests.browser import axe
from tests.browser.conftest import WORK_MS

VIEWS = {"wide": {"width": 1366, "height": 768}, "phone": {"width": 390, "height": 844}}


@pytest.fixture
def share(api, sample_map):
    """A link to the sample with which visitors can give photos; the photos are removed afterwards."""
    api.wait_for_jobs(sample_map)
    known = {photo["id"] for photo in api.state(sample_map)["photos"]}
    made = api.ask("POST", f"/maps/{sample_map}/shares", data={"contribute": True})
    yield made
    api.ask("DELETE", f"/maps/{sample_map}/shares/{made['id']}")
    for photo in api.state(sample_map)["photos"]:
        if photo["id"] not in known:
            api.ask("DELETE", f"/maps/{sample_map}/experiences/{photo['id']}")
    api.cancel_jobs(sample_map)


def fits(page):
    return page.evaluate("document.documentElement.scrollWidth - innerWidth") <= 0


@pytest.mark.parametrize("view", VIEWS)
def test_a_photo_is_given_accepted_and_taken_back(
    page, open_context, api, sample_map, sample_folder, share, view
):
    visitor = open_context(viewport=VIEWS[view], has_touch=view == "phone").new_page()
    visitor.goto(f"{share['url']}/map")
    give = visitor.get_by_test_id("give")
    expect(visitor.get_by_test_id("give-input")).to_be_disabled()
    visitor.get_by_test_id("give-consent").check()
    photo = sample_folder / "queries" / ("query_02.jpg" if view == "wide" else "query_05.jpg")
    visitor.get_by_test_id("give-input").set_input_files(photo)
    expect(give).to_contain_text("Its place on the map was found.", timeout=WORK_MS)
    assert axe.findings(visitor) == [] and fits(visitor)
    visitor.get_by_test_id("give-input").set_input_files(photo)
    visitor.context.watch.expect(409)
    expect(give).to_contain_text("sent before")

    page.set_viewport_size(VIEWS[view])
    page.goto(f"/maps/{sample_map}/edit")
    page.get_by_test_id("share-map").click()
    page.get_by_role("link", name="Photos from visitors").click()
    page.wait_for_url("**/contributions")
    card = page.get_by_test_id("contribution")
    expect(card).to_have_count(1)
    expect(card).to_contain_text(photo.name)
    expect(card).to_contain_text(re.compile(r"found, with .*\d+\s%"))
    expect(card.locator(".co-dot")).to_be_visible()
    expect(card.get_by_test_id("accept")).to_be_enabled()
    expect(page.get_by_text("Look for faces and number plates yourself")).to_be_visible()
    expect(page.locator("#waiting")).to_have_text("1 photo waits.")
    assert axe.findings(page) == [] and fits(page)
    id = int(card.get_attribute("data-id"))

    def place():
        return next(one["x_px"] for one in api.state(sample_map)["photos"] if one["id"] == id)

    assert place() is None
    card.get_by_test_id("accept").click()
    expect(page.locator("#waiting")).to_have_text("No photos wait.")
    assert place() is not None
    page.get_by_role("button", name="Undo").click()
    expect(card).to_have_count(1)
    assert place() is None
    card.get_by_test_id("refuse").click()
    expect(card).to_have_count(0)
    page.get_by_role("button", name="Undo").click()
    expect(card).to_have_count(1)
