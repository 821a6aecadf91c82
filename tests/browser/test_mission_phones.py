"""Phones in a mission: a link is made and opened on a phone, and the person appears, also after a cut."""

import socket
import subprocess
import sys
import time

import pytest
from playwright.sync_api import expect

from tests.browser import axe
from tests.browser.app import expmap
from tests.browser.polling import PATIENCE_S, until
from tests.connect.mavlink.vehicle import SimulatedVehicle

PHONE = {"viewport": {"width": 390, "height": 844}, "has_touch": True, "is_mobile": True}
CUT = "net::ERR_INTERNET_DISCONNECTED"
HERE = {"latitude": 50.0772, "longitude": 14.4175, "accuracy": 8}


@pytest.fixture
def mission(api):
    return api.ask("POST", "/missions", data={"name": "Search by the river"})["id"]


@pytest.fixture
def link(page, mission):
    """The link of a new phone, made on the page of the mission."""
    page.goto(f"/missions/{mission}")
    page.get_by_label("More").click()
    page.get_by_role("button", name="People with phones").click()
    page.get_by_role("button", name="Add a phone").click()
    page.get_by_test_id("phone-name").fill("Anna")
    page.get_by_role("button", name="Create a link").click()
    expect(page.get_by_test_id("phone-qr")).to_be_visible()
    assert axe.findings(page) == []
    address = page.get_by_test_id("phone-url").input_value()
    page.get_by_role("button", name="Close").click()
    return address


def poses(api, mission):
    return sum(track["poses"] for track in api.ask("GET", f"/missions/{mission}")["tracks"])


def test_a_person_with_a_phone_appears_on_the_map(page, api, mission, link, open_context):
    phone = open_context(geolocation=HERE, permissions=["geolocation"], **PHONE)
    there = phone.new_page()
    there.goto(link)
    expect(there.get_by_role("heading", name="Search by the river")).to_be_visible()
    assert axe.findings(there) == []
    share = there.get_by_test_id("share-position")
    share.click()
    expect(share).to_have_text("Stop sharing")
    expect(there.get_by_test_id("position-accuracy")).to_have_text("8 m")
    expect(page.get_by_test_id("track")).to_contain_text("Anna")
    expect(page.get_by_test_id("live-state")).to_have_text("Live")
    expect(there.get_by_test_id("position-waiting")).to_have_text("0")
    before = poses(api, mission)

    phone.set_offline(True)
    for step in (1, 2):
        phone.set_geolocation(HERE | {"latitude": HERE["latitude"] + step * 0.001})
        expect(there.get_by_test_id("position-waiting")).to_have_text(str(step))
    phone.set_offline(False)
    expect(there.get_by_test_id("position-waiting")).to_have_text("0")
    assert poses(api, mission) == before + 2
    phone.watch.faults = [fault for fault in phone.watch.faults if CUT not in fault]

    there.reload()  # it was on, and goes on
    expect(share).to_have_text("Stop sharing")
    share.click()
    expect(share).to_have_text("Share my position")


def test_a_link_that_was_removed_says_so(page, api, mission, link, open_context):
    phone = open_context(geolocation=HERE, permissions=["geolocation"], **PHONE)
    phone.watch.expect(404, 409)  # 409: it was removed while a position was being stored
    there = phone.new_page()
    there.goto(link)
    there.get_by_test_id("share-position").click()
    until(there, "() => document.getElementById('position-sent').textContent !== '–'")
    page.get_by_label("More").click()
    page.get_by_role("button", name="People with phones").click()
    expect(page.get_by_test_id("phone")).to_contain_text("1 position")
    page.get_by_role("button", name="Remove Anna").click()
    page.get_by_role("button", name="Remove", exact=True).click()
    expect(page.get_by_test_id("phone")).to_have_count(0)
    problem = there.get_by_test_id("position-problem")
    for step in range(10):  # the browser may miss a change of its simulated place
        phone.set_geolocation(HERE | {"latitude": 50.08 + step / 1000})
        there.wait_for_timeout(1000)
        if problem.inner_text():
            break
    expect(problem).to_contain_text("no longer valid")
    expect(there.get_by_test_id("share-position")).to_have_text("Share my position")


@pytest.fixture
def drone(app, mission, tmp_path):
    """Sends packets of a simulated drone to `expmap connect mavlink`, which runs."""
    token = expmap("account", "token", "--name", "drone", library=app.library).split()[-1]
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sending:
        sending.bind(("127.0.0.1", 0))
        port = sending.getsockname()[1]
    words = [tmp_path / "spool", f"udp:127.0.0.1:{port}", "--url", app.url, "--mission", mission]
    options = ["--token", token, "--name", "1=Hawk", "--every", 0.2]
    command = [sys.executable, "-m", "webapp", "connect", "mavlink", *map(str, [*words, *options])]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True)
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as sending:
        yield lambda *packets: [sending.sendto(one, ("127.0.0.1", port)) for one in packets]
    process.kill()
    process.communicate()


def test_a_drone_and_a_phone_appear_live_on_one_page(page, api, mission, link, open_context, drone):
    vehicle, boot_ms = SimulatedVehicle(), 1000

    def fly():
        nonlocal boot_ms
        boot_ms += 500
        place = vehicle.position(boot_ms, HERE["latitude"] + boot_ms * 1e-7, HERE["longitude"])
        drone(vehicle.heartbeat(), vehicle.receiver(), vehicle.charge(63), place)
        page.wait_for_timeout(100)

    robot = page.get_by_test_id("robot").filter(has_text="Hawk")
    track = page.get_by_test_id("track").filter(has_text="Hawk")
    end = time.monotonic() + PATIENCE_S
    while robot.count() == 0 or track.count() == 0:
        assert time.monotonic() < end, "the drone did not appear"
        fly()
    drone(vehicle.text("Geofence breached", 2))
    expect(robot).to_contain_text("Battery 63 %")
    expect(robot).to_contain_text("Loiter")
    expect(robot).to_contain_text("critical: Geofence breached")

    phone = open_context(geolocation=HERE, permissions=["geolocation"], **PHONE)
    there = phone.new_page()
    there.goto(link)
    there.get_by_test_id("share-position").click()
    expect(page.get_by_test_id("track").filter(has_text="Anna")).to_be_visible()
    expect(page.get_by_test_id("robot").filter(has_text="Anna")).to_be_visible()
    expect(page.get_by_test_id("live-state")).to_have_text("Live")
    end = time.monotonic() + PATIENCE_S

    def poses():
        return {one["name"]: one["poses"] for one in api.ask("GET", f"/missions/{mission}")["tracks"]}

    before = poses()
    fly()
    while poses()["Hawk"] == before["Hawk"]:
        assert time.monotonic() < end, "the drone did not go on"
        page.wait_for_timeout(100)
    assert before.keys() == {"Hawk", "Anna"}
