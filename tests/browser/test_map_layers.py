"""Layers: the tiles of a service below the image of a map, at the right positions."""

import io
import math
import re

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import expect

from tests.browser import axe
from tests.browser.edit_page import EditPage
from tests.browser.polling import until
from tests.browser.test_north_up import (
    AT,
    COLOURS,
    M_PER_DEG,
    METRES_PER_PX,
    NORTH_DEG,
    SMALL,
    colour_at,
    place,
    turn_north_up,
    turned_map,  # noqa: F401
)

pytestmark = pytest.mark.slow

SERVICE = "Local imagery"
ALL_CAME = "[...document.querySelectorAll('.map-background img')].every(({complete}) => complete)"
BEYOND = (150, 150, 150)
"""Colour of the tiles outside the image."""


def tile_of(zoom, column, row):
    """Draw a tile of a world that shows the map's image at its place, grey around it."""
    within = (np.arange(256) + 0.5) / 256
    u, v = np.meshgrid((column + within) / 2**zoom, (row + within) / 2**zoom)
    lat, lon = np.degrees(np.arctan(np.sinh(math.pi * (1 - 2 * v)))), u * 360 - 180
    north = (lat - AT[0]) * M_PER_DEG / METRES_PER_PX
    east = (lon - AT[1]) * M_PER_DEG * math.cos(math.radians(AT[0])) / METRES_PER_PX
    sine, cosine = math.sin(math.radians(NORTH_DEG)), math.cos(math.radians(NORTH_DEG))
    x, y = east * cosine + north * sine + SMALL[0] / 2, east * sine - north * cosine + SMALL[1] / 2
    quarter = (x >= SMALL[0] / 2) + 2 * (y >= SMALL[1] / 2)
    pixels = np.array(COLOURS, np.uint8)[quarter]
    pixels[(x < 0) | (y < 0) | (x > SMALL[0]) | (y > SMALL[1])] = BEYOND
    png = io.BytesIO()
    Image.fromarray(pixels).save(png, "PNG")
    return png.getvalue()


@pytest.fixture
def addresses(tiles, page):
    """Pattern of the addresses of the service's tiles."""
    page.context.watch.allow(f"http://127.0.0.1:{tiles.port}")
    return re.compile(re.sub(r"\\{[zxy]\\}", r"(\\d+)", re.escape(tiles.url)))


@pytest.fixture
def asked(page, addresses):
    """A stand-in for the service; the tiles that were requested."""
    found = []

    def answer(route):
        tile = tuple(map(int, addresses.fullmatch(route.request.url).groups()))
        found.append(tile)
        route.fulfill(body=tile_of(*tile), content_type="image/png")

    page.route(addresses, answer)
    return found


def choose(page, service, *, opacity=None):
    page.get_by_test_id("layers").click()
    page.get_by_test_id("layer-below").select_option(service)
    if opacity is not None:
        page.get_by_test_id("image-opacity").fill(str(opacity))
    page.keyboard.press("Escape")


def check_ground(edit):
    """Check that the tiles show the image at its place, a few pixels on both sides of each edge."""
    page, (width, height) = edit.page, SMALL
    expect(page.locator(".map-background img").first).to_be_attached()
    until(page, f"() => {ALL_CAME}")
    for n, (x, y) in enumerate(((-8, -8), (8, -8), (-8, 8), (8, 8))):
        assert colour_at(page, edit.screen(width / 2 + x, height / 2 + y)) == n
    assert colour_at(page, edit.screen(8, height / 4)) == 0
    assert colour_at(page, edit.screen(width - 8, height - 8)) == 3
    assert colour_at(page, edit.screen(-8, height / 4)) is None
    assert colour_at(page, edit.screen(width / 2, height + 8)) is None


def test_the_ground_is_seen_where_it_is_on_the_image(turned_map, asked, page):  # noqa: F811
    edit = EditPage(page, turned_map()).open()
    assert asked == [], "nothing is fetched before it is chosen"
    choose(page, SERVICE, opacity=0)
    check_ground(edit)
    expect(page.locator(".ed-credit")).to_contain_text("these tests")
    assert len(asked) == len(set(asked)) < 60
    turn_north_up(edit)
    check_ground(edit)


