"""A library with one small map adopted from its folder."""

import pytest

from webapp.store.library import open_library
from webapp.store.maps import edits
from webapp.store.schema import Account, MapRecord, Photo
from webapp.tasks.maps import adopt_map


@pytest.fixture
def library(tmp_path):
    library = open_library(tmp_path / "library")
    yield library
    library.database.close()


@pytest.fixture
def owner(library):
    with library.database.write() as session:
        account = Account(name="ana", is_owner=True)
        session.add(account)
    return account.id


@pytest.fixture
def adopt(library, owner, make_map):
    """Make a map folder with photos, change it, adopt it, and return the map's id."""

    def make(slug="park", photos=3, change=lambda cfg: None):
        cfg = make_map(library.map_folder(slug), photos)
        change(cfg)
        return adopt_map.adopt_map(library, slug, account_id=owner)

    return make


@pytest.fixture
def record(library):
    """Read the record of a map."""

    def read(map_id):
        with library.database.read() as session:
            return session.get(MapRecord, map_id)

    return read


@pytest.fixture
def rows(library):
    """Read the records of a map's photos, by id."""

    def read(map_id):
        with library.database.read() as session:
            found = session.query(Photo).where(Photo.map_id == map_id).order_by(Photo.id)
            return {row.id: row for row in found}

    return read


@pytest.fixture
def edit(library, owner):
    """Apply an edit to a map."""

    def apply(map_id, changes, kind="place"):
        with library.database.write() as session:
            record = session.get(MapRecord, map_id)
            edits.apply(session, record, changes=changes, kind=kind, account_id=owner)

    return apply
