"""Street-level photos: an area is drawn on the image; its photos are counted, added, and credited."""

import json

import pytest
from playwright.sync_api import expect

from tests.browser.edit_page import EditPage
from tests.street_server import Shot

pytestmark = pytest.mark.slow


def test_photos_of_an_area_are_counted_added_and_credited(page, api, sample_folder, tmp_path, streets):
    corners = tmp_path / "corners.json"
    edges = {"top_left": {"lat": 50.1, "lon": 14.4}, "bottom_right": {"lat": 50.0925, "lon": 14.41}}
    corners.write_text(json.dumps(edges))
    streets.shots = [Shot("a1", 50.09775, 14.403), Shot("b2", 50.09475, 14.407)]
    slug = api.make_map("Streets", satellite=sample_folder / "satellite.png", corners=corners)
    edit = EditPage(page, slug).open()
    page.locator("#add-menu summary").click()
    page.locator("#street-button").click()
    count, add = page.get_by_test_id("street-count"), page.get_by_test_id("street-add")
    count.click()
    expect(add).to_have_text("Add 2 photos")
    corner = page.get_by_role("button", name="Bottom right corner of the area").bounding_box()
    page.mouse.move(corner["x"] + corner["width"] / 2, corner["y"] + corner["height"] / 2)
    page.mouse.down()
    page.mouse.move(*edit.screen(*(side / 2 for side in edit.size)), steps=6)
    page.mouse.up()
    expect(add).to_be_disabled()
    count.click()
    expect(add).to_have_text("Add 1 photo")
    expect(page.get_by_test_id("street-outcome")).to_contain_text("CC-BY-SA-4.0: 1")
    assert not streets.photos_asked(), "so far they are only counted"
    add.click()
    expect(edit.placed).to_have_text("1")
    expect(page.get_by_test_id("photo-credit")).to_have_text("© Ana, Panoramax (CC-BY-SA-4.0)")
    expect(page.locator(".ed-credit")).to_contain_text("Photos: Panoramax (CC-BY-SA-4.0)")
