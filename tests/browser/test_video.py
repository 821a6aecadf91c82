"""A video becomes photos of a map: chosen in the editor, sent, cut by a job, with positions of its track."""

import pytest
from playwright.sync_api import expect

from tests.browser.edit_page import EditPage
from tests.tasks.video.test_cut_video import GPX, POSITIONS, STARTS
from tests.video_clips import pan, write_clip

pytestmark = pytest.mark.slow


def open_dialog(page, slug):
    edit = EditPage(page, slug).open()
    page.locator("#add-menu summary").click()
    page.get_by_role("button", name="Add photos from a video …").click()
    return edit


def test_a_clip_and_its_track_become_photos(page, api, sample_folder, tmp_path):
    pytest.importorskip("av", reason="PyAV (the extra `video`) is not installed")
    clip = write_clip(tmp_path / "walk.mp4", pan(POSITIONS), metadata=STARTS)
    (tmp_path / "walk.gpx").write_text(GPX)
    slug = api.make_map("Walk", satellite=sample_folder / "satellite.png")
    open_dialog(page, slug)
    add = page.get_by_test_id("video-add")
    expect(add).to_be_disabled()
    page.get_by_test_id("video-file").set_input_files(clip)
    page.get_by_test_id("video-track").set_input_files(tmp_path / "walk.gpx")
    add.click()
    expect(page.get_by_role("dialog")).to_have_count(0)
    page.get_by_role("button", name="Show more").click()
    summary = page.get_by_test_id("video-summary")
    expect(summary).to_contain_text("photos added.", timeout=60_000)
    expect(summary).to_contain_text("photos have a position.")
    photos = api.state(slug)["photos"]
    assert len(photos) > 6
    assert all(photo["name"].startswith("walk_") and photo["taken_at"] for photo in photos)


def test_a_server_without_the_extra_says_so(page, api, sample_folder):
    slug = api.make_map("No video", satellite=sample_folder / "satellite.png")
    answer = {"available": False, "install": "pip install 'experience-map[video]'", "most_mb": 4000.0}
    page.route("**/videos", lambda route: route.fulfill(json=answer))
    open_dialog(page, slug)
    expect(page.get_by_test_id("video-missing")).to_contain_text("pip install 'experience-map[video]'")
    expect(page.get_by_test_id("video-add")).to_have_count(0)
