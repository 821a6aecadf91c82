"""A map is deleted while files arrive for it: the sender gets a 404, and the sweep finds what is left."""

import io
from dataclasses import replace

import pytest

from tests.web.maps.test_photo_uploads import Sender, jpeg, left, records
from webapp.settings import UploadLimits
from webapp.store.schema import MapRecord, Photo
from webapp.tasks.maps import add_photo
from webapp.tasks.maps.photo_files import sweep_uploads

CHUNK = 10_000


@pytest.fixture
def settings(settings):
    return replace(settings, upload=UploadLimits(chunk_mb=CHUNK / 1e6, reserve_mb=0.0))


@pytest.fixture
def sender(client, park):
    return Sender(client, park)


@pytest.fixture
def delete(client, park):
    """Move the map to the bin, or delete it permanently."""

    def run(*, permanently):
        for query in ("", "?forever=true")[: 1 + permanently]:
            assert client.delete(f"/api/v1/maps/{park}{query}").status_code == 200

    return run


@pytest.fixture
def meanwhile(monkeypatch, delete):
    """Delete the map while a complete photo is looked at, before it is stored."""

    def arrange(*, permanently):
        look = add_photo.sha256_of

        def late(path):
            monkeypatch.setattr(add_photo, "sha256_of", look)
            delete(permanently=permanently)
            return look(path)

        monkeypatch.setattr(add_photo, "sha256_of", late)

    return arrange


def files(library):
    """Return the files of photos of any map."""
    return [path for path in library.folder.rglob("*.jpg") if ".library" not in path.parts]


def stored(library, kind):
    with library.database.read() as session:
        return session.query(kind).count()


def refused(answer):
    assert answer.status_code in (404, 409, 410), answer.get_data(as_text=True)
    assert answer.json["error"].keys() == {"code", "message", "where", "hint"}


@pytest.mark.parametrize("permanently", [False, True])
def test_between_two_chunks(sender, delete, library, settings, permanently):
    data = jpeg()
    id = sender.begin(data).json["id"]
    assert sender.chunk(id, data[:CHUNK], offset=0).status_code == 200
    delete(permanently=permanently)
    refused(sender.chunk(id, data[CHUNK : 2 * CHUNK], offset=CHUNK))
    refused(sender.client.get(f"{sender.url}/{id}"))
    refused(sender.begin(data))
    assert files(library) == [] and stored(library, Photo) == 0
    if permanently:
        assert (records(library), stored(library, MapRecord)) == (0, 0)
        sweep_uploads(library, settings=replace(settings, upload=UploadLimits(keep_hours=1e-9)))
        assert left(library) == []


@pytest.mark.parametrize("permanently", [False, True])
def test_while_the_last_chunk_is_looked_at(sender, meanwhile, library, permanently):
    data = jpeg(side=120)
    assert len(data) < CHUNK
    id = sender.begin(data).json["id"]
    meanwhile(permanently=permanently)
    refused(sender.chunk(id, data, offset=0))
    assert files(library) == [] and stored(library, Photo) == 0


@pytest.mark.parametrize("permanently", [False, True])
def test_while_a_request_with_photos_is_answered(client, park, meanwhile, library, permanently):
    meanwhile(permanently=permanently)
    photos = [(io.BytesIO(jpeg(n, side=60)), f"{n}.jpg") for n in range(3)]
    answer = client.post(f"/api/v1/maps/{park}/photos", data={"file": photos})
    if answer.status_code == 207:
        assert all("error" in result for result in answer.json)
    else:
        refused(answer)
    assert files(library) == [] and stored(library, Photo) == 0
    assert left(library) == []


def test_a_restored_map_takes_the_rest(client, sender, delete, library, park):
    data = jpeg()
    begun = sender.begin(data).json
    sender.chunk(begun["id"], data[:CHUNK], offset=0)
    delete(permanently=False)
    assert client.post(f"/api/v1/maps/{park}/restore").status_code == 200
    again = sender.begin(data).json
    assert again["offset"] == CHUNK
    assert sender.rest(again, data).status_code == 200
    assert stored(library, Photo) == 1 and left(library) == []
