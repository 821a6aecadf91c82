"""The pages of missions: a track from a file, a live robot, its objects, the replay."""

import math
import re
import time
from urllib.parse import urlsplit

import pytest
from playwright.sync_api import expect

from tests.browser import axe
from tests.browser.conftest import WORK_MS
from tests.browser.drawn import DRAWN, OF_COLOUR

PHONE = {
    "viewport": {"width": 390, "height": 844},
    "color_scheme": "dark",
    "has_touch": True,
    "is_mobile": True,
}
CUT = "net::ERR_INTERNET_DISCONNECTED"
PLACE = (50.0772, 14.4175)
PATIENCE_S = 60
BEGIN = 1_760_000_000
FIRST = {"id": "a1", "class": "car", "time": BEGIN + 2, "lat": PLACE[0], "lon": PLACE[1], "confidence": 0.9}
SECOND = {
    **FIRST,
    "id": "b2",
    "class": "person",
    "time": BEGIN + 9,
    "lat": PLACE[0] + 2e-4,
    "confidence": 0.4,
}


def pose(n, **more):
    """Return a pose on a circle, one per second."""
    angle = n / 30
    lat, lon = PLACE[0] + 4e-4 * math.sin(angle), PLACE[1] + 6e-4 * math.cos(angle)
    return {"type": "pose", "time": BEGIN + n, "lat": lat, "lon": lon, "height_m": 200 + n / 10, **more}


@pytest.fixture
def mission(api, request):
    """Make a mission and return its id."""
    return api.ask("POST", "/missions", data={"name": request.node.name[:60]})["id"]


@pytest.fixture
def send(api, mission):
    """Send records as a robot does."""
    result = {"next": 0}

    def send(*records):
        result.update(
            api.ask(
                "POST",
                f"/missions/{mission}/batches",
                data={"sender": "robot", "first": result["next"], "records": list(records)},
            )
        )

    return send


def seen(record):
    """Return the record of an object."""
    return {"type": "object", **record}


def by_id(page, id):
    return page.get_by_test_id(id)


def set_moment(page, seconds):
    """Move the slider, as a drag does."""
    by_id(page, "moment").evaluate(
        "(slider, at) => { slider.value = at; slider.dispatchEvent(new Event('input')); }", seconds
    )


def wait_for_pixels(page, fits):
    """Wait until the number of drawn pixels fits; the CSP forbids eval, which Playwright uses."""
    end = time.monotonic() + PATIENCE_S
    while not fits(drawn := page.evaluate(DRAWN)):
        assert time.monotonic() < end, drawn
        page.wait_for_timeout(100)


def settled_pixels(page):
    """Wait until the number of drawn pixels is the same three times in a row, and return it."""
    looks = []

    def fits(count):
        looks.append(count)
        return count >= 300 and looks[-3:] == [count] * 3

    wait_for_pixels(page, fits)
    return looks[-1]


def test_a_robot_under_way_is_seen_live(page, mission, send):
    page.goto(f"/missions/{mission}")
    expect(page.get_by_text("No positions yet", exact=True)).to_be_visible()
    send(*(pose(n) for n in range(40)), seen(FIRST))
    track = by_id(page, "track")
    expect(track).to_contain_text("40")
    expect(page.get_by_text("No positions yet", exact=True)).to_be_hidden()
    expect(by_id(page, "live-state")).to_have_text("Live")
    drawn = settled_pixels(page)
    send(*(pose(n) for n in range(40, 120)), seen(SECOND))
    expect(track).to_contain_text("120")
    # More or fewer: how much of the longer track is in view depends on the moment of the first fit.
    wait_for_pixels(page, lambda count: abs(count - drawn) >= 30)
    page.get_by_role("tab", name=re.compile("Objects")).click()
    expect(by_id(page, "object")).to_have_count(2)
    send({"type": "end"})
    expect(by_id(page, "live-state")).to_have_text("Ended")
    expect(page.get_by_role("button", name="Follow latest")).to_have_attribute("aria-pressed", "false")


@pytest.mark.slow
def test_the_server_away_and_back(page, context, mission, send):
    send(*(pose(n) for n in range(10)))
    page.goto(f"/missions/{mission}")
    expect(by_id(page, "track")).to_contain_text("10")
    context.set_offline(True)
    expect(by_id(page, "live-state")).to_have_text("No connection", timeout=90_000)
    context.set_offline(False)
    send(*(pose(n) for n in range(10, 30)))
    expect(by_id(page, "track")).to_contain_text("30", timeout=90_000)
    context.watch.faults = [fault for fault in context.watch.faults if CUT not in fault]


