"""Printing a map: dialog, preview and download; and the browser's own print view."""

import re

import pytest
from playwright.sync_api import expect

from tests.browser import axe
from tests.browser.polling import until

pytestmark = pytest.mark.slow


def test_a_sheet_is_seen_before_it_is_downloaded(page, sample_map):
    page.goto(f"/maps/{sample_map}/edit")
    page.locator("summary[aria-label='More export formats']").click()
    page.get_by_test_id("print-map").click()
    sheet = page.get_by_test_id("print-preview")
    landscape = "image => image.complete && image.naturalWidth > image.naturalHeight"
    portrait = "image => image.complete && image.naturalWidth < image.naturalHeight"
    until(page, landscape, sheet.element_handle())
    page.get_by_label("Orientation").select_option("portrait")
    page.get_by_label("Title").fill("Our park")
    until(page, portrait, sheet.element_handle())
    pdf = page.get_by_test_id("print-pdf")
    expect(pdf).to_have_attribute("href", re.compile(r"print\.pdf\?.*orientation=portrait.*title=Our\+park"))
    assert axe.findings(page) == []
    with page.expect_download() as download:
        pdf.click()
    assert download.value.suggested_filename.endswith(".pdf")


def test_the_page_as_the_browser_prints_it_has_the_map_and_no_buttons(page, sample_map):
    page.goto(f"/maps/{sample_map}/edit")
    expect(page.get_by_test_id("map-canvas")).to_be_visible()
    page.emulate_media(media="print")
    expect(page.get_by_test_id("map-canvas")).to_be_visible()
    expect(page.locator("#toolbar")).to_be_hidden()
    expect(page.locator("#side")).to_be_hidden()
