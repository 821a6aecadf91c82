"""Landmarks in 3D: points, cameras and selecting one, wide and on a phone, light and dark."""

import io
import re

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import expect

from tests.browser import axe
from tests.browser.edit_page import spots
from tests.browser.landmark_files import align_landmarks, write_landmarks

pytestmark = pytest.mark.slow

PHOTOS = 6
POINTS = 400
POINT_COLOUR = (255, 0, 255)
CHOSEN_COLOUR = (255, 138, 51)
PHONE = {
    "viewport": {"width": 390, "height": 844},
    "has_touch": True,
    "is_mobile": True,
    "device_scale_factor": 2,
}


@pytest.fixture
def joined(make_page, api, app):
    """The slug of a map with six photos, one of them unplaced meanwhile, and points around them."""
    slug = make_page(PHOTOS, placed=True).slug
    api.cancel_jobs(slug)  # the index of this map is not needed
    photos = api.state(slug)["photos"]
    at = np.array([*spots(PHOTOS)], float)
    draw = np.random.default_rng(5)
    low, high = at.min(axis=0) - 40.0, at.max(axis=0) + 120.0
    xy = draw.uniform(low, high, size=(POINTS, 2))
    points = np.column_stack([xy[:, 0], -xy[:, 1], draw.uniform(0.0, 60.0, POINTS)])
    names = [photo["name"] for photo in photos]
    write_landmarks(app.library / slug / "map.cfg", names, at=at, points=points)
    changes = [{"id": photos[-1]["id"], "x_px": None, "y_px": None}]
    data = {"seen": api.state(slug)["revision"], "kind": "unplace", "changes": changes}
    api.ask("PATCH", f"/maps/{slug}/experiences", data=data)
    api.cancel_jobs(slug)
    align_landmarks(app.library, slug)
    return slug, photos


def coloured(page, colour):
    """Count the pixels of the view with about this colour; overlays hide some."""
    picture = Image.open(io.BytesIO(page.get_by_test_id("scene").screenshot())).convert("RGB")
    return int((np.abs(np.asarray(picture).astype(int) - colour).max(axis=2) < 60).sum())


def open_scene(page, slug):
    page.goto(f"/maps/{slug}/landmarks")
    scene = page.locator(f"[data-testid=scene][data-points='{POINTS}']")
    expect(scene).to_be_visible()
    expect(page.locator("#status")).to_have_text(f"{POINTS} points · {PHOTOS} of {PHOTOS} photos")
    return scene


def test_points_and_cameras_are_drawn_and_a_photo_is_chosen(page, joined):
    slug, photos = joined
    open_scene(page, slug)
    assert coloured(page, POINT_COLOUR) > POINTS / 2
    expect(page.get_by_text("in the tray", exact=True)).to_be_visible()
    page.get_by_role("combobox", name="Photo").select_option(str(photos[2]["id"]))
    card = page.get_by_test_id("camera-card")
    expect(card.get_by_role("heading")).to_have_text(photos[2]["name"])
    expect(card).to_contain_text("Placed")
    card.get_by_role("button", name="Next photo").click()
    expect(card.get_by_role("heading")).to_have_text(photos[3]["name"])
    card.get_by_role("button", name="Look from here").click()
    page.get_by_role("button", name="From above").click()
    expect(page.locator("#scale")).to_be_visible()
    page.get_by_label("Display", exact=True).click()
    page.get_by_label("Colour of the points").select_option("height")
    expect(page.locator("#legend-height")).to_be_visible()
    page.keyboard.press("Escape")
    assert coloured(page, POINT_COLOUR) < POINTS / 10
    card.get_by_test_id("open-in-editor").click()
    expect(page).to_have_url(re.compile(f"/maps/{slug}/edit\\?photo={photos[3]['id']}$"))


def test_the_view_is_in_order_wide_and_on_a_phone_light_and_dark(open_context, owner, joined):
    slug, photos = joined
    for screen in ({}, PHONE):
        page = open_context(storage_state=owner, reduced_motion="reduce", **screen).new_page()
        open_scene(page, slug)
        page.get_by_role("combobox", name="Photo").select_option(str(photos[2]["id"]))
        expect(page.get_by_test_id("camera-card").get_by_role("img")).to_be_visible()
        for scheme in ("light", "dark"):
            page.emulate_media(color_scheme=scheme)
            assert axe.findings(page) == [], scheme
            assert coloured(page, CHOSEN_COLOUR) > 5, "the card covers the camera"
        assert page.evaluate("document.documentElement.scrollWidth - innerWidth") <= 0
