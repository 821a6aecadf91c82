"""The exported page opens without a network and shows the photos at their positions."""

from dataclasses import replace

import pytest

from webapp.core.geo.georeference import Georeference
from webapp.files.maps.folder import read_map, write_map
from webapp.render import folium_page
from webapp.settings import Settings
from webapp.tasks.exchange.export_source import of_folder

TURNED = Georeference("EPSG:4326", (1.5e-5, 4e-6, 26.5, 2e-6, -7.5e-6, 60.4, 0, 0, 1), "affine")
TITLE = "</title><script>window.hacked = 1</script>"
NAME = "photos/1 </script><script>window.hacked=1<img src=x onerror=hacked()>.jpg".replace("</", "<")


@pytest.fixture
def source(make_map, tmp_path):
    cfg = make_map(tmp_path / "folder", 3)
    map_ = read_map(cfg)
    (cfg.parent / "photos" / "1.jpg").rename(cfg.parent / NAME)
    first, second, third = map_.experiences
    second = replace(second, photo=NAME, heading_deg=90.0)
    write_map(cfg, replace(map_, experiences=(first, second, third)))
    return of_folder(cfg, title=TITLE)


def page_of(source):
    return b"".join(folium_page.export_map_page(source, settings=Settings()).pieces)


@pytest.fixture
def opened(browser, tmp_path):
    """Open a page from disk, offline; return it, its requests and its errors."""
    contexts = []

    def show(content):
        path = tmp_path / "page.html"
        path.write_bytes(content)
        context = browser.new_context(offline=True)
        contexts.append(context)
        page = context.new_page()
        page.result = []
        page.on(
            "request", lambda r: page.result.append(r.url[:80]) if not r.url.startswith("data:") else None
        )
        page.on("console", lambda m: page.result.append(m.text))
        page.on("pageerror", lambda e: page.result.append(str(e)))
        page.goto(path.as_uri())
        return page

    yield show
    for context in contexts:
        context.close()


@pytest.mark.parametrize("georeference", [None, TURNED], ids=["pixels", "earth"])
def test_it_opens_offline_and_shows_everything(source, opened, georeference):
    page = opened(page_of(replace(source, map=replace(source.map, georeference=georeference))))
    assert page.locator(".photo-marker").count() == 3
    image = page.locator(".leaflet-image-layer")
    assert image.evaluate("i => i.decode().then(() => i.naturalWidth)") >= 400
    page.locator(".photo-marker").nth(1).click()
    page.locator(".photo-popup img").wait_for()
    assert page.locator(".photo-popup img").evaluate("i => i.decode().then(() => i.naturalWidth)") == 320
    assert page.locator(".photo-popup strong").inner_text() == NAME.rsplit("/", 1)[-1]
    assert ("60.39" in page.locator(".photo-popup").inner_text()) == (georeference is not None)
    assert page.evaluate("window.hacked") is None
    assert [result for result in page.result if not result.startswith("file:")] == []
    assert len(page.result) == 1


def test_markers_are_on_their_place_of_the_image(source, opened):
    page = opened(page_of(source))
    at = page.locator(".leaflet-image-layer").bounding_box()
    for number, e in enumerate(source.map.experiences):
        box = page.locator(".photo-marker").nth(number).bounding_box()
        x = (box["x"] + box["width"] / 2 - at["x"]) / at["width"] * 400
        y = (box["y"] + box["height"] / 2 - at["y"]) / at["height"] * 200
        assert (x, y) == pytest.approx(e.position, abs=2)


def test_keys_and_buttons_go_from_photo_to_photo(source, opened):
    page = opened(page_of(source))
    shown = page.locator(".photo-popup strong")
    names = [e.photo.rsplit("/", 1)[-1] for e in source.map.experiences]
    page.keyboard.press("ArrowRight")
    page.get_by_text("1 / 3").wait_for()
    assert shown.inner_text() == names[0]
    page.get_by_role("button", name="Next photo").click()
    page.get_by_text("2 / 3").wait_for()
    assert shown.inner_text() == names[1]
    page.keyboard.press("ArrowLeft")
    page.get_by_text("1 / 3").wait_for()
    assert shown.inner_text() == names[0]
