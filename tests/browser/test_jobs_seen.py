"""A job is seen in every open page, and can be cancelled from any."""

from playwright.sync_api import expect


def test_progress_and_cancel_in_two_pages(make_page, context, api):
    edit = make_page(30, placed=True)
    listed = context.new_page()
    listed.goto(f"/maps/{edit.slug}/jobs")
    one, two = (page.get_by_test_id("job-progress") for page in (edit.page, listed))
    expect(one.first).to_be_visible()
    expect(two.first).to_be_visible()
    listed.get_by_role("button", name="Cancel").first.click()
    expect(listed.get_by_text("cancelled")).to_be_visible(timeout=20_000)
    expect(edit.page.locator("[data-testid=job-progress][data-state=cancelled]")).to_be_attached(
        timeout=20_000
    )
    (job, *_) = api.ask("GET", f"/jobs?map={edit.slug}")["jobs"]
    assert (job["state"], job["done"] < job["total"]) == ("cancelled", True)
    listed.get_by_role("button", name="Try again").first.click()
    expect(listed.get_by_text("done", exact=True)).to_be_visible(timeout=60_000)
