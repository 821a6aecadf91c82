"""The list of tasks, used by one rescuer at a desk and one with a phone, with shared updates."""

import pytest
from playwright.sync_api import expect

from tests.browser import axe

pytestmark = pytest.mark.slow

PHONE = {
    "viewport": {"width": 390, "height": 844},
    "color_scheme": "dark",
    "has_touch": True,
    "is_mobile": True,
}
BEGIN = 1_760_000_000
CLASSES = ("victim", "victim", "car", "fire", "gas leak")


def pose(n):
    return {"type": "pose", "time": BEGIN + n, "lat": 50.0772 + n * 1e-6, "lon": 14.4175 + n * 1e-5}


def seen(n, kind):
    at = {"lat": 50.0772 + n * 2e-4, "lon": 14.4177 + n * 1e-4}
    return {"type": "object", "class": kind, "time": BEGIN + n, "covariance": [4, 4, 0], **at}


@pytest.fixture
def mission(api):
    """The id of an ended mission with objects."""
    id = api.ask("POST", "/missions", data={"name": "Search in the yard"})["id"]
    found = [seen(n, kind) for n, kind in enumerate(CLASSES)]
    records = [*(pose(n) for n in range(40)), *found, {"type": "end"}]
    api.ask("POST", f"/missions/{id}/batches", data={"sender": "robot", "first": 0, "records": records})
    return id


def test_tasks_are_done_with_a_phone_and_seen_at_once(page, open_context, owner, mission):
    page.goto(f"/missions/{mission}")
    page.get_by_test_id("tab-tasks").click()
    tasks = page.get_by_test_id("task")
    expect(tasks).to_have_count(5)
    phone = open_context(storage_state=owner, reduced_motion="reduce", **PHONE).new_page()
    phone.goto(f"/missions/{mission}")
    phone.get_by_test_id("tab-tasks").tap()
    phone.get_by_role("button", name="Confirm: victim #2").tap()
    expect(tasks.first).to_contain_text("victim #2")  # confirmed ones come first
    expect(tasks.first).to_contain_text("Confirmed")
    assert axe.findings(page) == []
    assert axe.findings(phone) == []
    page.get_by_role("button", name="victim #2", exact=True).click()
    card = page.get_by_test_id("object-card")
    card.get_by_role("textbox", name="Note").fill("taken to the gate")
    card.get_by_role("button", name="Clear: victim #2").click()
    expect(card.get_by_test_id("object-state")).to_have_text("Cleared")
    expect(card.get_by_test_id("object-changes")).to_contain_text("taken to the gate")
    expect(phone.get_by_test_id("task")).to_have_count(4)
    phone.get_by_role("button", name="Done").tap()
    expect(phone.get_by_test_id("task")).to_have_count(1)
    expect(phone.get_by_test_id("task")).to_contain_text("victim #2")
    assert axe.findings(page) == []
