"""Files that are no valid photos: each gets its own message, and the valid ones are added."""

import io
import re

import numpy as np
import pytest
from PIL import Image
from playwright.sync_api import expect

pytestmark = pytest.mark.slow


@pytest.fixture
def odd(tmp_path, small_photos):
    """Files by name whose content contradicts their name, or is too large."""
    good = small_photos[0].read_bytes()
    picture = io.BytesIO()
    Image.new("1", (20_000, 15_000)).save(picture, "PNG")
    files = {
        "truncated.jpg": good[: len(good) // 2],
        "text.jpg": b"this is no photo at all\n" * 50,
        "page.html.jpg": b"<script>alert(1)</script>",
        "huge.png": picture.getvalue(),
        "empty.jpg": b"",
        "<img src=x onerror=alert(1)>.jpg": small_photos[1].read_bytes(),
        "really_a_jpeg.png": small_photos[2].read_bytes(),
        "semi;colon, ünï.jpg": small_photos[3].read_bytes(),
    }
    paths = []
    for name, data in files.items():
        paths.append(tmp_path / name)
        paths[-1].write_bytes(data)
    return paths


def test_every_file_has_its_own_outcome(make_page, odd, api, context):
    context.watch.expect(400, 413, 415, 422)
    edit = make_page(0)
    edit.choose_photos(odd)
    edit.uploaded()
    errors = edit.page.get_by_test_id("error-message")
    text = " ".join(errors.all_text_contents())
    for name in ("truncated.jpg", "text.jpg", "page.html.jpg", "huge.png", "empty.jpg"):
        assert name in text
    assert errors.count() == 5, text
    expect(edit.unplaced).to_have_text("3")
    names = {photo["name"] for photo in api.state(edit.slug)["photos"]}
    assert len(names) == 3


def test_the_same_file_again_is_recognised(make_page, small_photos, api):
    edit = make_page(2)
    edit.choose_photos(small_photos[:3])
    expect(edit.unplaced).to_have_text("3")
    edit.uploaded()
    assert len(api.state(edit.slug)["photos"]) == 3


def test_a_new_map_at_the_address_of_a_deleted_one_gets_all_files(make_page, small_photos, api, context):
    context.watch.expect(404)  # the open page may request the deleted map
    edit = make_page(0)
    edit.choose_photos(small_photos[:1])
    edit.uploaded()
    api.wait_for_jobs(edit.slug)  # an active job would create the folder again
    for path in (f"/maps/{edit.slug}", f"/maps/{edit.slug}?forever=true"):
        api.ask("DELETE", path)
    again = make_page(0)
    assert again.slug == edit.slug
    again.choose_photos(small_photos[1:2])  # it now has the id that the other photo had
    again.uploaded()
    again.choose_photos(small_photos[:2])
    again.uploaded()
    expect(again.unplaced).to_have_text("2")
    assert len(api.state(again.slug)["photos"]) == 2


def test_a_satellite_image_that_is_none_is_refused(page, api, tmp_path, context):
    context.watch.expect(400, 413, 415, 422)
    slug = api.make_map("No image", satellite=None)
    page.goto(f"/maps/{slug}/edit")
    (tmp_path / "plan.png").write_bytes(b"no image")
    page.get_by_test_id("satellite-input").set_input_files(tmp_path / "plan.png")
    expect(page.get_by_test_id("error-message")).to_contain_text(re.compile(r"\w{3}"))
    assert api.state(slug)["satellite"] is None


def test_real_odd_photos(make_page, shared_data, context, api):
    context.watch.expect(400, 413, 415, 422)
    edit = make_page(0)
    paths = sorted((shared_data / "odd_photos").iterdir())
    edit.choose_photos(paths)
    edit.uploaded()
    photos = api.state(edit.slug)["photos"]
    refused = edit.page.get_by_test_id("error-message").count()
    assert photos and len(photos) + refused <= len(paths)


XMP = (
    '<x:xmpmeta xmlns:x="adobe:ns:meta/"><r:RDF xmlns:r="http://www.w3.org/1999/02/22-rdf-syntax-ns#">'
    '<r:Description xmlns:exif="http://ns.adobe.com/exif/1.0/" exif:GPSLatitude="50,6.0N" '
    'exif:GPSLongitude="14,24.0E"/></r:RDF></x:xmpmeta>'
)


def test_files_beside_photos_are_sent_with_them(make_page, api, tmp_path, small_photos):
    (tmp_path / "a.jpg").write_bytes(small_photos[0].read_bytes())
    (tmp_path / "a.jpg.xmp").write_text(XMP)
    (tmp_path / "alone.xmp").write_text(XMP)
    edit = make_page(0)
    edit.choose_photos([tmp_path / name for name in ("a.jpg.xmp", "a.jpg", "alone.xmp")])
    edit.uploaded()
    errors = edit.page.get_by_test_id("error-message")
    expect(errors).to_contain_text("belongs to a photo")
    (photo,) = api.state(edit.slug)["photos"]
    assert (photo["gps"]["lat"], photo["file_notes"]) == (50.1, ["its position is from a.jpg.xmp"])
    expect(edit.page.locator("#current")).to_contain_text("its position is from a.jpg.xmp")


def test_a_photo_of_few_of_its_16_bits_says_that_it_was_stretched(make_page, tmp_path):
    pixels = np.linspace(7000, 8020, 120 * 90).astype(np.uint16).reshape(90, 120)
    Image.fromarray(pixels).save(tmp_path / "thermal.png")
    edit = make_page(0)
    edit.choose_photos([tmp_path / "thermal.png"])
    edit.uploaded()
    expect(edit.page.locator("#current-facts")).to_contain_text(
        "its contrast was stretched: nearly all of its 16-bit values"
    )