def test_it_is_seen_through_the_image_and_kept_for_the_map(turned_map, api, asked, page):  # noqa: F811
    slug = turned_map(photos=2)
    place(api, slug, [(200, 200), (600, 400)])
    edit = EditPage(page, slug).open()
    choose(page, SERVICE)
    image = page.locator("img.leaflet-image-layer")
    expect(image).to_have_css("opacity", "0.6")
    choose(page, SERVICE, opacity=25)
    expect(image).to_have_css("opacity", "0.25")
    page.reload()
    expect(image).to_have_css("opacity", "0.25")
    expect(page.locator(".map-background img").first).to_be_attached()
    page.goto(f"/maps/{slug}/localize")
    expect(image).to_have_css("opacity", "0.25")
    page.get_by_test_id("layers").click()
    assert axe.findings(page) == []
    page.keyboard.press("Escape")
    choose(page, "")
    expect(image).to_have_css("opacity", "1")
    expect(page.locator(".map-background")).to_have_count(0)
    expect(page.locator(".ed-credit")).not_to_contain_text("these tests")
    before = len(asked)
    edit.open()
    assert len(asked) == before


def test_zooming_in_asks_for_finer_tiles_and_drops_the_coarse_ones(turned_map, asked, page):  # noqa: F811
    edit = EditPage(page, turned_map()).open()
    choose(page, SERVICE, opacity=0)
    check_ground(edit)
    first = {zoom for zoom, _, _ in asked}
    (zoom,) = first
    for finer in (zoom + 1, zoom + 2):
        page.locator("#zoom-in").click()
        expect(page.locator(f".map-background img[src*='/{finer}/']").first).to_be_attached()
    expect(page.locator(".map-background__level")).to_have_count(1)
    assert {z for z, _, _ in asked} == {zoom, zoom + 1, zoom + 2}
    middle = edit.screen(SMALL[0] / 2, SMALL[1] / 2)
    for n, (x, y) in enumerate(((-60, -60), (60, -60), (-60, 60), (60, 60))):
        assert colour_at(page, (middle[0] + x, middle[1] + y)) == n


def test_a_service_that_gives_nothing_is_named(turned_map, addresses, page):  # noqa: F811
    page.route(addresses, lambda route: route.fulfill(status=404))
    page.context.watch.expect(404)
    EditPage(page, turned_map()).open()
    page.get_by_test_id("layers").click()
    page.get_by_test_id("layer-below").select_option(SERVICE)
    said = re.compile(r"No map of this place came from 127\.0\.0\.1:\d+\.")
    expect(page.locator("#layers-status")).to_have_text(said)


def test_an_image_that_is_nowhere_has_no_layers(api, sample_folder, page):
    slug = api.make_map("Nowhere", satellite=sample_folder / "satellite.png")
    EditPage(page, slug).open()
    expect(page.get_by_test_id("layers")).to_be_hidden()


def test_visitors_of_a_shared_map_choose_too_and_nothing_is_kept(turned_map, api, asked, page):  # noqa: F811
    slug = turned_map(photos=1)
    place(api, slug, [(300, 200)])
    share = api.ask("POST", f"/maps/{slug}/shares", data={})
    page.goto(share["url"])
    expect(page.locator("img.leaflet-image-layer")).to_be_visible()
    assert asked == []
    choose(page, SERVICE)
    expect(page.locator(".map-background img").first).to_be_attached()
    assert share["url"].rsplit("/", 1)[-1] not in page.evaluate("JSON.stringify({...localStorage})")
    assert page.evaluate("Object.keys(localStorage).filter((key) => key.startsWith('expmap.layers'))") == []
    page.reload()
    expect(page.locator("img.leaflet-image-layer")).to_be_visible()
    asked.clear()
    page.wait_for_load_state("networkidle")
    assert asked == [] and page.locator(".map-background").count() == 0


def test_tiles_that_failed_are_asked_for_again_when_the_network_is_back(turned_map, addresses, page):  # noqa: F811
    page.route(addresses, lambda route: route.fulfill(status=404))
    page.context.watch.expect(404)
    EditPage(page, turned_map()).open()
    choose(page, SERVICE)
    expect(page.locator("#layers-status")).to_contain_text("No map of this place came from")
    page.unroute(addresses)
    page.route(addresses, lambda route: route.fulfill(body=tile_of(1, 0, 0), content_type="image/png"))
    page.evaluate("dispatchEvent(new Event('online'))")
    expect(page.locator("#layers-status")).to_have_text("")
    expect(page.locator(".map-background img:not([hidden])").first).to_be_visible()


def test_keys_on_the_slider_and_escape_from_the_menu_leave_the_photos_alone(turned_map, api, asked, page):  # noqa: F811
    slug = turned_map(photos=2)
    place(api, slug, [(300, 200), (320, 210)])
    edit = EditPage(page, slug).open()
    edit.canvas.focus()
    page.keyboard.press("Control+a")
    page.get_by_test_id("layers").click()
    page.get_by_test_id("layer-below").select_option(SERVICE)
    page.get_by_test_id("image-opacity").focus()
    page.keyboard.press("Delete")
    page.keyboard.press("Backspace")
    page.keyboard.press("Escape")
    expect(page.get_by_test_id("layer-below")).to_be_hidden()
    assert asked and len(api.positions(slug)) == 2
