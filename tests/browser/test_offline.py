"""On a phone in the field: photos taken offline are answered once each when the network is back."""

import pytest
from playwright.sync_api import Page, expect

from tests.browser import axe
from tests.browser.conftest import PATIENCE_MS, sign_in
from tests.browser.polling import until

PHONE = {
    "viewport": {"width": 390, "height": 844},
    "has_touch": True,
    "is_mobile": True,
    "device_scale_factor": 2,
}
ANSWERED_WITHIN_MS = 180_000
CUT = "net::ERR_INTERNET_DISCONNECTED"
KEPT = """
async slug => {
  if (!navigator.serviceWorker.controller) return false;
  const paths = [`/api/v1/maps/${slug}`, "/api/v1/maps", "/field"];
  return (await Promise.all(paths.map((path) => caches.match(path)))).every((found) => found);
}
"""
GONE = """
async () => (await caches.keys()).every((name) => name.startsWith("files-") || name === "who")
"""

LATE_LIST = """
const ask = window.fetch;
window.fetch = async (...asked) => {
  const answer = await ask(...asked);
  const { serviceWorker } = navigator;
  if (new URL(answer.url).pathname === "/api/v1/maps" && !serviceWorker.controller)
    await new Promise((done) => serviceWorker.addEventListener("controllerchange", done, { once: true }));
  return answer;
};
"""
"""Script: delay the response with the list of maps until after the service worker is active."""


@pytest.fixture
def phone(open_context, owner):
    """A phone with a service worker; errors due to the cut network are no faults."""
    context = open_context(storage_state=owner, service_workers="allow", **PHONE)
    yield context
    faults = context.watch.faults
    context.watch.faults = [fault for fault in faults if CUT not in fault and "ERR_FAILED" not in fault]


def open_field(context, slug) -> Page:
    """Open the page for the field, with its map."""
    page = context.new_page()
    page.goto(f"/field?map={slug}")
    ready(page, slug)
    return page


def ready(page: Page, slug) -> None:
    """Wait until the page shows the map."""
    expect(page.get_by_test_id("map-canvas")).to_have_attribute("data-ready", slug, timeout=PATIENCE_MS)


def kept(page: Page, slug) -> None:
    """Wait until the page and the map are cached on the device."""
    until(page, KEPT, slug)


def waiting(page: Page, count: int) -> None:
    expect(page.get_by_test_id("waiting")).to_have_attribute("data-count", str(count))


def photos(page: Page, state: str):
    return page.locator(f"[data-testid=field-photo][data-state={state}]")


def names(api, slug):
    """Return the names of the photos that the server has localized, the newest first."""
    return [query["name"] for query in api.ask("GET", f"/maps/{slug}/queries")["queries"]]


@pytest.fixture
def shots(sample_folder, api, sample_map):
    """Three photos of the sample that were not localized yet, once the map is ready to answer."""
    api.wait_for_jobs(sample_map)
    for query in api.ask("GET", f"/maps/{sample_map}/queries")["queries"]:
        api.ask("DELETE", f"/maps/{sample_map}/queries/{query['id']}")
    return sorted((sample_folder / "queries").glob("*.jpg"))[:3]


def test_three_photos_taken_without_a_network_are_answered_once(phone, api, shots, sample_map):
    page = open_field(phone, sample_map)
    kept(page, sample_map)
    phone.set_offline(True)
    page.reload()
    ready(page, sample_map)
    for count, shot in enumerate(shots, start=1):
        page.get_by_test_id("shot-input").set_input_files(shot)
        waiting(page, count)
    expect(page.get_by_test_id("waiting")).to_have_text("waiting: 3 photos")
    page.reload()
    waiting(page, 3)
    page.close()  # as a phone does when memory is short
    page = open_field(phone, sample_map)
    waiting(page, 3)
    assert names(api, sample_map) == []
    phone.set_offline(False)
    expect(photos(page, "answered")).to_have_count(3, timeout=ANSWERED_WITHIN_MS)
    waiting(page, 0)
    expected = [shot.name for shot in reversed(shots)]
    assert names(api, sample_map) == expected
    page.reload()
    expect(photos(page, "answered")).to_have_count(3)
    page.wait_for_timeout(500)
    assert names(api, sample_map) == expected
    photos(page, "answered").first.locator("button").first.click()
    expect(page.get_by_test_id("hypothesis").first).to_be_visible()
    assert axe.findings(page) == []
    assert page.evaluate("document.documentElement.scrollWidth - innerWidth") <= 0


