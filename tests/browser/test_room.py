"""Room for what people look at: low windows, messages and jobs that cover nothing, cards, long names."""

import itertools
import re

import pytest
from playwright.sync_api import expect

from tests.browser.test_jobs_seen import FAILED

LEAST_PX = 200
LOW = {"width": 683, "height": 384}
"""A window of 1366 x 768 at 200 %."""

WIDE = {"width": 1366, "height": 768}


def overlap(one, two):
    """Return whether two boxes overlap."""
    return all(
        one[at] < two[at] + two[size] and two[at] < one[at] + one[size]
        for at, size in (("x", "width"), ("y", "height"))
    )


@pytest.mark.parametrize("tab", ["edit", "localize"])
def test_in_a_low_window_the_map_has_a_least_height_and_the_page_scrolls(make_page, tab):
    page = make_page(2, placed=True).page
    page.set_viewport_size(LOW)
    page.goto(re.sub("/[a-z]+$", f"/{tab}", page.url))
    box = page.locator("#map-canvas").bounding_box()
    assert box["height"] >= LEAST_PX
    expect(page.get_by_role("link", name="Missions")).to_be_in_viewport()
    assert page.evaluate("document.documentElement.scrollHeight > innerHeight + 100")
    page.evaluate("window.scrollTo(0, 9999)")
    assert page.evaluate("window.scrollY > 100")


def assert_page_scrolls(page):
    assert page.evaluate("document.documentElement.scrollHeight > innerHeight + 20")
    page.evaluate("window.scrollTo(0, 9999)")
    assert page.evaluate("window.scrollY > 10")


@pytest.mark.parametrize("width", [683, 1000])
def test_in_a_low_window_nothing_covers_the_map_of_a_mission(page, api, width):
    mission = api.ask("POST", "/missions", data={"name": f"Low {width}"})["id"]
    place = {"type": "pose", "time": 1_760_000_000, "lat": 50.0772, "lon": 14.4175}
    records = [place, {**place, "time": place["time"] + 9, "lat": 50.0774}]
    api.ask("POST", f"/missions/{mission}/batches", data={"sender": "robot", "first": 0, "records": records})
    page.set_viewport_size({"width": width, "height": 384})
    page.goto(f"/missions/{mission}")
    page.get_by_test_id("track").wait_for()
    boxes = [page.locator(part).bounding_box() for part in ("#map-canvas", ".mi-time", "#panel")]
    assert boxes[0]["height"] >= LEAST_PX
    assert not any(overlap(*pair) for pair in itertools.combinations(boxes, 2))
    assert_page_scrolls(page)


@pytest.mark.parametrize(("locale", "tab"), [("de", "edit"), ("fr", "quality"), ("de", "settings")])
def test_tabs_without_room_are_not_cut_through_words(open_context, owner, sample_map, locale, tab):
    options = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}
    page = open_context(storage_state=owner, locale=locale, **options).new_page()
    page.goto(f"/maps/{sample_map}/{tab}")
    expect(page.locator(".tabs [data-cut]").first).to_be_attached()
    left, right = page.locator(".tabs").evaluate("bar => [bar.scrollLeft > 1, bar.hasAttribute('data-more')]")
    seen = page.locator(".tabs a:not([data-cut]):visible").evaluate_all(
        "tabs => tabs.map((tab) => tab.getBoundingClientRect()).map(({ left, right }) => [left, right])"
    )
    assert len(seen) >= 3
    assert min(start for start, _ in seen) >= (28 if left else 0)
    assert max(end for _, end in seen) <= 391 - (28 if right else 0)
    expect(page.locator(".tabs [aria-current=page]")).not_to_have_attribute("data-cut", "")


def test_jobs_are_slim_lines_and_messages_are_over_the_image(make_page):
    edit = make_page(2, placed=True)
    page = edit.page
    page.set_viewport_size(WIDE)
    running = FAILED | {
        "kind": "index",
        "state": "running",
        "error": None,
        "note": "describing photos",
        "map": edit.slug,
    }

    def with_job(route):
        answer = route.fetch()
        route.fulfill(response=answer, json=answer.json() | {"jobs": [running]})

    page.route(re.compile(r"[?&]since="), with_job)
    job = page.get_by_test_id("job-progress").first
    expect(job).to_have_attribute("data-state", "running")
    assert page.locator("#activity").bounding_box()["height"] <= 64
    edit.tray.first.click()
    page.locator("#current-remove").click()
    message = page.locator(".toast").first
    expect(message).to_be_visible()
    for part in ("#current", "#side"):
        assert not overlap(message.bounding_box(), page.locator(part).bounding_box()), part


