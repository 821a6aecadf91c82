"""Jobs through the API, for pages and programs."""

from datetime import timedelta

import pytest

from webapp.store.clock import now
from webapp.store.maps import maps
from webapp.store.operate import jobs
from webapp.store.operate.jobs import Lease, Limits
from webapp.store.schema import Job


@pytest.fixture
def people(new_account):
    """Accounts by their role, and one without any."""
    return {role: new_account(role) for role in ("owner", "editor", "viewer", "stranger")}


@pytest.fixture
def slug(people, new_map):
    """The slug of a map that the first three share."""
    return new_map(people["owner"], shared={people[role]: role for role in ("editor", "viewer")})


@pytest.fixture
def job(library, people, slug):
    """The id of a queued job."""
    with library.database.write() as session:
        record = maps.find(session, slug, account=people["owner"])
        return jobs.enqueue(session, "index", map_id=record.id, account_id=people["owner"].id).id


def test_the_jobs_of_a_map_are_listed(people, sign_in, slug, job):
    answer = sign_in(people["viewer"]).get(f"/api/v1/jobs?map={slug}")
    assert [(j["id"], j["kind"], j["state"]) for j in answer.json["jobs"]] == [(job, "index", "queued")]
    assert sign_in(people["viewer"]).get(f"/api/v1/jobs/{job}").json == answer.json["jobs"][0]


@pytest.mark.parametrize(
    ("note", "words"),
    [
        ("second look: xfeat", "the same for a second look at difficult photos"),
        (
            "without a second look: it would exceed the time budget",
            "without a second look at difficult photos",
        ),
        ("calibrating the probabilities", "checking how sure the answers may be"),
        ("fusing odometry and fixes", "combining odometry and GPS"),
        ("2 of 3 tiles", "2 of 3 tiles"),
    ],
)
def test_what_a_job_does_is_said_in_plain_words(library, people, sign_in, job, note, words):
    with library.database.write() as session:
        session.get(Job, job).note = note
    assert sign_in(people["viewer"]).get(f"/api/v1/jobs/{job}").json["note"] == words


def test_who_does_not_see_the_map_does_not_see_its_jobs(people, sign_in, slug, job):
    client = sign_in(people["stranger"])
    assert client.get(f"/api/v1/jobs?map={slug}").status_code == 404
    foreign, missing = (client.get(f"/api/v1/jobs/{id}") for id in (job, 999))
    assert foreign.status_code == missing.status_code == 404
    assert foreign.text.replace(str(job), "999") == missing.text
    assert client.post(f"/api/v1/jobs/{job}/cancel").status_code == 404


def test_viewers_cancel_nothing_and_editors_do(people, sign_in, job):
    assert sign_in(people["viewer"]).post(f"/api/v1/jobs/{job}/cancel").status_code == 403
    client = sign_in(people["editor"])
    assert client.post(f"/api/v1/jobs/{job}/retry").status_code == 409
    assert client.post(f"/api/v1/jobs/{job}/cancel").json["state"] == "cancelled"
    assert client.post(f"/api/v1/jobs/{job}/retry").json["state"] == "queued"


def test_viewers_cancel_and_retry_their_own(people, sign_in, slug, job):
    client = sign_in(people["viewer"])
    own = client.post(f"/api/v1/maps/{slug}/exports", json={"format": "zip"}).json["job"]
    listed = {one["id"]: one["mine"] for one in client.get(f"/api/v1/jobs?map={slug}").json["jobs"]}
    assert listed == {own: True, job: False}
    assert client.post(f"/api/v1/jobs/{own}/cancel").json["state"] == "cancelled"
    assert client.post(f"/api/v1/jobs/{own}/retry").json["state"] == "queued"
    assert sign_in(people["owner"]).get(f"/api/v1/jobs/{own}").json["mine"] is False


def test_a_job_without_a_map_is_its_account_s(library, people, sign_in):
    with library.database.write() as session:
        own = jobs.enqueue(session, "sample", account_id=people["editor"].id).id
    assert sign_in(people["editor"]).get(f"/api/v1/jobs/{own}").status_code == 200
    assert sign_in(people["owner"]).get(f"/api/v1/jobs/{own}").status_code == 404


@pytest.mark.parametrize("id", ["0", "x", "-1", "9" * 30])
def test_a_job_that_cannot_be_is_404(people, sign_in, id):
    assert sign_in(people["owner"]).get(f"/api/v1/jobs/{id}").status_code == 404


def test_the_jobs_of_all_maps_that_one_sees(people, sign_in, library, slug, job, new_map):
    with library.database.write() as session:
        hidden = maps.find(session, new_map(people["stranger"], name="Far"), account=people["stranger"])
        far = jobs.enqueue(session, "index", map_id=hidden.id).id
        own = jobs.enqueue(session, "mission-inspect", account_id=people["viewer"].id).id
        old = jobs.enqueue(session, "export", map_id=session.get_one(Job, job).map_id)
        old.state, old.ended_at, old_id = "done", now() - timedelta(days=2), old.id
    listed = {
        role: {one["id"]: one for one in sign_in(people[role]).get("/api/v1/jobs").json["jobs"]}
        for role in ("editor", "viewer", "stranger")
    }
    assert {role: set(found) for role, found in listed.items()} == {
        "editor": {job},
        "viewer": {job, own},
        "stranger": {far},
    }, f"the export {old_id} has ended long ago"
    shown = listed["viewer"][job]
    assert (shown["map"], shown["map_name"], shown["by"]) == (slug, "Park", "owner")
    assert (shown["mine"], shown["can_change"], shown["seconds"]) == (False, False, None)
    assert listed["viewer"][own]["can_change"] and listed["editor"][job]["can_change"]
    assert listed["stranger"][far]["by"] is None, "a change has started it"


def test_a_job_that_waits_says_for_what_but_names_no_map_of_others(
    library, people, sign_in, slug, new_map, job
):
    with library.database.write() as session:
        first = jobs.lease(session, "test", limits=Limits(60, 3))
        jobs.beat(session, Lease(first.id, first.fence), seconds=60, progress=(1, 4, ""))
        first.started_at -= timedelta(seconds=60)
    own = new_map(people["stranger"])
    with library.database.write() as session:
        mine, other = (
            maps.find(session, s, account=people[who]) for s, who in ((own, "stranger"), (slug, "owner"))
        )
        waiting = [jobs.enqueue(session, "evaluate", map_id=m.id).id for m in (mine, other)]
        short = jobs.enqueue(session, "export", map_id=other.id).id
    seen = sign_in(people["stranger"]).get(f"/api/v1/jobs/{waiting[0]}").json["behind"]
    assert (seen["kind"], seen["map_name"]) == ("index", None)
    client = sign_in(people["owner"])
    seen = client.get(f"/api/v1/jobs/{waiting[1]}").json["behind"]
    assert (seen["kind"], seen["map_name"]) == ("index", "Park")
    assert seen["seconds_left"] == pytest.approx(180, abs=5)
    assert client.get(f"/api/v1/jobs/{short}").json["behind"] is None, "it starts at once"
    assert client.get(f"/api/v1/jobs/{job}").json["behind"] is None, "it runs"
