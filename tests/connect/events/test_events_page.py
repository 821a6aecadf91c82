"""The page: receivers are added, tried, changed and removed without a script."""

import re

from tests.connect.events.conftest import API

PAGE = "/account/events"


def test_a_webhook_is_added_on_the_page_and_its_secret_shown_once(client, hook, work):
    assert PAGE in client.get("/account").text
    added = client.post(PAGE, data={"kind": "webhook", "address": hook.url, "events": ["job.failed"]})
    assert re.search(r'value="(whsec_[^"]{40,})"', added.text)
    shown = client.get(PAGE).text
    assert hook.url in shown and "whsec_" not in shown
    (receiver,) = client.get(API).json["receivers"]
    assert receiver["events"] == ["job.failed"]
    client.post(f"{PAGE}/{receiver['id']}/choose", data={"events": ["robot.silent", "robot.heard"]})
    assert client.get(API).json["receivers"][0]["events"] == ["robot.silent", "robot.heard"]
    hook.status = 500
    assert client.post(f"{PAGE}/{receiver['id']}/test").status_code == 303
    work()
    shown = client.get(PAGE).text
    assert "1 failed try" in shown and "The receiver answered 500" in shown
    client.post(f"{PAGE}/{receiver['id']}/remove")
    assert client.get(API).json["receivers"] == []


def test_errors_are_shown_on_the_page(client, hook):
    answer = client.post(PAGE, data={"kind": "webhook", "address": "hook"})
    assert answer.status_code == 400
    assert "This is not the address of a webhook" in answer.text
    answer = client.post(PAGE, data={"kind": "webhook", "address": hook.url, "events": ["unknown"]})
    assert "Unknown event" in answer.text
    answer = client.post(PAGE, data={"kind": "mail", "address": "eva@example.org"})
    assert "This server sends no e-mail" in answer.text


def test_strangers_are_sent_to_the_sign_in(stranger):
    assert stranger.get(PAGE).status_code == 302
    assert stranger.get(API).status_code == 401
