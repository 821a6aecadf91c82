"""Webhooks: what a receiver gets, when it is tried again, and where messages never go."""

import json
import os
import signal
import socket
import subprocess
import sys
import threading
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import pytest
from standardwebhooks import Webhook, WebhookVerificationError

from tests.connect.events.conftest import ALL, API
from webapp.errors import InputError
from webapp.missions.store import missions
from webapp.missions.store.schema import RobotHeard
from webapp.missions.tasks import store_batch
from webapp.missions.tasks.store_batch import Numbered
from webapp.net.public_hosts import resolve
from webapp.store import outbox
from webapp.store.accounts import accounts
from webapp.store.operate import jobs
from webapp.store.outbox import EventDelivery, EventReceiver
from webapp.store.schema import Account, Job

ROOT = Path(__file__).resolve().parents[3]
POSE = {"type": "pose", "time": 1714564800.0, "lat": 50.0, "lon": 14.0, "track": "rover"}


@pytest.fixture
def patrol(library, owner):
    """A mission with an alarm, in which a robot was heard; its number."""
    with library.database.write() as session:
        mission = missions.create(session, "Patrol", account_id=owner.id)
        mission.silent_after_s = 60.0
    store_batch.store_batch(library, mission.id, records=[POSE], place=Numbered("a", 0))
    return mission.id


@pytest.fixture
def fall_silent(library, patrol):
    def make(seconds=100.0):
        with library.database.write() as session:
            session.get_one(RobotHeard, (patrol, "rover")).time_s -= seconds

    return make


def retry_now(library):
    with library.database.write() as session:
        session.query(EventReceiver).update({"try_at": None})


def test_a_public_library_verifies_what_a_receiver_gets(add, hook, work, client, park):
    secret = add("webhook", hook.url)["secret"]
    client.post(f"/api/v1/maps/{park}/shares", json={"public": True})
    work()
    ((path, headers, body),) = hook.got
    content = Webhook(secret).verify(body, {name.lower(): value for name, value in headers.items()})
    assert (path, headers["Content-Type"]) == ("/hook", "application/json")
    assert content["type"] == "share.made"
    assert content["id"] == headers["webhook-id"]
    assert content["data"] == {
        "map": {"slug": park, "name": "Park"},
        "answer": None,
        "public": True,
        "by": "owner",
        "path": f"/maps/{park}/edit",
        "url": f"https://maps.example.org/maps/{park}/edit",
    }
    with pytest.raises(WebhookVerificationError):
        Webhook(secret).verify(body + b" ", {name.lower(): value for name, value in headers.items()})


def test_a_silent_robot_is_reported_once_and_again_when_it_is_heard(
    add, hook, work, library, patrol, fall_silent
):
    add("webhook", hook.url)
    work()
    assert hook.got == []
    fall_silent()
    work()
    work()
    store_batch.store_batch(library, patrol, records=[POSE | {"time": 1714564801.0}], place=Numbered("a", 1))
    work()
    got = [json.loads(body) for _, _, body in hook.got]
    assert [one["type"] for one in got] == ["robot.silent", "robot.heard"]
    silent, heard = (one["data"] for one in got)
    assert silent["robot"] == "rover"
    assert silent["mission"] == {"id": patrol, "name": "Patrol"}
    assert heard["heard_s"] - heard["silent_since_s"] > 60
    assert heard["silent_since_s"] == silent["silent_since_s"]


def test_no_alarm_after_the_end_of_a_mission_or_without_one(add, hook, work, library, patrol, fall_silent):
    add("webhook", hook.url)
    fall_silent()
    with library.database.write() as session:
        mission = session.get_one(missions.Mission, patrol)
        missions.end(mission)
    work()
    with library.database.write() as session:
        mission = session.get_one(missions.Mission, patrol)
        mission.ended_at, mission.silent_after_s = None, None
    work()
    assert hook.got == []


