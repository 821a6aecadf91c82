"""A library in a temporary folder, with an owner and a map."""

import pytest

from webapp.store.maps import maps
from webapp.store.schema import Account, Photo


@pytest.fixture
def library(tmp_path, new_library):
    return new_library(tmp_path / "library")


@pytest.fixture
def new_account(library):
    """Make an account and return its record."""

    def make(name, *, is_owner=False):
        with library.database.write() as session:
            account = Account(name=name, is_owner=is_owner)
            session.add(account)
            session.flush()
        return account

    return make


@pytest.fixture
def new_photo():
    """Return the record of a photo that is not yet part of a map."""

    def make(number, **fields):
        return Photo(
            name=f"IMG_{number}.jpg",
            path=f"photos/{number}.jpg",
            sha256=f"{number:064x}",
            size_bytes=1000,
            width=640,
            height=480,
            **fields,
        )

    return make


@pytest.fixture
def new_map(library, new_photo):
    """Make a map with a number of photos and return its id."""

    def make(account, *, photos=0, name="Park"):
        with library.database.write() as session:
            record = maps.create(session, name, account_id=account.id)
            for number in range(photos):
                maps.add_photo(session, record, row=new_photo(number))
        return record.id

    return make
