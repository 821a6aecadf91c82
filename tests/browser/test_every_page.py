"""Every page, wide and on a phone, light and dark: no serious findings of axe-core, no overflow."""

import pytest
from playwright.sync_api import expect

from tests.browser import axe
from tests.browser.polling import until
from tests.pages import addresses

pytestmark = pytest.mark.slow

PHONE = {"width": 390, "height": 844}
PAGES = addresses(slug="sample", name="photos") | {"nowhere": "/nowhere"}
TOUCH = {"has_touch": True, "is_mobile": True, "device_scale_factor": 2}
SCREENS = {"wide": {}, "phone": {"viewport": PHONE, **TOUCH}}
WIDTH = "document.querySelector('#map-view img.leaflet-image-layer').getBoundingClientRect().width"
SHOWN = "[...document.images].every((image) => image.complete || image.loading === 'lazy')"
CALM = """
() => document.getAnimations().every((animation) =>
  animation.playState !== "running" || !isFinite(animation.effect.getTiming().iterations))
"""


@pytest.fixture(scope="module", params=SCREENS)
def screen(request):
    """Name of the screen that pages are shown on."""
    return request.param


@pytest.fixture
def visit(open_context, owner, screen, sample_map):
    """Open a page and wait until it is idle."""

    def visit(path, *, signed_in=True):
        storage = owner if signed_in else None
        context = open_context(storage_state=storage, reduced_motion="reduce", **SCREENS[screen])
        context.watch.expect(404)
        page = context.new_page()
        page.goto(path)
        # the editor asks for changes again and again, so its network is never idle
        page.wait_for_load_state("networkidle" if "edit" not in path else "load")
        until(page, SHOWN)
        until(page, CALM)
        return page

    return visit


def check(page, within="html"):
    """Check accessibility in the light and the dark theme, and overflow, title and heading."""
    for scheme in ("light", "dark"):
        page.emulate_media(color_scheme=scheme)
        until(page, CALM)
        assert axe.findings(page, within) == [], scheme
    overflow = page.evaluate("document.documentElement.scrollWidth - innerWidth")
    assert overflow <= 0, f"{overflow} pixels are outside the screen"
    assert page.title().strip(" ·") and page.locator("h1").count() == 1


@pytest.mark.parametrize("name", PAGES)
def test_page(visit, name):
    check(visit(PAGES[name]))


def test_sign_in_page(visit):
    check(visit("/sign-in", signed_in=False))


def test_the_menu_and_a_dialog(visit):
    page = visit("/")
    page.locator("header summary:not(#jobs-menu-button)").click()
    check(page, "header")  # it overlays other elements
    page.goto("/")
    page.locator(".map-card .menu summary").first.click()
    page.get_by_role("button", name="Rename").first.click()
    expect(page.get_by_role("dialog")).to_be_visible()
    check(page)


def test_the_menus_of_the_editor_and_the_sheet_of_a_phone(visit, screen):
    page = visit(PAGES["map_pages.editor"])
    for menu in ("#add-menu", "#place-menu", "#map-menu", ".ed-export + .menu"):
        page.locator(f"{menu} > summary").click()
        expect(page.locator(f"{menu} > .menu__list")).to_be_visible()
        check(page, f"{menu} > .menu__list")
        box = page.locator(f"{menu} > .menu__list").bounding_box()
        assert box["x"] >= 0 and box["x"] + box["width"] <= page.viewport_size["width"]
        page.keyboard.press("Escape")
    if screen == "phone":
        page.locator("#side-toggle").click()
        expect(page.locator("#side-body")).to_be_visible()
        check(page, "#side")


def test_the_dialogs_of_the_editor(visit, screen):
    page = visit(PAGES["map_pages.editor"])
    place, export = "#place-menu", ".ed-export + .menu"
    buttons = {
        "place-by-file": place,
        "place-by-track": place,
        "place-the-rest": place,
        "floors-button": "#map-menu",
        "plan-button": "#add-menu",
        "print-map": export,
        **({} if screen == "phone" else {"help": None}),  # help on keys only with a keyboard
    }
    dialog = page.locator("dialog[open]")
    for button, menu in buttons.items():
        if menu:
            page.locator(f"{menu} > summary").click()
        page.locator(f"#{button}").click()
        expect(dialog).to_be_visible()
        check(page, "dialog[open]")
        box = dialog.bounding_box()
        assert box["x"] >= 0 and box["x"] + box["width"] <= page.viewport_size["width"], button
        if button in ("place-the-rest", "plan-button") and screen == "wide":
            tools = page.locator("#toolbar").bounding_box()
            assert box["y"] >= tools["y"] + tools["height"], button
            page.locator("#zoom-in").click(trial=True)
        page.keyboard.press("Escape")
        expect(dialog).to_have_count(0)


def test_maps_for_points_have_the_zoom_buttons_of_the_others(visit):
    page = visit(PAGES["landmarks_pages.control_points"])
    expect(page.locator(".leaflet-control-zoom")).to_have_count(0)
    view = page.get_by_test_id("map-view")
    image = view.locator("img.leaflet-image-layer")
    before = image.bounding_box()["width"]
    view.get_by_role("button", name="Zoom in").click()
    until(page, f"before => ({WIDTH}) > 1.5 * before", before)
    view.get_by_role("button", name="Show the whole image").click()
    until(page, f"before => Math.abs(({WIDTH}) - before) < 1", before)
    assert view.locator(".ed-zoom").evaluate("one => getComputedStyle(one).flexDirection") == "column"


def test_the_buttons_of_a_dialog_are_in_reach_without_scrolling(visit):
    page = visit(PAGES["map_pages.editor"])
    page.locator(".ed-export + .menu > summary").click()
    page.locator("#print-map").click()
    box = page.get_by_test_id("print-pdf").bounding_box()
    assert box["y"] + box["height"] <= page.viewport_size["height"]
    assert page.evaluate("document.querySelector('dialog[open]').scrollTop") == 0


def test_a_map_that_cannot_answer_says_what_it_needs_and_asks_for_no_photo(visit, api):
    slug = api.ask("POST", "/maps", data={"name": "Bare"})["slug"]
    page = visit(f"/maps/{slug}/localize")
    expect(page.locator("#no-map")).to_be_visible()
    expect(page.locator("#welcome, .lo-toolbar")).to_have_count(2)
    assert [one.is_visible() for one in page.locator("#welcome, .lo-toolbar").all()] == [False, False]
    editor = page.locator("#no-map a").bounding_box()
    assert editor["y"] + editor["height"] <= page.viewport_size["height"]
    check(page)
