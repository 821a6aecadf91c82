"""The whole workflow with photos on a phone: sign in, make a map, download the `.cfg`."""

import json
import math

from playwright.sync_api import expect

from tests.browser.api import Api
from tests.browser.app import expmap
from tests.browser.edit_page import EditPage
from webapp.files.maps.cfg import read_cfg


def new_map(page, name, satellite):
    """Make a map with an image on the pages, and return its edit page."""
    page.goto("/")
    page.get_by_test_id("new-map").click()
    page.get_by_test_id("map-name").fill(name)
    page.keyboard.press("Enter")
    page.wait_for_url("**/maps/*/edit")
    page.get_by_test_id("satellite-input").set_input_files(satellite)
    expect(page.locator("#no-satellite")).to_be_hidden()
    return EditPage(page, page.url.split("/")[-2])


def georeference(edit, corners):
    """Enter the corners of the image on its page."""
    page = edit.page
    page.goto(f"/maps/{edit.slug}/image")
    if page.locator("#where").get_attribute("open") is None:
        page.locator("#where > summary").click()
    page.get_by_test_id("known-corners").click()
    for label, key in (("Top left", "top_left"), ("Bottom right", "bottom_right")):
        group = page.get_by_role("group", name=label)
        group.get_by_label("Latitude").fill(str(corners[key]["lat"]))
        group.get_by_label("Longitude").fill(str(corners[key]["lon"]))
    with page.expect_event("load"):
        page.get_by_test_id("georeference-apply").click()


def take_away(edit, folder):
    """Download the `.cfg` by its button, and return the map in it."""
    with edit.page.expect_download() as waiting:
        edit.page.get_by_test_id("export-cfg").click()
    waiting.value.save_as(folder / "taken.cfg")
    return read_cfg(folder / "taken.cfg").map


def test_photos_with_gps_place_themselves(fresh_owner, sample_folder, app, tmp_path):
    edit = new_map(fresh_owner, "By the photos' GPS", sample_folder / "satellite.png")
    georeference(edit, json.loads((sample_folder / "corners.json").read_text("utf-8")))
    edit.open()
    edit.choose_photos(sorted((sample_folder / "photos").glob("*.jpg"))[:12])
    edit.uploaded()
    expect(edit.placed).to_have_text("12")
    expect(edit.unplaced).to_have_text("0")
    truth = {e.photo.split("/")[-1]: e.position for e in read_cfg(sample_folder / "map.cfg").map.experiences}
    for name, (x, y) in Api(edit.page.context).positions(edit.slug).items():
        assert math.hypot(truth[name].x - x, truth[name].y - y) < 2, name
    assert len(take_away(edit, tmp_path).experiences) == 12
    expmap("map", "check", app.library / edit.slug / "map.cfg", library=app.library)


def test_photos_without_gps_wait_and_say_why_and_a_list_places_them(
    page, small_photos, sample_folder, tmp_path
):
    edit = new_map(page, "By a list", sample_folder / "satellite.png").open()
    edit.choose_photos(small_photos[:3])
    edit.uploaded()
    expect(edit.unplaced).to_have_text("3")
    expect(page.locator("#tray-gps-count")).to_have_text("3 photos have no GPS position")
    page.locator("#tray-gps-count").click()
    expect(page.locator("#tray-gps-why li")).to_contain_text(["3 photos: it has no GPS position"])
    page.locator("#place-menu summary").click()
    page.locator("#place-by-file").click()
    page.get_by_test_id("list-file").set_input_files(sample_folder / "map.cfg")
    page.get_by_test_id("list-place").click()
    expect(edit.placed).to_have_text("3")
    result = page.locator("dialog[open]")  # it may appear after the photos are shown as placed
    expect(result).to_be_visible()
    page.keyboard.press("Escape")
    expect(result).to_have_count(0)
    taken = {e.photo.split("/")[-1][:8]: e.position for e in take_away(edit, tmp_path).experiences}
    truth = {
        e.photo.split("/")[-1][:8]: e.position for e in read_cfg(sample_folder / "map.cfg").map.experiences
    }
    assert taken == {name: truth[name] for name in taken} and len(taken) == 3