def test_a_failed_job_is_reported_to_who_wanted_it_with_its_reason(
    add, hook, work, library, client, owner, new_account
):
    add("webhook", hook.url)
    other = new_account("Eva")
    with library.database.write() as session:
        mine = jobs.enqueue(session, "unheard-of", account_id=owner.id).id
        jobs.enqueue(session, "unheard-of", account_id=other.id, key="theirs")
    work()
    work()
    (content,) = [json.loads(body) for _, _, body in hook.got]
    assert content["type"] == "job.failed"
    assert (content["data"]["job"], content["data"]["kind"]) == (mine, "unheard-of")
    assert "unknown kind of job" in content["data"]["message"]


def test_only_who_may_see_a_mission_hears_of_its_robots(
    sign_in, new_account, hook, work, patrol, fall_silent
):
    stranger = sign_in(new_account("Eva"))
    stranger.post(API, json={"kind": "webhook", "address": hook.url, "events": ALL})
    fall_silent()
    work()
    assert hook.got == []


def test_only_chosen_events_are_sent(add, hook, work, client, park):
    added = add("webhook", hook.url, ["job.failed"])
    client.post(f"/api/v1/maps/{park}/shares", json={})
    work()
    assert hook.got == []
    client.patch(f"{API}/{added['id']}", json={"events": ["share.made"]})
    client.post(f"/api/v1/maps/{park}/shares", json={})
    work()
    assert len(hook.got) == 1


def test_an_event_is_stored_with_what_caused_it_or_not_at_all(add, hook, library, owner, park):
    add("webhook", hook.url)
    with pytest.raises(ZeroDivisionError), library.database.write() as session:
        outbox.emit(session, "share.made", facts={}, concerns=lambda _: True)
        raise ZeroDivisionError
    with library.database.read() as session:
        assert session.query(EventDelivery).count() == 0


@pytest.mark.parametrize("status", [400, 404, 500, 503])
def test_what_is_not_accepted_is_tried_again_with_the_same_id(
    add, hook, work, library, messages, client, status
):
    added, hook.status = add("webhook", hook.url), status
    client.post(f"{API}/{added['id']}/test")
    work()
    work()
    assert len(hook.got) == 1, "it waits"
    retry_now(library)
    work()
    listed = client.get(API).json
    assert listed["messages"][0]["error"] == f"the receiver answered {status}"
    assert (listed["messages"][0]["tries"], listed["receivers"][0]["failures"]) == (2, 2)
    hook.status = 204
    retry_now(library)
    work()
    assert messages() == ["sent"]
    assert client.get(API).json["receivers"][0]["failures"] == 0
    assert len({headers["webhook-id"] for _, headers, _ in hook.got}) == 1
    assert len(hook.got) == 3


def test_pauses_grow_to_an_hour_and_old_events_are_given_up(add, hook, work, library, messages, client):
    added, hook.status = add("webhook", hook.url), 500
    client.post(f"{API}/{added['id']}/test")
    pauses = []
    for _ in range(12):
        with library.database.write() as session:
            session.query(EventReceiver).update({"try_at": None})
            before = outbox.now()
        work()
        with library.database.read() as session:
            pauses.append((session.query(EventReceiver).one().try_at - before).total_seconds())
    assert pauses[0] == pytest.approx(5, abs=3)
    assert pauses[1] == pytest.approx(10, abs=3)
    assert pauses[-1] == pytest.approx(3600, abs=3)
    assert messages() == ["waiting"]
    with library.database.write() as session:
        session.query(EventDelivery).one().at -= timedelta(hours=25)
    retry_now(library)
    work()
    assert messages() == ["given up"]


def test_a_dead_receiver_holds_up_no_other(add, hook, work, client, park):
    with socket.create_server(("127.0.0.1", 0)) as closed:
        dead = f"http://127.0.0.1:{closed.getsockname()[1]}/"
    add("webhook", dead)
    add("webhook", hook.url)
    client.post(f"/api/v1/maps/{park}/shares", json={})
    work()
    assert len(hook.got) == 1
    states = {one["receiver"]: one for one in client.get(API).json["messages"]}
    assert states[1]["error"] == "the receiver cannot be reached (ConnectionRefusedError)"
    assert states[2]["state"] == "sent"


