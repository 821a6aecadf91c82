"""The search "Which map is this?" through the API and by the command, among the maps that one may see."""

import io
import json
import shutil
from concurrent.futures import ThreadPoolExecutor
from threading import BoundedSemaphore, Event

import pytest
from click.testing import CliRunner
from sqlalchemy import select

from webapp.app.main import COMPOSITION, root
from webapp.errors import BeingOpened, NotReady, StorageUnavailable
from webapp.store.maps import maps
from webapp.store.schema import Job
from webapp.tasks.find import find_map
from webapp.tasks.find.find_map import MapRanking
from webapp.tasks.localize import map_cache
from webapp.tasks.localize.map_cache import MapCache
from webapp.tasks.localize.plan import OpenOptions
from webapp.tasks.localize.upload import UploadedPhoto
from webapp.tasks.maps import adopt_map
from webapp.threads import permit

EVENTS = "text/event-stream, application/json;q=0.5"


def ask(browser, path):
    return browser.post("/api/v1/find", data={"file": (io.BytesIO(path.read_bytes()), path.name)})


@pytest.fixture
def empty(library, owner):
    """A map without an index."""
    with library.database.write() as session:
        return maps.create(session, "Nothing yet", account_id=owner.id).slug


def test_the_map_is_found_and_others_are_named(client, sample, empty, queries):
    answer = ask(client, queries / "query_02.jpg")
    assert answer.status_code == 200
    found = answer.json
    (best,) = found["maps"]
    assert best["slug"] == "sample"
    assert best["probability"] > 0.9
    assert best["probability"] + found["no_map_probability"] == pytest.approx(1.0)
    assert len(best["answer"]["hypotheses"]) == 1
    (skipped,) = found["not_searched"]
    assert skipped["slug"] == empty and "image" in skipped["reason"]


def test_maps_without_an_index_are_indexed_before_other_long_work(
    client, library, owner, ready_sample, queries
):
    folder = library.map_folder("sample")
    shutil.copytree(ready_sample, folder, ignore=shutil.ignore_patterns("derived"))
    adopt_map.adopt_map(library, "sample", account_id=owner.id)
    (skipped,) = ask(client, queries / "query_02.jpg").json["not_searched"]
    assert "is being built" in skipped["reason"]
    with library.database.read() as session:
        (job,) = session.scalars(select(Job).where(Job.kind == "index"))
        assert job.asked_at is not None


def test_which_map_is_being_searched_is_sent_as_an_event(client, sample, queries):
    client.environ_base["HTTP_ACCEPT"] = EVENTS
    progress, answer = ask(client, queries / "query_02.jpg").get_data(as_text=True).split("\n\n")[:-1]
    assert progress.startswith("event: progress\ndata: ")
    assert json.loads(progress.split("data: ")[1]) == {"map": "Sample", "done": 0, "total": 1}
    assert json.loads(answer.removeprefix("event: answer\ndata: "))["maps"][0]["slug"] == "sample"


def test_a_search_ends_when_its_client_has_gone_and_counts_until_then(
    app, client, sample, empty, queries, library, monkeypatch
):
    searched, may_end = [], Event()

    def slowly(_cache, map_id, *, request):
        searched.append(map_id)
        may_end.wait(20)
        raise NotReady("it has no index")

    monkeypatch.setattr(find_map.upload, "localize_uploads", slowly)
    free = app.extensions["expmap_concurrency"]["answers"] = BoundedSemaphore(1)
    for accepted, status in (EVENTS, 200), (EVENTS, 503), ("application/json", 503):
        client.environ_base["HTTP_ACCEPT"] = accepted
        answer = ask(client, queries / "query_02.jpg")
        assert answer.status_code == status
        answer.close()
    may_end.set()
    with permit(free):
        assert len(searched) == 1
        assert list(library.uploads.iterdir()) == []
    assert len(ask(client, queries / "query_02.jpg").json["not_searched"]) == 2


