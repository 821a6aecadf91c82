"""Street-level photos through the API: counted, queued, and added by the job."""

import io
import json

import pytest
import requests
from PIL import Image

from tests.street_server import Shot, street
from webapp.jobs.context import Context, JobProgress
from webapp.jobs.map_jobs import fetch_street_photos
from webapp.settings import Settings, StreetSettings
from webapp.store.operate import jobs
from webapp.store.schema import Job
from webapp.web.maps import api_street

CORNERS = {"top_left": {"lat": 50.1, "lon": 14.4}, "bottom_right": {"lat": 50.098, "lon": 14.403}}


@pytest.fixture
def service():
    with street(Shot("a1", 50.0995, 14.4005), Shot("b2", 50.0985, 14.4025, panorama=True)) as server:
        yield server


@pytest.fixture
def settings(tmp_path, service):
    chosen = StreetSettings(panoramax=service.base, requests_per_second=1000.0)
    return Settings(library=tmp_path / "library", street=chosen)


@pytest.fixture
def place(client, park):
    """Give the map a georeferenced image."""
    file = io.BytesIO()
    Image.new("RGB", (300, 200), "green").save(file, "PNG")
    file.seek(0)
    data = {"file": (file, "s.png"), "corners": json.dumps(CORNERS)}
    assert client.put(f"/api/v1/maps/{park}/satellite", data=data).status_code == 200


@pytest.fixture
def base(park):
    return f"/api/v1/maps/{park}/street-photos"


@pytest.fixture
def run_job(library, settings):
    """Run a queued job, as the worker does."""

    def run(id):
        with library.database.write() as session:
            job = jobs.lease(session, "test", limits=jobs.Limits(seconds=60, attempts=3))
            while job.id != id:
                jobs.finish(session, jobs.Lease(job.id, job.fence))
                job = jobs.lease(session, "test", limits=jobs.Limits(seconds=60, attempts=3))
            lease, arguments = jobs.Lease(job.id, job.fence), dict(job.arguments)
            map_id, account_id = job.map_id, job.account_id
        progress = JobProgress()
        context = Context(library, settings, progress, lease, map_id, account_id, arguments)
        result = fetch_street_photos(context)
        with library.database.write() as session:
            jobs.finish(session, lease)
        return result, progress

    return run


def test_only_what_is_set_up_is_offered(client, base):
    assert client.get(base).json == {"services": [{"key": "panoramax", "name": "Panoramax"}]}
    refused = client.post(base, json={"source": "mapillary"})
    assert refused.status_code == 404 and "mapillary is not set up" in refused.json["error"]["message"]


@pytest.mark.usefixtures("place")
def test_photos_are_counted_and_nothing_is_downloaded(client, base, service):
    found = client.post(f"{base}/preview", json={"source": "panoramax"}).json
    assert (found["found"], found["to_download"], found["panoramas"]) == (2, 2, 1)
    assert found["licences"] == {"CC-BY-SA-4.0": 2} and found["size_mb"] > 1.2
    assert found["positions"] == [pytest.approx([50, 50], abs=0.01), pytest.approx([250, 150], abs=0.01)]
    left = client.post(f"{base}/preview", json={"source": "panoramax", "area": [0, 0, 100, 200]}).json
    assert left["positions"] == found["positions"][:1] and not service.photos_asked()


@pytest.mark.usefixtures("place")
def test_the_job_adds_them_once(client, park, base, service, run_job):
    queued = client.post(base, json={"source": "panoramax", "panoramas": "skip"})
    assert queued.status_code == 202 and queued.json["kind"] == "street-photos"
    result, progress = run_job(queued.json["id"])
    assert (result["added"], result["failed"]) == (1, [])
    assert progress.state()[:2] == (1, 1)
    (photo,) = client.get(f"/api/v1/maps/{park}").json["photos"]
    assert (photo["x_px"], photo["y_px"]) == pytest.approx((50, 50), abs=0.01)
    assert photo["source"]["credit"] == "© Ana, Panoramax (CC-BY-SA-4.0)"
    again = client.post(base, json={"source": "panoramax"}).json["id"]
    assert run_job(again)[0]["added"] == 6, "the views of the panorama"
    assert service.photos_asked() == {"a1": 1, "b2": 1}