def test_time_goes_back_and_runs(page, mission, send):
    send(*(pose(n) for n in range(120)))
    page.goto(f"/missions/{mission}")
    wait_for_pixels(page, lambda count: count >= 1200)
    whole = page.evaluate(DRAWN)
    set_moment(page, 30)
    wait_for_pixels(page, lambda count: count < whole * 0.6)
    before = by_id(page, "moment-text").inner_text()
    page.get_by_label("Speed of the replay").select_option("5")
    by_id(page, "play").click()
    expect(by_id(page, "moment-text")).not_to_have_text(before)
    expect(by_id(page, "play")).to_have_accessible_name("Pause")
    by_id(page, "play").click()
    expect(by_id(page, "play")).to_have_accessible_name("Replay")
    page.get_by_role("button", name="Follow latest").click()
    wait_for_pixels(page, lambda count: count >= whole * 0.9)
    expect(by_id(page, "profile-facts")).to_contain_text("Distance")
    page.get_by_role("button", name="Height").click()
    expect(page.get_by_role("button", name="Height")).to_have_attribute("aria-pressed", "true")


def test_the_legend_on_a_phone_is_whole(open_context, owner, mission, send):
    send(*(pose(n, source=source) for n in range(5) for source in ("gps", "odometry", "visual", "manual")))
    page = open_context(storage_state=owner, **PHONE).new_page()
    page.goto(f"/missions/{mission}")
    legend = by_id(page, "legend")
    expect(legend).to_be_hidden()
    by_id(page, "legend-toggle").tap()
    expect(legend).to_contain_text("Visual fixes")
    assert legend.evaluate("one => one.parentElement.scrollWidth - one.parentElement.clientWidth") <= 0
    offer = page.locator("#ground-offer")
    expect(offer).to_be_visible()
    shown, whole = legend.locator("..").bounding_box(), page.locator("#map-canvas").bounding_box()
    assert offer.bounding_box()["y"] > shown["y"] + shown["height"]
    assert shown["width"] * shown["height"] <= whole["width"] * whole["height"] / 4


def test_colours_have_a_legend(page, mission, send):
    send(*(pose(n) for n in range(60)), *(pose(n, source="odometry") for n in range(60)))
    page.goto(f"/missions/{mission}")
    legend = by_id(page, "legend")
    expect(legend).to_contain_text("GPS")
    expect(legend).to_contain_text("Odometry")
    by_id(page, "colour-by").select_option("speed")
    expect(legend).to_contain_text("m/s")
    by_id(page, "colour-by").select_option("time")
    expect(legend).not_to_contain_text("m/s")
    by_id(page, "track").filter(has_text="Odometry").get_by_role("checkbox").uncheck()
    by_id(page, "colour-by").select_option("source")
    expect(legend).not_to_contain_text("Odometry")


def pixels_of(page, colour):
    """Count the pixels of the map that have a colour, `#rrggbb`."""
    return page.evaluate(OF_COLOUR, colour)


