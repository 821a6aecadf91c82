"""A library in SQLite with values of all types, and databases of a server for it."""

import shutil

import pytest
from sqlalchemy import insert

from tests.tasks.operate.moves import ZERO_AT_THE_END, new_query
from webapp.missions.store import missions
from webapp.missions.store.schema import Pose, Track, TrackProfile
from webapp.store.accounts import accounts
from webapp.store.library import open_library
from webapp.store.maps import edits
from webapp.store.schema import Account, MapRecord, QueryRecord
from webapp.tasks.maps import adopt_map, export


@pytest.fixture(scope="module")
def made(tmp_path_factory, make_map):
    """A library in SQLite with values of all types."""
    folder = tmp_path_factory.mktemp("moves") / "library"
    library = open_library(folder)
    with library.database.write() as session:
        owner = accounts.ensure_owner(session)
        session.add(Account(name="Žofie 'x' \\ \t\n 🗺", created_at=ZERO_AT_THE_END))
    make_map(library.map_folder("park"), 3)
    adopt_map.adopt_map(library, "park", account_id=owner.id)
    with library.database.write() as session:
        record = session.query(MapRecord).one()
        moved = {"photo/1": {"x_px": -0.0, "y_px": 1 / 3}}
        edits.apply(session, record, changes=moved, kind="move", account_id=owner.id)
        session.add_all([new_query("kept"), new_query("deleted")])
        mission = missions.create(session, "Yard", account_id=owner.id).id
        session.add(Track(id=1, mission_id=mission, source="gps"))
        session.flush()
        row = {"track_id": 1, "lon": -0.0, "travelled_m": 1e-300}
        poses = [{**row, "number": n, "time_s": n / 7, "lat": 50 + n / 3e5} for n in range(2100)]
        session.execute(insert(Pose), poses)
        session.add(TrackProfile(track_id=1, chunk=0, points=bytes(range(256))))
    with library.database.write() as session:
        session.delete(session.query(QueryRecord).filter_by(name="deleted").one())
    export.export_map(library, record.id)
    library.database.close()
    return folder


@pytest.fixture
def folder(made, tmp_path):
    """A copy of it."""
    return shutil.copytree(made, tmp_path / "library")


@pytest.fixture
def server(postgresql):
    """Addresses of new, empty databases."""
    made = []

    def new():
        made.append(postgresql.new_database(empty=True))
        return made[-1]

    yield new
    for url in made:
        postgresql.drop(url)
