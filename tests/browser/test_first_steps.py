"""First use: the introduction, and a first answer with an example photo."""

from playwright.sync_api import expect

from tests.browser import axe
from tests.browser.conftest import WORK_MS, sign_in


def test_a_newcomer_gets_a_first_answer(open_context, api, sample_map):
    link = api.ask("POST", "/accounts", data={"name": "newcomer"})
    try:
        page = open_context().new_page()
        sign_in(page, link["url"])
        welcome = page.get_by_test_id("welcome")
        expect(welcome).to_contain_text("maps you make yourself")
        expect(welcome.get_by_role("link", name="Try it on the sample")).to_have_count(0)
        welcome.get_by_role("link", name="Make a map from photos").click()
        expect(page.get_by_test_id("map-name")).to_be_focused()
        api.ask("POST", f"/maps/{sample_map}/members", data={"name": "newcomer", "role": "viewer"})
        api.wait_for_jobs(sample_map)
        page.goto("/")
        assert axe.findings(page) == []
        welcome.get_by_role("link", name="Try it on the sample").click()
        page.get_by_role("button", name="Try the photo query_02.jpg").click()
        expect(page.get_by_test_id("hypothesis").first).to_be_visible(timeout=WORK_MS)
        page.close()  # it may still load pictures, which fail once the account is deleted
    finally:
        api.ask("DELETE", f"/accounts/{link['account']}")


def test_a_link_to_a_photo_opens_it(make_page):
    edit = make_page(3, placed=True)
    last = edit.tray.last
    id, name = last.get_attribute("data-id"), last.locator(".ed-tile__name").inner_text()
    edit.page.goto(f"/maps/{edit.slug}/edit?photo={id}")
    expect(edit.current).to_contain_text(name)