def test_a_track_is_named_and_coloured_for_all_from_the_legend(open_context, owner, page, api, mission, send):
    send(*(pose(n) for n in range(60)), *(pose(n, source="odometry") for n in range(20)), seen(FIRST))
    share = api.ask("POST", f"/missions/{mission}/shares", data={})
    page.goto(f"/missions/{mission}")
    visitor = open_context().new_page()
    visitor.goto(share["url"])
    legend = by_id(page, "legend")
    expect(legend).to_contain_text("car")
    expect(by_id(visitor, "legend")).to_contain_text("Odometry")
    expect(by_id(visitor, "track-look")).to_have_count(0)
    settled_pixels(page)
    assert pixels_of(page, "#d55e00") == 0

    legend.get_by_role("button", name="Name and colour of GPS").click()
    by_id(page, "track-title").fill("Team 2")
    page.get_by_text("Vermilion", exact=True).locator("xpath=..").click()
    by_id(page, "track-width").fill("8")
    by_id(page, "track-look-save").click()
    expect(legend).to_contain_text("Team 2")
    expect(by_id(page, "track").first).to_contain_text("Team 2")
    expect(legend.get_by_role("button", name="Name and colour of Team 2")).to_be_focused()
    wait_for_pixels(page, lambda _: pixels_of(page, "#d55e00") > 300)
    expect(by_id(visitor, "legend")).to_contain_text("Team 2")

    legend.get_by_role("button", name="Name and colour of Odometry").click()
    by_id(page, "track-shown").uncheck()
    by_id(page, "track-look-save").click()
    expect(by_id(visitor, "legend")).not_to_contain_text("Odometry")
    visitor.get_by_role("checkbox", name="Odometry").check()
    expect(by_id(visitor, "legend")).to_contain_text("Odometry")
    page.get_by_role("button", name="Undo").last.click()
    expect(legend).to_contain_text("Odometry")

    by_id(page, "track").first.get_by_role("button", name="Name and colour of Team 2").click()
    page.get_by_role("button", name="Reset").click()
    expect(legend).not_to_contain_text("Team 2")
    wait_for_pixels(page, lambda _: pixels_of(page, "#d55e00") == 0)
    expect(by_id(visitor, "legend")).not_to_contain_text("Team 2")


def test_objects_are_filtered_sorted_and_looked_at(page, mission, send):
    moved = {**FIRST, "time": BEGIN + 20, "lon": PLACE[1] + 3e-4}
    send(*(pose(n) for n in range(60)), seen(FIRST), seen(SECOND), seen(moved))
    page.goto(f"/missions/{mission}")
    by_id(page, "tab-objects").click()
    rows = by_id(page, "object")
    expect(rows).to_have_count(2)
    expect(rows.first).to_contain_text("a1")  # seen last
    page.get_by_role("button", name="Class", exact=True).click()
    expect(rows.first).to_contain_text("car")
    page.get_by_role("button", name="Class", exact=True).click()
    expect(rows.first).to_contain_text("person")
    by_id(page, "object-filter").fill("a1")
    expect(rows).to_have_count(1)
    by_id(page, "object-filter").fill("")
    page.get_by_label("Class", exact=True).select_option("person")
    expect(rows).to_have_count(1)
    page.get_by_label("Class", exact=True).select_option("")
    page.get_by_role("button", name="a1").click()
    card = by_id(page, "object-card")
    expect(card).to_contain_text("2 times")
    expect(card).to_contain_text("Moved")
    assert axe.findings(page) == []
    card.get_by_role("button", name="Close").click()
    expect(card).to_be_hidden()


def test_two_missions_over_each_other(page, api, mission, send):
    send(*(pose(n) for n in range(60)))
    other = api.ask("POST", "/missions", data={"name": "the other round"})["id"]
    records = [{**pose(n), "time": BEGIN + 86_400 * 30 + n} for n in range(90)]
    api.ask("POST", f"/missions/{other}/batches", data={"sender": "x", "first": 0, "records": records})
    page.goto(f"/missions/{mission}")
    page.get_by_role("button", name="Overlay another mission").click()
    page.get_by_role("dialog").get_by_role("button", name="the other round").click()
    expect(by_id(page, "track")).to_have_count(2)
    expect(page).to_have_url(re.compile(f"with={other}"))
    # they are a month apart, so they are aligned to begin together
    expect(by_id(page, "moment")).to_have_attribute("max", "89")
    by_id(page, "colour-by").select_option("mission")
    expect(by_id(page, "legend")).to_contain_text("the other round")
    page.reload()
    expect(by_id(page, "track")).to_have_count(2)
    page.get_by_role("button", name="Remove the other round").click()
    expect(by_id(page, "track")).to_have_count(1)


def test_a_track_from_a_file(page, tmp_path):
    points = "".join(
        f'<trkpt lat="{pose(n)["lat"]}" lon="{pose(n)["lon"]}"><ele>{200 + n}</ele>'
        f"<time>2026-05-01T10:{n // 60:02}:{n % 60:02}Z</time></trkpt>"
        for n in range(90)
    )
    head = '<gpx version="1.1" creator="test" xmlns="http://www.topografix.com/GPX/1/1">'
    track = tmp_path / "morning walk.gpx"
    track.write_text(f"{head}<trk><trkseg>{points}</trkseg></trk></gpx>", encoding="utf-8")
    page.goto("/missions")
    by_id(page, "import-track").click()
    assert axe.findings(page) == []
    by_id(page, "track-file").set_input_files(track)
    expect(by_id(page, "import-file")).to_contain_text("90 positions")
    by_id(page, "import-start").click()
    page.wait_for_url(re.compile(r"/missions/\d+$"), timeout=WORK_MS)
    expect(page.get_by_role("heading", level=1)).to_have_text("morning walk")
    expect(by_id(page, "track")).to_contain_text("90")
    wait_for_pixels(page, lambda count: count >= 300)
    page.goto("/missions")
    expect(by_id(page, "mission").filter(has_text="morning walk")).to_contain_text("90 positions")


