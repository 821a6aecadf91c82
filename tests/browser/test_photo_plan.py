"""The next photos: planned in the editor, and taken by a phone that is guided to the spots offline."""

import re

import pytest
from playwright.sync_api import expect

from tests.browser import axe
from tests.browser.conftest import PATIENCE_MS
from tests.browser.edit_page import EditPage
from tests.browser.test_offline import CUT, PHONE, open_field, photos, ready, until, waiting

pytestmark = pytest.mark.slow

KEPT = """
async slug => {
  if (!navigator.serviceWorker.controller) return false;
  const paths = [`/api/v1/maps/${slug}/photo-plan`, `/api/v1/maps/${slug}`, "/api/v1/maps", "/field"];
  return (await Promise.all(paths.map((path) => caches.match(path)))).every((found) => found);
}
"""

DENIED = """
() => {
  let asked = 0;
  navigator.geolocation.clearWatch = () => {};
  navigator.geolocation.watchPosition = (found, failed) => {
    asked += 1;
    if (asked > 1) setTimeout(() => found({ coords: { latitude: 0, longitude: 0, accuracy: 5 } }));
    else setTimeout(() => failed({ code: 1, PERMISSION_DENIED: 1, message: "denied" }));
    return asked;
  };
}
"""


@pytest.fixture
def planned(api, sample_folder, small_photos):
    """The slug of a georeferenced map, and its plan of three spots."""
    corners = sample_folder / "corners.json"
    slug = api.make_map(
        "Planned", satellite=sample_folder / "satellite.png", photos=small_photos[:6], corners=corners
    )
    ids = [photo["id"] for photo in api.state(slug)["photos"]]
    changes = [{"id": id, "x_px": 300 + 60 * n, "y_px": 300, "heading_deg": 90} for n, id in enumerate(ids)]
    api.ask("PATCH", f"/maps/{slug}/experiences", data={"kind": "place", "changes": changes})
    api.cancel_jobs(slug)  # the index of this map is not needed
    return slug


def test_spots_are_planned_on_the_image(page, planned):
    EditPage(page, planned).open()
    page.locator("#add-menu summary").click()
    page.locator("#plan-button").click()
    page.get_by_test_id("plan-count").fill("4")
    page.get_by_test_id("plan-make").click()
    spots = page.get_by_test_id("plan-spot")
    expect(spots).to_have_count(4)
    expect(spots.first).to_contain_text("seen in one direction only")
    expect(page.get_by_test_id("plan-outcome")).to_contain_text("From photo positions only.")
    assert axe.findings(page) == []
    legend = page.get_by_test_id("plan-legend")
    page.get_by_label("Show how well each part is recognised").uncheck()
    expect(legend).to_be_hidden()
    with page.expect_download() as download:
        page.get_by_test_id("plan-gpx").click()
    assert download.value.path().read_text("utf-8").count("<wpt ") == 4
    page.get_by_label("In an area that I draw on the image").check()
    expect(page.get_by_role("button", name="Top left corner of the area")).to_be_visible()
    page.get_by_role("dialog").get_by_role("button", name="Cancel").click()
    expect(page.get_by_role("button", name="Top left corner of the area")).to_have_count(0)


def test_the_dialog_says_which_photos_join_and_between_which_some_are_missing(page, planned):
    EditPage(page, planned).open()
    page.locator("#add-menu summary").click()
    page.locator("#plan-button").click()
    page.get_by_test_id("pieces-check").click()
    outcome = page.get_by_test_id("pieces-outcome")
    expect(outcome).to_contain_text(re.compile(r"pieces?, of|No photos join"), timeout=PATIENCE_MS)
    gap = page.get_by_test_id("pieces-gap").first
    expect(gap).to_contain_text(re.compile("in common"))
    expect(gap.get_by_role("button")).to_have_count(2)
    expect(page.get_by_test_id("pieces-check")).to_be_enabled()
    assert axe.findings(page) == []


def test_a_phone_is_led_to_the_spots_and_ticks_them_off_without_a_network(
    open_context, owner, api, planned, small_photos
):
    plan = api.ask("POST", f"/maps/{planned}/photo-plan", data={"spots": 3})["plan"]
    first, second = plan["spots"][:2]
    south = {"latitude": first["lat"] - 0.0003, "longitude": first["lon"]}
    phone = open_context(
        storage_state=owner, service_workers="allow", geolocation=south, permissions=["geolocation"], **PHONE
    )
    page = open_field(phone, planned)
    until(page, KEPT, planned)
    phone.set_offline(True)
    page.reload()
    ready(page, planned)
    expect(page.get_by_test_id("plan-title")).to_have_text("Spot 1 of 3")
    assert axe.findings(page) == []
    page.get_by_test_id("plan-lead").click()
    expect(page.get_by_test_id("plan-distance")).to_have_text(re.compile(r"^3[34] m to the north$"))
    phone.set_geolocation({"latitude": first["lat"], "longitude": first["lon"], "accuracy": 8})
    expect(page.get_by_test_id("plan-distance")).to_have_text("You are there.")
    page.get_by_test_id("locate").click()
    expect(page.get_by_test_id("here")).to_have_text("You are here, within 8 m")
    assert axe.findings(page) == []
    for count, shot in enumerate(small_photos[10 : 10 + len(first["headings_deg"])], start=1):
        page.get_by_test_id("spot-input").set_input_files(shot)
        waiting(page, count)
    expect(page.get_by_test_id("plan-title")).to_have_text("Spot 2 of 3")
    page.get_by_test_id("plan-done").click()
    expect(page.get_by_test_id("plan-count")).to_have_attribute("data-done", "2")
    page.reload()
    ready(page, planned)
    expect(page.get_by_test_id("plan-title")).to_have_text("Spot 3 of 3")
    expect(page.get_by_test_id("plan-count")).to_have_text("2 of 3 done")
    assert page.evaluate("document.documentElement.scrollWidth - innerWidth") <= 0
    phone.set_offline(False)
    expect(photos(page, "added")).to_have_count(len(first["headings_deg"]), timeout=PATIENCE_MS)
    suggested = api.ask("GET", f"/maps/{planned}/place-rest")["suggested"]
    assert {(one["x_px"], one["y_px"]) for one in suggested} == {(first["x_px"], first["y_px"])}
    assert {one["heading_deg"] for one in suggested} == set(first["headings_deg"])
    assert (second["x_px"], second["y_px"]) not in {(one["x_px"], one["y_px"]) for one in suggested}
    faults = phone.watch.faults
    phone.watch.faults = [fault for fault in faults if CUT not in fault and "ERR_FAILED" not in fault]


def test_who_denied_the_position_can_ask_again(open_context, owner, api, planned):
    api.ask("POST", f"/maps/{planned}/photo-plan", data={"spots": 1})
    phone = open_context(storage_state=owner, service_workers="allow", permissions=[], **PHONE)
    page = open_field(phone, planned)
    ready(page, planned)
    page.evaluate(DENIED)
    lead = page.get_by_test_id("plan-lead")
    lead.click()
    expect(page.get_by_test_id("plan-distance")).to_contain_text("The position of this device is not known")
    expect(lead).to_be_visible()
    lead.click()
    expect(page.get_by_test_id("plan-distance")).to_contain_text("to the")
    expect(lead).to_be_hidden()
