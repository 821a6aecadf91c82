"""Evaluating how well photos are localized on a map, started by a click."""

import pytest
from playwright.sync_api import expect

from tests.browser import axe
from tests.browser.conftest import WORK_MS


@pytest.mark.slow
def test_it_is_tried_and_shown(make_page, api):
    edit = make_page(6, placed=True)
    api.wait_for_jobs(edit.slug)
    page = edit.page
    page.goto(f"/maps/{edit.slug}/quality")
    expect(page.get_by_text("Not evaluated yet")).to_be_visible()
    page.get_by_test_id("evaluate").click()
    expect(page.get_by_test_id("job-progress")).to_be_visible()
    shown = page.get_by_test_id("quality")
    expect(shown).to_have_count(2, timeout=WORK_MS)
    assert axe.findings(page) == []
    shown.first.get_by_text("Details", exact=True).click()
    expect(shown.first.locator("svg.chart")).to_have_count(2)
    expect(shown.first.get_by_role("row", name="Photos evaluated")).to_contain_text("6")
    assert axe.findings(page) == []
    page.set_viewport_size({"width": 390, "height": 844})
    assert page.evaluate("document.documentElement.scrollWidth - innerWidth") <= 0
    page.goto(f"/maps/{edit.slug}/edit")
    edit.drag((100, 60), (300, 300))
    edit.saved()
    page.goto(f"/maps/{edit.slug}/quality")
    expect(page.get_by_text("The map has changed since.")).to_be_visible()
