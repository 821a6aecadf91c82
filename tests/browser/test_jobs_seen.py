"""A job is shown in every open page, and can be cancelled from any of them."""

import json
import re

import pytest
from playwright.sync_api import expect

from tests.browser import axe
from tests.browser.conftest import WORK_MS, sign_in

KINDS = ("Evaluation", "Export")


@pytest.mark.slow
def test_progress_and_cancel_in_two_pages(page, context, api, sample_map):
    photos = {"limit": 40}  # enough to leave time for cancelling
    id = api.ask("POST", f"/maps/{sample_map}/evaluation", data=photos)["id"]
    page.goto(f"/maps/{sample_map}/edit")
    listed = context.new_page()
    listed.goto(f"/maps/{sample_map}/jobs")
    row = listed.locator(f"#jobs [data-job='{id}']")
    editor = "[data-testid=job-progress][data-kind=evaluate][data-state={}]".format
    expect(page.locator(editor("running")).first).to_be_visible()
    expect(row.get_by_test_id("job-progress")).to_be_visible()
    other = context.new_page()
    other.goto("/account")
    expect(other.get_by_test_id("jobs-count")).to_have_text(re.compile(r"[1-9]"))
    other.locator("#jobs-menu-button").press("Enter")
    mine = other.locator(f"#jobs-menu-list [data-job='{id}']")
    expect(mine.get_by_test_id("job-progress")).to_be_visible()
    expect(mine).to_contain_text("started by")
    assert axe.findings(other, "#jobs-menu") == []
    mine.get_by_role("button", name="Cancel").evaluate("button => button.click()")  # rows are redrawn
    expect(mine.get_by_text("cancelled")).to_be_visible()
    other.keyboard.press("Escape")
    expect(other.locator("#jobs-menu-list")).to_be_hidden()
    expect(other.locator("#jobs-menu-button")).to_be_focused()
    expect(row.get_by_text("cancelled")).to_be_visible()
    expect(page.locator(editor("cancelled")).first).to_be_attached()
    job = api.ask("GET", f"/jobs/{id}")
    assert (job["state"], job["done"] < job["total"]) == ("cancelled", True)
    row.get_by_role("button", name="Try again").click()
    expect(row.get_by_text("done", exact=True)).to_be_visible(timeout=WORK_MS)


FAILED = {
    **dict.fromkeys(("result", "seconds", "seconds_left", "next_try_s", "by", "behind")),
    "id": 4711,
    "state": "failed",
    "done": 1,
    "total": 4,
    "note": "",
    "error": {"message": "the tile server does not answer", "where": None, "hint": "try another service"},
    "created_at": "2026-01-02T03:04:05+00:00",
    "mine": True,
    "can_change": True,
}


@pytest.mark.parametrize(("tab", "kind"), [("quality", "evaluate"), ("image", "satellite-tiles")])
def test_a_failure_is_still_there_after_a_reload_until_it_is_dismissed(make_page, tab, kind):
    edit = make_page(1, placed=True)
    page = edit.page
    job = FAILED | {"kind": kind, "map": edit.slug, "map_name": "A map"}

    def with_failure(route):
        answer = route.fetch()
        page_data = answer.text().replace('"failure": null', f'"failure": {json.dumps(job)}')
        route.fulfill(response=answer, body=page_data)

    # Image has it in its page, Quality asks for it
    page.route(re.compile("/image$"), with_failure)
    page.route(re.compile(r"/api/v1/jobs\?map="), lambda route: route.fulfill(json={"jobs": [job]}))
    failure = page.locator("[data-job-failure]")
    for _ in range(2):
        page.goto(f"/maps/{edit.slug}/{tab}")
        expect(failure).to_contain_text("The tile server does not answer")
    failure.get_by_role("button", name="Dismiss").dispatch_event("click")
    expect(failure).to_have_count(0)
    page.reload(wait_until="networkidle")
    expect(failure).to_have_count(0)


def test_a_failure_in_the_editor_is_hidden_for_good(make_page, api):
    edit = make_page(1)
    page = edit.page
    id = api.ask("POST", f"/maps/{edit.slug}/exports", data={"format": "geojson"})["job"]
    page.goto(f"/maps/{edit.slug}/edit")
    failed = page.locator("[data-testid=job-progress][data-kind=export][data-state=failed]")
    expect(failed).to_be_visible(timeout=WORK_MS)
    page.reload()
    expect(failed).to_be_visible()
    failed.get_by_role("button", name="Hide").click()
    page.reload()
    expect(page.locator("#map-canvas")).to_be_visible()
    expect(failed).to_have_count(0)
    assert api.ask("GET", f"/jobs/{id}")["state"] == "failed"


