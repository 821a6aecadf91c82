"""Libraries that are down, slow, lie or refuse: what the page and the jobs say, and that nothing is lost."""

import pytest
from click.testing import CliRunner
from sqlalchemy import select

from tests.connect.libraries.conftest import PAGE
from tests.connect.libraries.immich_server import Shot
from webapp.connect.libraries.command import libraries
from webapp.connect.libraries.records import unseal
from webapp.errors import InputError
from webapp.store.photo_libraries import LinkedAlbum, PhotoLibrary


def add(client, server, **changed):
    return client.post(PAGE, data={"kind": server.kind, "address": server.url, "key": server.key, **changed})


def error_of(linked):
    """Return message and hint of the failed job, which the page shows, too."""
    job = linked.job()
    assert job.state == "failed"
    shown = linked.client.get(PAGE).text
    assert job.error["message"][1:] in shown
    return f"{job.error['message']}: {job.error['hint']}"


def test_the_key_is_stored_encrypted_and_never_shown(client, server, connect, library):
    connect()
    with library.database.read() as session:
        stored = session.scalars(select(PhotoLibrary)).one()
    assert server.key not in stored.sealed_key and unseal(library.inner, stored.sealed_key) == server.key
    assert server.key not in client.get(PAGE).text
    assert add(client, server, key="wrong").status_code == 422
    (library.inner / "secret-key").unlink()
    with pytest.raises(InputError, match="another secret key"):
        unseal(library.inner, stored.sealed_key)
    assert "connect the photo library again" in client.post(f"{PAGE}/1/albums").text.lower()


def test_wrong_input_is_named_on_the_page(client, server, new_account, sign_in):
    for changed, said in (
        ({"key": "wrong"}, f"{server.name} refuses the API key (401)"),
        ({"key": "a b"}, "This is not an API key"),
        ({"kind": "other"}, "Unknown kind of photo library"),
        ({"address": "photos"}, "This is not the address of a photo library"),
        ({"address": "http://a:b@127.0.0.1"}, "This is not the address of a photo library"),
        ({"address": "http://127.0.0.1:9"}, "cannot be reached (ConnectionRefusedError)"),
        ({"address": "http://169.254.1.1"}, "can allow it: libraries.private_hosts"),
    ):
        answer = add(client, server, **changed)
        assert answer.status_code in (400, 422) and said in answer.text, changed
    assert 'data-testid="library"' not in client.get(PAGE).text
    add(client, server)
    other = sign_in(new_account("Eva"))
    assert other.post(f"{PAGE}/1/albums").status_code == 404
    assert other.post(f"{PAGE}/1/remove").status_code == 404
    assert 'data-testid="library"' not in other.get(PAGE).text


def test_only_maps_that_one_may_edit_are_offered_and_accepted(client, server, connect, park):
    connect()
    choice = client.post(f"{PAGE}/1/albums").text
    assert f'<option value="{park}">' in choice and "Round (3)" in choice
    data = {"album": next(iter(server.albums)), "map": "none", "every_h": "24"}
    assert client.post(f"{PAGE}/1/link", data=data).status_code == 404
    assert client.post(f"{PAGE}/1/link", data={**data, "map": park, "album": "x"}).status_code == 404
    assert client.post(f"{PAGE}/1/link", data={**data, "map": park, "every_h": "5"}).status_code == 400
    assert client.post(f"{PAGE}/1/link", data={**data, "map": park}).status_code == 303
    assert client.post(f"{PAGE}/1/link", data={**data, "map": park}).status_code == 409
    assert "Round" in client.get(PAGE).text


@pytest.mark.parametrize("content", [b"<html>", b"[1]", b'{"assets": {"items": [{"id": 1}]}}', b"null"])
def test_an_answer_that_is_no_list_changes_nothing(linked, server, content):
    server.bodies[server.LIST] = content
    linked.update()
    assert "JSON" in error_of(linked) or "did not send a list of photos" in error_of(linked)
    assert not any(photo.removed for photo in linked.photos().values())


def test_half_an_answer_and_an_empty_one_change_nothing(linked, server):
    server.cut.add(server.LIST)
    linked.update()
    assert "cannot be reached" in error_of(linked)
    server.cut.clear()
    server.bodies[server.LIST] = b'{"assets": {"items": [], "nextPage": null}}'
    linked.update()
    assert "lists no photos, although the album is not empty" in error_of(linked)
    server.albums.clear()
    linked.update()
    assert "no longer shows this album" in error_of(linked)
    assert not any(photo.removed for photo in linked.photos().values())
    server.bodies.clear()
    server.albums["11111111-2222-4333-8444-555555555555"] = "Renamed"
    assert linked.update().state == "done"
    assert "Renamed" in linked.client.get(PAGE).text


