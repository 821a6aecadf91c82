"""The list of maps: make, rename, copy, bin and restore, delete for good."""

import re

import pytest
from playwright.sync_api import expect

from tests.browser import axe

KEEP_MESSAGES = """
const real = setTimeout;
window.setTimeout = (run, ms = 0, ...given) => (ms > 5000 ? 0 : real(run, ms, ...given));
"""
"""Keep messages with Undo open, however slow the machine is."""


def card(page, name):
    """Return the card of a map in the list."""
    return page.locator("[data-slug]").filter(has_text=name)


def choose(page, name, action):
    """Choose from the menu of a map."""
    card(page, name).locator("summary").click()
    card(page, name).get_by_role("button", name=action).click()


def test_a_map_is_made_by_its_name(page, api):
    page.goto("/")
    page.get_by_test_id("new-map").click()
    page.get_by_test_id("map-name").fill("Zámecký park")
    page.keyboard.press("Enter")
    page.wait_for_url("**/maps/*/edit")
    slug = page.url.split("/")[-2]
    assert re.fullmatch(r"[a-z0-9-]+", slug)
    assert api.state(slug)["name"] == "Zámecký park"


def test_a_map_without_a_name_is_not_made(page):
    page.goto("/")
    page.get_by_test_id("new-map").click()
    page.get_by_test_id("map-name").fill("   ")
    page.context.watch.expect(400, 422)
    page.get_by_role("button", name="Create without photos").click()
    expect(page.get_by_test_id("error-message")).to_be_visible()


def test_a_map_goes_to_the_bin_and_comes_back(page, api, sample_folder):
    slug = api.make_map("Goes and comes", satellite=sample_folder / "satellite.png")
    page.goto("/")
    choose(page, "Goes and comes", "Move to the bin")
    expect(card(page, "Goes and comes")).to_have_count(0)
    expect(page.get_by_text("1 map is in the bin.")).to_be_visible()
    page.goto("/bin")
    card(page, "Goes and comes").get_by_role("button", name="Restore").click()
    expect(card(page, "Goes and comes")).to_have_count(0)
    page.goto("/")
    expect(card(page, "Goes and comes")).to_have_count(1)
    assert api.state(slug)["satellite"] is not None


def test_a_map_is_deleted_for_good(page, api, app):
    slug = api.make_map("Goes for good", satellite=None)
    api.ask("DELETE", f"/maps/{slug}")
    page.goto("/bin")
    card(page, "Goes for good").get_by_role("button", name="Delete permanently").click()
    page.get_by_role("dialog").get_by_role("button", name="Delete permanently").click()
    expect(card(page, "Goes for good")).to_have_count(0)
    assert not (app.library / slug).exists()


def test_a_map_is_renamed_and_copied(page, api, small_photos, sample_folder):
    slug = api.make_map("Old name", satellite=sample_folder / "satellite.png", photos=small_photos[:2])
    page.goto("/")
    choose(page, "Old name", "Rename")
    page.get_by_label("Name", exact=True).fill("New name")
    page.keyboard.press("Enter")
    expect(card(page, "New name")).to_have_count(1)
    choose(page, "New name", "Duplicate")
    page.wait_for_url(re.compile(r"/maps/.+/(jobs|edit)"))
    copy = page.url.split("/")[-2]
    assert copy != slug
    api.wait_for_jobs(copy)
    assert len(api.state(copy)["photos"]) == 2


def test_which_map_is_this(page, api, sample_map, sample_folder):
    api.wait_for_jobs(sample_map)
    page.goto("/")
    page.get_by_test_id("find-photo").click()
    page.get_by_test_id("find-input").set_input_files(sample_folder / "queries" / "query_02.jpg")
    results = page.get_by_test_id("find-results")
    name = api.state(sample_map)["name"]
    expect(page.get_by_test_id("find-verdict")).to_have_text(f"On the map {name}")
    expect(results).to_contain_text("None of these maps")
    assert axe.findings(page) == []
    results.get_by_role("button", name=f"Show on {name}").click()
    page.wait_for_url(re.compile(r"/maps/sample/localize\?query=\d+"))
    expect(page.get_by_test_id("hypothesis").first).to_be_visible()