def test_what_a_job_waits_for_is_said(make_page):
    edit = make_page(1)
    behind = {"kind": "index", "map_name": "Getty", "seconds_left": 181.0}
    job = FAILED | {"kind": "export", "state": "queued", "error": None, "map": edit.slug, "behind": behind}
    edit.page.route(re.compile(r"/api/v1/jobs\?map="), lambda route: route.fulfill(json={"jobs": [job]}))
    edit.page.goto(f"/maps/{edit.slug}/jobs")
    shown = edit.page.locator("#jobs").get_by_test_id("job-progress")
    expect(shown).to_have_text("Queued behind: Index (Getty) · about 3 minutes left")


def test_what_a_job_waits_for_and_when_it_is_tried_again(make_page):
    edit = make_page(3)
    nothing = ("error", "result", "seconds", "seconds_left", "by")
    job = {
        **dict.fromkeys(nothing),
        "id": 1,
        "kind": "index",
        "state": "queued",
        "done": 0,
        "total": 0,
        "note": "the Dask scheduler cannot be reached",
        "next_try_s": 79.6,
        "created_at": "2026-01-02T03:04:05+00:00",
        "mine": False,
        "map": edit.slug,
        "map_name": "A map",
        "can_change": True,
    }
    edit.page.route(re.compile(r"/api/v1/jobs\?map="), lambda route: route.fulfill(json={"jobs": [job]}))
    edit.page.goto(f"/maps/{edit.slug}/jobs")
    shown = edit.page.locator("#jobs").get_by_test_id("job-progress")
    expect(shown).to_have_text("the Dask scheduler cannot be reached · retrying in 80 seconds")


def test_the_card_of_jobs_leaves_image_and_photos_free_on_a_wide_screen(make_page):
    edit = make_page(30, placed=True)
    card = edit.page.locator("#activity")
    expect(card).to_be_visible()
    for view in ("side", "strip", "grid"):
        edit.page.locator(f"[data-view={view}]:is(button)").click()
        result = card.bounding_box()
        for part in ("#map-canvas", "#side"):
            box = edit.page.locator(part).bounding_box()
            assert (
                result["x"] >= box["x"] + box["width"] - 1 or result["y"] + result["height"] <= box["y"] + 1
            )
        assert result["y"] + result["height"] <= edit.page.viewport_size["height"]


def test_viewers_cancel_what_they_have_started(open_context, app, api, sample_map):
    name = f"viewer {sample_map}"
    link = api.ask("POST", "/accounts", data={"name": name})
    api.ask("POST", f"/maps/{sample_map}/members", data={"name": name, "role": "viewer"})
    try:
        page = open_context().new_page()
        sign_in(page, link["url"])
        api.ask("POST", f"/maps/{sample_map}/evaluation", data={})
        page.goto(f"/maps/{sample_map}/jobs")
        theirs, own = (page.locator(".job", has=page.get_by_role("heading", name=kind)) for kind in KINDS)
        expect(theirs.get_by_test_id("job-progress")).to_be_visible()
        expect(theirs.get_by_role("button", name="Cancel")).to_have_count(0)
        waiting = FAILED | {"kind": "export", "state": "queued", "error": None, "can_change": False}
        ended = []

        def with_own(route):
            own_job = waiting | ({"state": "cancelled"} if ended else {"can_change": True})
            route.fulfill(json={"jobs": [own_job, *route.fetch().json()["jobs"]]})

        def cancelled(route):
            ended.append(route.request.url)
            route.fulfill(json={})

        page.route(re.compile(r"/api/v1/jobs\?map="), with_own)
        page.route("**/api/v1/jobs/4711/cancel", cancelled)
        own.get_by_role("button", name="Cancel").click()
        expect(own.get_by_text("cancelled")).to_be_visible()
        page.unroute_all(behavior="wait")
        page.close()  # it would go on polling, which fails once the account is deleted
    finally:
        api.cancel_jobs(sample_map)
        api.ask("DELETE", f"/accounts/{link['account']}")


def test_the_menu_asks_on_after_the_server_was_away(page):
    job = {
        **dict.fromkeys(("map", "map_name", "by", "error", "result", "seconds_left", "next_try_s")),
        "id": 1,
        "kind": "export",
        "state": "running",
        "note": "",
        "done": 1,
        "total": 2,
        "seconds": 3,
        "created_at": "2026-11-01T00:00:00+00:00",
        "mine": True,
        "can_change": False,
    }
    answers = [job, None, {**job, "state": "done"}]

    def answer(route):
        now = answers.pop(0) if len(answers) > 1 else answers[0]
        if now is None:
            route.abort()
        else:
            route.fulfill(json={"jobs": [now]})

    page.route("**/api/v1/jobs", answer)
    page.goto("/account")
    expect(page.get_by_test_id("jobs-count")).to_have_text("1")
    page.locator("#jobs-menu-button").click()
    expect(page.locator("#jobs-menu-list .badge")).to_have_text("done")
    expect(page.get_by_test_id("jobs-count")).to_be_hidden()
    watch = page.context.watch
    watch.faults = [fault for fault in watch.faults if "net::ERR_FAILED" not in fault]