def test_why_a_map_was_not_searched_is_in_the_language_of_the_page(client, empty, queries):
    photo = (queries / "query_02.jpg").read_bytes()
    form = {"file": (io.BytesIO(photo), "query_02.jpg")}
    answer = client.post("/api/v1/find", data=form, headers={"Accept-Language": "cs"})
    (skipped,) = answer.json["not_searched"]
    assert skipped["reason"] == "mapa ještě nemá satelitní snímek"


def test_maps_of_others_are_not_searched(sign_in, new_account, sample, queries):
    found = ask(sign_in(new_account("eva")), queries / "query_02.jpg").json
    assert found["maps"] == [] and found["not_searched"] == []
    assert found["no_map_probability"] == 1.0


def test_what_is_no_photo_is_refused_and_nothing_stays(client, library, sample, tmp_path):
    (path := tmp_path / "words.jpg").write_bytes(b"no photo")
    assert ask(client, path).status_code == 422
    assert list(library.uploads.iterdir()) == []


def test_the_search_ends_when_its_time_is_up(monkeypatch, library, record, queries, settings):
    monkeypatch.setattr(find_map, "BUDGET_S", -1.0)
    photo = UploadedPhoto(queries / "query_02.jpg", "query_02.jpg")
    search = find_map.LibrarySearch(MapCache(library, settings), MapRanking(library, settings), settings)
    found = find_map.find_map(search, [record()], photo=photo)
    assert found.maps == () and "ran out of time" in found.not_searched[0].reason.message


@pytest.mark.parametrize("error", [StorageUnavailable, BeingOpened])
def test_a_map_that_cannot_be_opened_now_is_named_and_others_are_searched(
    monkeypatch, library, record, queries, settings, error
):
    localize, asked = find_map.upload.localize_uploads, []

    def away_at_first(*given, **named):
        asked.append(given)
        if len(asked) == 1:
            raise error("it cannot be reached", wait_s=5)
        return localize(*given, **named)

    photo = UploadedPhoto(queries / "query_02.jpg", "query_02.jpg")
    search = find_map.LibrarySearch(MapCache(library, settings), MapRanking(library, settings), settings)
    monkeypatch.setattr(find_map.upload, "localize_uploads", away_at_first)
    found = find_map.find_map(search, [record(), record()], photo=photo)
    assert len(found.maps) == 1 and "cannot be reached" in found.not_searched[0].reason.message
    asked.clear()
    with pytest.raises(error, match="cannot be reached"):
        find_map.find_map(search, [record()], photo=photo)


def test_who_asks_while_another_opens_the_map_does_not_wait_for_long(monkeypatch, library, record, settings):
    monkeypatch.setattr(map_cache, "_OPEN_WAIT_S", 0.05)
    asked, cache = [], MapCache(library, settings)

    def open_slowly(*_, **__):
        with pytest.raises(BeingOpened, match="is being opened"), ThreadPoolExecutor() as another:
            another.submit(cache.get, record().id, OpenOptions()).result()
        asked.append(True)
        raise NotReady("it has no index")

    monkeypatch.setattr(cache, "_current", open_slowly)
    with pytest.raises(NotReady):
        cache.get(record().id, OpenOptions())
    assert asked


def test_the_command_says_the_same(sample, library, queries, tmp_path):
    (bad := tmp_path / "words.jpg").write_bytes(b"no photo")
    words = ["find", "--library", str(library.folder), str(queries / "query_02.jpg")]
    told = CliRunner().invoke(root, words, obj=COMPOSITION)
    assert told.exit_code == 0 and "query_02.jpg: on the map" in told.output
    done = CliRunner().invoke(root, [*words, str(bad), "--json"], obj=COMPOSITION)
    assert done.exit_code == 1
    first, second = json.loads(done.stdout)
    assert first["maps"][0]["slug"] == "sample" and first["maps"][0]["probability"] > 0.9
    assert "error" in second
