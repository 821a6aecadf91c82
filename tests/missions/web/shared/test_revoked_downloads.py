"""A download of a mission ends, incomplete, when its link is revoked or its caller loses the role."""

import pytest

from webapp.errors import NotFound
from webapp.web import sending


@pytest.fixture
def at_once(monkeypatch):
    """Check the right before each piece."""
    monkeypatch.setattr(sending, "CHECK_S", 0.0)


pytestmark = pytest.mark.usefixtures("at_once")


def test_a_revoked_link(app, client, new_mission, share):
    mission = new_mission(3000)
    made = share(mission)
    visitor = app.test_client()
    path = f"/m/{made['url'].rpartition('/')[2]}/export.kmz"
    answer = visitor.get(path, buffered=False)
    assert answer.status_code == 200
    stream = iter(answer.response)
    sent = next(stream)
    assert client.delete(f"/api/v1/missions/{mission}/shares/{made['id']}").status_code < 300
    with pytest.raises(NotFound):
        next(stream)
    assert b"doc.kml" not in sent
    answer.close()
    assert visitor.get(path).status_code == 404


def test_a_member_who_was_removed(client, sign_in, new_account, new_map, owner, new_mission, add_photo):
    member = new_account("Eve")
    slug = new_map(owner, shared={member: "viewer"})
    mission = new_mission(map=slug)
    add_photo(mission)
    browser = sign_in(member)
    path = f"/api/v1/missions/{mission}/export.kmz"
    assert b"photos/" in browser.get(path).data
    answer = browser.get(path, buffered=False)
    stream = iter(answer.response)
    next(stream)
    assert client.delete(f"/api/v1/maps/{slug}/members/{member.id}").status_code < 300
    with pytest.raises(NotFound):
        next(stream)
    answer.close()
    assert browser.get(path).status_code == 404
    assert client.get(path).status_code == 200, "and its slot is free"
