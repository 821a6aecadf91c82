"""Colours and language as a person chooses them."""

from playwright.sync_api import expect


def test_czech_stays_chosen(open_context, app, fresh_owner):
    page = fresh_owner
    page.goto("/")
    page.locator("header summary").click()
    page.get_by_role("button", name="Čeština").click()
    expect(page.locator("html")).to_have_attribute("lang", "cs")
    expect(page.get_by_role("heading", level=1)).to_have_text("Mapy")
    page.goto("/account")
    expect(page.locator("html")).to_have_attribute("lang", "cs")
    page.locator("header summary").click()
    page.get_by_role("button", name="English").click()
    expect(page.locator("html")).to_have_attribute("lang", "en")


def test_a_browser_in_czech_gets_czech(open_context):
    page = open_context(locale="cs-CZ").new_page()
    page.goto("/sign-in")
    expect(page.locator("html")).to_have_attribute("lang", "cs")
    expect(page.get_by_label("Heslo")).to_be_visible()


def test_dark_stays_chosen(page):
    page.goto("/")
    light = page.evaluate("getComputedStyle(document.body).backgroundColor")
    page.locator("header summary").click()
    page.get_by_role("button", name="Dark").click()
    dark = page.evaluate("getComputedStyle(document.body).backgroundColor")
    assert dark != light
    page.reload()
    assert page.evaluate("getComputedStyle(document.body).backgroundColor") == dark
