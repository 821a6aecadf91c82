"""A control point is named, clicked in two photos and on the image; residuals: a table and arrows."""

import numpy as np
import pytest
from playwright.sync_api import expect

from tests.browser.edit_page import spots
from tests.browser.landmark_files import align_landmarks, write_landmarks

pytestmark = pytest.mark.slow

PHOTOS = 8
WRONG = 4
"""Index of the photo whose landmark position contradicts its placed position."""


@pytest.fixture
def joined(make_page, api, app):
    """The slug of a map with eight placed photos, of which the landmarks contradict one; and its photos."""
    slug = make_page(PHOTOS, placed=True).slug
    api.cancel_jobs(slug)  # the index of this map is not needed
    photos = api.state(slug)["photos"]
    at = np.array([*spots(PHOTOS)], float)
    at[WRONG] += 300.0
    names = [photo["name"] for photo in photos]
    write_landmarks(app.library / slug / "map.cfg", names, at=at, points=np.zeros((0, 3)))
    return slug, photos


def test_a_point_is_clicked_in_two_photos_and_on_the_image(page, api, app, joined):
    slug, photos = joined
    page.goto(f"/maps/{slug}/control-points")
    page.get_by_test_id("point-name").fill("gate")
    page.get_by_test_id("point-add").click()
    ask = page.get_by_test_id("point-next")
    expect(ask).to_have_text("gate: click it in 2 more photos.")
    view = page.get_by_test_id("photo-view")
    view.click(position={"x": 150, "y": 150})
    expect(ask).to_have_text("gate: click it in 1 more photo.")
    page.get_by_role("button", name="Next photo").click()
    view.click(position={"x": 200, "y": 160})
    expect(ask).to_have_text("gate: click it on the image of the map.")
    page.get_by_test_id("map-view").click(position={"x": 180, "y": 120})
    expect(ask).to_contain_text("gate is complete")
    page.get_by_label("Point gate: height").fill("212.5")
    with page.expect_response(lambda answer: answer.request.method == "PUT"):
        page.get_by_label("Point gate: height").press("Enter")
    align_landmarks(app.library, slug)
    rows = page.locator("[data-testid=residuals] tr")
    expect(rows).to_have_count(PHOTOS + 1)
    expect(rows.first).to_contain_text(photos[WRONG]["name"])
    expect(rows.first).to_contain_text("left out: it contradicts the others")
    expect(page.locator("[data-name=gate]")).to_contain_text("is not clicked in any joined photo")
    expect(page.locator("#map-view path.sat-arrow")).not_to_have_count(0)
    (gate,) = api.ask("GET", f"/maps/{slug}/landmarks/control-points")["points"]
    assert [click["id"] for click in gate["photos"]] == [photo["id"] for photo in photos[:2]]
    assert gate["height_m"] == 212.5
    page.get_by_role("button", name="Undo").click()
    expect(page.get_by_label("Point gate: height")).to_have_value("")
    page.get_by_role("button", name="Remove the point gate").click()
    expect(page.get_by_test_id("control-points").locator("tr")).to_have_count(0)


def test_a_check_point_is_left_out_and_its_residual_shown(page, joined):
    slug, _ = joined
    page.goto(f"/maps/{slug}/control-points")
    page.get_by_test_id("point-name").fill("oak")
    with page.expect_response(lambda answer: answer.request.method == "PUT"):
        page.get_by_test_id("point-add").click()
    with page.expect_response(lambda answer: answer.request.method == "PUT"):
        page.get_by_label("Point oak: check point").check()
    page.reload()
    expect(page.get_by_label("Point oak: check point")).to_be_checked()
    answer = residuals_with(check=True, dx_px=3.0, dy_px=-4.0, residual_px=5.0, photos=2, sigma_px=1.2)
    page.route("**/landmarks/control-points", lambda route: route.fulfill(json=answer))
    page.reload()
    row = page.locator("[data-name=oak]")
    expect(row).to_contain_text("5 px")
    expect(row).to_contain_text("check point")
    expect(row).to_contain_text("+3.00 px right, -4.00 px down, seen in 2 photos, itself accurate to 1.2 px")
    rmse = page.get_by_test_id("rmse").locator("li")
    expect(rmse).to_have_text(["Check points: RMSE 5 px ± 50 % of 1 point that took no part in the fit."])


def residuals_with(**oak):
    """Return the API's answer with one check point and its residual."""
    none = dict.fromkeys(("x_px", "y_px", "accuracy_m", "height_m", "tag"))
    empty = dict.fromkeys(
        ("rmse_px", "rmse_m", "rmse_east_m", "rmse_north_m", "rmse_height_m", "uncertainty")
    )
    lengths = dict.fromkeys(
        ("residual_m", "east_m", "north_m", "height_off_m", "sigma_m", "photo", "problem")
    )
    places = {"x_px": 60.0, "y_px": 50.0, "others_x_px": 63.0, "others_y_px": 46.0}
    return {
        "points": [{**none, "name": "oak", "x_px": 60.0, "y_px": 50.0, "photos": [], "check": True}],
        "residuals": [{**lengths, **places, "name": "oak", "contradicts": False, "wrong_clicks": [], **oak}],
        "accuracy": {
            "control": {**empty, "points": 0, "heights": 0},
            "check": {**empty, "points": 1, "heights": 0, "rmse_px": oak["residual_px"], "uncertainty": 0.5},
        },
        "laid": True,
        "current": True,
        "job": None,
        "can_undo": False,
    }


def test_a_printed_tag_is_chosen_at_a_point_and_a_sheet_is_downloaded(page, api, joined):
    slug, _ = joined
    page.goto(f"/maps/{slug}/control-points")
    page.get_by_test_id("point-name").fill("door")
    page.get_by_test_id("point-add").click()
    tag = page.get_by_role("group", name="Printed tag at the chosen point")
    expect(tag.get_by_role("spinbutton", name="Id", exact=True)).to_be_disabled()
    with page.expect_response(lambda answer: answer.request.method == "PUT"):
        tag.get_by_role("combobox", name="Family", exact=True).select_option("36h11")
    tag.get_by_role("spinbutton", name="Id", exact=True).fill("7")
    with page.expect_response(lambda answer: answer.request.method == "PUT"):
        tag.get_by_role("spinbutton", name="Id", exact=True).press("Tab")
    tag.get_by_role("spinbutton", name="Heading, degrees from north").fill("180")
    with page.expect_response(lambda answer: answer.request.method == "PUT"):
        tag.get_by_role("spinbutton", name="Heading, degrees from north").press("Tab")
    page.get_by_test_id("map-view").click(position={"x": 180, "y": 120})
    expect(page.get_by_test_id("point-next")).to_have_text(
        "door is complete: photos that show its tag are localized by it."
    )
    page.reload()
    expect(tag.get_by_role("spinbutton", name="Id", exact=True)).to_have_value("7")
    (door,) = api.ask("GET", f"/maps/{slug}/landmarks/control-points")["points"]
    expected = {"family": "36h11", "id": 7, "size_mm": 150.0, "mount": "wall", "heading_deg": 180.0}
    assert door["tag"] == expected
    with page.expect_download() as started:
        page.get_by_test_id("print-tags").click()
    assert started.value.suggested_filename == "tags-36h11.pdf"
