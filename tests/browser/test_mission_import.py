"""Import of files with tracks into a mission: contents, preview of positions, and results."""

import math
import re

import pytest
from playwright.sync_api import expect

from tests.browser import axe

PHONE = {
    "viewport": {"width": 390, "height": 844},
    "color_scheme": "dark",
    "has_touch": True,
    "is_mobile": True,
}
BEGIN = 1_777_629_600
JOBS_MS = 240_000
"""Timeout; the worker may be busy with the index of the sample."""


def by_id(page, id):
    return page.get_by_test_id(id)


@pytest.fixture
def way(tmp_path):
    """Return a straight track of 29 m in the robot frame, starting at (5, 5)."""
    path = tmp_path / "rover way.tum"
    path.write_text("".join(f"{BEGIN + n} {5 + n} 5 0 0 0 0 1\n" for n in range(30)), encoding="utf-8")
    return path


@pytest.fixture
def middle(api, sample_map):
    """Return the latitude and longitude of the middle of the sample's image."""
    grid = api.state(sample_map)["georeference"]["latlon_grid"]
    assert grid["columns"] % 2 == grid["rows"] % 2 == 0
    return grid["latlon"][len(grid["latlon"]) // 2]


def point(page, dx, dy):
    """Return a position on the preview by its offset from the middle, pixels."""
    box = by_id(page, "import-picture").bounding_box()
    return box["x"] + box["width"] / 2 + dx, box["y"] + box["height"] / 2 + dy


def values(page):
    return [by_id(page, f"import-start-{place}").input_value() for place in range(3)]


@pytest.mark.parametrize("look", [{}, PHONE], ids=["wide-light", "phone-dark"])
def test_a_track_in_metres_lies_where_it_was_clicked(open_context, owner, api, sample_map, way, middle, look):
    page = open_context(storage_state=owner, reduced_motion="reduce", **look).new_page()
    press = page.touchscreen.tap if look else page.mouse.click
    mission = api.ask("POST", "/missions", data={"name": "clicked", "map": sample_map})["id"]
    page.goto(f"/missions/{mission}")
    page.get_by_role("button", name="Import a file").click()
    by_id(page, "track-file").set_input_files(way)
    hint = by_id(page, "import-hint")
    expect(hint).to_have_text("Click where the robot started.")
    expect(by_id(page, "import-source")).to_be_checked()
    by_id(page, "import-start").click()
    expect(by_id(page, "error-message")).to_contain_text("rover way.tum are in metres")
    press(*point(page, 0, 0))
    expect(hint).to_have_text("Click in the direction it was facing.")
    by_id(page, "import-start").click()
    expect(by_id(page, "error-message")).to_contain_text("The start also needs a heading")
    assert axe.findings(page) == []
    assert page.evaluate("document.documentElement.scrollWidth - innerWidth") <= 0
    press(*point(page, 60, 0))
    expect(hint).to_contain_text("Drag")
    lat, lon, heading = map(float, values(page))
    assert (lat, lon) == pytest.approx(middle, abs=5e-6)
    assert heading == pytest.approx(90, abs=3), "to the right: the image is north up"
    by_id(page, "import-start").click()
    expect(page.get_by_role("dialog")).to_have_count(0, timeout=JOBS_MS)
    expect(by_id(page, "track")).to_contain_text("30")
    (track,) = api.ask("GET", f"/missions/{mission}")["tracks"]
    last = track["last"]
    assert last["heading_deg"] == pytest.approx(heading, abs=0.1)
    assert last["lat"] == pytest.approx(middle[0], abs=2e-5)
    metres_east = (last["lon"] - middle[1]) * 111_320 * math.cos(math.radians(lat))
    assert metres_east == pytest.approx(29, abs=0.5)


def test_several_files_each_with_its_result(page, context, tmp_path, way, middle):
    context.watch.expect(422, 400)
    lat, lon = middle
    rows = "".join(f"{BEGIN + n};{lat + n * 2e-5:.6f};{lon:.6f}\n" for n in range(30))
    logger, hollow = tmp_path / "logger.csv", tmp_path / "hollow.gpx"
    logger.write_text(f"sekunden;breite gps;laenge gps\n{rows}{BEGIN + 99};;\n", encoding="utf-8")
    hollow.write_text("no track", encoding="utf-8")
    page.goto("/missions")
    by_id(page, "import-track").click()
    by_id(page, "track-file").set_input_files([logger, hollow, way])
    expect(by_id(page, "import-problem")).to_contain_text("No columns of positions")
    expect(page.get_by_role("group", name="Files")).to_contain_text("no known format")
    by_id(page, "column-time").select_option("1")
    by_id(page, "column-lat").select_option("2")
    expect(by_id(page, "reading-error")).to_contain_text("Only one of the two coordinates")
    by_id(page, "import-start").click()
    expect(by_id(page, "error-message")).to_contain_text("Cannot read logger.csv like this")
    by_id(page, "column-lon").select_option("3")
    expect(by_id(page, "import-source")).to_have_count(1)
    expect(by_id(page, "import-file")).to_contain_text("30 positions")
    page.get_by_label("Map", exact=True).select_option("sample")
    expect(by_id(page, "import-picture").locator("img")).not_to_have_count(0)
    by_id(page, "import-start").click()
    expect(by_id(page, "error-message")).to_contain_text("rover way.tum are in metres")
    for place, value in enumerate((lat, lon, 90)):
        by_id(page, f"import-start-{place}").fill(str(value))
    assert axe.findings(page) == []
    by_id(page, "import-name").fill("Both rounds")
    by_id(page, "import-start").click()
    lines = by_id(page, "import-remarks").get_by_test_id("import-line")
    expect(lines.nth(0)).to_contain_text("30 positions", timeout=JOBS_MS)
    expect(lines.nth(2)).to_contain_text("30 positions", timeout=JOBS_MS)
    expect(lines.nth(1)).to_contain_text("no known format")
    expect(by_id(page, "import-remarks")).to_contain_text("Rows without a position (1)")
    assert axe.findings(page) == []
    page.get_by_role("button", name="Done").click()
    page.wait_for_url(re.compile(r"/missions/\d+$"))
    expect(page.get_by_role("heading", level=1)).to_have_text("Both rounds")
    expect(by_id(page, "track")).to_have_count(2)


def test_what_is_not_ticked_stays_out(page, tmp_path):
    rows = [
        f"{BEGIN + n},{50 + n * 1e-5:.6f},{14 + k / 1e3},{name}\n"
        for k, name in enumerate("ab")
        for n in range(9)
    ]
    table = tmp_path / "two tracks.csv"
    table.write_text("time,lat,lon,track\n" + "".join(rows), encoding="utf-8")
    page.goto("/missions")
    by_id(page, "import-track").click()
    by_id(page, "track-file").set_input_files(table)
    ticks = by_id(page, "import-source")
    expect(ticks).to_have_count(2)
    ticks.nth(0).uncheck()
    ticks.nth(1).uncheck()
    by_id(page, "import-start").click()
    expect(by_id(page, "error-message")).to_contain_text("Nothing selected in two tracks.csv")
    ticks.nth(1).check()
    by_id(page, "import-start").click()
    page.wait_for_url(re.compile(r"/missions/\d+$"), timeout=JOBS_MS)
    expect(by_id(page, "track")).to_have_count(1)
    expect(by_id(page, "track")).to_contain_text("two tracks b")


def test_a_closed_dialog_leaves_nothing_behind(page, app, way):
    waiting = app.library / ".library" / "uploads"
    before = set(waiting.glob("*.track"))
    page.goto("/missions")
    by_id(page, "import-track").click()
    by_id(page, "track-file").set_input_files(way)
    expect(by_id(page, "import-hint")).to_contain_text("In metres from the start")
    assert len(set(waiting.glob("*.track")) - before) == 1
    with page.expect_response(lambda answer: answer.request.method == "DELETE") as deleted:
        page.get_by_role("dialog").get_by_role("button", name="Cancel").click()
    assert deleted.value.status == 204
    assert set(waiting.glob("*.track")) == before
