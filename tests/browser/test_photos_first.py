"""A new map starts with its photos: their GPS proposes the area, and they are placed on the image."""

import io
import re
from pathlib import Path

import piexif
import pytest
from PIL import Image
from playwright.sync_api import expect

from tests.browser import axe
from tests.browser.conftest import WORK_MS
from tests.browser.edit_page import EditPage

LUND = (55.7055, 13.1930)
COUNT_CLICKS = """
addEventListener("click", (event) => {
  if (event.isTrusted) sessionStorage.setItem("clicks", Number(sessionStorage.getItem("clicks")) + 1);
}, true);
"""
PASTE = """
async (element) => {
  const canvas = Object.assign(document.createElement("canvas"), { width: 40, height: 30 });
  const blob = await new Promise((resolve) => canvas.toBlob(resolve, "image/png"));
  const data = new DataTransfer();
  data.items.add(new File([blob], "image.png", { type: "image/png" }));
  const how = { clipboardData: data, bubbles: true, cancelable: true };
  element.dispatchEvent(new ClipboardEvent("paste", how));
}
"""


def gps(lat, lon):
    """Return the EXIF GPS of a position north of the equator and east of Greenwich."""

    def sexagesimal(value):
        minutes = value % 1 * 60
        return ((int(value), 1), (int(minutes), 1), (round(minutes % 1 * 60 * 10_000), 10_000))

    names = piexif.GPSIFD
    return {
        names.GPSLatitudeRef: b"N",
        names.GPSLatitude: sexagesimal(lat),
        names.GPSLongitudeRef: b"E",
        names.GPSLongitude: sexagesimal(lon),
    }


@pytest.fixture(scope="module")
def photos(tmp_path_factory) -> list[Path]:
    """Thirty small photos: 28 along a street, one far away, one without a position."""
    folder = tmp_path_factory.mktemp("street")
    positions = [(LUND[0] + 2e-5 * (n % 3), LUND[1] + 8e-5 * n) for n in range(28)]
    paths = []
    for n, position in enumerate([*positions, (48.2, 16.4), None]):
        exif = b"" if position is None else piexif.dump({"GPS": gps(*position)})
        buffer = io.BytesIO()
        Image.new("RGB", (64, 48), (8 * n, 120, 60)).save(buffer, "JPEG", exif=exif)
        paths.append(folder / f"street_{n:02}.jpg")
        paths[-1].write_bytes(buffer.getvalue())
    return paths


@pytest.fixture
def new_page(page, context, tiles):
    context.watch.allow(f"http://127.0.0.1:{tiles.port}")
    tiles.asked.clear()
    context.add_init_script(COUNT_CLICKS)
    return page


def choose(page, files):
    """Choose files by a click that opens the system's file dialog."""
    with page.expect_file_chooser() as waiting:
        page.get_by_test_id("choose-photos").click()
    waiting.value.set_files(files)
    page.wait_for_url("**/image")


def test_photos_become_a_placed_map_by_three_clicks(new_page, api, photos, tiles):
    page = new_page
    page.goto("/")
    page.get_by_test_id("new-map").click()
    choose(page, photos)
    proposal = page.get_by_test_id("area-proposal")
    expect(proposal).to_contain_text("29 photos know where they were taken")
    expect(proposal).to_contain_text("1 was taken far from the others")
    expect(proposal).to_contain_text("1 without a position")
    expect(page.locator(".sat-photo")).to_have_count(29)
    expect(page.get_by_test_id("tile-estimate")).to_contain_text("m per pixel")
    assert axe.findings(page) == []
    assert not tiles.asked, "no service is asked for anything before the person asks"
    page.get_by_test_id("tile-fetch").click()
    page.wait_for_url("**/edit", timeout=WORK_MS)  # the worker may be busy with the sample's index
    edit = EditPage(page, page.url.split("/")[-2])
    expect(edit.placed).to_have_text("28")
    expect(edit.unplaced).to_have_text("2")
    assert page.evaluate("Number(sessionStorage.getItem('clicks'))") == 3
    assert re.match(r"Map of \w", api.state(edit.slug)["name"])


def test_the_area_can_be_seen_on_a_map_first(new_page, photos, tiles):
    page = new_page
    page.goto("/new")
    page.get_by_test_id("map-name").fill("Our street")
    choose(page, photos[:3])
    expect(page.locator(".header__map")).to_have_text("Our street")
    page.get_by_test_id("tile-load").click()
    expect(page.locator(".leaflet-tile-loaded").first).to_be_visible()
    expect(page.get_by_test_id("tile-load")).to_be_hidden()
    assert tiles.asked


def test_what_is_no_photo_is_named_and_a_closed_page_has_lost_nothing(new_page, api, photos, tmp_path):
    page = new_page
    page.context.watch.expect(415, 422)
    (broken := tmp_path / "broken.jpg").write_bytes(b"no photo")
    page.goto("/new")
    page.get_by_test_id("map-name").fill("Half done")
    choose(page, [broken, *photos[:2]])
    expect(page.locator(".note--warning").first).to_contain_text("broken.jpg")
    slug = page.url.split("/")[-2]
    assert len(api.state(slug)["photos"]) == 2
    page.goto("/")  # and comes back another day
    page.get_by_role("link", name="Half done", exact=True).click()
    page.get_by_role("link", name="Get one from a map service").click()
    expect(page.get_by_test_id("area-proposal")).to_contain_text("2 photos know")


def test_a_pasted_picture_begins_a_map(new_page, api):
    page = new_page
    page.goto("/new")
    name = page.get_by_test_id("map-name")
    expect(name).to_be_focused()
    name.evaluate(PASTE)
    page.wait_for_url("**/image")
    (photo,) = api.state(page.url.split("/")[-2])["photos"]
    assert photo["name"].startswith("pasted ")


def test_photos_without_gps_lead_to_the_image(new_page, small_photos):
    page = new_page
    page.goto("/new")
    choose(page, small_photos[:2])
    expect(page.get_by_test_id("way-tiles")).to_have_attribute("aria-pressed", "false")
    expect(page.get_by_test_id("area-proposal")).to_have_count(0)


def test_a_reload_amid_an_upload_offers_to_continue_with_the_same_map(page, api, photos):
    page.goto("/new")
    page.get_by_test_id("map-name").fill("Begun")
    page.on("dialog", lambda dialog: dialog.accept())  # "leave the page?"
    begun = []

    def first_only(route):
        if route.request.method == "POST":
            begun.append(route.request.url)
        if route.request.method != "POST" or len(begun) == 1:
            route.continue_()  # the others wait until the page is left

    uploads = re.compile(r"/api/v1/maps/[^/]+/uploads")
    page.route(uploads, first_only)
    with page.expect_response(
        lambda answer: uploads.search(answer.url) and answer.request.method == "PATCH"
    ) as answer:
        page.get_by_test_id("photo-input").set_input_files(photos[:3])
    answer.value.finished()
    slug = answer.value.url.split("/maps/")[1].split("/")[0]
    page.reload()
    page.unroute_all(behavior="ignoreErrors")
    offer = page.get_by_test_id("begun-map")
    expect(offer).to_contain_text("The upload to Begun was interrupted: it has 1 photo.")
    assert axe.findings(page) == []
    offer.get_by_role("button", name="Add the rest to it").click()
    page.get_by_test_id("photo-input").set_input_files(photos[:3])
    page.wait_for_url(f"**/maps/{slug}/image")
    assert len(api.state(slug)["photos"]) == 3
    page.goto("/new")
    expect(page.get_by_test_id("choose-photos")).to_be_enabled()
    expect(offer).to_have_count(0)
