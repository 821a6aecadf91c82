"""A picture among the photos that looks like a plan becomes the map's image with one click."""

import pytest
from PIL import Image
from playwright.sync_api import expect

pytestmark = pytest.mark.slow


@pytest.fixture
def plan(tmp_path, sample_folder):
    """A drawing of the size of the sample's image."""
    with Image.open(sample_folder / "satellite.png") as image:
        size = image.size
    path = tmp_path / "plan.png"
    Image.new("RGB", size, "ivory").save(path)
    return path


def test_a_plan_among_the_photos_becomes_the_image(make_page, plan, small_photos, api):
    edit = make_page(0)
    before = api.state(edit.slug)["satellite"]
    edit.choose_photos([plan, *small_photos[:1]])
    edit.uploaded()
    offer = edit.page.get_by_test_id("image-offer")
    expect(offer).to_have_count(1)
    expect(offer).to_contain_text("plan.png")
    offer.get_by_role("button").click()
    expect(offer).to_have_count(0)
    expect(edit.unplaced).to_have_text("1")
    after = api.state(edit.slug)
    assert after["satellite"] != before
    assert [photo["name"] for photo in after["photos"] if not photo.get("removed")] == [small_photos[0].name]


def test_with_placed_photos_it_asks_first(make_page, plan, api):
    edit = make_page(2, placed=True)
    before = api.state(edit.slug)["satellite"]
    edit.choose_photos([plan])
    edit.uploaded()
    button = edit.page.get_by_test_id("image-offer").get_by_role("button")
    dialog = edit.page.get_by_role("dialog")
    button.click()
    expect(dialog).to_contain_text("2 photos are already placed")
    dialog.get_by_role("button", name="Cancel").click()
    assert api.state(edit.slug)["satellite"] == before
    button.click()
    dialog.get_by_role("button", name="Replace").click()
    expect(button).to_have_count(0)
    assert api.state(edit.slug)["satellite"] != before
    expect(edit.placed).to_have_text("2")


def test_on_a_map_without_an_image(page, api, plan):
    slug = api.make_map("No image yet", satellite=None)
    page.goto(f"/maps/{slug}/edit")
    page.get_by_test_id("photo-input").set_input_files(plan)
    page.get_by_test_id("image-offer").get_by_role("button").click()
    expect(page.locator("#no-satellite")).to_be_hidden()
    assert api.state(slug)["satellite"]["width"] > 0
