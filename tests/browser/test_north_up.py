"""North up: the image of a map is drawn rotated, with everything on it."""

import io
import math

import pytest
from PIL import Image
from playwright.sync_api import expect

from tests.browser import axe
from tests.browser.edit_page import EditPage
from tests.browser.polling import until

pytestmark = pytest.mark.slow

NORTH_DEG = 35.0
"""Direction of north on the image, clockwise from its top."""

METRES_PER_PX = 0.5
M_PER_DEG = 111_195
AT = (50.0, 14.0)
COLOURS = ((200, 40, 40), (40, 160, 40), (40, 60, 200), (220, 200, 40))
"""Colours of the quarters of an image, row by row."""

SMALL = (840, 560)
LARGE = (4800, 3200)
"""Large enough to be shown in tiles."""

TILES_ARE_SHOWN = """
() => [...document.querySelectorAll("img.leaflet-tile")].every((tile) =>
  tile.classList.contains("leaflet-tile-loaded") && getComputedStyle(tile).opacity === "1")
"""
"""Script: all tiles have loaded and faded in."""


def quartered(path, size):
    """Write an image whose quarters have different colours."""
    width, height = size
    image = Image.new("RGB", size)
    for n, colour in enumerate(COLOURS):
        left, top = (n % 2) * width // 2, (n // 2) * height // 2
        image.paste(colour, (left, top, left + width // 2, top + height // 2))
    image.save(path)
    return path


def lat_lon(x, y, size):
    """Return the latitude and longitude of a map pixel."""
    dx, dy = x - size[0] / 2, y - size[1] / 2
    sine, cosine = math.sin(math.radians(NORTH_DEG)), math.cos(math.radians(NORTH_DEG))
    east, north = (dx * cosine + dy * sine) * METRES_PER_PX, (dx * sine - dy * cosine) * METRES_PER_PX
    return AT[0] + north / M_PER_DEG, AT[1] + east / (M_PER_DEG * math.cos(math.radians(AT[0])))


def northward(size, pixels):
    """Return the map pixel at a distance north of the middle."""
    turn = math.radians(NORTH_DEG)
    return size[0] / 2 + pixels * math.sin(turn), size[1] / 2 - pixels * math.cos(turn)


@pytest.fixture
def turned_map(api, tmp_path, small_photos, request):
    """Make a map whose image is not north-up, with some photos, and return its slug."""
    made = []

    def make(size=SMALL, *, photos=0):
        image = quartered(tmp_path / "image.png", size)
        slug = api.make_map(request.node.name[:60], satellite=image, photos=small_photos[:photos])
        made.append(slug)
        points = []
        for x, y in ((0, 0), (size[0], 0), (0, size[1]), size):
            lat, lon = lat_lon(x, y, size)
            points.append({"x": x, "y": y, "lat": lat, "lon": lon})
        georeference = {"kind": "control-points", "points": points, "model": "affine"}
        api.ask("PUT", f"/maps/{slug}/georeference", data=georeference)
        return slug

    yield make
    for slug in made:
        api.cancel_jobs(slug)


def place(api, slug, positions):
    """Place the photos of a map and return their ids."""
    ids = [photo["id"] for photo in api.state(slug)["photos"]]
    changes = [{"id": id, "x_px": x, "y_px": y} for id, (x, y) in zip(ids, positions, strict=True)]
    api.ask("PATCH", f"/maps/{slug}/experiences", data={"kind": "place", "changes": changes})
    return ids


def turn_north_up(edit):
    button = edit.page.get_by_test_id("north-up")
    expect(button).to_have_attribute("aria-pressed", "false")
    button.click()
    expect(button).to_have_attribute("aria-pressed", "true")
    edit.turn_deg = -NORTH_DEG


def colour_at(page, point):
    """Return the quarter whose colour is at a point of the screen; None for other colours."""
    with Image.open(io.BytesIO(page.screenshot())) as shot:
        seen = shot.convert("RGB").getpixel((round(point[0]), round(point[1])))
    return next((n for n, one in enumerate(COLOURS) if max(map(abs, map(int.__sub__, seen, one))) < 12), None)


def check_quarters(edit):
    """Check that the image is drawn at its map pixels."""
    width, height = edit.size
    for n, (u, v) in enumerate(((0.04, 0.3), (0.75, 0.03), (0.48, 0.97), (0.97, 0.6))):
        assert colour_at(edit.page, edit.screen(u * width, v * height)) == n
    assert colour_at(edit.page, edit.screen(-0.04 * width, 0.5 * height)) is None, "that is left of the image"
    assert colour_at(edit.page, edit.screen(0.5 * width, 1.04 * height)) is None, "that is below the image"


def test_the_image_turns_and_photos_to_the_north_are_higher(turned_map, api, page):
    slug = turned_map(photos=2)
    spots = [northward(SMALL, 150), northward(SMALL, -150)]
    place(api, slug, spots)
    edit = EditPage(page, slug).open()
    check_quarters(edit)
    turn_north_up(edit)
    check_quarters(edit)
    (x, y), (below_x, below_y) = (edit.screen(*spot) for spot in spots)
    assert x == pytest.approx(below_x, abs=1)
    assert y < below_y - 100
    names = list(api.positions(slug))
    for spot, name in zip(spots, names, strict=True):
        edit.click(*spot)
        expect(page.locator("#current-name")).to_have_text(name)
    assert axe.findings(page) == []
    page.reload()
    expect(page.get_by_test_id("north-up")).to_have_attribute("aria-pressed", "true")
    check_quarters(edit)
    page.keyboard.press("u")
    edit.turn_deg = 0.0
    expect(page.get_by_test_id("north-up")).to_have_attribute("aria-pressed", "false")
    check_quarters(edit)


def test_photos_are_placed_dragged_and_turned_where_they_are_seen(turned_map, api, page):
    slug = turned_map(photos=2)
    edit = EditPage(page, slug).open()
    turn_north_up(edit)
    edit.click(200, 400)
    edit.saved()
    ((name, at),) = api.positions(slug).items()
    assert at == pytest.approx((200, 400), abs=1.5)
    page.keyboard.press("Escape")
    edit.drag((200, 400), (600, 150))
    edit.saved()
    assert api.positions(slug)[name] == pytest.approx((600, 150), abs=2)
    edit.click(600, 150)
    edit.turn_by_hand((600, 150), heading=0, to=90)
    edit.saved()
    (heading,) = [p["heading_deg"] for p in api.state(slug)["photos"] if p["name"] == name]
    assert heading == pytest.approx(90, abs=2), "east is to the right once north is up"


def test_a_box_selects_what_is_inside_on_the_screen(turned_map, api, page):
    slug = turned_map(photos=3)
    spots = [northward(SMALL, 120), northward(SMALL, -120), (430, 290)]
    place(api, slug, spots)
    edit = EditPage(page, slug).open()
    turn_north_up(edit)
    x, y = edit.screen(*spots[0])
    _, middle = edit.screen(*spots[2])
    page.keyboard.down("Shift")
    page.mouse.move(x - 30, y - 30)
    page.mouse.down()
    page.mouse.move(x + 30, (y + middle) / 2 + 10, steps=4)
    page.mouse.up()
    page.keyboard.up("Shift")
    expect(page.locator("#selection-count")).to_have_text("1 selected")


def test_tiles_of_a_large_image_turn_too(turned_map, api, page):
    slug = turned_map(LARGE)
    api.wait_for_jobs(slug)
    edit = EditPage(page, slug).open()
    expect(page.locator("img.leaflet-tile-loaded").first).to_be_attached()
    turn_north_up(edit)
    until(page, TILES_ARE_SHOWN)
    check_quarters(edit)
    with Image.open(io.BytesIO(page.screenshot())) as shot:
        (left, top), (right, bottom) = edit.screen(300, 1000), edit.screen(2000, 1000)
        line = [
            shot.convert("RGB").getpixel(
                (round(left + (right - left) * n / 200), round(top + (bottom - top) * n / 200))
            )
            for n in range(201)
        ]
    assert set(line) == {COLOURS[0]}, "no seams between tiles"
    scale = page.locator(".ed-scale")
    before = scale.inner_text()
    page.locator("#zoom-in").click()
    expect(scale).not_to_have_text(before)  # at the end of the animation
    until(page, TILES_ARE_SHOWN)
    middle = edit.screen(LARGE[0] / 2, LARGE[1] / 2)
    for n, (dx, dy) in enumerate(((-100, -60), (100, -60), (-100, 60), (100, 60))):
        turn = math.radians(-NORTH_DEG)
        at = (
            middle[0] + dx * math.cos(turn) - dy * math.sin(turn),
            middle[1] + dx * math.sin(turn) + dy * math.cos(turn),
        )
        assert colour_at(page, at) == n


def test_an_image_that_has_north_up_has_no_compass(api, sample_folder, page):
    slug = api.make_map("Upright", satellite=sample_folder / "satellite.png")
    EditPage(page, slug).open()
    expect(page.get_by_test_id("north-up")).to_be_hidden()


def test_it_fits_a_phone(turned_map, api, open_context, owner):
    slug = turned_map(photos=1)
    place(api, slug, [northward(SMALL, 100)])
    context = open_context(storage_state=owner, viewport={"width": 390, "height": 844}, has_touch=True)
    page = context.new_page()
    for address in (f"/maps/{slug}/edit", f"/maps/{slug}/localize", f"/field?map={slug}"):
        page.goto(address)
        button = page.get_by_test_id("north-up")
        expect(button).to_be_visible()
        if button.get_attribute("aria-pressed") == "false":
            button.click()
        expect(button).to_have_attribute("aria-pressed", "true")
        assert page.evaluate("document.documentElement.scrollWidth") <= 390
        turn = page.locator("img.leaflet-image-layer").evaluate(
            "one => { const m = new DOMMatrix(getComputedStyle(one).transform); return Math.atan2(m.b, m.a) }"
        )
        assert math.degrees(turn) == pytest.approx(-NORTH_DEG, abs=0.3)
        assert axe.findings(page) == []


def test_its_key_works_everywhere_on_a_page_but_while_somebody_types(turned_map, api, page):
    slug = turned_map(photos=1)
    place(api, slug, [northward(SMALL, 100)])
    button = page.get_by_test_id("north-up")
    for address in (f"/maps/{slug}/localize", f"/field?map={slug}"):
        page.goto(address)
        expect(button).to_be_visible()
        if button.get_attribute("aria-pressed") == "true":
            button.click()
        page.locator("h1, summary, a").first.focus()
        page.keyboard.press("u")
        expect(button).to_have_attribute("aria-pressed", "true")
        page.evaluate("document.body.append(document.createElement('textarea'))")
        page.locator("body > textarea").focus()
        page.keyboard.press("u")
        expect(page.locator("body > textarea")).to_have_value("u")
        expect(button).to_have_attribute("aria-pressed", "true")


def test_nothing_is_kept_of_a_shared_map(turned_map, api, page, open_context):
    slug = turned_map(photos=1)
    place(api, slug, [northward(SMALL, 100)])
    address = api.ask("POST", f"/maps/{slug}/shares", data={})["url"]
    visitor = open_context().new_page()
    visitor.goto(address)
    button = visitor.get_by_test_id("north-up")
    expect(button).to_have_attribute("aria-pressed", "false")
    visitor.keyboard.press("u")
    expect(button).to_have_attribute("aria-pressed", "true")
    button.click()
    button.click()
    expect(button).to_have_attribute("aria-pressed", "true")
    assert not visitor.evaluate("Object.keys(localStorage).filter((key) => key.includes('north'))")
    secret = address.rstrip("/").split("/")[-1]
    assert secret not in visitor.evaluate("JSON.stringify(localStorage)")


def test_with_reduced_motion_it_is_drawn_in_the_same_place(turned_map, open_context, owner):
    page = open_context(storage_state=owner, reduced_motion="reduce").new_page()
    edit = EditPage(page, turned_map()).open()
    turn_north_up(edit)
    check_quarters(edit)
