"""Several accounts on one device: nothing that one has kept or queued is shown to another, or to nobody."""

from secrets import token_hex

import pytest
from playwright.sync_api import Error

from tests.browser.app import expmap
from tests.browser.conftest import sign_in
from tests.browser.test_offline import CUT, GONE, PHONE, kept, open_field, photos, until, waiting
from webapp.store.accounts import accounts
from webapp.store.accounts import sign_in as ways_in
from webapp.store.library import open_library


@pytest.fixture
def newcomer(app):
    """A sign-in link of another account, without a role on any map."""
    library = open_library(app.library)
    with library.database.write() as session:
        account = accounts.create(session, f"newcomer {token_hex(4)}")
        link = ways_in.new_link(session, account, hours=1)
    library.database.close()
    return f"/sign-in/{link}"


@pytest.fixture
def device(open_context, link):
    """A phone on which the owner is signed in."""
    context = open_context(service_workers="allow", **PHONE)
    sign_in(context.new_page(), link)
    context.watch.expect(401, 404)
    yield context
    context.watch.faults = [
        fault for fault in context.watch.faults if CUT not in fault and "ERR_FAILED" not in fault
    ]


def sign_out(page):
    page.goto("/account")
    page.locator("header summary:not(#jobs-menu-button)").click()
    page.get_by_role("button", name="Sign out", exact=True).click()
    page.wait_for_url("**/sign-in")


def status_of(page, address):
    """Fetch an address as a page does, through the service worker and the cache of the browser."""
    return page.evaluate(
        "async (address) => (await fetch(address).catch(() => ({status: 0}))).status", address
    )


def test_nobody_sees_what_another_account_kept(device, newcomer, api, sample_map):
    page = open_field(device, sample_map)
    kept(page, sample_map)
    photo = api.state(sample_map)["photos"][0]["id"]
    pictures = [f"/api/v1/maps/{sample_map}/photos/{photo}/{kind}" for kind in ("preview", "original")]
    assert [status_of(page, address) for address in pictures] == [200, 200]
    other = device.new_page()  # a second tab signs out while the first one stays open
    sign_out(other)
    until(other, GONE)
    refused = [401, 401]
    assert [status_of(other, address) for address in pictures] == refused, "nor from the browser's cache"
    page.close()

    device.set_offline(True)
    for address in ("/", "/field", f"/field?map={sample_map}", f"/maps/{sample_map}/edit"):
        tab = device.new_page()
        with pytest.raises(Error, match=r"ERR_(INTERNET_DISCONNECTED|FAILED)"):
            tab.goto(address)  # nothing is kept: the browser's own page
        tab.close()
    assert [status_of(other, address) for address in pictures] == [0, 0]
    device.set_offline(False)

    sign_in(other, newcomer)
    assert [status_of(other, address) for address in pictures] == [404, 404]
    other.goto("/field")
    device.set_offline(True)
    assert [status_of(other, address) for address in pictures] == [0, 0]
    device.set_offline(False)
    sign_out(other)


def test_unsent_photos_wait_for_their_account(device, newcomer, app, sample_map, sample_folder):
    """They are sent neither for nobody nor for the next account, and are still there for their own."""
    page = open_field(device, sample_map)
    kept(page, sample_map)
    other = device.new_page()
    other.goto("/account")
    sent = []
    device.route("**/localize", lambda route: sent.append(route.request.url))  # never answered
    device.set_offline(True)
    page.get_by_test_id("shot-input").set_input_files(sorted((sample_folder / "queries").glob("*.jpg"))[0])
    waiting(page, 1)
    page.close()
    device.set_offline(False)
    sign_out(other)
    sign_in(other, newcomer)
    other.goto("/field")
    waiting(other, 0)
    assert photos(other, "waiting").count() == 0 and sent == []
    sign_out(other)
    sign_in(other, expmap("account", "link", "--url", app.url, library=app.library).split()[-1])
    other.goto(f"/field?map={sample_map}")
    waiting(other, 1)


def test_signing_out_without_a_network_leaves_nothing(device, sample_map):
    page = open_field(device, sample_map)
    kept(page, sample_map)
    leaving = device.new_page()
    leaving.goto("/account")
    device.set_offline(True)
    leaving.locator("header summary:not(#jobs-menu-button)").click()
    leaving.get_by_role("button", name="Sign out", exact=True).click()
    until(page, GONE)
