"""Choice of theme and language."""

import re

import pytest
from playwright.sync_api import expect

from tests.browser.edit_page import EditPage

pytestmark = pytest.mark.slow


def test_czech_stays_chosen(open_context, app, fresh_owner):
    page = fresh_owner
    page.goto("/")
    page.locator("header summary:not(#jobs-menu-button)").click()
    page.get_by_role("button", name="Čeština").click()
    expect(page.locator("html")).to_have_attribute("lang", "cs")
    expect(page.get_by_role("heading", level=1)).to_have_text("Mapy")
    page.goto("/account")
    expect(page.locator("html")).to_have_attribute("lang", "cs")
    page.locator("header summary:not(#jobs-menu-button)").click()
    page.get_by_role("button", name="English").click()
    expect(page.locator("html")).to_have_attribute("lang", "en")


def test_a_browser_in_czech_gets_czech(open_context):
    page = open_context(locale="cs-CZ").new_page()
    page.goto("/sign-in")
    expect(page.locator("html")).to_have_attribute("lang", "cs")
    expect(page.get_by_label("Heslo")).to_be_visible()


def test_the_current_tab_is_in_view_where_there_is_no_room_for_all(open_context, owner, sample_map):
    context = open_context(
        storage_state=owner, locale="cs-CZ", viewport={"width": 320, "height": 640}, has_touch=True
    )
    page = context.new_page()
    page.goto("/maps/sample/settings")
    expect(page.locator(".tabs [aria-current=page]")).to_be_in_viewport(ratio=0.9)
    expect(page.locator(".tabs")).not_to_have_attribute("data-more", "")
    page.goto("/maps/sample/image")
    expect(page.locator(".tabs")).to_have_attribute("data-more", "")


def test_dark_stays_chosen(page):
    page.goto("/")
    light = page.evaluate("getComputedStyle(document.body).backgroundColor")
    page.locator("header summary:not(#jobs-menu-button)").click()
    page.get_by_role("button", name="Dark").click()
    dark = page.evaluate("getComputedStyle(document.body).backgroundColor")
    assert dark != light
    page.reload()
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == dark


def choose_positions(page, name):
    page.locator("header summary:not(#jobs-menu-button)").click()
    page.get_by_role("group", name="Positions").get_by_role("button", name=name).click()
    page.keyboard.press("Escape")


def test_positions_in_the_form_that_was_chosen(open_context, owner, sample_map):
    context = open_context(storage_state=owner, permissions=["clipboard-read", "clipboard-write"])
    edit = EditPage(context.new_page(), sample_map).open()
    page = edit.page
    cursor = page.locator(".ed-cursor-position")
    page.mouse.move(*edit.screen(500, 600))
    expect(cursor).to_contain_text("° N")
    choose_positions(page, "MGRS")
    page.mouse.move(*edit.screen(501, 600))
    expect(cursor).to_contain_text(re.compile(r"33U WR \d{5} \d{5}"))
    page.mouse.click(*edit.screen(500, 600), button="right")
    page.get_by_role("menuitem", name="Copy the coordinates").click()
    expect(page.locator(".toast")).to_contain_text("Copied")
    assert re.fullmatch(r"33U WR \d{5} \d{5}", page.evaluate("navigator.clipboard.readText()"))
    page.goto(f"/maps/{sample_map}/view?photo=20")  # kept, also on other pages
    page.locator("#photo-facts-button, .vw-facts summary").first.click()
    shown = page.locator("#photo-facts .copy-text")
    expect(shown).to_contain_text("33U WR")
    choose_positions(page, "Degrees, minutes, seconds")
    expect(shown).to_contain_text(re.compile(r"50°\d\d'"))
    page.goto(f"/maps/{sample_map}/image")
    expect(page.locator("[data-position]").first).to_contain_text(re.compile(r"50°\d\d'"))