@pytest.mark.parametrize("kind", ["nothing", "nonsense", "a byte now and then", "endless headers"])
def test_a_lying_receiver_costs_a_bounded_time(add, work, client, settings, kind):
    stop = threading.Event()

    def serve():
        connection, _ = server.accept()
        with connection:
            if kind == "nonsense":
                connection.sendall(b"\x00\xff not http\r\n\r\n")
                return
            try:
                while kind != "nothing" and not stop.wait(0.1 if kind == "a byte now and then" else 0.0):
                    connection.sendall(b"H" if kind == "a byte now and then" else b"X" * 60_000)
            except OSError:
                return
            stop.wait(10)

    with socket.create_server(("127.0.0.1", 0)) as server:
        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        added = add("webhook", f"http://127.0.0.1:{server.getsockname()[1]}/")
        client.post(f"{API}/{added['id']}/test")
        work(events=replace(settings.events, timeout_s=0.5))
        stop.set()
        thread.join()
    assert client.get(API).json["messages"][0]["error"].startswith("the receiver cannot be reached")


def test_a_redirect_is_not_followed(add, hook, work, client):
    added = add("webhook", hook.url)
    hook.status, hook.headers = 307, {"Location": f"{hook.url}/elsewhere"}
    client.post(f"{API}/{added['id']}/test")
    work()
    assert [path for path, _, _ in hook.got] == ["/hook"]
    assert "redirects (307)" in client.get(API).json["messages"][0]["error"]


@pytest.mark.parametrize("host", ["127.0.0.1", "localhost", "[::1]", "2130706433", "0x7f.1", "hooks.test"])
def test_messages_never_go_to_private_addresses(add, hook, work, client, settings, monkeypatch, host):
    real = socket.getaddrinfo

    def answer(name, port, *given, **named):
        return real("127.0.0.1" if name == "hooks.test" else name, port, *given, **named)

    monkeypatch.setattr(socket, "getaddrinfo", answer)
    added = add("webhook", hook.url.replace("127.0.0.1", host))
    client.post(f"{API}/{added['id']}/test")
    work(events=replace(settings.events, private_hosts=None))
    assert hook.got == []
    assert "which is not a public address" in client.get(API).json["messages"][0]["error"]


@pytest.mark.parametrize(
    "address",
    ["10.0.0.1", "192.168.1.1", "169.254.169.254", "100.64.0.1", "0.0.0.0", "224.0.0.1", "::", "fe80::1",
     "fd00::1", "::ffff:10.0.0.1", "64:ff9b::a00:1", "2002:a00:1::1"],
)  # fmt: skip
def test_an_address_is_private_also_inside_another(address):
    with pytest.raises(InputError, match="not a public address"):
        resolve(address, 80, allowed="")


def test_public_and_allowed_addresses_are_accepted():
    assert resolve("1.1.1.1", 443, allowed="") == ["1.1.1.1"]
    assert resolve("10.1.2.3", 443, allowed="hooks.internal, 10.1.0.0/16") == ["10.1.2.3"]
    with pytest.raises(InputError):
        resolve("10.2.2.3", 443, allowed="hooks.internal, 10.1.0.0/16")


@pytest.mark.parametrize(
    "address",
    ["", "hook", "ftp://example.org", "https://", "https://user:secret@example.org/", "https://a b/",
     "https://example.org\\@10.0.0.1/", "https://exämple.org/", "https://[::1"],
)  # fmt: skip
def test_what_is_no_webhook_is_refused(client, address):
    answer = client.post(API, json={"kind": "webhook", "address": address, "events": []})
    assert answer.status_code == 400
    assert answer.json["error"]["message"] == "this is not the address of a webhook"
    assert client.get(API).json["receivers"] == []


def test_a_secret_is_shown_once_and_stored_nowhere(add, hook, work, client, library, tmp_path, caplog):
    added = add("webhook", hook.url)
    client.post(f"{API}/{added['id']}/test")
    with caplog.at_level(0):
        work()
    secret = added["secret"]
    assert secret not in client.get(API).text + client.get("/account/events").text + caplog.text
    with library.database.read() as session:
        rows = [session.query(EventReceiver).one().__dict__, session.query(EventDelivery).one().__dict__]
        rows += [job.__dict__ for job in session.query(Job)]
    assert secret.removeprefix("whsec_") not in str(rows)
    other = add("webhook", f"{hook.url}/2")["secret"]
    assert other != secret


