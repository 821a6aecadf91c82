"""Actions on a rotated image, north up: floors, distances, notes, keys, touch, other pages."""

import math

import pytest
from PIL import Image
from playwright.sync_api import expect

from tests.browser.edit_page import EditPage
from tests.browser.polling import until
from tests.browser.test_north_up import (
    COLOURS,
    METRES_PER_PX,
    NORTH_DEG,
    SMALL,
    colour_at,
    northward,
    place,
    turn_north_up,
    turned_map,  # noqa: F401
)

pytestmark = pytest.mark.slow

PLAN = (150, 30, 150)
TURN = "one => { const m = new DOMMatrix(getComputedStyle(one).transform); return Math.atan2(m.b, m.a) }"
MIDDLES = """
all => all.map((one) => {
  const {x, y, width, height} = one.getBoundingClientRect();
  return [x + width / 2, y + height / 2];
})
"""


@pytest.fixture
def north_up(turned_map, page):  # noqa: F811
    """Open the editor of a map with some photos in the tray, north up."""

    def open_one(photos=1):
        edit = EditPage(page, turned_map(photos=photos)).open()
        turn_north_up(edit)
        return edit

    return open_one


def scale_of(edit):
    """Return the screen pixels per image pixel."""
    return math.dist(edit.screen(0, 0), edit.screen(100, 0)) / 100


def turn_of(image):
    """Return the rotation of an image on the screen, degrees clockwise."""
    return math.degrees(image.evaluate(TURN))


def test_the_plan_of_a_floor_covers_the_turned_image(north_up, page, api, tmp_path):
    edit = north_up()
    Image.new("RGB", SMALL, PLAN).save(tmp_path / "plan.png")
    plan = {
        "name": "plan.png",
        "mimeType": "image/png",
        "buffer": (tmp_path / "plan.png").read_bytes(),
    }
    api.ask("POST", f"/maps/{edit.slug}/floors", multipart={"name": "Gallery", "level": "1", "file": plan})
    page.get_by_test_id("floor-switch").get_by_role("button", name="Gallery").click()
    floor = page.locator(".leaflet-image-layer[src*='/floors/1/image']")
    expect(floor).to_have_count(1)
    until(page, "() => document.querySelector(\".leaflet-image-layer[src*='/floors/1/image']\").complete")
    assert turn_of(floor) == pytest.approx(-NORTH_DEG, abs=0.3)
    boxes = [
        one.bounding_box() for one in (floor, page.locator(".leaflet-image-layer:not([src*='/floors/'])"))
    ]
    assert list(boxes[0].values()) == pytest.approx(list(boxes[1].values()), abs=0.5)
    for u, v in ((0.04, 0.3), (0.48, 0.97), (0.97, 0.6)):
        assert colour_at(page, edit.screen(u * SMALL[0], v * SMALL[1])) is None, "the image is below the plan"
    page.get_by_test_id("north-up").click()
    assert turn_of(floor) == pytest.approx(0, abs=0.3)


def test_a_distance_is_measured_and_drawn_where_it_is_clicked(north_up, page):
    edit = north_up()
    page.get_by_role("button", name="Measure a distance").click()
    ends = [(300, 200), (500, 350)]
    for end in ends:
        edit.click(*end)
    metres = math.dist(*ends) * METRES_PER_PX
    expect(page.locator("#measure-length")).to_have_text(f"{metres:.0f} m")
    drawn = page.locator(".ed-measure-point").evaluate_all(MIDDLES)
    for at, end in zip(drawn, ends, strict=True):
        assert at == pytest.approx(edit.screen(*end), abs=1.5)
    page.get_by_test_id("north-up").click()
    edit.turn_deg = 0.0
    drawn = page.locator(".ed-measure-point").evaluate_all(MIDDLES)
    assert drawn[1] == pytest.approx(edit.screen(*ends[1]), abs=2.5), "it turns with the image"


def test_a_note_is_dragged_on_the_turned_image(north_up, page, api):
    edit = north_up()
    api.ask("POST", f"/maps/{edit.slug}/notes", data={"title": "Here", "x_px": 300, "y_px": 250})
    mark = page.locator(".note-mark")
    expect(mark).to_have_count(1)
    box = mark.bounding_box()
    tip = (box["x"] + box["width"] / 2, box["y"] + box["height"])
    assert tip == pytest.approx(edit.screen(300, 250), abs=2), "it stands upright on its spot"
    (x, y), (to_x, to_y) = edit.screen(300, 250), edit.screen(550, 200)
    page.mouse.move(x, y - 8)
    page.mouse.down()
    page.mouse.move(to_x, to_y - 8, steps=4)
    with page.expect_response("**/notes/1") as moved:
        page.mouse.up()
    assert moved.value.ok
    (note,) = api.state(edit.slug)["notes"]
    assert (note["x_px"], note["y_px"]) == pytest.approx((550, 200), abs=3)


