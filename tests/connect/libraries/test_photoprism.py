"""PhotoPrism, with a local server that speaks the part of its API that is used.

Written from https://docs.photoprism.app/developer-guide/api/
"""

import pytest

from tests.connect.libraries.conftest import PAGE, at
from tests.connect.libraries.immich_server import ImmichServer, Shot, serving
from webapp.connect.libraries import photoprism


class PhotoPrismServer(ImmichServer):
    name, kind, key = "PhotoPrism", "photoprism", "app-password-1"
    token = "preview1"

    def is_signed(self, headers):
        return headers.get("Authorization") == f"Bearer {self.key}"

    def answer(self, method, path, query, content):
        start, count = int(query.get("offset", ["0"])[0]), int(query.get("count", ["0"])[0])
        if (method, path) == ("GET", "/api/v1/albums"):
            listed = [{"UID": "at1", "Title": "Round", "PhotoCount": len(self.shots)}]
            return 200, listed[start : start + count]
        if (method, path) == ("GET", "/api/v1/photos"):
            assert (query["s"], query["primary"]) == (["at1"], ["true"])
            return 200, [self._item(shot) for shot in self.shots[start : start + count]]
        if (method, path) == ("GET", "/api/v1/config"):
            return 200, {"previewToken": self.token}
        if method == "PUT" and path.startswith("/api/v1/photos/"):
            shot = self.find(path.split("/")[-1])
            assert content.keys() == {"Lat", "Lng", "PlaceSrc"} and content["PlaceSrc"] == "manual"
            shot.lat, shot.lon = content["Lat"], content["Lng"]
            self.written.append((shot.id, shot.lat, shot.lon))
            return 200, self._item(shot)
        parts = path.split("/")
        if parts[3] == "t" and parts[5:] == [self.token, "fit_1920"]:
            return 200, next(shot.file for shot in self.shots if shot.checksum == parts[4])
        return 404, {"error": "Not found"}

    def _item(self, shot):
        item = {
            "UID": shot.id,
            "Type": "image",
            "Hash": shot.checksum,
            "FileName": f"2026/05/IMG_{shot.id}.jpg",
            "OriginalName": "",
            "TakenAtLocal": "2026-05-01T12:30:15Z",
            "TakenSrc": "meta",
            "CameraMake": "Canon",
            "CameraModel": "EOS R6",
            "Lat": shot.lat or 0,
            "Lng": shot.lon or 0,
            "PlaceSrc": "meta",
        }
        return {**item, **shot.fields}


@pytest.fixture
def shots():
    lat, lon = at(100, 200)
    guessed = {"Lat": lat, "Lng": lon, "PlaceSrc": "estimate"}
    video = {"Type": "video"}
    known = Shot("a", lat, lon, checksum="suma")
    return [known, Shot("b", checksum="sumb", fields=guessed), Shot("v", checksum="sumv", fields=video)]


@pytest.fixture
def server(shots):
    server = PhotoPrismServer(shots)
    server.albums = {"at1": "Round"}
    with serving(server) as started:
        yield started


def test_an_album_is_listed_in_pages_followed_and_written_back(linked, server, monkeypatch):
    monkeypatch.setattr(photoprism, "_PAGE", 2)
    photos = linked.photos()
    assert photos.keys() == {"a", "b"}
    one = photos["a"]
    assert (one.name, one.taken_at, one.camera) == ("IMG_a.jpg", "2026-05-01T12:30:15", "Canon EOS R6")
    assert (round(one.x_px), round(one.y_px), photos["b"].x_px) == (100, 200, None)  # a guess counts as none
    linked.edit("b", x_px=500.0, y_px=600.0)
    server.find("b").fields = {}
    server.shots.append(Shot("c", *at(10, 20), checksum="sumc"))
    result = linked.update().result
    assert (result["found"], result["added"], result["written"]) == (3, 1, 1)
    assert [id for id, *_ in server.written] == ["b"]
    del server.shots[0]
    assert linked.update().result["removed"] == 1


@pytest.mark.parametrize(
    ("path", "content", "said"),
    [
        ("GET /api/v1/photos", b"{}", "did not send a list"),
        ("GET /api/v1/photos", b'[{"UID": "../x"}]', "did not send a list of photos"),
        ("GET /api/v1/albums", b"[1]", "did not send a list of albums"),
        ("GET /api/v1/albums", b"<html>", "did not answer with JSON"),
    ],
)
def test_answers_that_are_no_lists_are_refused(linked, server, path, content, said):
    server.bodies[path] = content
    assert said in linked.update().error["message"]


def test_previews_that_are_not_there_yet_are_fetched_later(linked, server):
    server.shots.append(Shot("c", checksum="sumc", file=b"<svg/>"))
    result = linked.update().result
    assert "has no preview of this photo yet" in result["failed"][0]["reason"]
    server.find("c").file = Shot("c").file
    assert linked.update().result["added"] == 1
    server.shots.append(Shot("d", checksum="sumd"))
    server.bodies["GET /api/v1/config"] = b'{"previewToken": "../../x"}'
    assert "did not send a token" in linked.update().result["failed"][0]["reason"]


def test_a_wrong_app_password_is_refused(client, server):
    answer = client.post(PAGE, data={"kind": server.kind, "address": server.url, "key": "wrong"})
    assert answer.status_code == 422 and "PhotoPrism refuses the API key (401)" in answer.text
