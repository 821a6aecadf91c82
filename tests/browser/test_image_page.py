"""The image of a map and its georeference, entered on the page."""

import io

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import expect

from tests.browser import axe
from tests.browser.conftest import WORK_MS

LANDMARKS = [(50.0765, 14.4164), (50.0771, 14.4187), (50.0779, 14.4172)]


def picture(width=600, height=400):
    y, x = np.mgrid[0:height, 0:width]
    pixels = np.stack([x % 256, y % 256, (x + y) % 256], axis=2).astype(np.uint8)
    buffer = io.BytesIO()
    Image.fromarray(pixels).save(buffer, format="PNG")
    return {"name": "plan.png", "mimeType": "image/png", "buffer": buffer.getvalue()}


@pytest.fixture
def image_page(page, api, context, tiles, request):
    """The image page of a new map, and the map's state."""
    context.watch.allow(f"http://127.0.0.1:{tiles.port}")
    tiles.landmarks = LANDMARKS
    slug = api.make_map(request.node.name[:60], satellite=None)
    page.goto(f"/maps/{slug}/image")
    return page, lambda: api.state(slug)


def by_id(page, id):
    return page.get_by_test_id(id)


def choose_area(page):
    by_id(page, "way-tiles").click()
    page.get_by_label("Go to").first.fill("50.0772, 14.4175")
    page.keyboard.press("Enter")
    by_id(page, "tile-view").click()
    expect(by_id(page, "tile-estimate")).to_contain_text("pieces to download")


def click_at(page, id, *, across, down):
    box = by_id(page, id).bounding_box()
    page.mouse.click(box["x"] + across * box["width"], box["y"] + down * box["height"])


def reloads(page, press, *, timeout=60_000):
    """Do something that reloads the page, and wait for the message."""
    with page.expect_event("load", timeout=timeout):
        press()
    expect(page.locator(".note--success")).to_be_visible()


def upload(page, file):
    by_id(page, "image-file").set_input_files(file)
    reloads(page, by_id(page, "image-upload").click)


def test_an_area_of_a_tile_service(image_page):
    page, state = image_page
    choose_area(page)
    estimate = by_id(page, "tile-estimate").inner_text()
    assert axe.findings(page) == []
    # the worker may be busy with the sample's index
    by_id(page, "tile-fetch").click()
    page.wait_for_url("**/edit", timeout=WORK_MS)
    expect(page.locator(".toast")).to_contain_text("pixels")
    satellite = state()["satellite"]
    assert estimate.startswith(f"{satellite['width']:,} × {satellite['height']:,} pixels")
    assert satellite["attribution"] == "© these tests"
    assert state()["georeference"]["plane"] == "EPSG:3857"
    expect(page.get_by_text("© these tests")).to_be_visible()


def test_a_place_is_found_by_its_name_when_asked(image_page, geocoder):
    page, _ = image_page
    by_id(page, "way-tiles").click()
    field = page.get_by_label("Go to").first
    geocoder.asked.clear()
    field.press_sequentially("Lund")
    field.blur()
    assert not geocoder.asked, "nothing is searched while somebody types"
    page.get_by_role("button", name="Search for the place").click()
    places = by_id(page, "tile-places")
    expect(places).to_contain_text("© OpenStreetMap contributors")
    assert axe.findings(page) == []
    places.get_by_role("button", name="Lund, Lunds kommun").click()
    expect(places).to_be_hidden()
    by_id(page, "tile-view").click()
    north, south = (float(page.locator(f"#tile-{side}").input_value()) for side in ("north", "south"))
    assert south < 55.7029 < north
    field.fill("Atlantis")
    field.press("Enter")
    expect(places).to_contain_text("No place called Atlantis was found.")
    field.fill("50.0772, 14.4175")
    field.press("Enter")
    assert [query["q"] for query in geocoder.asked] == [["Lund"], ["Atlantis"]]


def test_the_area_is_chosen_by_the_keyboard(image_page):
    page, _ = image_page
    choose_area(page)
    south = page.get_by_label("South", exact=True)
    before = float(south.input_value())
    page.get_by_role("button", name="Corner in the south-east").focus()
    page.keyboard.press("ArrowUp")
    assert float(south.input_value()) > before
    page.get_by_text("Edges of the area, degrees").first.click()
    page.get_by_label("North", exact=True).fill("50.9")
    page.keyboard.press("Tab")
    expect(by_id(page, "tile-estimate")).to_contain_text("allowed")
    expect(by_id(page, "tile-fetch")).to_be_disabled()


