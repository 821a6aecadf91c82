"""A map of the owner, whose image is uploaded and read through the API."""

import io
import json

import pytest

from webapp.store.maps import maps
from webapp.store.schema import MapRecord, Photo


@pytest.fixture
def base(park):
    return f"/api/v1/maps/{park}"


@pytest.fixture
def put(client, base):
    """Upload an image."""

    def send(data, *, name="sat.png", who=None, **fields):
        corners = fields.pop("corners", None)
        form = {"file": (io.BytesIO(data), name), **{k: str(v) for k, v in fields.items()}}
        if corners is not None:
            form["corners"] = corners if isinstance(corners, str) else json.dumps(corners)
        return (who or client).put(f"{base}/satellite", data=form)

    return send


@pytest.fixture
def record(library, park):
    def read():
        with library.database.read() as session:
            return session.query(MapRecord).filter_by(slug=park).one()

    return read


@pytest.fixture
def add_photos(library, record):
    """Add photos with the given fields to the map."""

    def add(*photos):
        with library.database.write() as session:
            row = session.get(MapRecord, record().id)
            for n, fields in enumerate(photos, start=row.next_id):
                photo = Photo(
                    name=f"{n}.jpg",
                    path=f"photos/{n}.jpg",
                    sha256=f"{n:064x}",
                    size_bytes=1,
                    width=4,
                    height=3,
                    **fields,
                )
                maps.add_photo(session, row, row=photo)

    return add


@pytest.fixture
def photo(library, record):
    def read(id):
        with library.database.read() as session:
            return session.get(Photo, (record().id, id))

    return read
