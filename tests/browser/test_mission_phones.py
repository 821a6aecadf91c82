"""Phones in a mission: a link is made and opened on a phone, and the person appears, also after a cut."""

import pytest
from playwright.sync_api import expect

from tests.browser import axe
from tests.browser.polling import until

PHONE = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}
CUT = "net::ERR_INTERNET_DISCONNECTED"
HERE = {"latitude": 50.0772, "longitude": 14.4175, "accuracy": 8}


@pytest.fixture
def mission(api):
    return api.ask("POST", "/missions", data={"name": "Search by the river"})["id"]


@pytest.fixture
def link(page, mission):
    """The link of a new phone, made on the page of the mission."""
    page.goto(f"/missions/{mission}")
    page.get_by_label("More").click()
    page.get_by_role("button", name="People with phones").click()
    page.get_by_role("button", name="Add a phone").click()
    page.get_by_test_id("phone-name").fill("Anna")
    page.get_by_role("button", name="Create a link").click()
    expect(page.get_by_test_id("phone-qr")).to_be_visible()
    assert axe.findings(page) == []
    address = page.get_by_test_id("phone-url").input_value()
    page.get_by_role("button", name="Close").click()
    return address


def poses(api, mission):
    return sum(track["poses"] for track in api.ask("GET", f"/missions/{mission}")["tracks"])


def test_a_person_with_a_phone_appears_on_the_map(page, api, mission, link, open_context):
    phone = open_context(geolocation=HERE, permissions=["geolocation"], **PHONE)
    there = phone.new_page()
    there.goto(link)
    expect(there.get_by_role("heading", name="Search by the river")).to_be_visible()
    assert axe.findings(there) == []
    share = there.get_by_test_id("share-position")
    share.click()
    expect(share).to_have_text("Stop sharing")
    expect(there.get_by_test_id("position-accuracy")).to_have_text("8 m")
    expect(page.get_by_test_id("track")).to_contain_text("Anna")
    expect(page.get_by_test_id("live-state")).to_have_text("Live")
    expect(there.get_by_test_id("position-waiting")).to_have_text("0")
    before = poses(api, mission)

    phone.set_offline(True)
    for step in (1, 2):
        phone.set_geolocation(HERE | {"latitude": HERE["latitude"] + step * 0.001})
        expect(there.get_by_test_id("position-waiting")).to_have_text(str(step))
    phone.set_offline(False)
    expect(there.get_by_test_id("position-waiting")).to_have_text("0")
    assert poses(api, mission) == before + 2
    phone.watch.faults = [fault for fault in phone.watch.faults if CUT not in fault]

    there.reload()  # it was on, and goes on
    expect(share).to_have_text("Stop sharing")
    share.click()
    expect(share).to_have_text("Share my position")


def test_a_link_that_was_removed_says_so(page, api, mission, link, open_context):
    phone = open_context(geolocation=HERE, permissions=["geolocation"], **PHONE)
    phone.watch.expect(404)
    there = phone.new_page()
    there.goto(link)
    there.get_by_test_id("share-position").click()
    until(there, "() => document.getElementById('position-sent').textContent !== '–'")
    page.get_by_label("More").click()
    page.get_by_role("button", name="People with phones").click()
    expect(page.get_by_test_id("phone")).to_contain_text("1 position")
    page.get_by_role("button", name="Remove Anna").click()
    page.get_by_role("button", name="Remove", exact=True).click()
    phone.set_geolocation(HERE | {"latitude": 50.08})
    expect(there.get_by_test_id("position-problem")).to_contain_text("no longer valid")
    expect(there.get_by_test_id("share-position")).to_have_text("Share my position")
