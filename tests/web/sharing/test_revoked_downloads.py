"""A download that runs when its caller loses the right to it ends there, incomplete."""

import pytest

from webapp.app.registry import REGISTRY
from webapp.errors import NotFound
from webapp.jobs.worker import Worker
from webapp.tasks.maps import adopt_map
from webapp.web import sending

PHOTOS = 3
CORNERS = {
    "kind": "corners",
    "corners": {"top_left": {"lat": 50.001, "lon": 14.0}, "bottom_right": {"lat": 50.0, "lon": 14.002}},
}


@pytest.fixture
def member(new_account):
    return new_account("Eve")


@pytest.fixture
def park(library, owner, member, client, make_map):
    """The slug of a map with photos that the member may view."""
    make_map(library.map_folder("park"), PHOTOS)
    adopt_map.adopt_map(library, "park", account_id=owner.id)
    assert client.put("/api/v1/maps/park/georeference", json=CORNERS).status_code == 200
    shared = client.post("/api/v1/maps/park/members", json={"name": member.name, "role": "viewer"})
    assert shared.status_code == 200
    return "park"


class Clock:
    """A clock that the test sets."""

    def __init__(self):
        self.now = 1000.0

    def monotonic(self):
        return self.now


@pytest.fixture
def clock(monkeypatch):
    made = Clock()
    monkeypatch.setattr(sending, "time", made)
    return made


@pytest.fixture
def kept(client, library, settings, park):
    """The path of a zip that a job has made."""
    job = client.post(f"/api/v1/maps/{park}/exports", json={"format": "zip"}).json["job"]
    Worker(library, settings, registry=REGISTRY).run(once=True)
    assert client.get(f"/api/v1/jobs/{job}").json["state"] == "done"
    return f"exports/{park}.zip"


def read(stream, until):
    """Read a stream until it contains some bytes."""
    data = b""
    while until not in data:
        data += next(stream)
    return data


@pytest.mark.parametrize(
    ("path", "photo"),
    [("export.zip", b"photos/%d.jpg"), ("export.kmz", b"files/%d.jpg"), ("export.exif", b"%d.jpg")],
)
def test_no_photo_is_added_after_a_member_was_removed(path, photo, client, sign_in, member, park, clock):
    browser = sign_in(member)
    answer = browser.get(f"/api/v1/maps/{park}/{path}", buffered=False)
    assert answer.status_code == 200
    stream = iter(answer.response)
    read(stream, photo % 0)
    assert client.delete(f"/api/v1/maps/{park}/members/{member.id}").status_code < 300
    clock.now += sending.CHECK_S
    with pytest.raises(NotFound):
        next(stream)
    assert not list(stream)
    assert browser.get(f"/api/v1/maps/{park}/{path}").status_code == 404
    whole = client.get(f"/api/v1/maps/{park}/{path}").data
    assert all(photo % number in whole for number in range(PHOTOS))


def test_a_kept_file_is_not_sent_to_its_end(client, sign_in, member, kept, park, clock):
    browser = sign_in(member)
    whole = client.get(f"/api/v1/maps/{park}/{kept}", buffered=True)
    assert int(whole.headers["Content-Length"]) == len(whole.data)
    part = client.get(f"/api/v1/maps/{park}/{kept}", headers={"Range": "bytes=5-104"}, buffered=True)
    assert (part.status_code, part.data) == (206, whole.data[5:105])
    answer = browser.get(f"/api/v1/maps/{park}/{kept}", buffered=False)
    stream = iter(answer.response)
    sent = next(stream)
    assert client.delete(f"/api/v1/maps/{park}/members/{member.id}").status_code < 300
    clock.now += sending.CHECK_S
    with pytest.raises(NotFound):
        next(stream)
    answer.close()
    assert len(sent) < len(whole.data)


def test_the_right_is_checked_once_a_second(sign_in, member, park, clock, monkeypatch):
    checks = []
    real = sending.repeated_check

    def counted():
        check = real()
        return lambda: checks.append(check())

    monkeypatch.setattr(sending, "repeated_check", counted)
    browser = sign_in(member)
    stream = iter(browser.get(f"/api/v1/maps/{park}/export.zip", buffered=False).response)
    next(stream), next(stream)
    assert len(checks) == 0
    clock.now += sending.CHECK_S
    next(stream)
    clock.now += sending.CHECK_S / 2
    next(stream)
    assert len(checks) == 1
