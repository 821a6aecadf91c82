"""A stream of events ends when the caller may no longer follow the mission; nothing more is sent."""

import dataclasses

import pytest

from webapp.settings import MissionSettings


@pytest.fixture
def settings(settings):
    return dataclasses.replace(settings, missions=MissionSettings(stream_s=120.0, look_s=0.02))


@pytest.fixture
def member(new_account):
    return new_account("Eve")


@pytest.fixture
def browser(sign_in, member):
    """A browser in which the member is signed in."""
    return sign_in(member)


@pytest.fixture
def mission(new_mission, new_map, owner, member):
    """A mission on a map that the member may view."""
    return new_mission(map=new_map(owner, shared={member: "viewer"}))


ENDS = {
    "removed from the map": (
        lambda client, member, _: client.delete(f"/api/v1/maps/park/members/{member.id}"),
        404,
    ),
    "account removed": (lambda client, member, _: client.delete(f"/api/v1/accounts/{member.id}"), 401),
    "signed out": (lambda _, _member, browser: browser.post("/sign-out"), 401),
}


@pytest.mark.parametrize(("end", "status"), ENDS.values(), ids=ENDS)
def test_nothing_is_sent_to_somebody_who_lost_the_right(
    end, status, client, browser, member, mission, send, walk
):
    path = f"/api/v1/missions/{mission}/events"
    copy = browser.get_cookie("expmap")
    answer = browser.get(path, buffered=False)
    stream = iter(answer.response)
    assert next(stream) == b"retry: 1000\n\n"
    assert b"event: changed" in next(stream)
    assert end(client, member, browser).status_code < 400
    if status == 404:  # the other streams end although nothing happens
        send(walk(3))
    assert list(stream) == []
    if copy is not None:
        browser.set_cookie("expmap", copy.value)
    assert browser.get(path).status_code == status
    assert client.get(path, buffered=False).status_code == 200, "others go on"
