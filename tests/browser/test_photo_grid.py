"""The grid of photos: number in view, sorting, filters, layouts, actions on one or several."""

import json
import math
import re

import pytest
from playwright.sync_api import expect

from tests.browser import axe
from tests.browser.edit_page import EditPage, spots

SMALL_SCREEN = {"width": 1366, "height": 768}
NAMES = """
all => all.sort((a, b) => a.ariaPosInSet - b.ariaPosInSet)
  .map((one) => one.querySelector(".ed-tile__name").textContent)
"""
WHOLE_IN_SIGHT = """
() => {
  const box = document.getElementById("tray-list").getBoundingClientRect();
  return [...document.querySelectorAll("[data-testid=tray-photo]")].filter((tile) => {
    const at = tile.getBoundingClientRect();
    return at.top >= box.top && at.bottom <= box.bottom && at.left >= box.left && at.right <= box.right;
  }).length;
}
"""


def names(edit: EditPage) -> list[str]:
    """Return the names in the grid, in the order shown."""
    return edit.tray.evaluate_all(NAMES)


def in_order(edit: EditPage, expected: list[str]) -> None:
    """Wait until the grid shows these photos in this order."""
    expect(edit.tray).to_have_count(len(expected))
    expect(edit.tray.and_(edit.page.locator("[aria-posinset='1']"))).to_contain_text(expected[0])
    assert names(edit) == expected


@pytest.fixture
def sample_page(open_context, owner, sample_map):
    """The editor of the sample on a small screen."""
    page = open_context(storage_state=owner, viewport=SMALL_SCREEN).new_page()
    return EditPage(page, sample_map).open()


def test_twelve_photos_are_in_sight_with_one_open(sample_page):
    expect(sample_page.current.locator("#current-image")).to_be_visible()
    assert sample_page.page.evaluate(WHOLE_IN_SIGHT) >= 12
    grid = sample_page.page.locator("#tray-list")
    expect(grid).to_have_attribute("aria-activedescendant", re.compile("."))
    grid.evaluate("grid => grid.scrollTo(0, grid.scrollHeight)")  # where the photo has no element
    expect(grid).not_to_have_attribute("aria-activedescendant", re.compile("."))


def test_sorting_and_filters(make_page, api):
    edit = make_page(4)
    page = edit.page
    by_name = sorted(names(edit))
    edit.click(600, 400)
    edit.click(300, 300)
    page.locator("[data-filter=all]").click()
    edit.tray.filter(has_text=by_name[1]).click()
    page.locator("#current-heading").fill("90")
    page.locator("#current-heading").press("Enter")
    edit.saved()
    page.locator("#photo-sort").select_option("distance")
    in_order(edit, [by_name[1], by_name[0], by_name[2], by_name[3]])
    page.locator("#photo-sort").select_option("name")
    in_order(edit, by_name)
    page.get_by_label("Filter").click()
    page.locator("#filter-heading").select_option("no")
    in_order(edit, [by_name[0], by_name[2], by_name[3]])
    page.locator("#filter-gps").select_option("yes")
    expect(edit.tray).to_have_count(0)
    page.keyboard.press("Escape")
    page.get_by_role("button", name="Clear the filters").click()
    page.locator("#tray-search").fill(by_name[2])
    in_order(edit, [by_name[2]])


def test_next_goes_through_what_the_grid_shows(make_page):
    edit = make_page(4, placed=True)
    all_names = sorted(names(edit))
    edit.page.locator("#photo-sort").select_option("name")
    edit.tray.filter(has_text=all_names[0]).click()
    edit.page.locator("#tray-search").fill(all_names[2])
    in_order(edit, [all_names[2]])
    edit.page.locator("#current-next").click()
    expect(edit.current).to_contain_text(all_names[2])


def test_a_photo_is_dragged_from_the_grid_to_the_image(make_page, api):
    edit = make_page(3)
    second = names(edit)[1]
    image = edit.canvas.bounding_box()
    x, y = edit.screen(420, 240)
    target = {"x": x - image["x"], "y": y - image["y"]}
    edit.tray.filter(has_text=second).drag_to(edit.canvas, target_position=target)
    expect(edit.unplaced).to_have_text("2")
    edit.saved()
    assert math.dist(api.positions(edit.slug)[second], (420, 240)) < 3


def test_a_dot_shows_its_picture(make_page):
    edit = make_page(2, placed=True)
    picture = edit.page.locator(".ed-preview img")
    edit.page.mouse.move(*edit.screen(*spots(2)[1]))
    expect(picture).to_be_visible()
    edit.page.mouse.move(*edit.screen(500, 600))
    expect(picture).to_be_hidden()


