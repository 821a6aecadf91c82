"""Missions of the owner, and data sent by robots."""

import pytest
from sqlalchemy import select

from webapp.app.registry import REGISTRY
from webapp.core.geo.fit import Corners, from_corners
from webapp.core.geo.types import LatLon
from webapp.files.maps.map_json import georeference_fields
from webapp.jobs.context import Context, JobProgress
from webapp.store.operate import jobs
from webapp.store.operate.jobs import Lease, Limits
from webapp.store.schema import MapRecord


@pytest.fixture
def new_mission(client):
    """Make a mission and return its id."""

    def make(browser=client, **fields):
        answer = browser.post("/api/v1/missions", json={"name": "Yard", **fields})
        assert answer.status_code == 201, answer.json
        return answer.json["id"]

    return make


@pytest.fixture
def mission(new_mission):
    return new_mission()


@pytest.fixture
def send(client, mission):
    """Send records to the mission and return the answer."""

    def post(records, *, first=0, sender="robot", browser=client, id=mission):
        given = {"sender": sender, "first": first, "records": records}
        return browser.post(f"/api/v1/missions/{id}/batches", json=given)

    return post


@pytest.fixture
def place_image(library):
    """Give a map the record of an image of 1000 x 1000 pixels between two corners."""

    def place(slug, north_west, south_east):
        corners = Corners(LatLon(*north_west), LatLon(*south_east))
        fit = from_corners(corners, width=1000, height=1000)
        with library.database.write() as session:
            record = session.scalars(select(MapRecord).where(MapRecord.slug == slug)).one()
            record.satellite_path, record.satellite_width, record.satellite_height = "a.png", 1000, 1000
            record.georeference = georeference_fields(fit.georeference)

    return place


@pytest.fixture
def walk():
    """Make poses towards north, one metre apart."""

    def make(count, *, begin=0, **more):
        return [
            {"type": "pose", "time": 1000.0 + n, "lat": 50 + n / 111_229, "lon": 14.0, **more}
            for n in range(begin, begin + count)
        ]

    return make


@pytest.fixture
def state(client, mission):
    """Give the state of the mission."""
    return lambda: client.get(f"/api/v1/missions/{mission}").json


@pytest.fixture
def add_photo(client, mission, save_photo, tmp_path):
    """Add a photo to the mission, different for each seed, and return the response."""

    def post(seed=1, **fields):
        path = tmp_path / f"{seed}.jpg"
        save_photo(path, seed)
        with path.open("rb") as file:
            given = {"file": (file, "car 1.jpg"), **fields}
            return client.post(f"/api/v1/missions/{mission}/photos", data=given)

    return post


@pytest.fixture
def work(library, settings):
    """Run the queued job as a worker does."""

    def go():
        with library.database.write() as session:
            job = jobs.lease(session, "test", limits=Limits(60, 3))
            lease, function = Lease(job.id, job.fence), REGISTRY.function(job.kind)
            known = (job.map_id, job.account_id, job.arguments)
        function(Context(library, settings, JobProgress(), lease, *known))
        with library.database.write() as session:
            assert jobs.finish(session, lease)

    return go
