"""The settings of a map, the button that shares it, and the permissions of each role."""

import pytest

from webapp.store.accounts import accounts
from webapp.store.maps import maps
from webapp.store.operate import job_views


@pytest.fixture
def people(new_account):
    """Three accounts by their role."""
    return {role: new_account(role.title()) for role in ("owner", "editor", "viewer")}


@pytest.fixture
def shared(people, new_map):
    """The slug of a map that they share."""
    others = {people[role]: role for role in ("editor", "viewer")}
    return new_map(people["owner"], name="Shared", shared=others)


def roles(library, slug, account):
    """Return the members of the map: name to role."""
    with library.database.read() as session:
        record = maps.find(session, slug, account=account)
        return {person.name: role for person, role in accounts.members_of(session, record)}


@pytest.mark.parametrize(("role", "shown"), [("owner", True), ("editor", False), ("viewer", False)])
def test_only_owners_get_the_button_that_shares(people, shared, sign_in, role, shown):
    client = sign_in(people[role])
    for name in ("edit", "localize", "image", "quality", "settings"):
        page = client.get(f"/maps/{shared}/{name}").text
        assert (f'data-share="{shared}"' in page) == shown, name
    assert "Editor" in page, "the settings name the members"


@pytest.mark.parametrize("role", ["editor", "viewer"])
def test_only_owners_change_settings(library, people, shared, sign_in, role):
    client, where = sign_in(people[role]), f"/maps/{shared}/settings"
    assert client.get(where).status_code == 200
    assert client.post(f"{where}/name", data={"name": "Mine"}).status_code == 403
    assert roles(library, shared, people["owner"]) == {
        "Owner": "owner",
        "Editor": "editor",
        "Viewer": "viewer",
    }


def test_everybody_may_leave_but_the_last_owner(people, shared, sign_in):
    for role, status in (("viewer", 303), ("owner", 400)):
        client = sign_in(people[role])
        assert client.post(f"/maps/{shared}/settings/leave").status_code == status


def test_a_map_gets_another_name(people, shared, sign_in):
    client, where = sign_in(people["owner"]), f"/maps/{shared}/settings"
    before = client.get(f"/api/v1/maps/{shared}").json["revision"]
    assert client.post(f"{where}/name", data={"name": "  New   name "}).status_code == 303
    assert "New name" in client.get("/").text
    after = client.get(f"/api/v1/maps/{shared}").json["revision"]
    assert after > before, "the files of the map follow, which name it too"
    assert client.post(f"{where}/name", data={"name": " "}).status_code == 400


def test_names_are_text_and_no_markup(people, new_map, sign_in):
    new_map(people["owner"], name="<img src=x onerror=alert(1)>")
    text = sign_in(people["owner"]).get("/").text
    assert "<img src=x" not in text
    assert "&lt;img src=x" in text


def test_a_map_learns_from_photos_added_from_answers_unless_its_owner_declines(
    library, people, shared, sign_in, monkeypatch
):
    owner = sign_in(people["owner"])

    def state():
        with library.database.read() as session:
            record = maps.find(session, shared, account=people["owner"])
            return record.uses_adopted, [j.kind for j in job_views.current(session, record.id)]

    where = f"/maps/{shared}/settings/calibration"
    assert sign_in(people["editor"]).post(where).status_code == 403
    assert state() == (True, [])

    def save(**sent):
        answer = owner.post(where, data=sent, follow_redirects=True)
        assert answer.status_code == 200
        return "calibrated again" in answer.text, *state()

    assert save() == (False, False, []), "there is no photo to calibrate on"
    monkeypatch.setattr(maps, "counts", lambda session, record: (3, 2))
    assert save() == (False, False, []), "it is not new"
    assert save(adopted="on") == (True, True, ["index"])
    assert save(adopted="on") == (False, True, ["index"])
