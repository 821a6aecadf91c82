"""Floors of a map: added, switched, photos placed on them and moved; the switch on a shared answer."""

import re
from pathlib import Path

import pytest
from PIL import Image
from playwright.sync_api import expect

from tests.browser import axe
from tests.browser.polling import until

pytestmark = pytest.mark.slow


def test_a_floor_is_added_and_photos_are_placed_on_it_and_moved(make_page, page, api, tmp_path: Path):
    edit = make_page(2)
    plan = tmp_path / "plan.png"
    Image.new("RGB", (300, 300), "#f5e3df").save(plan)
    switch = page.get_by_test_id("floor-switch")
    expect(switch).to_be_hidden()
    page.locator("#map-menu > summary").click()
    page.get_by_test_id("floors-button").click()
    page.get_by_test_id("floor-name").fill("Gallery")
    page.get_by_test_id("floor-file").set_input_files(plan)
    page.get_by_test_id("floor-add").click()
    expect(page.locator(".floor-list .floor-row")).to_have_count(2)
    assert axe.findings(page) == []
    page.keyboard.press("Escape")
    shown = switch.get_by_role("button", pressed=True)
    expect(shown).to_have_accessible_name("1: Gallery")
    expect(page.locator(".leaflet-image-layer[src*='/floors/1/image']")).to_have_count(1)
    assert axe.findings(page) == []

    edit.click(300, 300)
    edit.saved()
    placed = [photo for photo in api.state(edit.slug)["photos"] if photo["x_px"] is not None]
    assert [photo["floor"] for photo in placed] == [1]
    switch.get_by_role("button", name="Ground floor").click()
    expect(page.locator(".leaflet-image-layer[src*='/floors/1/image']")).to_have_count(0)
    edit.click(500, 300)
    edit.saved()
    floors = [photo["floor"] for photo in api.state(edit.slug)["photos"]]
    assert sorted(floors) == [0, 1]

    page.goto(re.sub(r"/edit.*", f"/edit?photo={placed[0]['id']}", page.url))
    expect(shown).to_have_accessible_name("1: Gallery")
    page.get_by_test_id("undo").click()
    page.get_by_test_id("undo").click()
    page.get_by_test_id("undo").click()
    expect(switch).to_be_hidden()


def test_the_plan_of_a_floor_covers_a_new_image_of_the_map(make_page, page, api, tmp_path: Path):
    edit = make_page(1)
    plan, image = tmp_path / "plan.png", tmp_path / "wide.png"
    Image.new("RGB", (300, 300), "#f5e3df").save(plan)
    api.ask(
        "POST", f"/maps/{edit.slug}/floors", multipart={
            "name": "Gallery", "level": "1",
            "file": {"name": plan.name, "mimeType": "image/png", "buffer": plan.read_bytes()},
        },
    )  # fmt: skip
    page.get_by_test_id("floor-switch").get_by_role("button", name="Gallery").click()
    overlay = page.locator(".leaflet-image-layer[src*='/floors/1/image']")
    expect(overlay).to_have_count(1)
    Image.new("RGB", (900, 300), "#dfe8f5").save(image)
    page.evaluate("document.querySelector(\".leaflet-image-layer[src*='/floors/']\").dataset.before = 'yes'")
    upload = {"name": image.name, "mimeType": "image/png", "buffer": image.read_bytes()}
    api.ask("PUT", f"/maps/{edit.slug}/satellite", multipart={"file": upload, "tray": "1"})
    expect(page.locator("[data-before]")).to_have_count(0)
    expect(overlay).to_have_count(1)
    boxes = page.evaluate(  # in one call: the image may still be moving
        "[...document.querySelectorAll('.leaflet-image-layer')].map((image) => {"
        " const {x, y, width, height} = image.getBoundingClientRect(); return [x, y, width, height]; })"
    )
    assert len(boxes) == 2 and boxes[0] == pytest.approx(boxes[1], abs=0.5)


def test_a_note_is_shown_on_its_floor_alone_and_moved_to_another(make_page, page, api):
    edit = make_page(1)
    api.ask("POST", f"/maps/{edit.slug}/floors", multipart={"name": "Gallery", "level": "1"})
    switch, mark = page.get_by_test_id("floor-switch"), page.locator(".note-mark")
    switch.get_by_role("button", name="Gallery").click()
    page.locator("#map-menu > summary").click()
    page.locator("#note-button").click()
    page.get_by_test_id("note-title").fill("Lift")
    floor = page.get_by_role("dialog").get_by_label("Floor")
    assert floor.evaluate("select => select.selectedOptions[0].textContent") == "Gallery"
    assert axe.findings(page) == []
    page.get_by_test_id("note-save").click()
    expect(mark).to_have_count(1)
    switch.get_by_role("button", name="Ground floor").click()
    expect(mark).to_have_count(0)
    switch.get_by_role("button", name="Gallery").click()
    mark.click()
    floor.select_option("Ground floor")
    page.get_by_test_id("note-save").click()
    expect(mark).to_have_count(0)
    switch.get_by_role("button", name="Ground floor").click()
    expect(mark).to_have_count(1)
    page.get_by_test_id("undo").click()
    expect(mark).to_have_count(0)
    assert [note["floor"] for note in api.state(edit.slug)["notes"]] == [1]


def test_all_floors_are_printed_into_one_pdf(make_page, page, api):
    edit = make_page(1)
    api.ask("POST", f"/maps/{edit.slug}/floors", multipart={"name": "Gallery", "level": "1"})
    page.get_by_test_id("floor-switch").get_by_role("button", name="Gallery").wait_for()
    page.locator("summary[aria-label='More export formats']").click()
    page.get_by_test_id("print-map").click()
    page.get_by_role("dialog").get_by_label("Floor").select_option("All floors, a page each")
    expect(page.get_by_test_id("print-png")).to_be_hidden()
    sheet = page.get_by_test_id("print-preview")
    until(page, "image => image.naturalWidth > 0", sheet.element_handle())
    with page.expect_download() as download:
        page.get_by_test_id("print-pdf").click()
    assert download.value.path().read_bytes().count(b"/Type /Page\n") == 2