def test_a_deleted_account_gets_nothing_more(add, sign_in, new_account, hook, work, library, client, park):
    eva = new_account("Eva")
    sign_in(eva).post(API, json={"kind": "webhook", "address": hook.url, "events": ALL})
    client.post(f"/api/v1/maps/{park}/members", json={"name": "Eva", "role": "viewer"})
    with library.database.write() as session:
        assert session.query(EventDelivery).count() == 1
        accounts.remove(session, session.get_one(Account, eva.id))
    work()
    assert hook.got == []
    with library.database.read() as session:
        assert (session.query(EventReceiver).count(), session.query(EventDelivery).count()) == (0, 0)


def test_a_receiver_removed_while_its_message_is_sent_leaves_nothing(add, hook, work, client, library):
    added, hook.wait_s = add("webhook", hook.url), 0.4
    client.post(f"{API}/{added['id']}/test")
    worker = threading.Thread(target=work)
    worker.start()
    while not hook.got:
        pass
    client.delete(f"{API}/{added['id']}")
    worker.join()
    with library.database.read() as session:
        assert session.query(EventDelivery).count() == 0
        assert [job.state for job in session.query(Job)] == ["done"]


def test_nobody_touches_the_receivers_of_another(add, hook, sign_in, new_account):
    id, other = add("webhook", hook.url)["id"], sign_in(new_account("Eva"))
    assert other.get(API).json["receivers"] == []
    assert other.patch(f"{API}/{id}", json={"events": []}).status_code == 404
    assert other.post(f"{API}/{id}/test").status_code == 404
    assert other.delete(f"{API}/{id}").status_code == 404
    assert other.post(f"/account/events/{id}/remove").status_code == 404


def test_limits_of_an_account(add, hook, client):
    added = [add("webhook", f"{hook.url}/{n}") for n in range(20)]
    answer = client.post(API, json={"kind": "webhook", "address": hook.url, "events": []})
    assert answer.json["error"]["message"] == "an account has at most 20 receivers"
    statuses = [client.post(f"{API}/{added[0]['id']}/test").status_code for _ in range(61)]
    assert statuses == [204] * 60 + [429]
    assert len(client.get(API).json["messages"]) == 1, "one waits already"


def test_a_killed_worker_loses_nothing_and_repeats_with_the_same_id(
    add, hook, library, settings, client, messages
):
    added, hook.wait_s = add("webhook", hook.url), 60.0
    client.post(f"{API}/{added['id']}/test")
    environ = {
        **os.environ,
        "PYTHONPATH": str(ROOT),
        "EXPMAP_EVENTS_PRIVATE_HOSTS": "127.0.0.1",
        "EXPMAP_EVENTS_TIMEOUT_S": "60",
    }
    if settings.database:
        environ["EXPMAP_DATABASE"] = settings.database
    # by itself: without --once it starts a second worker, which would survive it
    command = [sys.executable, "-m", "webapp", "worker", "--once", "--library", str(library.folder)]
    process = subprocess.Popen(command, cwd=ROOT, env=environ, start_new_session=True)
    try:
        deadline = threading.Event()
        while not hook.got:
            assert process.poll() is None
            deadline.wait(0.05)
    finally:
        os.killpg(process.pid, signal.SIGKILL)
        process.wait()
    assert messages() == ["waiting"]
    hook.wait_s = 0.0
    again = subprocess.run(command, cwd=ROOT, env=environ, timeout=120, check=False)
    assert again.returncode == 0
    assert messages() == ["sent"]
    assert len(hook.got) == 2
    assert len({headers["webhook-id"] for _, headers, _ in hook.got}) == 1


def test_unknown_events_are_refused(client, hook):
    answer = client.post(API, json={"kind": "webhook", "address": hook.url, "events": ["answer.off_map"]})
    assert answer.status_code == 422
