"""A shared mission as a visitor sees it: live, in a frame, until the link is revoked."""

import pytest
from playwright.sync_api import expect

from tests.browser import axe

BEGIN = 1_760_000_000
PHONE = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}


@pytest.fixture
def shared(api, small_photos):
    """A live mission with two photos: a function to send more, and its share."""
    id = api.ask("POST", "/missions", data={"name": "Round the yard"})["id"]
    result = {"next": 0}

    def send(*records):
        data = {"sender": "robot", "first": result["next"], "records": list(records)}
        result.update(api.ask("POST", f"/missions/{id}/batches", data=data))

    send(*(pose(n) for n in range(40)), seen("a1", "car"))
    for path in small_photos[:2]:
        photo = {"name": path.name, "mimeType": "image/jpeg", "buffer": path.read_bytes()}
        api.ask("POST", f"/missions/{id}/photos", multipart={"file": photo, "time": str(BEGIN)})
    share = api.ask("POST", f"/missions/{id}/shares", data={"photos": True})
    return send, share, lambda: api.ask("DELETE", f"/missions/{id}/shares/{share['id']}")


def pose(n):
    return {"type": "pose", "time": BEGIN + n, "lat": 50.0772 + n * 1e-6, "lon": 14.4175 + n * 1e-5}


def seen(id, kind):
    return {"type": "object", "id": id, "class": kind, "time": BEGIN + 5, "lat": 50.0773, "lon": 14.4176}


@pytest.fixture
def visitor(open_context):
    """A page of a visitor without an account."""
    return open_context().new_page()


def test_visitors_follow_a_mission_until_the_link_is_taken_back(visitor, shared):
    send, share, revoke = shared
    visitor.goto(share["url"])
    expect(visitor.locator("#map-canvas canvas")).to_be_visible()
    expect(visitor.get_by_test_id("track")).to_have_count(1)
    expect(visitor.get_by_test_id("track")).to_contain_text("40")
    live = visitor.get_by_test_id("live-state")
    expect(live).to_have_text("Recorded")  # the poses are of another year
    visitor.get_by_test_id("tab-objects").click()
    expect(visitor.get_by_test_id("object")).to_have_count(1)
    send(*(pose(n) for n in range(40, 55)), seen("b2", "person"))
    expect(visitor.get_by_test_id("object")).to_have_count(2)
    expect(live).to_have_text("Live")
    visitor.get_by_role("tab", name="Photos").click()
    photos = visitor.locator("#photos li")
    expect(photos).to_have_count(2)
    expect(photos.first).to_contain_text("Photo 1")
    photos.first.get_by_role("button").click()
    visitor.get_by_role("tab", name="Tracks").click()
    expect(visitor.get_by_test_id("track")).to_contain_text("55")
    assert axe.findings(visitor) == []
    send({"type": "end"})
    expect(visitor.get_by_test_id("live-state")).to_have_text("Ended")
    visitor.context.watch.expect(404)
    revoke()
    expect(visitor.locator("#failed")).to_contain_text("This link is no longer valid.")


@pytest.mark.parametrize(("width", "height"), [(390, 844), (683, 384)])
def test_visitors_with_small_windows_choose_the_notation_of_positions(visitor, shared, width, height):
    _, share, _ = shared
    visitor.set_viewport_size({"width": width, "height": height})
    visitor.goto(share["url"])
    place = visitor.get_by_test_id("track").locator("[data-position]")
    expect(place).not_to_contain_text("33U")
    visitor.get_by_label("Account and display").click()
    for name in ("Dark", "Deutsch"):
        button = visitor.get_by_role("button", name=name, exact=True)
        button.scroll_into_view_if_needed()
        expect(button).to_be_in_viewport()
    visitor.get_by_role("button", name="UTM", exact=True).click()
    expect(place).to_contain_text("33U")
    visitor.get_by_label("Account and display").click()
    visitor.get_by_label("Export").click()
    expect(visitor.get_by_role("link", name="GPX")).to_be_visible()
    assert visitor.evaluate("document.documentElement.scrollWidth - innerWidth") <= 0


def test_an_embedded_mission_opens_as_a_page(visitor, shared):
    _, share, _ = shared
    visitor.goto(share["url"] + "/embed")
    expect(visitor.locator("#map-canvas canvas")).to_be_visible()
    assert visitor.context.cookies() == []
    with visitor.expect_popup() as opened:
        visitor.get_by_role("link", name="Open as a page").click()
    expect(opened.value.get_by_test_id("track")).to_have_count(1)


def test_another_site_shows_a_mission_in_a_frame(visitor, shared, elsewhere):
    _, share, _ = shared
    site = elsewhere(share["embed"])
    visitor.context.watch.allow(site)
    visitor.goto(f"{site}/")
    frame = visitor.frame_locator("iframe")
    expect(frame.locator("#map-canvas canvas")).to_be_visible()
    expect(frame.get_by_test_id("track")).to_contain_text("40")
    tabs = frame.get_by_role("tablist").first
    assert tabs.evaluate("one => one.scrollWidth <= one.clientWidth")
    assert visitor.context.cookies() == []


def test_a_shared_mission_fits_a_phone(open_context, shared):
    _, share, _ = shared
    page = open_context(**PHONE).new_page()
    page.goto(share["url"])
    expect(page.locator("#map-canvas canvas")).to_be_visible()
    assert page.evaluate("document.documentElement.scrollWidth") <= 390
    assert axe.findings(page) == []


def test_the_export_menu_gives_files(visitor, shared):
    _, share, _ = shared
    visitor.goto(share["url"])
    visitor.get_by_text("Export", exact=True).click()
    with visitor.expect_download() as got:
        visitor.get_by_role("link", name="Live KML link").click()
    assert got.value.suggested_filename == "Round-the-yard-live.kml"
