"""A library with missions."""

import numpy as np
import pytest

from webapp.missions.core.trajectory.records import make_poses
from webapp.missions.store import missions, tracks
from webapp.missions.store.schema import MissionObject, ObjectSighting
from webapp.store.schema import Account

BEGIN = 1_777_629_600.0
"""2026-05-01T10:00:00Z."""


@pytest.fixture(scope="session")
def some_poses():
    """Make poses twice a second along a wave."""

    def make(n):
        way = np.arange(n, dtype=float)
        latlon = np.column_stack([50 + 1e-3 * np.sin(way / 50), 14 + way * 1e-6])
        more = {"height_m": 200 + way / n, "heading_deg": way % 360}
        return make_poses(BEGIN + way / 2, latlon, travelled_m=way / 4, **more)

    return make


@pytest.fixture
def library(tmp_path, new_library):
    return new_library(tmp_path / "library")


@pytest.fixture
def owner(library):
    with library.database.write() as session:
        account = Account(name="ana", is_owner=True)
        session.add(account)
    return account.id


@pytest.fixture
def new_mission(library, owner, some_poses):
    """Make a mission with a track and objects, each seen twice, and return its id."""

    def make(poses=10, *, objects=3, name="Search"):
        with library.database.write() as session:
            mission = missions.create(session, name, account_id=owner)
            track = tracks.get_or_create(session, mission.id, source="gps")
            tracks.append(session, track, some_poses(poses))
            for number in range(objects):
                id = f"o{number}"
                at = {"lat": 50 + number / 1e3, "lon": 14.0, "confidence": number / 10}
                kind = "car" if number % 2 else "victim"
                times = {"first_time_s": BEGIN, "last_time_s": BEGIN + 60 * number}
                session.add(
                    MissionObject(mission_id=mission.id, object_id=id, kind=kind, sightings=2, **times, **at)
                )
                for seen in range(2):
                    time = {"number": seen, "time_s": BEGIN + seen}
                    session.add(ObjectSighting(mission_id=mission.id, object_id=id, **time, **at))
        return mission.id

    return make