def test_the_bar_of_the_selection_is_in_sight_and_turns_all(make_page, api):
    edit = make_page(3, placed=True)
    edit.page.locator("#tray-list").press("Control+a")
    bar = edit.page.locator("#selection-bar")
    for view in ("strip", "grid", "side"):
        edit.page.keyboard.press("Escape")
        edit.page.locator(f"[data-view={view}]:is(button)").click()
        edit.page.locator("#tray-list").press("Control+a")
        expect(bar).to_be_in_viewport(ratio=1)
        expect(bar).to_contain_text("3 selected")
    bar.get_by_role("button", name="Set the headings").click()
    edit.page.get_by_test_id("heading-way").select_option("along")
    edit.page.get_by_role("dialog").get_by_role("button", name="Set the headings").click()
    edit.saved()
    headings = [photo["heading_deg"] for photo in api.state(edit.slug)["photos"]]
    assert headings == pytest.approx([90, 90, 90])
    edit.undo.click()
    edit.saved()
    assert [photo["heading_deg"] for photo in api.state(edit.slug)["photos"]] == [None] * 3


def test_the_photo_on_the_whole_screen(make_page):
    edit = make_page(3, placed=True)
    all_names = names(edit)
    edit.tray.first.dblclick()
    viewer = edit.page.get_by_role("dialog")
    expect(viewer).to_contain_text(all_names[0])
    assert axe.findings(edit.page) == []
    edit.page.keyboard.press("ArrowRight")
    expect(viewer).to_contain_text(all_names[1])
    edit.page.keyboard.press("+")
    expect(viewer.locator(".viewer__frame")).to_have_class("ed-frame viewer__frame is-zoomed")
    edit.page.keyboard.press("Escape")
    expect(viewer).to_have_count(0)
    expect(edit.current).to_contain_text(all_names[1])


def test_the_menu_of_a_photo_by_mouse_and_by_keyboard(make_page):
    edit = make_page(2, placed=True)
    menu = edit.page.get_by_role("menu")
    edit.tray.first.click(button="right")
    expect(menu.get_by_role("menuitem").first).to_be_focused()
    assert axe.findings(edit.page) == []
    edit.page.keyboard.press("Escape")
    expect(menu).to_have_count(0)
    edit.page.locator("#tray-list").focus()
    edit.page.keyboard.press("Shift+F10")
    expect(menu).to_be_visible()
    edit.page.keyboard.press("Escape")
    edit.page.mouse.click(*edit.screen(*spots(2)[1]), button="right")
    menu.get_by_role("menuitem", name="Back to the tray").click()
    expect(edit.unplaced).to_have_text("1")


def test_coordinates_are_copied_from_the_image(open_context, owner, sample_map):
    context = open_context(storage_state=owner, permissions=["clipboard-read", "clipboard-write"])
    edit = EditPage(context.new_page(), sample_map).open()
    edit.page.mouse.click(*edit.screen(500, 600), button="right")
    edit.page.get_by_role("menuitem", name="Copy the coordinates").click()
    expect(edit.page.locator(".toast")).to_contain_text("Copied")
    lat, lon = map(float, edit.page.evaluate("navigator.clipboard.readText()").split(", "))
    assert (lat, lon) == (pytest.approx(50.21, abs=0.01), pytest.approx(15.825, abs=0.01))


def test_the_size_of_the_grid_is_kept(make_page):
    edit = make_page(3)
    side = edit.page.locator("#side")
    wide = side.bounding_box()["width"]
    edge = edit.page.locator("#side-edge")
    for _ in range(3):
        edge.press("ArrowRight")
    assert side.bounding_box()["width"] == wide + 72
    edit.open()
    assert side.bounding_box()["width"] == wide + 72
    box = edge.bounding_box()
    edit.page.mouse.move(box["x"] + 5, 400)
    edit.page.mouse.down()
    edit.page.mouse.move(box["x"] + 5 - 100, 400, steps=3)
    edit.page.mouse.up()
    assert side.bounding_box()["width"] == wide - 28
    edit.page.locator("button[data-view=strip]").click()
    edit.open()
    expect(edit.page.locator("button[data-view=strip]")).to_have_attribute("aria-pressed", "true")
    assert side.bounding_box()["width"] == edit.page.viewport_size["width"]


