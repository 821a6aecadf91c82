"""Photos of missions are stored once, and served as pictures."""

import hashlib
import io

from webapp.app.registry import REGISTRY
from webapp.jobs import worker
from webapp.settings import Settings

CAR = {"type": "object", "id": "car-1", "class": "car", "time": 5.0, "lat": 50.0, "lon": 14.0}


def test_a_photo_comes_in_once(client, mission, add_photo, library, state):
    first = add_photo(time=12.5)
    assert first.status_code == 201
    again = add_photo(object="car-1")
    assert again.json["sha256"] == first.json["sha256"]
    (photo,) = client.get(f"/api/v1/missions/{mission}/photos").json["photos"]
    assert (photo["time_s"], photo["object"], photo["name"]) == (12.5, "car-1", "car 1.jpg")
    assert state()["photos"] == 1
    (file,) = (library.folder / ".missions" / str(mission) / "photos").iterdir()
    assert file.name == f"{photo['sha256'][:16]}-car-1.jpg"
    assert list(library.uploads.iterdir()) == []


def test_its_pictures(client, mission, add_photo):
    photo = add_photo().json
    for size, mime in (("url", "image/jpeg"), ("thumb", "image/webp")):
        with client.get(photo[size]) as picture:
            assert (picture.status_code, picture.mimetype) == (200, mime)
    with client.get(f"/api/v1/missions/{mission}/photos/{photo['sha256']}/original") as original:
        assert hashlib.sha256(original.data).hexdigest() == photo["sha256"]
    assert client.get(f"/api/v1/missions/{mission}/photos/{'0' * 64}/preview").status_code == 404


def test_no_photo(client, mission, state):
    given = {"file": (io.BytesIO(b"no photo"), "a.jpg")}
    answer = client.post(f"/api/v1/missions/{mission}/photos", data=given)
    assert (answer.status_code, answer.json["error"]["where"]) == (422, "a.jpg")
    assert state()["photos"] == 0


def test_an_object_shows_its_photo(client, mission, send, add_photo):
    send([CAR])
    sha256 = add_photo(object="car-1").json["sha256"]
    assert client.get(f"/api/v1/missions/{mission}/objects/car-1").json["photo"] == sha256


def test_folders_of_no_mission_are_swept(library, mission, add_photo):
    add_photo()
    stray = library.folder / ".missions" / "999" / "photos"
    stray.mkdir(parents=True)
    worker.delete_leftovers(library, Settings(), more=REGISTRY.sweeps)
    assert [path.name for path in (library.folder / ".missions").iterdir()] == [str(mission)]