def test_a_track_without_times_shows_no_speed(page, tmp_path):
    points = "".join(
        f'<trkpt lat="{pose(n)["lat"]}" lon="{pose(n)["lon"]}"><ele>{200 + n}</ele></trkpt>'
        for n in range(0, 180, 2)
    )
    head = '<gpx version="1.1" creator="test" xmlns="http://www.topografix.com/GPX/1/1">'
    track = tmp_path / "drawn route.gpx"
    track.write_text(f"{head}<trk><trkseg>{points}</trkseg></trk></gpx>", encoding="utf-8")
    page.goto("/missions")
    by_id(page, "import-track").click()
    by_id(page, "track-file").set_input_files(track)
    by_id(page, "import-start").click()
    page.wait_for_url(re.compile(r"/missions/\d+$"), timeout=WORK_MS)
    expect(by_id(page, "track")).to_contain_text("only the order")
    wait_for_pixels(page, lambda count: count >= 300)
    facts = page.locator("#profile-facts")
    expect(facts).to_contain_text("Climb")
    assert not re.search("km/h|m/s|Duration", facts.inner_text() + by_id(page, "track").inner_text())
    expect(page.locator("[data-quantity=speed]")).to_be_disabled()
    colours = by_id(page, "colour-by")
    for mode in ("time", "speed"):
        colours.select_option(mode)
        wait_for_pixels(page, lambda count: count >= 300)


def test_a_file_that_is_no_track_is_reported(page, context, tmp_path):
    context.watch.expect(422)
    track = tmp_path / "hollow file.gpx"
    track.write_text("no track", encoding="utf-8")
    page.goto("/missions")
    by_id(page, "import-track").click()
    by_id(page, "track-file").set_input_files(track)
    expect(by_id(page, "import-line")).to_contain_text("no known format")
    expect(by_id(page, "import-start")).to_be_hidden()
    page.goto("/missions")
    expect(page.locator("#loading")).to_be_hidden()
    expect(by_id(page, "mission").filter(has_text="hollow file")).to_have_count(0)


def test_what_was_left_out_is_said_before_the_mission_opens(page, context, tmp_path):
    track = tmp_path / "patchy walk.csv"
    rows = "".join(f"{1777629600 + n},{50 + n * 1e-5:.5f},14\n" for n in range(30))
    track.write_text(f"time,lat,lon\n{rows}1777629700,,14\n-100000000,50,14\n", encoding="utf-8")
    page.goto("/missions")
    by_id(page, "import-track").click()
    hollow = tmp_path / "hollow file.gpx"
    hollow.write_text("no track", encoding="utf-8")
    context.watch.expect(422)
    by_id(page, "track-file").set_input_files([track, hollow])
    by_id(page, "import-start").click()
    remarks = by_id(page, "import-remarks")
    expect(remarks).to_contain_text("Rows without a position (1)", timeout=WORK_MS)
    expect(remarks).to_contain_text("dated before 1980")
    expect(remarks).to_contain_text("hollow file.gpx")
    expect(remarks).to_contain_text("no known format")
    assert axe.findings(page) == []
    page.get_by_role("button", name="Done").click()
    page.wait_for_url(re.compile(r"/missions/\d+$"))