def test_notes_and_tags_of_several_photos(make_page, api):
    edit = make_page(4)
    page = edit.page
    ids = [photo["id"] for photo in api.state(edit.slug)["photos"]]
    changes = [{"id": ids[0], "note": "Old oak #tree"}]
    api.ask("PATCH", f"/maps/{edit.slug}/experiences", data={"kind": "note", "changes": changes})
    page.reload()
    page.locator("#tray-list").focus()
    page.keyboard.press("Control+a")
    page.locator("#selection-note").click()
    dialog = page.get_by_role("dialog")
    tree = dialog.get_by_label("#tree")
    expect(tree).to_be_checked(indeterminate=True)
    assert axe.findings(page) == []
    dialog.get_by_test_id("notes-add").fill("Walk of May")
    dialog.get_by_test_id("tags-add").fill("north, #Gate")
    dialog.get_by_role("button", name="Save").click()
    expect(dialog).to_have_count(0)
    edit.saved()
    notes = sorted(photo["note"] for photo in api.state(edit.slug)["photos"])
    assert notes == ["Old oak #tree\nWalk of May #north #gate", *["Walk of May #north #gate"] * 3]
    page.locator("#filter-menu > summary").click()
    page.locator("#filter-note").select_option("#tree")
    expect(edit.tray).to_have_count(1)
    page.locator("#filter-note").select_option("#gate")
    expect(edit.tray).to_have_count(4)
    page.locator("#filter-menu > summary").click()
    page.locator("#tray-list").focus()
    page.keyboard.press("Control+a")
    page.locator("#selection-note").click()
    dialog.get_by_label("#gate").uncheck()
    tree.check()
    dialog.get_by_role("button", name="Save").click()
    expect(edit.tray).to_have_count(0)  # none has the tag of the filter now
    notes = sorted(photo["note"] for photo in api.state(edit.slug)["photos"])
    assert notes == ["Old oak #tree\nWalk of May #north", *["Walk of May #north #tree"] * 3]
    edit.undo.click()
    expect(edit.tray).to_have_count(4)


def only_dots(page, held):
    """Let a page start with only the dots of its photos, and hold the request for their details."""

    def begin(route):
        answer = route.fetch()
        before, tag, rest = answer.text().partition('<script type="application/json" id="state">')
        text, end, after = rest.partition("</script>")
        state = json.loads(text)
        fields = ("id", "x_px", "y_px", "heading_deg", "fov_deg", "floor")
        state["dots"] = {field: [photo.get(field) for photo in state["photos"]] for field in fields}
        state["photos"] = []
        route.fulfill(response=answer, body="".join((before, tag, json.dumps(state), end, after)))

    page.route("**/edit", begin)
    page.route("**/photos?after=*&limit=5000", lambda route: held.append(route))


def test_filters_are_offered_while_details_are_loading(make_page, page, api):
    edit = make_page(3)
    ids = [photo["id"] for photo in api.state(edit.slug)["photos"]]
    changes = [{"id": id, "note": note} for id, note in zip(ids, ("#oak", "#gate", ""), strict=True)]
    api.ask("PATCH", f"/maps/{edit.slug}/experiences", data={"kind": "note", "changes": changes})
    held = []
    only_dots(page, held)
    with page.expect_request("**/photos?after=*&limit=5000"):
        edit.open()
    page.get_by_label("Filter").click()
    loading = page.get_by_text("More choices follow while details of the photos are loading.")
    expect(loading).to_be_visible()
    tag = page.locator("#filter-note option[value='#gate']")
    expect(tag).to_have_count(0)
    page.locator("#filter-note").select_option("yes")
    page.locator("#filter-camera").select_option("unknown")
    expect(edit.tray).to_have_count(1)  # the current photo, whose details come first
    held[0].continue_()
    expect(tag).to_have_text("#gate (1)")
    expect(loading).to_be_hidden()
    expect(page.locator("#filter-note")).to_have_value("yes")
    expect(page.locator("#filter-camera")).to_have_value("unknown")
    expect(edit.tray).to_have_count(2)


def test_photos_are_filtered_by_camera_or_by_not_knowing_it(make_page, page):
    def with_camera(route):
        answer = route.fetch()
        body, changed = re.subn('"camera": ?null', '"camera": "Kestrel 2"', answer.text(), count=1)
        assert changed
        route.fulfill(response=answer, body=body)

    page.route("**/edit", with_camera)
    edit = make_page(3)
    page.get_by_label("Filter").click()
    page.locator("#filter-camera").select_option("Kestrel 2")
    expect(edit.tray).to_have_count(1)
    page.locator("#filter-camera").select_option("unknown")
    expect(edit.tray).to_have_count(2)


@pytest.mark.parametrize("width", [1366, 1024, 390])
def test_what_is_done_with_selected_photos_fits_the_screen(open_context, owner, sample_map, width):
    page = open_context(storage_state=owner, viewport={"width": width, "height": 768}).new_page()
    EditPage(page, sample_map).open()
    if width < 768:
        page.locator("#side-toggle").click()
    page.locator("#tray-list").focus()
    page.keyboard.press("Control+a")
    button = page.locator("#selection-note")
    expect(button).to_be_visible()
    assert button.bounding_box()["height"] < 50, "its words are in one line"
    assert page.evaluate("document.documentElement.scrollWidth") <= width
    last = page.locator(".ed-selection button").last.bounding_box()
    assert last["x"] + last["width"] <= width
