"""A photo library, the web application, and a worker that updates albums."""

from dataclasses import replace

import pytest
from sqlalchemy import select

from tests.connect.conftest import DEG, LAT, LON
from tests.connect.libraries.immich_server import ImmichServer, Shot, serving
from tests.web.conftest import app, client, library, new_account, new_map, owner, sign_in, stranger
from webapp.app.registry import REGISTRY
from webapp.connect.libraries import http
from webapp.jobs.kinds import Kind
from webapp.jobs.worker import Worker
from webapp.settings import LibrarySettings, Settings
from webapp.store.maps import maps
from webapp.store.photo_libraries import LinkedAlbum, LinkedPhoto
from webapp.store.schema import Job, MapRecord

__all__ = ["app", "client", "library", "new_account", "new_map", "owner", "sign_in", "stranger"]
PAGE = "/account/libraries"
QUICK = replace(
    REGISTRY, kinds={**REGISTRY.kinds, "index": Kind("tests.connect.libraries.conftest:no_index")}
)


def no_index(_context):
    """Do nothing, instead of building an index."""


def at(x, y):
    """Return the position of a pixel of the map of these tests."""
    return LAT - y * DEG, LON + x * DEG


@pytest.fixture
def settings(tmp_path, database_url):
    allowed = LibrarySettings(
        private_hosts="127.0.0.1", requests_per_second=10_000.0, timeout_s=2.0, patience_s=1.0
    )
    return Settings(library=tmp_path / "library", database=database_url, libraries=allowed)


@pytest.fixture(autouse=True)
def no_pauses(monkeypatch):
    monkeypatch.setattr(http, "_PAUSES_S", (0.0, 0.01))


@pytest.fixture
def shots():
    """Two photos with a position, one without."""
    return [Shot("a", *at(100, 200)), Shot("b"), Shot("c", *at(300, 400))]


@pytest.fixture
def server(shots):
    with serving(ImmichServer(shots)) as started:
        yield started


class Linked:
    """An album of the server that is linked with the map."""

    def __init__(self, client, library, settings, slug):
        self.client, self.library, self.settings, self.slug = client, library, settings, slug

    def work(self, **changed):
        """Do what is due, as a worker would; returns the last job."""
        used = replace(self.settings, libraries=replace(self.settings.libraries, **changed))
        Worker(self.library, used, registry=QUICK).run(once=True)
        return self.job()

    def update(self, **changed):
        """Ask for an update, and do it."""
        with self.library.database.read() as session:
            id = session.scalars(select(LinkedAlbum.id)).one()
        assert self.client.post(f"{PAGE}/albums/{id}/update").status_code == 303
        return self.work(**changed)

    def job(self):
        with self.library.database.read() as session:
            of_kind = select(Job).where(Job.kind == "photo-library").order_by(Job.id.desc())
            return session.scalars(of_kind).first()

    def photos(self):
        """Return the photos of the map by the assets that they are from."""
        with self.library.database.read() as session:
            record = session.scalars(select(MapRecord).where(MapRecord.slug == self.slug)).one()
            photos = {photo.id: photo for photo in maps.photos(session, record)}
            rows = session.scalars(select(LinkedPhoto)).all()
            return {row.asset: photos[row.photo_id] for row in rows if row.photo_id is not None}

    def row(self, asset):
        with self.library.database.read() as session:
            return session.scalars(select(LinkedPhoto).where(LinkedPhoto.asset == asset)).one()

    def edit(self, asset, **fields):
        """Change a photo as a person does on the page."""
        id = self.photos()[asset].id
        answer = self.client.patch(f"/api/v1/maps/{self.slug}/experiences/{id}", json=fields)
        assert answer.status_code == 200, answer.text

    def remove(self, asset):
        """Remove a photo as a person does on the page."""
        address = f"/api/v1/maps/{self.slug}/experiences/{self.photos()[asset].id}"
        assert self.client.delete(address).status_code == 200


@pytest.fixture
def connect(client, server):
    """Connect the server, and return the id of the library."""

    def do():
        data = {"kind": server.kind, "address": server.url, "key": server.key}
        answer = client.post(PAGE, data=data)
        assert answer.status_code == 200, answer.text
        return 1

    return do


@pytest.fixture
def linked(client, connect, library, settings, server, park):
    """Link the album with the map; the first update has been done."""
    data = {"album": next(iter(server.albums)), "map": park, "every_h": "24", "writes_back": "1"}
    answer = client.post(f"{PAGE}/{connect()}/link", data=data)
    assert answer.status_code == 303, answer.text
    made = Linked(client, library, settings, park)
    made.work()
    return made