def test_on_the_image_of_a_map(page, api, sample_map):
    state = api.state(sample_map)
    places = [place for place in state["georeference"]["latlon_grid"]["latlon"] if place]
    lat, lon = places[len(places) // 2]
    made = api.ask("POST", "/missions", data={"name": "in the park", "map": sample_map})["id"]
    records = [{**pose(n), "lat": lat + n * 2e-6, "lon": lon} for n in range(50)]
    api.ask("POST", f"/missions/{made}/batches", data={"sender": "x", "first": 0, "records": records})
    page.goto(f"/missions/{made}")
    wait_for_pixels(page, lambda count: count >= 100)
    assert page.locator("#map-canvas .leaflet-image-layer, #map-canvas .leaflet-tile").count() > 0
    page.get_by_label("Background").select_option("plain")
    wait_for_pixels(page, lambda count: count >= 100)
    pictures = page.locator("#map-canvas .leaflet-image-layer, #map-canvas .leaflet-tile")
    assert pictures.count() == 0
    api.ask("PATCH", f"/missions/{made}", data={"map": None})
    page.evaluate("localStorage.clear()")
    page.reload()
    expect(page.get_by_label("Background")).to_have_value(f"map:{sample_map}")
    expect(pictures).not_to_have_count(0)
    page.context.watch.expect(404)
    page.route(f"**/api/v1/maps/{sample_map}", lambda route: route.fulfill(status=404))
    page.reload()
    expect(page.get_by_label("Background")).to_have_value("plain")
    wait_for_pixels(page, lambda count: count >= 100)


def test_tiles_are_offered_with_where_they_come_from(page, context, mission, send, tiles):
    send(*(pose(n) for n in range(60)))
    context.watch.allow(f"http://127.0.0.1:{tiles.port}")
    asked = []
    page.on("request", lambda request: asked.append(request.url))
    page.goto(f"/missions/{mission}")
    offer = by_id(page, "ground-offer")
    host = urlsplit(tiles.url).netloc
    expect(offer).to_contain_text(f"A background map would be fetched from {host}.")
    assert axe.findings(page) == [] and not any(host in url for url in asked)
    offer.get_by_role("button", name="Show a background map").click()
    expect(page.locator("#map-canvas .leaflet-tile")).not_to_have_count(0)
    expect(offer).to_be_hidden()


def test_new_mission_renamed_and_into_the_bin(page):
    page.goto("/missions")
    by_id(page, "new-mission").click()
    by_id(page, "mission-name").fill("First try")
    page.get_by_role("button", name="Create").click()
    page.wait_for_url(re.compile(r"/missions/\d+$"))
    page.get_by_label("More", exact=True).click()
    page.get_by_role("button", name="Rename").click()
    page.get_by_role("dialog").get_by_label("Name").fill("Second try")
    with page.expect_navigation():
        page.get_by_role("dialog").get_by_role("button", name="Rename").click()
    expect(page.get_by_role("heading", level=1)).to_have_text("Second try")
    page.get_by_label("More", exact=True).click()
    page.get_by_role("button", name="Move to the bin").click()
    page.get_by_role("dialog").get_by_role("button", name="Move to the bin").click()
    page.wait_for_url("**/missions")
    page.goto("/missions/bin")
    expect(by_id(page, "mission").filter(has_text="Second try")).to_be_visible()
    page.get_by_role("button", name="Delete Second try permanently").click()
    page.get_by_role("dialog").get_by_role("button", name="Delete permanently").click()
    expect(by_id(page, "mission").filter(has_text="Second try")).to_have_count(0)


def test_a_long_list_comes_in_pages(page, api):
    for number in range(53):
        api.ask("POST", "/missions", data={"name": f"round {number:02}"})
    page.goto("/missions")
    entries, more = by_id(page, "mission"), by_id(page, "more-missions")
    expect(entries).to_have_count(50)
    assert axe.findings(page) == []
    while more.is_visible():
        before = entries.count()
        more.click()
        expect(entries.nth(before).get_by_role("link").first).to_be_focused()
    names = entries.get_by_role("heading").all_inner_texts()
    rounds = [name for name in names if re.fullmatch(r"round \d\d", name)]
    assert rounds == [f"round {number:02}" for number in reversed(range(53))]


def test_missions_are_searched_sorted_and_put_into_the_bin_together(page, api):
    made = [api.ask("POST", "/missions", data={"name": f"Žleb {number}"})["id"] for number in (10, 2)]
    way = [pose(n) for n in range(30)]
    api.ask("POST", f"/missions/{made[0]}/batches", data={"sender": "x", "first": 0, "records": way})
    for number in range(51):
        api.ask("POST", "/missions", data={"name": f"later {number:02}"})
    page.goto("/missions")
    expect(by_id(page, "mission")).to_have_count(50)
    page.context.watch.expect(429)
    page.route("**/api/v1/missions?*", lambda route: route.fulfill(status=429), times=1)
    by_id(page, "list-search").fill("z")
    expect(by_id(page, "error-message")).to_be_visible()
    asked = []
    page.on("request", lambda request: "/api/v1/missions?" in request.url and asked.append(request.url))
    by_id(page, "list-search").fill("zleb")
    shown = page.locator("[data-testid=mission]:not([hidden])")
    expect(shown.get_by_role("heading")).to_have_text(["Žleb 10", "Žleb 2"])
    expect(shown.first.locator(".map-card__line").first).to_be_attached()
    assert all("search=" in url and "limit=" in url for url in asked), "the server searches"
    by_id(page, "list-search").fill("nowhere")
    expect(by_id(page, "mission")).to_have_count(0)
    expect(page.get_by_text("No mission is called that.")).to_be_visible()
    by_id(page, "list-search").fill("")
    expect(by_id(page, "mission")).to_have_count(50)
    by_id(page, "list-search").fill("zleb")
    expect(shown).to_have_count(2)
    bar = by_id(page, "list-bar")
    page.get_by_role("button", name="Select", exact=True).click()
    bar.get_by_role("button", name="Select all").click()
    bar.get_by_role("button", name="Move to the bin").click()
    expect(shown).to_have_count(0)
    by_id(page, "list-search").fill("nowhere")
    expect(page.get_by_text("No mission is called that.")).to_be_visible()
    page.get_by_role("button", name="Undo").click()
    expect(page.get_by_role("button", name="Undo")).to_have_count(0)
    expect(page.get_by_text("No mission is called that.")).to_be_visible()  # they do not match it
    expect(shown).to_have_count(0)
    by_id(page, "list-search").fill("zleb")
    expect(shown).to_have_count(2)
    page.get_by_role("button", name="Select", exact=True).click()
    page.get_by_label("Sort", exact=True).select_option("name")
    expect(shown.get_by_role("heading")).to_have_text(["Žleb 2", "Žleb 10"])
    page.get_by_label("Sort", exact=True).select_option("length")
    expect(shown.get_by_role("heading")).to_have_text(["Žleb 10", "Žleb 2"])
    page.get_by_role("button", name="Select", exact=True).click()
    bar.get_by_role("button", name="Select all").click()
    expect(bar).to_contain_text("2 selected")
    bar.get_by_role("button", name="Move to the bin").click()
    expect(shown).to_have_count(0)
    assert {one["id"] for one in api.ask("GET", "/missions?bin=1")["missions"]} >= set(made)
    page.get_by_role("button", name="Undo").click()
    expect(shown.get_by_role("heading")).to_have_text(["Žleb 10", "Žleb 2"])
    assert {one["id"] for one in api.ask("GET", "/missions")["missions"]} >= set(made)


@pytest.mark.parametrize("look", [{}, PHONE], ids=["wide-light", "phone-dark"])
def test_nothing_to_stumble_over(open_context, owner, look, mission, send):
    send(*(pose(n) for n in range(60)), seen(FIRST), seen(SECOND))
    page = open_context(storage_state=owner, reduced_motion="reduce", **look).new_page()
    for path in ("/missions", f"/missions/{mission}", "/missions/bin"):
        page.goto(path)
        if str(mission) in path:
            wait_for_pixels(page, lambda count: count >= 100)
        else:
            expect(page.locator("#loading")).to_be_hidden()
        assert axe.findings(page) == []
        assert page.evaluate("document.documentElement.scrollWidth - innerWidth") <= 0
        assert page.locator("h1").count() == 1


def test_a_fusion_that_failed_is_still_shown_after_a_reload_until_it_is_dismissed(page, api, mission, send):
    send(*(pose(n) for n in range(20)))
    failed = {"state": "failed", "kind": "mission-fuse", "error": {"message": "too few fixes", "hint": None}}

    def with_job(route):
        answer = route.fetch()
        route.fulfill(response=answer, body=answer.text().replace('"fusion": null', '"fusion": 987654'))

    page.route(f"**/missions/{mission}", with_job)
    page.route("**/api/v1/jobs/987654", lambda route: route.fulfill(json={"id": 987654, **failed}))
    page.goto(f"/missions/{mission}")
    message = page.locator("#panel").get_by_test_id("error-message")
    expect(message).to_contain_text("Too few fixes")
    assert axe.findings(page) == []
    message.get_by_role("button", name="Dismiss").click()
    page.reload()
    expect(page.locator("#tracks")).not_to_be_empty()
    expect(message).to_have_count(0)


def test_fusion_asks_which_of_several_odometries_is_meant(page, api, mission, send):
    """The chosen one is corrected, not the longest."""
    page.context.watch.expect(400)  # by which the server asks
    moving = [pose(n) for n in range(20)]
    for name, step in (("wheels", 1e-5), ("visual", 2e-5)):
        send(
            *(
                {**one, "source": "odometry", "track": name, "lon": PLACE[1] + n * step}
                for n, one in enumerate(moving)
            )
        )
    send(*moving)
    page.goto(f"/missions/{mission}")
    page.locator('[data-does="fuse"]').first.click()
    question = page.get_by_role("dialog", name="Correct the track?")
    expect(question).to_contain_text("Odometry and GPS")
    question.get_by_role("button", name="Correct").click()
    dialog = page.get_by_role("dialog", name="Which odometry?")
    options = dialog.get_by_role("option")
    expect(options).to_have_count(2)
    dialog.get_by_role("combobox").select_option(label=options.filter(has_text="wheels").inner_text())
    dialog.get_by_role("button", name="Correct").click()
    expect(page.get_by_role("checkbox", name="Corrected")).to_be_visible(timeout=WORK_MS)
    assert api.ask("GET", f"/missions/{mission}/fusion")["odometry_name"] == "wheels"
    page.get_by_role("group", name="Tools").get_by_label("More").click()
    page.get_by_role("button", name="Remove the corrected track").click()
    page.get_by_role("dialog").get_by_role("button", name="Remove").click()
    expect(page.get_by_role("checkbox", name="Corrected")).to_have_count(0)
    expect(page.locator('[data-does="unfuse"]')).to_be_hidden()


def test_a_distance_is_measured(page, mission, send):
    send(*(pose(n) for n in range(120)), seen({**FIRST, "time": BEGIN}))
    page.goto(f"/missions/{mission}")
    settled_pixels(page)
    page.keyboard.press("d")
    bar = by_id(page, "measure-bar")
    expect(bar).to_be_visible()
    box = by_id(page, "map-canvas").bounding_box()
    x, y = box["x"] + box["width"] / 2, box["y"] + box["height"] / 2
    places = [(x - 150, y - 60), (x + 150, y - 60), (x + 150, y + 60)]
    for place in places:
        page.mouse.click(*place)
    expect(page.locator(".ed-measure-point")).to_have_count(3)
    length = page.locator("#measure-length")
    whole = float(length.inner_text().split()[0])
    leg, bearing = re.fullmatch(
        r"last leg ([\d.]+) m, (\d+)°", by_id(page, "measure-leg").inner_text()
    ).groups()
    assert float(leg) / whole == pytest.approx(120 / 420, abs=0.01)
    assert int(bearing) == pytest.approx(180, abs=1)
    assert axe.findings(page) == []
    expect(by_id(page, "object-card")).to_be_hidden()  # clicks measure, they choose nothing
    page.get_by_role("button", name="Remove the last point").click()
    expect(by_id(page, "measure-leg")).to_have_text("90°")
    by_id(page, "map-canvas").focus()
    page.keyboard.press("Enter")
    expect(page.locator(".ed-measure-point")).to_have_count(3)
    page.keyboard.press("Escape")
    expect(bar).to_be_hidden()
    expect(page.locator(".ed-measure-point")).to_have_count(0)
    expect(page.get_by_role("button", name="Measure a distance")).to_have_attribute("aria-pressed", "false")


def test_the_last_position_with_its_accuracy_in_the_chosen_form(page, mission, send):
    send(*(pose(n) for n in range(20)), pose(20, covariance=[9, 36, 0]))
    page.goto(f"/missions/{mission}")
    track = by_id(page, "track")
    expect(track).to_contain_text("± 9.06 m × 4.53 m (68\u00a0%)")
    expect(track).to_contain_text("° N")
    page.locator("header summary:not(#jobs-menu-button)").click()
    page.get_by_role("group", name="Positions").get_by_role("button", name="UTM").click()
    expect(track).to_contain_text(re.compile(r"33U \d{6} \d{7}"))