@pytest.mark.usefixtures("place")
def test_equal_wishes_are_one_job_and_others_wait_their_turn(client, base, library):
    whole, corner = {"source": "panoramax"}, {"source": "panoramax", "area": [0, 0, 9, 9]}
    first, second, again = (client.post(base, json=wish).json["id"] for wish in (whole, corner, whole))
    assert again == first != second
    with library.database.read() as session:
        areas = [session.get_one(Job, id).arguments["area"] for id in (first, second)]
    assert areas == [None, [0, 0, 9, 9]]


@pytest.mark.parametrize("way", ["", "/preview"])
def test_without_a_georeference_one_sentence(client, base, service, way):
    refused = client.post(f"{base}{way}", json={"source": "panoramax"})
    assert refused.status_code == 400
    assert refused.json["error"]["message"] == "the map has no satellite image yet"
    assert not service.asked


@pytest.mark.usefixtures("place")
@pytest.mark.parametrize("area", [[0, 0, 10], [900, 0, 950, 10], [5, 5, 5, 9], ["a", 0, 1, 1]])
def test_an_area_that_is_none_is_refused(client, base, service, area):
    assert client.post(base, json={"source": "panoramax", "area": area}).status_code in (400, 422)
    assert not service.asked


@pytest.mark.usefixtures("place")
def test_who_may_only_look_adds_nothing(
    client, sign_in, new_account, new_map, owner, stranger, base, service
):
    viewer = new_account("vera")
    slug = new_map(owner, name="Other", shared={viewer: "viewer"})
    for way in ("", "/preview"):
        wish = {"source": "panoramax"}
        answer = sign_in(viewer).post(f"/api/v1/maps/{slug}/street-photos{way}", json=wish)
        assert answer.status_code == 403
        assert stranger.post(f"{base}{way}", json=wish).status_code in (401, 403)
    assert not service.asked


@pytest.mark.usefixtures("place")
def test_a_service_that_fails_is_one_sentence(client, base, service):
    service.bodies["/api/search"] = b"<html>"
    refused = client.post(f"{base}/preview", json={"source": "panoramax"})
    assert refused.status_code == 422
    assert "Panoramax did not send a list of photos" in refused.json["error"]["message"]
    service.bodies.clear()
    service.failing["/api/search"] = [429]
    service.retry_after = "3600"
    refused = client.post(f"{base}/preview", json={"source": "panoramax"})
    assert refused.status_code == 429 and "pause of 3600 seconds" in refused.json["error"]["message"]


@pytest.mark.usefixtures("place")
def test_a_service_that_takes_too_long_is_one_sentence(client, base, service, monkeypatch):
    monkeypatch.setattr(api_street, "_LIMIT_S", 0.2)
    service.failing["/api/search"] = [503] * 4
    service.retry_after = "4"
    refused = client.post(f"{base}/preview", json={"source": "panoramax"})
    assert refused.status_code == 422
    error = refused.json["error"]
    assert (error["message"], error["hint"]) == ("the service takes too long", "choose a smaller area")
    assert service.asked["/api/search"] <= 1, "nothing is asked after that"


@pytest.mark.usefixtures("place")
def test_a_silent_service_is_waited_for_briefly(client, base, monkeypatch):
    waits = []
    get = requests.Session.get

    def noted(session, address, **options):
        waits.append(options["timeout"])
        return get(session, address, **options)

    monkeypatch.setattr(requests.Session, "get", noted)
    assert client.post(f"{base}/preview", json={"source": "panoramax"}).status_code == 200
    assert waits == [5.0]