def test_an_uploaded_file_and_points_on_it(image_page, tiles):
    page, state = image_page
    upload(page, picture())
    assert state()["satellite"]["width"] == 600
    assert state()["georeference"] is None

    by_id(page, "point-load").click()
    page.locator("#point-goto").fill("50.0772, 14.4175")
    page.keyboard.press("Enter")
    for across, down in ((0.2, 0.35), (0.8, 0.35), (0.8, 0.65), (0.2, 0.65)):
        click_at(page, "point-image", across=across, down=down)
        click_at(page, "point-earth", across=across, down=down)
    expect(by_id(page, "verdict")).to_contain_text("projective")
    page.locator("#point-model").select_option("affine")
    expect(by_id(page, "verdict")).to_contain_text("affine")
    latitude = page.get_by_label("Point 4: latitude")
    latitude.fill(str(float(latitude.input_value()) + 0.0004))
    expect(page.locator(".sat-arrow").first).to_be_visible()
    assert page.locator(".sat-arrow").count() == 8
    assert page.locator(".leaflet-arrows-pane svg").first.bounding_box()["width"] > 100, "they can be seen"
    assert state()["georeference"] is None, "nothing is applied before it is asked for"
    assert axe.findings(page) == []

    page.get_by_role("button", name="Remove point 4").click()
    expect(by_id(page, "verdict")).to_contain_text("the fit cannot be checked")
    reloads(page, by_id(page, "georeference-apply").click)
    assert state()["georeference"]["method"] == "affine"


def test_corners_and_taking_them_away(image_page, context):
    page, state = image_page
    upload(page, picture())
    by_id(page, "known-corners").click()
    for label, lat, lon in (("Top left", 50.001, 14.0), ("Bottom right", 50.0, 14.002)):
        group = page.get_by_role("group", name=label)
        group.get_by_label("Latitude").fill(str(lat))
        group.get_by_label("Longitude").fill(str(lon))
    expect(by_id(page, "verdict")).to_contain_text("m per pixel")
    reloads(page, by_id(page, "georeference-apply").click)
    assert state()["georeference"]["method"] == "corners"
    page.locator("#where > summary").click()
    page.get_by_role("button", name="Remove the georeference").click()
    page.get_by_role("button", name="Remove it").click()
    expect(page.get_by_text("The georeference was removed.")).to_be_visible()
    assert state()["georeference"] is None


def test_a_wrong_world_file_is_reported_and_a_file_that_is_no_image(image_page, context):
    page, state = image_page
    context.watch.expect(422)
    by_id(page, "image-file").set_input_files(
        {"name": "sat.png", "mimeType": "image/png", "buffer": b"no image"}
    )
    by_id(page, "image-upload").click()
    expect(by_id(page, "error-message")).to_contain_text("not a PNG, JPEG or TIFF")
    assert state()["satellite"] is None
    upload(page, picture())
    by_id(page, "known-worldfile").click()
    page.get_by_label("Its six lines").fill("1\n2\n3")
    expect(by_id(page, "verdict")).to_contain_text("3 numbers, not 6")
    expect(by_id(page, "georeference-apply")).to_be_disabled()


def test_a_blank_plan(image_page):
    page, state = image_page
    by_id(page, "way-blank").click()
    page.get_by_label("Width, pixels").fill("800")
    reloads(page, by_id(page, "blank-use").click)
    assert (state()["satellite"]["width"], state()["satellite"]["height"]) == (800, 900)


def test_photos_outside_need_a_decision(image_page, api, context, small_photos):
    page, state = image_page
    slug = page.url.split("/")[-2]
    part = {"name": "a.jpg", "mimeType": "image/jpeg", "buffer": small_photos[0].read_bytes()}
    api.ask("POST", f"/maps/{slug}/photos", multipart={"file": part})
    upload(page, picture())
    (photo,) = state()["photos"]
    change = {"id": photo["id"], "x_px": 590, "y_px": 390}
    api.ask("PATCH", f"/maps/{slug}/experiences", data={"kind": "place", "changes": [change]})
    context.watch.expect(400)
    by_id(page, "image-file").set_input_files(picture(300, 200))
    by_id(page, "image-upload").click()
    reloads(page, page.get_by_role("button", name="Scale all positions with the image").click)
    (photo,) = state()["photos"]
    assert (photo["x_px"], photo["y_px"]) == (295, 195)
