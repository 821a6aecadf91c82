"""The editor page: its content, and permissions."""

import json
import re

import pytest

from webapp.files.decode import IMAGE_FORMATS
from webapp.resources import resource_folder
from webapp.store.accounts import accounts
from webapp.store.maps import maps
from webapp.store.schema import MapRecord


@pytest.fixture
def slug(library, owner):
    with library.database.write() as session:
        return maps.create(session, "Park", account_id=owner.id, folders=[]).slug


@pytest.fixture
def page(sign_in, owner, slug):
    return sign_in(owner).get(f"/maps/{slug}/edit")


def test_the_address_of_a_map_leads_to_it(sign_in, owner, slug, new_account):
    assert sign_in(owner).get(f"/maps/{slug}").location == f"/maps/{slug}/edit"
    assert sign_in(owner).get(f"/maps/{slug}/").location == f"/maps/{slug}"
    assert sign_in(owner).get("/maps/none").status_code == 404
    assert sign_in(new_account("Jan")).get(f"/maps/{slug}").status_code == 404


def test_the_state_comes_with_the_page(page, slug):
    text = page.get_data(as_text=True)
    found = re.search(r'<script type="application/json" id="state">(.*?)</script>', text, re.S)
    state = json.loads(found[1])
    assert (state["slug"], state["photos"], state["satellite"], state["can_edit"]) == (slug, [], None, True)


def test_scripts_find_what_they_look_for(page):
    text = page.get_data(as_text=True)
    wanted = set()
    for script in (resource_folder("static") / "js" / "editor").glob("*.js"):
        wanted |= set(re.findall(r'byId\("([\w-]+)"', script.read_text("utf-8")))
    assert len(wanted) > 30
    assert {id for id in wanted if f'id="{id}"' not in text} == set()


def test_nothing_inline_that_the_content_policy_refuses(page):
    text = page.get_data(as_text=True)
    assert not re.search(r"<[^>]+\s(style|on\w+)=", text)
    assert not re.search(r"<script(?![^>]*(src=|application/json))", text)


@pytest.mark.parametrize(
    "testid",
    ["map-canvas", "photo-input", "satellite-input", "current-photo", "undo", "redo", "export-cfg"],
)
def test_what_others_script_against_is_there_once(page, testid):
    assert page.get_data(as_text=True).count(f'data-testid="{testid}"') == 1


def test_who_may_only_look_finds_no_tools(library, sign_in, new_account, slug):
    guest = new_account("Guest")
    with library.database.write() as session:
        record = session.query(MapRecord).filter_by(slug=slug).one()
        accounts.set_member_role(session, record, account=accounts.named(session, "Guest"), role="viewer")
    text = sign_in(guest).get(f"/maps/{slug}/edit").get_data(as_text=True)
    assert '"can_edit": false' in text
    assert re.search(r'<div class="ed-group" hidden>\s*<input class="ed-file" id="photo-input"', text)


def test_a_map_of_others_is_not_found(sign_in, new_account, slug):
    assert sign_in(new_account("Stranger")).get(f"/maps/{slug}/edit").status_code == 404


def test_its_file_fields_accept_each_format_that_is_read(page):
    text = page.get_data(as_text=True)
    accepted = {
        id: set(found.split(","))
        for id, found in re.findall(r'id="([\w-]+)" type="file"[^>]*? accept="([^"]*)"', text)
    }
    suffixes = {suffix for entry in IMAGE_FORMATS.values() for suffix in entry.suffixes}
    assert accepted["photo-input"] == suffixes | {"image/*", ".xmp", ".json"}
    assert (
        accepted["satellite-input"] - {kind for e in IMAGE_FORMATS.values() for kind in e.media_types}
        == suffixes
    )
    sent = json.loads(
        re.search(r'<script type="application/json" id="accepted">(.*?)</script>', text, re.S)[1]
    )
    assert sent["positions"] == ".cfg,.csv,.tsv,.txt,.geojson,.json,.kml,.gpx,.gpkg"
    assert sent["map_images"].split(",")[0] == "image/jpeg"
