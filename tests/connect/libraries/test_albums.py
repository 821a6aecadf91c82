"""An album on a map: photos come in once, changes are followed, positions go back."""

import pytest

from tests.connect.libraries.conftest import PAGE, at
from tests.connect.libraries.immich_server import Shot
from webapp.connect.libraries import updating
from webapp.store.photo_libraries import LinkedAlbum


def places(linked):
    return {asset: (photo.x_px, photo.y_px) for asset, photo in linked.photos().items()}


def near(*position):
    return tuple(pytest.approx(value, abs=1e-7) for value in position)


def test_photos_come_in_once_with_what_the_library_says_of_them(linked, server):
    assert places(linked) == {"a": near(100, 200), "b": (None, None), "c": near(300, 400)}
    one = linked.photos()["a"]
    assert (one.name, one.taken_at, one.camera) == ("IMG_a.HEIC", "2026-05-01T12:30:15", "Canon EOS R6")
    said = ["a preview: the original is in the photo library", f"{server.url}/photos/a"]
    assert one.file_notes[:2] == said
    assert linked.photos()["b"].gps_problem == "no position is known where it is from"
    assert one.path == "photos/IMG_a.jpg" and one.source is None
    assert linked.job().result["added"] == 3
    assert linked.update().result == {
        "found": 3, "added": 0, "removed": 0, "moved": 0, "written": 0, "failed": [],
    }  # fmt: skip
    assert server.previews() == {"a": 1, "b": 1, "c": 1}
    assert server.keys == {server.key} and server.written == []


def test_a_killed_run_goes_on_without_a_second_photo(client, connect, linked, server, monkeypatch):
    server.shots += [Shot("d"), Shot("e")]
    with monkeypatch.context() as patched:
        patched.setattr(updating._Update, "_record", kill_after(1, updating._Update._record))
        assert linked.update().state == "failed"
    assert linked.photos().keys() == {"a", "b", "c", "d"}
    assert linked.update().result["added"] == 1
    photos = linked.photos()
    assert len({photo.id for photo in photos.values()}) == len(photos) == 5
    # the preview of the one that was not committed is fetched again, no other
    assert server.previews() == {"a": 1, "b": 1, "c": 1, "d": 1, "e": 2}


def kill_after(count, function):
    """Wrap a function so that it ends the process, as it were, after some calls, before it returns."""
    calls = []

    def call(*arguments, **options):
        calls.append(1)
        if len(calls) > count:
            raise RuntimeError("killed")
        return function(*arguments, **options)

    return call


def test_positions_set_here_are_written_back_once(linked, server):
    linked.edit("b", x_px=500.0, y_px=600.0)
    assert linked.update().result["written"] == 1
    assert server.written == [("b", *near(*at(500, 600)))]
    assert linked.update().result["written"] == 0
    linked.edit("b", x_px=510.0, y_px=600.0)
    assert linked.update().result["written"] == 1
    assert server.find("b").lon == near(at(510, 600)[1])[0]
    # removed there afterwards: it is not written again
    server.find("b").lat = server.find("b").lon = None
    assert linked.update().result["written"] == 0
    assert places(linked)["b"] == (510, 600)


def test_a_position_that_the_library_has_is_not_overwritten(linked, server):
    linked.edit("a", x_px=700.0, y_px=700.0)
    linked.edit("b", x_px=500.0, y_px=600.0)
    server.find("b").lat, server.find("b").lon = at(10, 10)
    assert linked.update().result["written"] == 0 and server.written == []
    assert (places(linked)["a"], places(linked)["b"]) == ((700, 700), (500, 600))


def test_a_kill_between_writing_and_noting_it_writes_nothing_twice(linked, server, monkeypatch):
    linked.edit("b", x_px=500.0, y_px=600.0)
    with monkeypatch.context() as patched:
        patched.setattr(updating, "is_same", lambda *_: 1 / 0)  # a mistake before anything is sent
        server.find("b").lat, server.find("b").lon = at(500, 600)  # as sent by the run that was killed
        assert linked.update().state == "failed"
    assert linked.update().result["written"] == 0 and server.written == []
    assert linked.row("b").written
    linked.edit("b", x_px=510.0, y_px=600.0)
    assert linked.update().result["written"] == 1