def test_arrow_keys_move_the_crosshair_as_it_is_seen(north_up, page, api):
    edit = north_up()
    page.keyboard.press("m")
    expect(page.locator(".ed-crosshair:not([hidden])")).to_have_count(1)  # the element has no size
    for _ in range(5):
        page.keyboard.press("Shift+ArrowRight")
    page.keyboard.press("Enter")
    edit.saved()
    ((_, at),) = api.positions(edit.slug).items()
    away, north = 5 * 48 / scale_of(edit), math.radians(NORTH_DEG)
    east = (SMALL[0] / 2 + away * math.cos(north), SMALL[1] / 2 + away * math.sin(north))
    assert at == pytest.approx(east, abs=2)


def test_two_fingers_zoom_around_the_spot_between_them(turned_map, open_context, owner):  # noqa: F811
    context = open_context(storage_state=owner, has_touch=True, reduced_motion="reduce")
    page = context.new_page()
    edit = EditPage(page, turned_map()).open()
    turn_north_up(edit)
    image = page.locator("img.leaflet-image-layer")
    width = image.evaluate("one => one.offsetWidth")
    between, middle = edit.screen(300, 240), edit.screen(SMALL[0] / 2, SMALL[1] / 2)
    fingers = context.new_cdp_session(page)

    def touch(kind, apart=None):
        points = (
            [] if apart is None else [{"x": between[0] + way * apart, "y": between[1]} for way in (-1, 1)]
        )
        fingers.send("Input.dispatchTouchEvent", {"type": kind, "touchPoints": points})

    touch("touchStart", 50)
    for apart in range(55, 101, 5):
        touch("touchMove", apart)
    touch("touchEnd")
    until(
        page, "before => document.querySelector('img.leaflet-image-layer').offsetWidth > 1.6 * before", width
    )
    grown = image.evaluate("one => one.offsetWidth") / width
    assert turn_of(image) == pytest.approx(-NORTH_DEG, abs=0.3)
    there = [b + grown * (m - b) for b, m in zip(between, middle, strict=True)]
    turn = math.radians(-NORTH_DEG)
    for n, (dx, dy) in enumerate(((-40, -30), (40, -30), (-40, 30), (40, 30))):
        x = there[0] + dx * math.cos(turn) - dy * math.sin(turn)
        y = there[1] + dx * math.sin(turn) + dy * math.cos(turn)
        assert colour_at(page, (x, y)) == n, COLOURS[n]


def test_the_second_map_of_localize_turns_along(turned_map, api, page):  # noqa: F811
    slug = turned_map(photos=2)
    place(api, slug, [northward(SMALL, 100), northward(SMALL, -100)])
    api.ask("PUT", f"/maps/{slug}/placements/Rooms", data={"clusters_px": 20})
    page.goto(f"/maps/{slug}/localize")
    button = page.get_by_test_id("north-up")
    button.click()
    page.locator("#beside").select_option("Rooms")
    first, second = (page.locator(f"#{id} img.leaflet-image-layer") for id in ("map-canvas", "map-canvas-2"))
    expect(second).to_be_visible()
    assert [turn_of(one) for one in (first, second)] == pytest.approx([-NORTH_DEG] * 2, abs=0.3)
    button.click()
    assert [turn_of(one) for one in (first, second)] == pytest.approx([0, 0], abs=0.3)
    view, image = page.locator("#map-canvas-2").bounding_box(), second.bounding_box()
    assert view["x"] - 1 <= image["x"] and image["x"] + image["width"] <= view["x"] + view["width"] + 1


def test_a_visitor_chooses_photos_on_a_turned_shared_map(turned_map, api, open_context):  # noqa: F811
    slug = turned_map(photos=2)
    spots = [northward(SMALL, 150), northward(SMALL, -150)]
    place(api, slug, spots)
    address = api.ask("POST", f"/maps/{slug}/shares", data={"photos": True})["url"]
    page = open_context().new_page()
    page.goto(address)
    shared = EditPage(page, slug)
    shared.canvas, shared.size = page.locator("#map-canvas"), SMALL
    turn_north_up(shared)
    assert turn_of(page.locator("img.leaflet-image-layer")) == pytest.approx(-NORTH_DEG, abs=0.3)
    (x, y), (below_x, below_y) = (shared.screen(*spot) for spot in spots)
    assert (x, y < below_y) == (pytest.approx(below_x, abs=1), True)
    for spot in spots:
        shared.click(*spot)
        expect(page.locator("#photo-facts")).to_contain_text("x {:.0f}, y {:.0f}".format(*spot))
