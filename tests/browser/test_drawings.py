"""Search areas on the page of a mission: drawn by clicks and keys, assigned, searched, seen by visitors."""

import json

import pytest
from playwright.sync_api import expect

from tests.browser import axe

BEGIN = 1_760_000_000
SQUARE = [[14.4175, 50.0771], [14.4181, 50.0771], [14.4181, 50.0775], [14.4175, 50.0775], [14.4175, 50.0771]]


@pytest.fixture
def mission(api):
    """The id of a mission with a track of 50 m."""
    id = api.ask("POST", "/missions", data={"name": "Search in the yard"})["id"]
    poses = [
        {"type": "pose", "time": BEGIN + n, "lat": 50.0772, "lon": 14.4175 + n * 1.4e-5, "track": "Rover"}
        for n in range(50)
    ]
    api.ask("POST", f"/missions/{id}/batches", data={"sender": "robot", "first": 0, "records": poses})
    return id


@pytest.fixture
def opened(page, mission):
    """The page of the mission with the tab of the areas; the map is there."""
    page.goto(f"/missions/{mission}")
    page.locator("#map-canvas.leaflet-container").wait_for()
    page.get_by_test_id("tab-areas").click()
    return page


def click_on_map(page, *places):
    """Click at shares of the width and height of the map."""
    box = page.get_by_test_id("map-canvas").bounding_box()
    for x, y in places:
        page.mouse.click(box["x"] + x * box["width"], box["y"] + y * box["height"])


def save(page, name, **fields):
    """Fill in the dialog of a drawing."""
    dialog = page.get_by_role("dialog")
    dialog.get_by_label("Name").fill(name)
    for label, value in fields.items():
        dialog.get_by_label(label.replace("_", " ")).fill(value)
    dialog.get_by_role("button", name="Save").click()


def test_an_area_is_drawn_assigned_and_searched(opened, open_context, mission, api, owner):
    page = opened
    page.get_by_test_id("draw-area").click()
    bar = page.get_by_test_id("sketch-bar")
    expect(bar.get_by_role("button", name="Done")).to_be_disabled()
    click_on_map(page, (0.2, 0.3), (0.8, 0.3), (0.8, 0.7), (0.2, 0.7))
    expect(bar).to_contain_text("Points: 4")
    bar.get_by_role("button", name="Done").click()
    assert axe.findings(page) == []
    save(page, "North slope", Assigned_to="Team 2", How_far_to_each_side="4")
    area = page.get_by_test_id("drawing")
    expect(area).to_contain_text("Team 2")
    expect(area.get_by_test_id("area-state")).to_have_text("Assigned")
    expect(area.get_by_test_id("coverage")).to_contain_text("%")
    other = open_context(storage_state=owner).new_page()
    other.goto(f"/missions/{mission}")
    other.get_by_test_id("tab-areas").click()
    page.get_by_role("button", name="Mark as searched: North slope").click()
    expect(other.get_by_test_id("area-state")).to_have_text("Searched")
    (drawn,) = api.ask("GET", f"/missions/{mission}/drawings")["drawings"]
    assert len(drawn["points"]) == 4
    assert drawn["radius_m"] == 4
    assert axe.findings(page) == []
    page.get_by_role("button", name="Delete North slope").click()
    page.get_by_role("dialog").get_by_role("button", name="Delete").click()
    expect(other.get_by_test_id("drawing")).to_have_count(0)


def test_an_area_is_drawn_by_keys_alone(opened, api, mission):
    page = opened
    page.get_by_test_id("draw-area").focus()
    page.keyboard.press("Enter")
    expect(page.get_by_test_id("map-canvas")).to_be_focused()
    for key in ("Enter", "ArrowRight", "Enter", "ArrowDown", "Enter", "ArrowLeft", "Enter", "Backspace"):
        page.keyboard.press(key)
    expect(page.get_by_test_id("sketch-bar")).to_contain_text("Points: 3")
    page.get_by_test_id("sketch-bar").get_by_role("button", name="Done").press("Enter")
    save(page, "Corner")
    expect(page.get_by_test_id("drawing")).to_contain_text("Corner")
    (drawn,) = api.ask("GET", f"/missions/{mission}/drawings")["drawings"]
    assert len(drawn["points"]) == 3


def test_a_crossing_outline_stays_in_the_dialog(opened):
    page = opened
    page.context.watch.expect(400)
    page.get_by_test_id("draw-area").click()
    click_on_map(page, (0.2, 0.3), (0.8, 0.7), (0.8, 0.3), (0.2, 0.7))
    page.get_by_test_id("sketch-bar").get_by_role("button", name="Done").click()
    save(page, "Bow tie")
    expect(page.get_by_test_id("error-message")).to_contain_text("crosses")
    page.get_by_role("textbox", name="Points").fill("50.0771, 14.4175\n50.0771, 14.4181\n50.0775, 14.4181")
    page.get_by_role("button", name="Save").click()
    expect(page.get_by_test_id("drawing")).to_contain_text("Bow tie")


@pytest.mark.parametrize("form", ["geojson", "kml"])
def test_shapes_of_a_file(opened, form):
    page = opened
    if form == "geojson":
        polygon = {"type": "Polygon", "coordinates": [SQUARE]}
        data = json.dumps({"type": "Feature", "geometry": polygon, "properties": {"name": "Yard"}})
    else:
        rows = " ".join(f"{lon},{lat},0" for lon, lat in SQUARE)
        ring = f"<LinearRing><coordinates>{rows}</coordinates></LinearRing>"
        mark = f"<name>Yard</name><Polygon><outerBoundaryIs>{ring}</outerBoundaryIs></Polygon>"
        data = f'<kml xmlns="http://www.opengis.net/kml/2.2"><Placemark>{mark}</Placemark></kml>'
    file = {"name": f"plan.{form}", "mimeType": "text/plain", "buffer": data.encode()}
    page.get_by_test_id("drawing-file").set_input_files(file)
    page.get_by_role("dialog").get_by_role("button", name="Save").click()
    expect(page.get_by_test_id("drawing")).to_contain_text("Yard")
    page.get_by_test_id("drawing-file").set_input_files({**file, "buffer": b"\x00"})
    expect(page.get_by_text("neither GeoJSON nor KML")).to_be_visible()


def test_lines_are_measured_and_visitors_see_all_of_it(opened, open_context, api, mission):
    page = opened
    page.get_by_test_id("draw-line").click()
    click_on_map(page, (0.3, 0.4), (0.6, 0.4))
    page.get_by_test_id("sketch-bar").get_by_role("button", name="Done").click()
    save(page, "Rope")
    page.get_by_test_id("draw-marker").click()
    click_on_map(page, (0.5, 0.5))
    save(page, "Post", Note="first aid")
    expect(page.get_by_test_id("drawing").first).to_contain_text(" m")
    expect(page.get_by_test_id("drawing").last).to_contain_text("first aid")
    share = api.ask("POST", f"/missions/{mission}/shares", data={"public": False, "photos": False})
    visitor = open_context().new_page()
    visitor.goto(share["url"])
    visitor.get_by_test_id("tab-areas").click()
    expect(visitor.get_by_test_id("drawing")).to_have_count(2)
    expect(visitor.get_by_role("button", name="Delete")).to_have_count(0)
    assert axe.findings(visitor) == []