def test_pages_that_never_end_and_albums_that_are_too_large_are_refused(linked, server):
    server.shots += [Shot(f"d{n}") for n in range(3)]
    linked.update(max_photos=5)
    assert "more than 5 photos" in error_of(linked)
    again = b'{"assets": {"items": [], "nextPage": "9"}}'
    server.bodies[server.LIST] = again
    linked.update()
    assert "did not send a list of photos" in error_of(linked)


def test_redirects_are_not_followed(linked, server):
    server.failing[server.LIST] = [(302, {"Location": "http://127.0.0.1:9/"})]
    linked.update()
    assert "redirects (302), which is not followed" in error_of(linked)


def test_a_pause_is_kept_if_it_is_short_and_else_the_update_is_put_off(linked, server, library):
    server.failing[server.LIST] = [(429, {"Retry-After": "0"}), (503, {})]
    assert linked.update().state == "done"
    server.failing[server.LIST] = [(429, {"Retry-After": "90000"})]
    linked.update()
    assert "asks for a pause of 90000 seconds" in error_of(linked)
    with library.database.read() as session:
        album = session.get_one(LinkedAlbum, 1)
        assert (album.due_at - linked.job().ended_at).total_seconds() > 86_000
    server.failing[server.LIST] = [(500, {})] * 3
    linked.update()
    assert "answered 500" in error_of(linked)


def test_files_that_are_no_photos_are_named_and_not_fetched_again(linked, server):
    server.shots += [Shot("d", file=b"GIF89a"), Shot("e")]
    result = linked.update().result
    assert [one["name"] for one in result["failed"]] == ["IMG_d.HEIC"] and result["added"] == 1
    assert "1 unusable" in linked.client.get(PAGE).text
    linked.update()
    assert server.previews()["d"] == 1
    server.find("d").checksum, server.find("d").file = "new=", Shot("f").file
    assert linked.update().result["added"] == 1


def test_a_preview_that_is_missing_is_tried_again_and_three_end_the_run(linked, server):
    server.shots += [Shot("d"), Shot("e")]
    server.failing[server.preview_path("d")] = [(404, {})]
    result = linked.update().result
    assert (result["added"], len(result["failed"])) == (1, 1)
    assert linked.update().result["added"] == 1
    server.shots += [Shot("f"), Shot("g"), Shot("h"), Shot("i")]
    for id in "fgh":
        server.failing[server.preview_path(id)] = [(404, {})]
    assert linked.update().state == "failed"
    assert "i" not in server.previews()


def test_a_library_of_somebody_who_may_no_longer_edit_the_map_is_not_updated(linked, library, new_account):
    eva = new_account("Eva")
    with library.database.write() as session:
        session.get_one(PhotoLibrary, 1).account_id = eva.id
    with pytest.raises(AssertionError):  # not Eva's map: her page does not have it
        linked.update()
    with library.database.write() as session:
        session.get_one(LinkedAlbum, 1).due_at = session.get_one(LinkedAlbum, 1).due_at.replace(year=2020)
    assert "may no longer edit this map" in linked.work().error["message"]


def test_what_is_unlinked_stays_on_the_map(linked, client):
    photos = len(linked.photos())
    client.post(f"{PAGE}/albums/1/unlink")
    assert "Round" not in client.get(PAGE).text
    client.post(f"{PAGE}/1/remove")
    assert 'data-testid="library"' not in client.get(PAGE).text
    assert client.get(f"/api/v1/maps/{linked.slug}").json["photos"][photos - 1]["id"] == photos - 1


def test_the_command_lists_albums_and_says_what_is_wrong(server, monkeypatch, tmp_path):
    monkeypatch.setenv("EXPMAP_LIBRARIES_PRIVATE_HOSTS", "127.0.0.0/8")
    file = tmp_path / "key"
    file.write_text(f"{server.key}\n")
    done = CliRunner().invoke(libraries, [server.kind, server.url, "--key-file", str(file)])
    assert done.output == "      3  Round\n1 albums\n"
    monkeypatch.setenv("EXPMAP_LIBRARIES_PRIVATE_HOSTS", "")
    done = CliRunner().invoke(libraries, [server.kind, server.url], input=f"{server.key}\n")
    assert isinstance(done.exception, InputError) and "libraries.private_hosts" in done.exception.hint
