"""A control point is named, clicked in two photos and on the image; residuals are a table and arrows."""

import numpy as np
import pytest
from playwright.sync_api import expect

from tests.browser.edit_page import spots
from webapp.core.landmarks.cloud import LandmarkCloud
from webapp.core.landmarks.pieces import RigidPiece
from webapp.files.landmarks.cloud import CLOUD_FILE, StoredCloud, write_cloud
from webapp.files.landmarks.colmap import PIECES_FILE, StoredPieces, write_pieces
from webapp.files.part_file import sha256_of
from webapp.store.library import open_library
from webapp.store.schema import MapRecord
from webapp.tasks.landmarks.show_cloud import lay_in_library
from webapp.tasks.localize.index_location import landmarks_folder

PHOTOS = 8
UP = np.array([[1.0, 0.0, 0.0], [0.0, 0.0, -1.0], [0.0, 1.0, 0.0]])
"""Camera from world, of one that looks to the top of the image; the world is map pixels, y up, z up."""
WRONG = 4
"""The photo that is placed elsewhere than the others have it."""


@pytest.fixture
def joined(make_page, api, app):
    """The slug of a map with eight placed photos, and landmarks that have one of them elsewhere."""
    slug = make_page(PHOTOS, placed=True).slug
    api.cancel_jobs(slug)  # nobody needs the index of this map
    photos = api.state(slug)["photos"]
    cfg = app.library / slug / "map.cfg"
    contents = tuple(sha256_of(cfg.parent / "photos" / p["name"]) for p in photos)
    at = np.array([*spots(PHOTOS)], float)
    at[WRONG] += 300.0
    centre = np.column_stack([at[:, 0], -at[:, 1], np.zeros(PHOTOS)])
    folder = landmarks_folder(cfg)
    folder.mkdir(parents=True, exist_ok=True)
    piece = RigidPiece(np.arange(PHOTOS), centre, np.tile(UP, (PHOTOS, 1, 1)))
    write_pieces(folder / PIECES_FILE, StoredPieces((piece,), contents, "key"))
    none = np.zeros(0, np.int32)
    cloud = LandmarkCloud(
        contents, np.zeros((0, 3)), none, np.zeros(PHOTOS + 1, np.int64), none,
        np.zeros((0, 2), np.float32), np.zeros((0, 128), np.uint8), np.zeros(PHOTOS), np.zeros(PHOTOS),
    )  # fmt: skip
    write_cloud(folder / CLOUD_FILE, StoredCloud(cloud, "key"))
    return slug, photos


def lay(app, slug):
    """Lay the landmarks on the map, for which the worker may have no time yet."""
    library = open_library(app.library)
    try:
        with library.database.read() as session:
            record = session.query(MapRecord).filter_by(slug=slug).one()
        lay_in_library(library, record)
    finally:
        library.database.close()


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
    lay(app, slug)
    rows = page.locator("[data-testid=residuals] tr")
    expect(rows).to_have_count(PHOTOS + 1)
    expect(rows.first).to_contain_text(photos[WRONG]["name"])
    expect(rows.first).to_contain_text("left out: it contradicts the others")
    expect(page.locator("[data-name=gate]")).to_contain_text("is clicked in no joined photo")
    expect(page.locator("#map-view path.sat-arrow")).not_to_have_count(0)
    (gate,) = api.ask("GET", f"/maps/{slug}/landmarks/control-points")["points"]
    assert [click["id"] for click in gate["photos"]] == [photo["id"] for photo in photos[:2]]
    assert gate["height_m"] == 212.5
    page.get_by_role("button", name="Undo").click()
    expect(page.get_by_label("Point gate: height")).to_have_value("")
    page.get_by_role("button", name="Remove the point gate").click()
    expect(page.get_by_test_id("control-points").locator("tr")).to_have_count(0)