def test_a_failed_job_is_low_until_opened_and_its_words_are_whole(make_page):
    edit = make_page(2, placed=True)
    page = edit.page
    page.set_viewport_size(WIDE)
    running = FAILED | {"kind": "satellite-tiles", "state": "running", "error": None, "map": edit.slug}
    jobs = [
        running | {"note": "fetching the tiles of the image"},
        *(
            FAILED | {"id": n, "kind": kind, "map": edit.slug}
            for n, kind in enumerate(("export", "index"), 900)
        ),
    ]

    def with_jobs(route):
        answer = route.fetch()
        route.fulfill(response=answer, json=answer.json() | {"jobs": jobs})

    page.route(re.compile(r"[?&]since="), with_jobs)
    name = page.locator("[data-kind=satellite-tiles] strong")
    expect(name).to_be_visible()
    assert name.evaluate("e => e.scrollWidth <= e.clientWidth && getComputedStyle(e).whiteSpace") == "normal"
    assert page.locator("#activity").bounding_box()["height"] <= 97
    page.locator(".ed-activity__fold").click()
    assert page.locator("#activity").bounding_box()["height"] > 120


def test_the_menu_of_the_header_is_above_a_dialog_over_the_photo(make_page):
    page = make_page(2, placed=True).page
    page.set_viewport_size(WIDE)
    page.locator("#add-menu summary").click()
    page.locator("#plan-button").click()
    expect(page.locator(".ed-dialog--beside")).to_be_visible()
    page.locator(".header .menu summary").last.click()
    out = page.get_by_role("button", name="Sign out")
    on_top = """e => { const {x, y, width, height} = e.getBoundingClientRect();
        return e.contains(document.elementFromPoint(x + width / 2, y + height / 2)); }"""
    assert out.evaluate(on_top)


def test_a_card_shows_the_whole_map_and_two_lines_of_its_name(page, api, sample_folder):
    name = "A map with a name that is much longer than any card is wide " * 2
    slug = api.make_map(name[:118].strip(), satellite=sample_folder / "satellite.png")
    page.goto("/")
    card = page.locator(f"[data-slug='{slug}']")
    picture = card.locator(".map-card__picture").bounding_box()
    image = card.locator("img")
    assert image.evaluate("image => getComputedStyle(image).objectFit") == "contain"
    assert image.bounding_box()["height"] <= picture["height"] + 1
    heading = card.locator("h2")
    line = heading.evaluate("h => parseFloat(getComputedStyle(h).lineHeight)")
    assert heading.bounding_box()["height"] <= 2.1 * line


def test_the_table_of_several_photos_has_short_names_and_no_broken_picture(
    page, sample_map, tmp_path, sample_folder
):
    heic = tmp_path / ("a name that is far too long for a narrow table " * 4 + ".heic")
    heic.write_bytes(b"\0\0\0\x18ftypheic")
    page.context.watch.expect(422)  # it is no photo
    page.goto(f"/maps/{sample_map}/localize")
    page.get_by_test_id("query-input").set_input_files([heic, sample_folder / "queries" / "query_01.jpg"])
    page.get_by_role("button", name="Each separately").click()
    row = page.get_by_test_id("batch-row").first
    expect(row.locator("img")).to_have_count(0)
    expect(row.locator("svg").first).to_be_visible()
    assert row.bounding_box()["height"] < 80


def test_on_a_phone_the_first_map_is_in_sight(page, sample_map):
    page.set_viewport_size({"width": 390, "height": 844})
    page.goto("/")
    first = page.locator(".map-card__picture").first.bounding_box()
    assert first["y"] + first["height"] < 844


@pytest.mark.parametrize("width", [320, 390, 560, 640, 683, 800, 959, 961, 1366])
def test_the_name_of_a_map_keeps_its_room_in_the_header(page, api, sample_folder, width):
    slug = api.make_map(f"A map with quite a long name {width}", satellite=sample_folder / "satellite.png")
    page.set_viewport_size({"width": width, "height": 700})
    page.goto(f"/maps/{slug}/settings")
    assert page.evaluate("document.documentElement.scrollWidth - innerWidth") <= 0
    assert page.locator(".header__map").bounding_box()["width"] >= 80
    expect(page.locator(".header summary").last).to_be_in_viewport(ratio=1)
