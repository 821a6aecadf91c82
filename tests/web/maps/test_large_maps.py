"""A map of very many photos is loaded in parts: dots first, then details in batches."""

import json
import re

import pytest
from sqlalchemy import insert

from webapp.store import sharing
from webapp.store.maps import maps
from webapp.store.schema import MapRecord, Photo
from webapp.web.maps import state

COUNT = 12
FIRST = 4


@pytest.fixture(autouse=True)
def few_first(monkeypatch):
    monkeypatch.setattr(state, "FIRST_PHOTOS", FIRST)


@pytest.fixture
def record(library, owner):
    """Every third photo is in the tray, the last one is removed, and later ids have earlier times."""
    with library.database.write() as session:
        record = maps.create(session, "Large", account_id=owner.id)
        record.satellite_width, record.satellite_height = 100, 80
        session.flush()
        rows = [
            {
                "map_id": record.id,
                "id": id,
                "name": f"{id}.jpg",
                "path": f"photos/{id}.jpg",
                "sha256": f"{id:064x}",
                "size_bytes": 1,
                "width": 4,
                "height": 3,
                "taken_at": f"2026-05-01T12:00:{COUNT - id:02}",
                "fov_deg": 65.0,
                "x_px": None if id % 3 == 0 else id + 0.123456,
                "y_px": None if id % 3 == 0 else 2.0,
                "heading_deg": None,
                "removed": id == COUNT - 1,
                "revision": 1,
            }
            for id in range(COUNT)
        ]
        session.execute(insert(Photo), rows)
    return record


def state_of(answer):
    return json.loads(re.search(r'id="state">(.*?)</script>', answer.text, re.S)[1])


@pytest.mark.parametrize("tab", ["edit", "localize"])
def test_a_page_has_the_first_of_the_tray_and_the_dots_of_all_others(client, record, tab):
    page = state_of(client.get(f"/maps/large/{tab}"))
    assert [photo["id"] for photo in page["photos"]] == [9, 6, 3, 0]
    assert page["dots"]["id"] == [1, 2, 4, 5, 7, 8, 10]
    assert page["dots"]["x_px"][0] == 1.12 and page["dots"]["fov_deg"] == [65.0] * 7
    assert set(page) - {"dots"} == set(client.get("/api/v1/maps/large").json)


def test_the_state_of_the_api_stays_whole(client, record):
    whole = client.get("/api/v1/maps/large").json
    assert [photo["id"] for photo in whole["photos"]] == list(range(COUNT - 1)) and "dots" not in whole


def test_the_details_come_page_by_page(client, record):
    whole = {photo["id"]: photo for photo in client.get("/api/v1/maps/large").json["photos"]}
    found, after = [], -1
    while after is not None:
        answer = client.get(f"/api/v1/maps/large/photos?after={after}&limit=5").json
        found += answer["photos"]
        after = answer["next"]
    assert {photo["id"]: photo for photo in found} == whole and len(found) == len(whole)


@pytest.mark.parametrize("query", ["limit=0", "limit=5001", "after=-2", f"after={2**63}", "after=x"])
def test_a_page_that_cannot_be_is_refused(client, record, query):
    assert client.get(f"/api/v1/maps/large/photos?{query}").status_code == 422


def test_a_stranger_and_somebody_else_get_no_details(stranger, sign_in, new_account, record):
    address = "/api/v1/maps/large/photos"
    assert stranger.get(address).status_code == 401
    assert sign_in(new_account("Jan")).get(address).status_code == 404


@pytest.mark.parametrize("originals", [False, True])
def test_visitors_get_the_same_and_nothing_of_the_tray(library, owner, stranger, record, originals):
    with library.database.write() as session:
        allows = sharing.SharePermissions(photos=True, originals=originals)
        row = session.get(MapRecord, record.id)
        _share, token = sharing.create(
            session, row, allows=allows, account_id=owner.id, query_id=None, public=False
        )
    page = state_of(stranger.get(f"/s/{token}"))
    whole = stranger.get(f"/api/v1/shared/{token}").json
    ids = [photo["id"] for photo in whole["photos"]]
    assert ids == [1, 2, 4, 5, 7, 8, 10]
    assert sorted([photo["id"] for photo in page["photos"]] + page["dots"]["id"]) == ids
    assert len(page["photos"]) == FIRST
    assert set(page["dots"]["fov_deg"]) == ({65.0} if originals else {None})
    answer = stranger.get(f"/api/v1/shared/{token}/photos?after=4&limit=3").json
    assert answer == {"photos": whole["photos"][3:6], "next": 8}
    assert stranger.get("/api/v1/shared/none/photos").status_code == 404


def test_a_preview_has_some_of_many_positions(library, record):
    with library.database.read() as session:
        row = session.get(MapRecord, record.id)
        every = [x for x, _ in maps.some_positions(session, [row], most=100)[row.id]]
        assert every == [id + 0.123456 for id in (1, 2, 4, 5, 7, 8, 10)]
        assert [x for x, _ in maps.some_positions(session, [row], most=3)[row.id]] == every[2::2]
