"""The edit page on a phone: touch, and a small screen."""

import math

import pytest
from playwright.sync_api import expect

from tests.browser.edit_page import EditPage

PHONE = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}


@pytest.fixture
def phone(open_context, owner, api, sample_folder, small_photos, request):
    """The edit page of a map with three photos in the tray, on a phone."""
    slug = api.make_map(
        request.node.name[:60], satellite=sample_folder / "satellite.png", photos=small_photos[:3]
    )
    page = open_context(storage_state=owner, **PHONE).new_page()
    return EditPage(page, slug).open()


def test_a_tap_places_and_the_next_comes(phone, api):
    names = phone.tray_names()
    expect(phone.current).to_contain_text(names[0])
    phone.page.touchscreen.tap(*phone.screen(300, 300))
    expect(phone.unplaced).to_have_text("2")
    expect(phone.current).to_contain_text(names[1])
    phone.saved()
    assert math.dist(api.positions(phone.slug)[names[0]], (300, 300)) < 4


def test_pages_fit_and_have_a_way_out(phone, api):
    phone.page.touchscreen.tap(*phone.screen(300, 300))
    phone.saved()
    api.ask("PUT", f"/maps/{phone.slug}/placements/rooms", data={"clusters_px": 20})
    width = "document.documentElement.scrollWidth"
    for tab in ("edit", "localize"):
        phone.page.goto(f"/maps/{phone.slug}/{tab}")
        expect(phone.page.locator(".tabs__tab").last).to_be_in_viewport(ratio=1)
        expect(phone.page.locator(".header")).to_be_visible()
        phone.page.set_viewport_size({"width": 390, "height": 640})
        expect(phone.page.locator(".tabs__home")).to_be_in_viewport(ratio=1)
        assert phone.page.evaluate(width) == 390
        phone.page.set_viewport_size(PHONE["viewport"])
    expect(phone.page.locator("label[for=shot-input]").first).to_be_visible()
    expect(phone.page.locator("#welcome")).not_to_contain_text("paste", use_inner_text=True)


def test_undo_and_export_are_in_reach(phone):
    phone.page.touchscreen.tap(*phone.screen(300, 300))
    expect(phone.undo).to_be_enabled()
    phone.undo.tap()
    expect(phone.unplaced).to_have_text("3")
    expect(phone.page.get_by_test_id("export-cfg")).to_be_in_viewport()
