"""The robots on the page of a mission: how they are, and the alarm when one is silent."""

import time

import pytest
from playwright.sync_api import expect

from tests.browser import axe

WAIT_MS = 30_000


@pytest.fixture
def mission(api):
    """The id of a mission with a robot."""
    id = api.ask("POST", "/missions", data={"name": "Search in the yard"})["id"]
    api.ask("PATCH", f"/missions/{id}", data={"silent_after_s": 6})
    return id


def test_a_silent_robot_raises_an_alarm(page, api, mission):
    def send(first):
        at = {"type": "pose", "time": time.time(), "lat": 50.0772, "lon": 14.4175, "track": "Rover"}
        said = {
            "type": "status",
            "time": time.time(),
            "track": "Rover",
            "battery_percent": 12,
            "mode": "auto",
        }
        records = [at, said]
        data = {"sender": "robot", "first": first, "records": records}
        api.ask("POST", f"/missions/{mission}/batches", data=data)

    send(0)
    page.goto(f"/missions/{mission}")
    robot = page.get_by_test_id("robot")
    expect(robot).to_contain_text("Battery 12 %")
    expect(robot).to_contain_text("auto")
    expect(robot.get_by_test_id("heard")).to_contain_text("last heard")
    alarm = page.get_by_test_id("silent-state")
    expect(alarm).to_have_text("Silent: Rover", timeout=WAIT_MS)
    expect(robot.get_by_test_id("heard")).to_have_class("badge badge--danger")
    assert axe.findings(page) == []
    send(2)
    expect(alarm).to_have_text("", timeout=WAIT_MS)
    page.get_by_text("Log of silences").click()
    expect(page.get_by_test_id("silences")).to_contain_text("Rover: silent from")
    page.get_by_test_id("silent-after").select_option("300")
    expect(alarm).to_have_text("")