def test_maps_are_searched_sorted_downloaded_and_put_into_the_bin_together(
    page, api, small_photos, sample_folder
):
    satellite = sample_folder / "satellite.png"
    slug = api.make_map("Zoo Žižkov 2", satellite=satellite, photos=small_photos[:2])
    ids = [photo["id"] for photo in api.state(slug)["photos"]]
    changes = [{"id": id, "x_px": 100, "y_px": 100} for id in ids]
    api.ask("PATCH", f"/maps/{slug}/experiences", data={"kind": "place", "changes": changes})
    api.make_map("Zoo Žižkov 10", satellite=None)
    page.goto("/")
    expect(card(page, "Zoo Žižkov 2").locator(".map-card__dots")).to_have_count(1)
    search = page.get_by_test_id("list-search")
    search.fill("zizkov")
    shown = page.locator(".map-card:not([hidden]) h2")
    expect(shown).to_have_text(["Zoo Žižkov 10", "Zoo Žižkov 2"])
    page.locator("#list-sort").select_option("name")
    expect(shown).to_have_text(["Zoo Žižkov 2", "Zoo Žižkov 10"])
    page.reload()
    search.fill("žižkov")
    expect(shown).to_have_text(["Zoo Žižkov 2", "Zoo Žižkov 10"])
    page.get_by_role("button", name="Select", exact=True).click()
    for name in ("Zoo Žižkov 2", "Zoo Žižkov 10"):
        page.get_by_role("checkbox", name=f"Select {name}", exact=True).check()
    bar = page.get_by_test_id("list-bar")
    expect(bar).to_contain_text("2 selected")
    assert axe.findings(page) == []
    with page.expect_download() as download:
        bar.get_by_role("button", name="Download").click()
    assert download.value.suggested_filename == f"{slug}.zip", "the other one has no image"
    bar.get_by_role("button", name="Move to the bin").click()
    expect(card(page, "Zoo Žižkov")).to_have_count(0)
    binned = {one["name"] for one in api.ask("GET", "/maps?bin=1")["maps"]}
    assert {"Zoo Žižkov 2", "Zoo Žižkov 10"} <= binned
    page.get_by_role("button", name="Undo").click()
    expect(shown).to_have_text(["Zoo Žižkov 2", "Zoo Žižkov 10"])
    expect(page.get_by_role("button", name="Undo")).to_have_count(0)
    assert not any(one["name"].startswith("Zoo") for one in api.ask("GET", "/maps?bin=1")["maps"])
    search.fill("no such map")
    expect(page.get_by_text("No map is called that.")).to_be_visible()


def test_each_undo_brings_back_what_its_message_is_about(page, api):
    for name in ("Kampa 1", "Kampa 2"):
        api.make_map(name, satellite=None)
    page.add_init_script(KEEP_MESSAGES)
    page.goto("/")
    for name in ("Kampa 1", "Kampa 2"):
        choose(page, name, "Move to the bin")
        expect(card(page, name)).to_have_count(0)
    page.get_by_role("button", name="Undo").first.click()
    expect(card(page, "Kampa 1")).to_have_count(1)
    expect(card(page, "Kampa 2")).to_have_count(0)
    page.get_by_role("button", name="Undo").click()
    expect(page.locator(".map-card h2").filter(has_text="Kampa")).to_have_text(["Kampa 2", "Kampa 1"])


@pytest.fixture
def many_maps(api):
    """More maps than the page lists at once; the newest is listed first."""
    slugs = [api.ask("POST", "/maps", data={"name": f"Row {number:02}"})["slug"] for number in range(60)]
    yield slugs
    for slug in slugs:
        api.ask("DELETE", f"/maps/{slug}")
        api.ask("DELETE", f"/maps/{slug}?forever=true")


def test_a_long_list_comes_in_parts_and_is_searched_on_the_server(page, many_maps):
    page.goto("/")
    cards = page.locator("#maps > [data-slug]")
    expect(cards).to_have_count(48)
    page.get_by_test_id("list-search").fill("row 03")
    expect(page.locator("#maps > [data-slug]:visible")).to_have_count(1)
    expect(card(page, "Row 03")).to_be_visible()
    page.get_by_test_id("list-search").fill("")
    expect(cards).to_have_count(48)
    expect(card(page, "Row 03")).to_have_count(0)
    page.get_by_test_id("more-maps").click()
    expect(card(page, "Row 03")).to_have_count(1)
    choose(page, "Row 03", "Rename")
    page.get_by_label("Name", exact=True).fill("Row of old")
    page.keyboard.press("Enter")
    expect(cards.first).to_have_attribute("data-name", "Row of old")
    assert axe.findings(page) == []


def test_a_long_list_is_sorted_as_a_whole(page, many_maps):
    page.goto("/")
    page.locator("#list-sort").select_option("name")
    expect(page.get_by_test_id("more-maps")).to_be_hidden()
    names = page.locator("#maps > [data-slug]").evaluate_all("cards => cards.map(c => c.dataset.name)")
    rows = [name for name in names if name.startswith("Row ")]
    assert rows == [f"Row {number:02}" for number in range(60)]


def test_a_photo_that_the_browser_cannot_show_leaves_words_in_its_place(page, tmp_path):
    heic = tmp_path / "photo.heic"
    heic.write_bytes(b"\0\0\0\x18ftypheic")
    page.context.watch.expect(422)  # it is no photo
    page.goto("/")
    page.get_by_test_id("find-photo").click()
    page.get_by_test_id("find-input").set_input_files(heic)
    dialog = page.get_by_role("dialog")
    expect(dialog).to_contain_text("This photo cannot be shown.")
    expect(dialog.locator("img")).to_have_count(0)