def test_an_answer_that_got_lost_is_not_asked_for_twice(phone, api, shots, sample_map):
    page = open_field(phone, sample_map)
    lost = []

    def lose(route):
        if lost:
            return route.continue_()
        lost.append(route.fetch().json()["id"])  # the server has responded, but the response is lost
        return route.abort("connectionreset")

    page.route("**/localize", lose)
    phone.watch.faults.clear()
    page.get_by_test_id("query-input").set_input_files(shots[0])
    waiting(page, 1)
    expect(photos(page, "answered")).to_have_count(1, timeout=ANSWERED_WITHIN_MS)
    page.unroute_all()
    assert len(lost) == 1
    assert [query["id"] for query in api.ask("GET", f"/maps/{sample_map}/queries")["queries"]] == lost
    phone.watch.faults = [fault for fault in phone.watch.faults if "ERR_CONNECTION_RESET" not in fault]


def test_a_file_that_is_not_a_photo_is_reported_and_can_be_taken_away(phone, sample_map, tmp_path):
    phone.watch.expect(422)
    page = open_field(phone, sample_map)
    (tmp_path / "odd.jpg").write_bytes(b"no photo")
    page.get_by_test_id("query-input").set_input_files(tmp_path / "odd.jpg")
    expect(photos(page, "refused")).to_have_count(1)
    page.get_by_role("button", name="Remove odd.jpg").click()
    expect(photos(page, "refused")).to_have_count(0)


@pytest.fixture
def noted_map(api, sample_map):
    """The sample with a note about its first photo."""
    about = api.state(sample_map)["photos"][0]["id"]
    note = {"title": "Gate", "text": "Closed at night.", "x_px": 300, "y_px": 300, "photos": [about]}
    api.ask("POST", f"/maps/{sample_map}/notes", data=note)
    yield sample_map
    for one in api.ask("GET", f"/maps/{sample_map}/notes")["notes"]:
        api.ask("DELETE", f"/maps/{sample_map}/notes/{one['id']}")


def test_pages_that_were_seen_open_without_a_network(phone, noted_map):
    sample_map = noted_map
    page = open_field(phone, sample_map)
    kept(page, sample_map)
    page.goto(f"/maps/{sample_map}/edit")
    expect(page.locator("#map-canvas canvas")).to_be_visible()
    phone.set_offline(True)
    page.reload()
    expect(page.locator("#map-canvas canvas")).to_be_visible()
    expect(page.locator(".note-mark")).to_have_count(1)
    never_kept = phone.new_page()
    never_kept.goto("/people")
    expect(never_kept.locator("h1")).to_have_text("No connection")
    page.goto(f"/maps/{sample_map}/localize")
    page.wait_for_url(f"**/field?map={sample_map}")
    page.locator(".note-mark").click()
    expect(page.get_by_role("dialog")).to_contain_text("Closed at night.")


def test_a_map_is_walked_through_without_a_network(phone, sample_map):
    page = open_field(phone, sample_map)
    kept(page, sample_map)
    page.goto(f"/maps/{sample_map}/view")
    page.wait_for_load_state("networkidle")
    phone.set_offline(True)
    page.reload()
    page.get_by_role("button", name="Next photo").click()
    expect(page.get_by_test_id("place-in-order")).to_contain_text("2")
    until(page, "document.getElementById('photo-image').naturalWidth > 0")


def test_what_was_kept_is_gone_after_signing_out(open_context, link, sample_map):
    context = open_context(service_workers="allow", **PHONE)
    page = context.new_page()
    sign_in(page, link)
    page = open_field(context, sample_map)
    kept(page, sample_map)
    page.locator("header summary:not(#jobs-menu-button)").click()
    page.get_by_role("button", name="Sign out").click()
    page.wait_for_url("**/sign-in")
    until(page, GONE)


def test_what_is_asked_while_the_service_worker_starts_is_kept(phone, sample_map):
    page = phone.new_page()
    page.add_init_script(LATE_LIST)
    page.goto(f"/field?map={sample_map}")
    ready(page, sample_map)
    kept(page, sample_map)


def test_a_page_that_is_not_kept_says_so(phone, api, sample_map):
    page = phone.new_page()
    page.goto("/missions")
    until(page, "async () => Boolean((await caches.match('/offline')) && (await caches.match('/missions')))")
    phone.set_offline(True)
    page.goto("/missions")
    expect(page.locator("h1")).to_have_text("Missions")
    page.goto("/account")
    expect(page.locator("h1")).to_have_text("No connection")
    phone.set_offline(False)
    page.get_by_role("link", name="Try again").click()
    expect(page.locator("h1")).not_to_have_text("No connection")