def test_without_the_choice_nothing_is_written(linked, server, client):
    client.post(f"{PAGE}/albums/1/change", data={"every_h": "0"})
    linked.edit("b", x_px=500.0, y_px=600.0)
    assert linked.update().result["written"] == 0 and server.written == []


def test_moves_there_are_followed_unless_a_person_placed_the_photo_here(linked, server):
    linked.edit("c", x_px=11.0, y_px=12.0)
    server.find("a").lat, server.find("a").lon = at(150, 250)
    server.find("b").lat, server.find("b").lon = at(50, 60)
    server.find("c").lat, server.find("c").lon = at(1, 1)
    assert linked.update().result["moved"] == 2
    assert places(linked) == {"a": near(150, 250), "b": near(50, 60), "c": (11, 12)}
    # out of the image: into the tray; what a person has put into the tray stays there
    server.find("a").lat, server.find("a").lon = at(5000, 10)
    linked.edit("b", x_px=None, y_px=None)
    server.find("b").lat, server.find("b").lon = at(55, 60)
    assert linked.update().result["moved"] == 1
    assert places(linked) == {"a": (None, None), "b": (None, None), "c": (11, 12)}
    assert linked.client.post(f"/api/v1/maps/{linked.slug}/undo").status_code == 200
    assert places(linked)["a"] == near(150, 250)


def test_photos_removed_there_leave_the_map_unless_a_person_worked_on_them(linked, server):
    linked.edit("c", x_px=11.0, y_px=12.0)
    linked.edit("b", note="by the gate")
    kept = server.shots
    server.shots = [Shot("d")]
    assert linked.update().result["removed"] == 1
    photos = linked.photos()
    assert {asset: photo.removed for asset, photo in photos.items()} == {
        "a": True, "b": False, "c": False, "d": False,
    }  # fmt: skip
    assert "2 no longer in the album" in linked.client.get(PAGE).text
    server.shots = [*kept, *server.shots]
    assert linked.update().result["added"] == 0
    assert not any(photo.removed for photo in linked.photos().values())
    assert "no longer" not in linked.client.get(PAGE).text


def test_what_a_person_removed_here_does_not_come_back(linked, server):
    linked.remove("a")
    server.find("a").lat, server.find("a").lon = at(150, 250)
    linked.update()
    server.shots, all_shots = server.shots[1:], server.shots
    linked.update()
    server.shots = all_shots
    linked.update()
    assert linked.photos()["a"].removed and linked.row("a").state == "here"


def test_a_replaced_file_is_fetched_unless_a_person_worked_on_the_photo(linked, server):
    before = linked.photos()
    linked.edit("c", x_px=11.0, y_px=12.0)
    for id in ("a", "c"):
        server.find(id).checksum, server.find(id).file = "new=", Shot(f"{id}2").file
    assert linked.update().result["added"] == 1
    after = linked.photos()
    assert after["a"].id != before["a"].id and after["c"].id == before["c"].id
    assert places(linked)["a"] == near(100, 200)
    assert linked.update().result["added"] == 0


def test_an_album_is_updated_when_it_is_due(linked, server, library):
    server.shots.append(Shot("d"))
    first = linked.job().id
    assert linked.work().id == first
    with library.database.write() as session:
        album = session.get_one(LinkedAlbum, 1)
        album.due_at = album.due_at.replace(year=2020)
    assert linked.work().id > first
    assert linked.photos().keys() == {"a", "b", "c", "d"}
    assert linked.work().id == linked.job().id


def test_a_photo_in_two_albums_is_one_and_stays_while_one_has_it(linked, server, client, park):
    server.albums["22222222-2222-4333-8444-555555555555"] = "Again"
    second = Shot("a2", file=server.find("a").file)
    server.shots.append(second)
    assert linked.update().result["added"] == 0
    assert linked.photos()["a2"].id == linked.photos()["a"].id
    server.shots.remove(second)
    assert linked.update().result["removed"] == 0
    assert not linked.photos()["a"].removed
