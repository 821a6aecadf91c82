"""Signing in by a one-time link or a password, and signing out."""

from playwright.sync_api import expect

from tests.browser.conftest import sign_in


def test_the_link_signs_in_once(open_context, link):
    page = open_context().new_page()
    sign_in(page, link)
    expect(page.get_by_test_id("new-map")).to_be_visible()
    second = open_context()
    second.watch.expect(401)
    again = second.new_page()
    again.goto(link)
    expect(again.get_by_test_id("error-message")).to_be_visible()
    again.goto("/")
    expect(again.get_by_test_id("new-map")).to_have_count(0)


def test_a_page_leads_to_the_sign_in_and_back(open_context, app):
    page = open_context().new_page()
    page.goto("/account")
    expect(page.get_by_label("Password")).to_be_visible()
    assert "/account" in page.url
