"""A library with photos and indexes in S3, on machines that share its folder and have separate caches."""

import hashlib
import io
import os
import subprocess
import sys
import time
import zipfile
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from datetime import timedelta
from pathlib import Path

import numpy as np
import pytest
from filelock import FileLock
from PIL import Image
from sqlalchemy import select

from tests.s3_server import using
from tests.web.conftest import Browser
from webapp.api import open_map
from webapp.app import main as program
from webapp.app.registry import REGISTRY
from webapp.app.web import create_app
from webapp.cli.library import existing_library, opened_library
from webapp.cli.progressbar import TerminalProgress
from webapp.core.features.table import choose
from webapp.core.landmarks.cloud import LandmarkCloud
from webapp.errors import DiskFull, StorageError, StorageUnavailable, UsageError
from webapp.files import contents
from webapp.files.atomic import write_text
from webapp.files.contents import connect
from webapp.files.landmarks import cloud
from webapp.files.localize import orientations
from webapp.files.maps.folder import read_map
from webapp.files.object_storage import bucket as bucket_module
from webapp.files.object_storage import storage
from webapp.files.object_storage.bucket import Bucket
from webapp.files.object_storage.cache import pointed_path, pointer_path, read_pointer
from webapp.files.object_storage.storage import MARKER
from webapp.jobs.worker import Worker
from webapp.progress import Progress
from webapp.settings import ExtractSettings, Settings, UploadLimits
from webapp.store import clock
from webapp.store.maps import maps
from webapp.store.operate import jobs
from webapp.store.schema import Job, MapRecord, Photo
from webapp.tasks.exchange.duplicate_map import duplicate_map
from webapp.tasks.landmarks.accept import library_of
from webapp.tasks.localize.build_index import BuildRequest, update_index
from webapp.tasks.localize.index_location import has_landmarks, landmarks_folder
from webapp.tasks.maps import adopt_map, findings, photo_files
from webapp.tasks.maps.delete_map import delete_map
from webapp.tasks.operate import maintain_objects, open_storage
from webapp.tasks.operate import move as move_library
from webapp.tasks.operate.backup import back_up, restore
from webapp.tasks.operate.move import move_to_file, move_to_folder
from webapp.tasks.satellite import display

pytestmark = pytest.mark.slow

ROOT = Path(__file__).resolve().parents[3]
ADDER = """
import sys
from pathlib import Path
from webapp.configuration import load_settings
from webapp.store.library import open_library
from webapp.tasks.maps.add_photo import IncomingPhoto, add_photo
from webapp.tasks.operate.open_storage import open_storage

settings = load_settings()
library = open_library(settings.library, url=settings.database)
open_storage(library, settings)
for file in sys.argv[2:]:
    photo = IncomingPhoto(Path(file), Path(file).name)
    print(add_photo(library, int(sys.argv[1]), photo=photo, settings=settings).id, flush=True)
"""


@pytest.fixture
def database_url(postgresql, monkeypatch):
    """The address of a database on the server: SQLite does not support object storage."""
    url = postgresql.new_database()
    monkeypatch.setenv("EXPMAP_DATABASE", url)
    yield url
    postgresql.drop(url)


def objects_in(s3, bucket):
    """Return the objects in a bucket, except the marker of its library."""
    return [key for key in s3.keys(bucket) if key != "lib/library"]


@pytest.fixture
def bucket(s3):
    return s3.new_bucket()


@pytest.fixture
def settings(tmp_path, database_url, bucket, monkeypatch):
    for name, value in {"STORAGE": f"s3://{bucket}/lib", "CACHE_FOLDER": tmp_path / "a"}.items():
        monkeypatch.setenv(f"EXPMAP_{name}", str(value))
    monkeypatch.setenv("EXPMAP_LIBRARY", str(tmp_path / "library"))
    yield Settings(
        library=tmp_path / "library",
        database=database_url,
        storage=f"s3://{bucket}/lib",
        cache_folder=tmp_path / "a",
        upload=UploadLimits(chunk_mb=0.01, reserve_mb=0.0),
        extract=ExtractSettings(max_side_px=320, keypoints=120),
    )
    contents.use(None)


@pytest.fixture
def machine(settings, library, owner, tmp_path):
    """Switch to another machine with an empty cache, and return a browser there."""

    apps = {}

    def go(name):
        there = replace(settings, cache_folder=tmp_path / name)
        app = apps[name] = apps.get(name) or create_app(there, library=library)
        connect(there)
        app.testing, app.test_client_class = True, Browser
        client = app.test_client()
        with client.session_transaction() as session:
            session["_user_id"] = f"{owner.id}.{owner.epoch}"
            session["session_id"] = "0" * 32
            session.permanent = True
        return client

    return go


@pytest.fixture
def row(library, make_map, owner, settings):
    """The id of a map whose photos and index are files, as before the library had object storage."""
    make_map(library.map_folder("row"), 4)
    id = adopt_map.adopt_map(library, "row", account_id=owner.id)
    contents.use(None)
    Worker(library, replace(settings, storage=None), registry=REGISTRY).run(once=True)
    return id


@pytest.fixture
def moved(library, settings, row):
    """The same after the move to S3."""
    open_storage.open_storage(library, settings)
    assert maintain_objects.move_photos(library) == 4 + 1, "the photos and the image"
    folder = library.map_folder("row") / "photos"
    assert (folder / "0.jpg").exists(), "somebody may have its path"
    for pointer in folder.parent.rglob(".*.object"):
        os.utime(pointer, (0, 0))
    assert maintain_objects.move_photos(library) == 0
    assert list(folder.glob("[!.]*")) == [] and not (folder.parent / "plan.png").exists()
    return row


def build(library, settings, map_id):
    """Let a worker build the index, and return the job's record."""
    with library.database.write() as session:
        id = jobs.enqueue(session, "index", map_id=map_id, arguments={}, key="").id
    Worker(library, settings, registry=REGISTRY).run(once=True)
    with library.database.read() as session:
        return session.get_one(Job, id)


def question(save_photo, tmp_path):
    """A query that shows the second photo of the map."""
    save_photo(tmp_path / "question.jpg", 1)
    return tmp_path / "question.jpg"


def jpeg(seed=0, *, side=200):
    pixels = np.random.default_rng(seed).integers(0, 255, (side, side, 3)).astype(np.uint8)
    file = io.BytesIO()
    Image.fromarray(pixels).save(file, "JPEG")
    return file.getvalue()


def send(client, data, name="a.jpg", *, slug="park"):
    answer = client.post(f"/api/v1/maps/{slug}/photos", data={"file": [(io.BytesIO(data), name)]})
    assert answer.status_code == 207
    return answer.get_json()[0]


def photos(library, slug):
    with library.database.read() as session:
        record = session.query(MapRecord).filter_by(slug=slug).one()
        return [photo.name for photo in maps.photos(session, record)]


def at(monkeypatch, hours):
    """Shift the clock of the sweep by hours."""
    monkeypatch.setattr(maintain_objects, "now", lambda: clock.now() + timedelta(hours=hours))


def test_a_photo_of_one_machine_is_read_on_another(machine, library, park, s3, bucket):
    data = jpeg()
    here = machine("a")
    assert send(here, data)["id"] == 0
    assert len(objects_in(s3, bucket)) == 1
    place = library.map_folder(park) / "photos/a.jpg"
    assert not place.exists() and read_pointer(place).bytes == len(data)
    there = machine("b")
    base = f"/api/v1/maps/{park}/photos/0"
    part = there.get(f"{base}/original", headers={"Range": "bytes=100-199"}, buffered=True)
    assert (part.status_code, part.data) == (206, data[100:200])
    assert there.get(f"{base}/original", buffered=True).data == data
    for preview in library.map_folder(park).glob("derived/previews/*"):
        preview.unlink()
    thumb = machine("c").get(f"{base}/thumb", buffered=True)
    assert Image.open(io.BytesIO(thumb.data)).size == (200, 200)


def test_nothing_is_copied_into_the_cache_while_others_wait(machine, library, park, s3, monkeypatch):
    here, copied, waiting = machine("a"), [], []
    cache, changing = contents.in_use().cache, type(library).changing
    adopt = cache.adopt

    @contextmanager
    def noted(self, *args, **options):
        with changing(self, *args, **options) as change:
            waiting.append(True)
            yield change
            waiting.pop()

    def adopted(*args, **options):
        copied.append(bool(waiting))
        adopt(*args, **options)

    monkeypatch.setattr(type(library), "changing", noted)
    monkeypatch.setattr(cache, "adopt", adopted)
    data = jpeg()
    assert send(here, data)["id"] == 0
    assert copied == [False]
    s3.refuse = (503, "SlowDown")
    original = here.get(f"/api/v1/maps/{park}/photos/0/original", buffered=True)
    assert original.data == data, "from the cache"


def test_a_photo_that_comes_twice_is_kept_once(machine, library, park):
    here = machine("a")
    assert not send(here, jpeg())["duplicate"]
    again = send(machine("b"), jpeg(), "b.jpg")
    assert (again["id"], again["duplicate"]) == (0, True)
    assert photos(library, park) == ["a.jpg"]
    assert send(here, jpeg(1))["id"] == 1, "another photo of the same name"
    assert len(list(library.map_folder(park).glob("photos/.*.object"))) == 2


def test_a_download_that_was_cut_off_goes_on_at_another_machine(machine, park, s3):
    data = jpeg(side=60)
    send(machine("a"), data, "b.jpg")
    base = "/api/v1/maps/park/photos/0/original"
    whole = machine("a").get(base, buffered=True)
    assert whole.headers["Accept-Ranges"] == "bytes"
    rest = {"Range": "bytes=1000-", "If-Range": whole.headers["ETag"]}
    s3.requests.clear()
    part = machine("b").get(base, headers=rest, buffered=True)
    assert (part.status_code, part.data) == (206, data[1000:])
    assert part.headers["Content-Range"] == f"bytes 1000-{len(data) - 1}/{len(data)}"
    assert "filename=b.jpg" in part.headers["Content-Disposition"]
    fetched = len(s3.requests)
    changed = machine("b").get(base, headers={**rest, "If-Range": '"another"'}, buffered=True)
    assert (changed.status_code, changed.data) == (200, data), "the client's beginning is of another file"
    last = machine("b").get(base, headers={"Range": "bytes=-10"}, buffered=True)
    assert (last.status_code, last.data) == (206, data[-10:])
    beyond = machine("b").get(base, headers={"Range": f"bytes={len(data)}-"}, buffered=True)
    assert beyond.status_code == 416
    assert len(s3.requests) == fetched, "ranges are cut from the copy that is here"


def test_an_upload_in_chunks_goes_on_at_another_machine(machine, library, park):
    data, here = jpeg(), machine("a")
    url = f"/api/v1/maps/{park}/uploads"
    asked = {"name": "a.jpg", "size_bytes": len(data), "fingerprint": "f"}
    begun = here.post(url, json=asked).get_json()
    kind = "application/octet-stream"
    for start in range(0, len(data), begun["chunk_bytes"]):
        client = machine("b" if start else "a")
        chunk = data[start : start + begun["chunk_bytes"]]
        answer = client.patch(
            f"{url}/{begun['id']}", data=chunk, headers={"Upload-Offset": str(start)}, content_type=kind
        )
    assert answer.status_code == 200
    assert photos(library, park) == ["a.jpg"]
    original = machine("c").get(f"/api/v1/maps/{park}/photos/0/original", buffered=True)
    assert original.data == data


@pytest.mark.parametrize(
    ("refusal", "code"),
    [
        ((503, "SlowDown"), "storage_unavailable"),
        ((403, "AccessDenied"), "storage_unavailable"),
        ((507, "X"), "disk_full"),
    ],
)
def test_a_photo_that_s3_refuses_is_not_acknowledged(machine, library, park, s3, bucket, refusal, code):
    client = machine("a")
    s3.refuse = refusal
    answer = send(client, jpeg())
    assert answer["error"]["code"] == code and "object storage" in answer["error"]["message"]
    assert photos(library, park) == [] and objects_in(s3, bucket) == []
    s3.reset()
    assert send(client, jpeg())["id"] == 0


def test_a_connection_that_breaks_off_is_one_sentence_in_page_and_log(
    machine, library, settings, park, s3, caplog
):
    data, said = jpeg(side=100), "the connection to the object storage was lost"
    s3.cut = {"PUT": 1000}
    refused = send(machine("a"), data)["error"]
    assert (refused["code"], refused["message"]) == ("storage_unavailable", said)
    assert photos(library, park) == []
    s3.reset()
    send(machine("a"), data)
    s3.cut = {"GET": 1000}
    caplog.clear()
    for _ in range(2):
        page = machine("b").get(f"/api/v1/maps/{park}/photos/0/original")
        assert (page.status_code, page.get_json()["error"]["message"]) == (503, said)
    ours = [record for record in caplog.records if record.name.startswith("webapp")]
    assert [(one.getMessage(), one.exc_info) for one in ours] == [(f"{settings.storage}: {said}", None)]


def test_an_upload_in_chunks_waits_for_s3(machine, library, park, s3):
    data, client = jpeg(side=40), machine("a")
    url = f"/api/v1/maps/{park}/uploads"
    asked = {"name": "a.jpg", "size_bytes": len(data), "fingerprint": "f"}
    begun = client.post(url, json=asked).get_json()
    chunk = {"data": data, "headers": {"Upload-Offset": "0"}, "content_type": "application/octet-stream"}
    s3.refuse = (503, "SlowDown")
    refused = client.patch(f"{url}/{begun['id']}", **chunk)
    assert (refused.status_code, refused.get_json()["error"]["code"]) == (503, "storage_unavailable")
    assert int(refused.headers["Retry-After"]) > 0
    assert photos(library, park) == []
    s3.reset()
    known = client.post(url, json=asked).get_json()
    assert (known["id"], known["offset"]) == (begun["id"], len(data))
    rest = {**chunk, "data": b"", "headers": {"Upload-Offset": str(len(data))}}
    assert client.patch(f"{url}/{begun['id']}", **rest).status_code == 200
    assert photos(library, park) == ["a.jpg"]


def test_a_photo_that_cannot_be_fetched_is_one_sentence(machine, park, s3):
    send(machine("a"), jpeg())
    base = f"/api/v1/maps/{park}/photos/0"
    s3.refuse = (503, "SlowDown")
    cold = machine("b")
    refused = cold.get(f"{base}/original")
    assert refused.status_code == 503 and refused.headers["Retry-After"] == "5"
    assert refused.get_json()["error"]["message"] == "the object storage is overloaded or out of order"
    assert machine("a").get(f"{base}/original", buffered=True).status_code == 200, "what is here is shown"


def test_a_cold_machine_answers_as_a_warm_one(
    machine, moved, library, ask, settings, s3, bucket, save_photo, tmp_path
):
    photo, folder = question(save_photo, tmp_path), library.map_folder("row")
    warm = ask(machine("a"), photo, slug="row").get_json()
    files = {path: path.read_bytes() for path in folder.glob("derived/map/*/[!.]*.*")}
    segments = [path for path in files if path.suffix in (".features", ".ivf", ".codebook")]
    assert len(segments) == 3
    assert build(library, settings, moved).state == "done"
    for path in segments:
        assert not path.exists() and read_pointer(path).bytes == len(files[path])
    before = len(objects_in(s3, bucket))
    cold = ask(machine("b"), photo, slug="row").get_json()
    assert cold["hypotheses"] == warm["hypotheses"] != []
    for path in segments:
        assert contents.local(path).read_bytes() == files[path], "the index is the same, byte for byte"
    assert len(objects_in(s3, bucket)) == before
    assert findings.list_findings(library, moved, settings=settings) == []


def test_a_lost_segment_is_built_again(machine, moved, library, settings, s3, bucket):
    assert build(library, settings, moved).state == "done"
    (segment,) = library.map_folder("row").glob("derived/map/*/.*.features.object")
    pointer = read_pointer(pointed_path(segment))
    s3.client.delete_object(Bucket=bucket, Key=f"lib/{pointer.key}")
    cold = replace(settings, cache_folder=settings.cache_folder.with_name("b"))
    machine("b")
    job = build(library, cold, moved)
    assert (job.state, job.result["computed"]) == ("done", 4)
    assert read_pointer(pointed_path(segment)).sha256 == pointer.sha256


def test_a_job_waits_for_s3_and_then_ends(machine, moved, library, settings, s3, monkeypatch):
    machine("b")
    cold = replace(settings, cache_folder=settings.cache_folder.with_name("b"))
    for manifest in library.map_folder("row").glob("derived/map/*/manifest.json"):
        manifest.unlink()
    monkeypatch.setattr(bucket_module, "_WAIT_S", 1)
    s3.refuse = (503, "SlowDown")
    with pytest.raises(StorageUnavailable, match="overloaded or out of order"):
        build(library, cold, moved)  # a worker with `--once` ends, and the job stays queued
    assert last_job(library).state == "queued"
    worker = Worker(library, cold, registry=REGISTRY)
    with ThreadPoolExecutor(1) as pool:
        working = pool.submit(worker.run)
        try:
            wait_until(lambda: last_job(library).fence > 1 and last_job(library).state == "queued")
            assert last_job(library).note == "the object storage is overloaded or out of order"
            s3.reset()
            wait_until(lambda: last_job(library).state == "done")
        finally:
            worker.stop()
        working.result()
    assert list(library.map_folder("row").glob("derived/map/*/.*.features.object"))


def test_a_build_for_which_s3_has_no_room_says_so_and_ends_when_it_has(
    machine, moved, library, settings, s3, caplog
):
    machine("a")
    for manifest in library.map_folder("row").glob("derived/map/*/manifest.json"):
        manifest.unlink()
    s3.refuse, s3.refused_methods = (507, "XMinioStorageFull"), {"PUT", "POST"}
    job = build(library, settings, moved)
    assert (job.state, job.error["message"]) == ("failed", "the object storage is full")
    told = [one.getMessage() for one in caplog.records if one.levelname == "WARNING"]
    assert f"{settings.storage}: the object storage is full" in told
    s3.reset()
    job = build(library, settings, moved)
    assert (job.state, job.result["computed"]) == ("done", 0), "what was computed is still there"


def wait_until(holds):
    until = time.monotonic() + 30
    while not holds():
        assert time.monotonic() < until
        time.sleep(0.05)


def last_job(library):
    with library.database.read() as session:
        return session.scalars(select(Job).order_by(Job.id.desc())).first()


def test_an_image_and_what_is_made_of_it_come_from_its_storage(machine, moved, library, s3, bucket, owner):
    client, plan = machine("b"), library.map_folder("row") / "plan.png"
    assert read_pointer(plan) is not None and not plan.exists()
    shown = client.get("/api/v1/maps/row/satellite", buffered=True)
    assert (shown.status_code, shown.mimetype) == (200, "image/png")
    assert shown.data == contents.local(plan).read_bytes()
    assert client.get("/api/v1/maps/row/thumbnail", buffered=True).status_code == 200
    assert client.get("/api/v1/maps/row/export.zip", buffered=True).data.count(b"plan.png") >= 1
    copy = duplicate_map(library, moved, account_id=owner.id, name="Copy")
    stored = objects_in(s3, bucket)
    assert machine("c").get(f"/api/v1/maps/{copy}/satellite", buffered=True).data == shown.data
    display.forget(library.map_folder("row"), "plan.png")
    assert read_pointer(plan) is None
    assert machine("d").get(f"/api/v1/maps/{copy}/satellite", buffered=True).data == shown.data
    assert objects_in(s3, bucket) == stored, "the copy names it"


def test_what_is_computed_of_an_index_is_in_its_storage(moved, library, settings, tmp_path, s3):
    (file,) = library.map_folder("row").glob("derived/map/*/orientations-*.arrays")
    there = orientations.read(file)
    orientations.write(file, there)
    assert not file.exists()
    connect(replace(settings, cache_folder=tmp_path / "b"))
    s3.requests.clear()
    assert orientations.read(file).key == there.key and len(s3.requests) == 1
    outside = tmp_path / "outside" / file.name
    orientations.write(outside, there)
    assert outside.exists(), "in no library"


def test_landmarks_are_found_in_their_storage(moved, library, tmp_path, settings):
    cfg = library.cfg("row")
    file = landmarks_folder(cfg) / cloud.CLOUD_FILE
    file.parent.mkdir(parents=True)
    none = np.zeros((0, 3))
    described = np.zeros((0, 128), np.uint8)
    empty = LandmarkCloud(
        ("a",), none, np.zeros(0, np.int32), np.zeros(2, np.int64), np.zeros(0, np.int64),
        np.zeros((0, 2), np.float32), described, np.ones(1), np.zeros(1),
    )  # fmt: skip
    cloud.write_cloud(file, cloud.StoredCloud(empty, "key"))
    assert not file.exists() and has_landmarks(cfg)
    before = contents.facts_of(file)
    connect(replace(settings, cache_folder=tmp_path / "b"))
    assert cloud.read_cloud(file).key == "key"
    cloud.write_cloud(file, cloud.StoredCloud(empty, "another"))
    assert cloud.read_cloud(file).key == "another" and contents.facts_of(file) != before


def test_a_photo_that_was_replaced_by_hand_is_stored(moved, library):
    photo = library.map_folder("row") / "photos/0.jpg"
    photo.write_bytes(jpeg(7))
    assert maintain_objects.move_photos(library) == 1
    assert read_pointer(photo).sha256 == hashlib.sha256(jpeg(7)).hexdigest()


def test_a_photo_that_is_deleted_while_it_is_stored_gets_no_pointer(moved, library, monkeypatch):
    photo, real = library.map_folder("row") / "photos/0.jpg", contents.in_use().store
    photo.write_bytes(jpeg(7))

    def store(path):
        stored = real(path)
        path.unlink()
        pointer_path(path).unlink()
        return stored

    monkeypatch.setattr(contents.in_use(), "store", store)
    assert maintain_objects.move_photos(library) == 0
    assert not pointer_path(photo).exists()


@pytest.fixture
def move(machine, library, park, expmap):
    """Run `expmap library move --to s3` with a photo that is a file; return exit code and messages."""
    send(machine("a"), jpeg())
    (library.map_folder(park) / "photos/a.jpg").write_bytes(jpeg(7))
    return lambda: expmap("library", "move", "--to", "s3", "--library", library.folder)


def test_a_move_into_s3_waits_for_a_worker_that_is_at_it(move, library, monkeypatch):
    noted = []

    def note(self, text):
        noted.append(text)
        lock.release()

    monkeypatch.setattr(TerminalProgress, "note", note)
    monkeypatch.setattr(move_library, "_CANCEL_POLL_S", 0.1)
    with FileLock(library.inner / "objects.lock") as lock:
        code, out, _ = move()
    assert (code, out.partition(",")[0]) == (0, f"{library.folder}: 1 files")
    assert noted == ["waiting for a worker that moves the same files"]


def test_a_move_into_s3_does_not_wait_for_ever(move, library, monkeypatch):
    monkeypatch.setattr(move_library, "_WORKER_WAIT_S", 0.2)
    with FileLock(library.inner / "objects.lock"):
        assert maintain_objects.move_photos(library) == 0, "a worker does not wait"
        code, out, said = move()
    assert (code != 0, out) == (True, "") and "a worker is moving the photos" in said
    assert move()[0] == 0


def test_a_move_into_s3_says_how_many_files_it_could_not_store(move, library, park, s3):
    damaged = library.map_folder(park) / "photos/.a.jpg.object"
    pointer = damaged.read_text()
    damaged.write_text("{}")
    code, out, said = move()
    assert (code, out) == (1, "") and "1 of 1 files could not be stored" in said and "run it again" in said
    assert f"{park}/photos/a.jpg" in said
    damaged.write_text(pointer)
    assert move()[0] == 0


@pytest.mark.parametrize("stage", ["the answer is lost", "the disk is full"])
def test_a_storage_that_was_claimed_by_a_start_that_failed_is_still_ours(
    library, settings, s3, bucket, monkeypatch, stage
):
    def lost(self, key, file):
        real(self, key, file)
        raise StorageUnavailable("the connection to the object storage was lost", wait_s=1)

    def full(path, text):
        if path.name == MARKER:
            raise DiskFull("the file cannot be written: No space left on device")
        write_text(path, text)

    real = Bucket.put
    if stage == "the answer is lost":
        monkeypatch.setattr(Bucket, "put", lost)
    else:
        monkeypatch.setattr(open_storage, "write_text", full)
    with pytest.raises(StorageError):
        open_storage.open_storage(library, settings)
    assert s3.keys(bucket) == ["lib/library"] and not (library.inner / MARKER).exists()
    monkeypatch.setattr(Bucket, "put", real)
    monkeypatch.setattr(open_storage, "write_text", write_text)
    for _ in range(2):
        open_storage.open_storage(library, settings)
    open_storage.check_owner(library.inner, contents.in_use())
    assert [path.name for path in library.inner.glob("object-storage*")] == [MARKER]


def test_a_sweep_that_is_stopped_deletes_nothing(machine, library, park, settings, s3, bucket, monkeypatch):
    send(machine("a"), jpeg())
    (library.map_folder(park) / "photos/.a.jpg.object").unlink()
    with library.changing(1) as change:
        change.session.query(Photo).delete()
    at(monkeypatch, 1)
    maintain_objects.sweep_objects(library, settings)
    at(monkeypatch, 40)
    assert maintain_objects.sweep_objects(library, settings, stops=lambda: True) == 0
    assert len(objects_in(s3, bucket)) == 1
    assert maintain_objects.sweep_objects(library, settings) == 1


def test_a_worker_that_is_started_now_and_then_keeps_the_storage_in_order(row, library, settings, s3, bucket):
    open_storage.open_storage(library, settings)
    Worker(library, settings, registry=REGISTRY).run(once=True)
    names = [path.name for path in (library.map_folder("row") / "photos").glob(".*.object")]
    assert len(names) == 4, "files became objects"


def test_commands_refuse_a_library_without_its_storage(machine, library, settings):
    machine("a")
    another = replace(settings, storage="s3://another")
    cfg = library.map_folder("park") / "map.cfg"
    for opening in (existing_library(another), opened_library(another), library_of(cfg, settings=another)):
        with pytest.raises(StorageError, match="are in an object storage"), opening:
            pass


@pytest.fixture
def expmap(capsys):
    """Run a command in this process and return exit code, standard output and standard error."""

    def call(*arguments):
        with pytest.raises(SystemExit) as ended:
            program.main([str(one) for one in arguments])
        said = capsys.readouterr()
        return ended.value.code, said.out, said.err

    return call


def test_commands_on_a_map_use_the_storage_of_its_library(
    machine, moved, library, expmap, save_photo, tmp_path, monkeypatch
):
    machine("b")
    cfg, photo = library.cfg("row"), question(save_photo, tmp_path)
    commands = [
        ("map", "check", cfg),
        ("build", cfg),
        ("evaluate", "--self", cfg),
        ("localize", cfg, photo),
        ("map", "blur", cfg),
        ("map", "place-rest", cfg),
        ("map", "write-exif", cfg, "-o", tmp_path / "out"),
    ]
    for address in ("s3://another/lib", None):
        if address is None:
            monkeypatch.delenv("EXPMAP_STORAGE")
        else:
            monkeypatch.setenv("EXPMAP_STORAGE", address)
        for command in commands:
            code, _, said = expmap(*command)
            assert code != 0 and "are in an object storage" in said, command
            assert "EXPMAP_STORAGE: s3://" in said
    with pytest.raises(StorageError, match="are in an object storage"):
        open_map(cfg, settings=Settings())


def test_a_map_in_a_library_is_built_and_localized_from_its_storage(
    machine, moved, library, expmap, save_photo, tmp_path, s3, bucket
):
    cfg, linked = library.cfg("row"), tmp_path / "linked"
    linked.symlink_to(library.folder, target_is_directory=True)
    contents.use(None)
    assert expmap("build", linked / "row" / "map.cfg")[0] == 0
    assert {p.suffix for p in map(pointed_path, cfg.parent.glob("derived/map/*/.*.object"))} >= {".features"}
    before = objects_in(s3, bucket)
    index = tmp_path / "index"
    assert expmap("localize", cfg, question(save_photo, tmp_path), "--index", index)[0] == 0
    assert [*index.rglob("*.features")] and not [*index.rglob("*.object")], "nobody would sweep them"
    assert objects_in(s3, bucket) == before


def test_a_map_in_no_library_needs_no_storage(settings, make_map, expmap, tmp_path, s3):
    cfg = make_map(tmp_path / "alone", 4)
    assert expmap("build", cfg)[0] == 0
    assert s3.requests == [] and [*cfg.parent.glob("derived/map/*/*.features")]
    assert contents.in_use() is None


def test_objects_of_a_deleted_map_stay_for_their_readers_and_are_then_swept(
    machine, library, park, settings, s3, bucket, owner, monkeypatch
):
    send(machine("a"), jpeg())
    send(machine("a"), jpeg(1), "b.jpg")
    with library.database.read() as session:
        map_id = session.query(MapRecord).filter_by(slug=park).one().id
    copy = duplicate_map(library, map_id, account_id=owner.id, name="Copy")
    client = machine("b")
    original = f"/api/v1/maps/{copy}/photos/0/original"
    assert client.get(original, buffered=True).data == jpeg()
    keys = objects_in(s3, bucket)
    assert len(keys) == 2, "a copy has the same objects"
    for slug in (park, copy):
        assert maintain_objects.sweep_objects(library, settings) == 0
        with library.database.write() as session:
            record = session.query(MapRecord).filter_by(slug=slug).one()
            maps.put_into_bin(record)
            map_id = record.id
        delete_map(library, map_id)
        assert objects_in(s3, bucket) == keys
    for hours, left in ((30, 2), (40, 2), (53, 2), (60, 0)):
        at(monkeypatch, hours)
        maintain_objects.sweep_objects(library, settings)
        assert len(objects_in(s3, bucket)) == left, hours


def test_a_storage_is_of_one_library_and_what_is_not_its_own_is_not_touched(
    machine, library, park, settings, s3, bucket, monkeypatch
):
    send(machine("a"), jpeg())
    s3.client.put_object(Bucket=bucket, Key="lib/theirs.txt", Body=b"a file of somebody")
    for hours in (1, 30, 60):
        at(monkeypatch, hours)
        maintain_objects.sweep_objects(library, settings)
    assert len(objects_in(s3, bucket)) == 2
    marker = library.inner / MARKER
    ours = marker.read_text()
    marker.unlink()  # as in the folder of another library
    with pytest.raises(StorageError, match="belongs to another library"):
        open_storage.open_storage(library, settings)
    assert not marker.exists()
    marker.write_text(ours)
    s3.client.put_object(Bucket=bucket, Key="lib/library", Body=b"another one")
    at(monkeypatch, 120)
    with pytest.raises(StorageError, match="belongs to another library"):
        maintain_objects.sweep_objects(library, settings)


def test_a_photo_that_is_uploaded_again_is_there_also_where_its_object_was_lost(
    machine, library, park, s3, bucket
):
    send(machine("a"), jpeg())
    (lost,) = objects_in(s3, bucket)
    s3.client.delete_object(Bucket=bucket, Key=lost)
    client = machine("b")
    original = f"/api/v1/maps/{park}/photos/0/original"
    assert client.get(original, buffered=True).status_code >= 400
    send(client, jpeg())
    assert client.get(original, buffered=True).data == jpeg()


def test_nothing_is_swept_where_the_folder_is_gone_or_a_pointer_is_lost(
    machine, library, park, settings, s3, bucket, monkeypatch
):
    send(machine("a"), jpeg())
    pointer = library.map_folder(park) / "photos/.a.jpg.object"
    aside = pointer.rename(pointer.with_name("aside"))
    for hours in (1, 30, 60):
        at(monkeypatch, hours)
        assert maintain_objects.sweep_objects(library, settings) == 0
    assert len(objects_in(s3, bucket)) == 1
    aside.rename(pointer)
    (library.inner / MARKER).unlink()
    at(monkeypatch, 90)
    with pytest.raises(StorageError, match="no longer mounted"):
        maintain_objects.sweep_objects(library, settings)


def test_a_backup_has_what_is_in_s3_and_is_restored_into_a_folder_or_into_s3(
    machine, moved, library, settings, tmp_path, s3, bucket, postgresql, request
):
    machine("a")
    send(machine("a"), jpeg(side=40), slug="row")
    photos = {path: contents.local(path).read_bytes() for path in stored_files(library.map_folder("row"))}
    assert len(photos) == 6
    machine("cold")
    warm = next(iter(photos))
    contents.local(warm)
    cached = contents.in_use().cache.size()
    report = back_up(library, tmp_path / "backup.zip", parts=(), progress=Progress())
    assert (report.photos, report.missing) == (5, ())
    assert contents.in_use().cache.size() == cached and not [*contents.in_use().cache.folder.glob("once/.*")]
    with zipfile.ZipFile(tmp_path / "backup.zip") as zipped:
        assert not [name for name in zipped.namelist() if name.endswith(".object")]
        for path, data in photos.items():
            assert zipped.read(f"maps/{path.relative_to(library.folder).as_posix()}") == data

    contents.use(None)
    plain = tmp_path / "plain"
    restore(tmp_path / "backup.zip", plain, parts=(), progress=Progress())
    assert all((plain / path.relative_to(library.folder)).read_bytes() == photos[path] for path in photos)
    url = postgresql.new_database(empty=True)
    request.addfinalizer(lambda: postgresql.drop(url))
    again = tmp_path / "again"
    restore(tmp_path / "backup.zip", again, parts=(), url=url, progress=Progress())
    other = replace(settings, library=again, database=url, storage=f"s3://{bucket}/again")
    with opened_library(other) as restored:
        assert maintain_objects.move_photos(restored) == 6
        connect(replace(other, cache_folder=tmp_path / "again-cold"))
        for path, data in photos.items():
            there = again / path.relative_to(library.folder)
            assert read_pointer(there) is not None and contents.local(there).read_bytes() == data


def test_photos_move_into_s3_and_back(row, library, settings, expmap, s3, bucket, tmp_path, monkeypatch):
    folder = library.map_folder("row")
    before = files_of(folder)
    library.database.close()
    code, out, _ = expmap("library", "move", "--to", "s3", "--library", library.folder)
    assert (code, out) == (0, f"{library.folder}: 5 files, now in {settings.storage}\n")
    again = expmap("library", "move", "--to", "s3", "--library", library.folder)
    assert again[:2] == (0, f"{library.folder}: 0 files, now in {settings.storage}\n")
    for pointer in folder.rglob(".*.object"):
        pointed_path(pointer).unlink()
    stored = objects_in(s3, bucket)
    assert len(stored) == 5
    monkeypatch.setenv("EXPMAP_CACHE_FOLDER", str(tmp_path / "cold"))
    back = ("library", "move", "--to", "folder", "--library", library.folder)
    s3.refuse = (503, "SlowDown")
    code, _, said = expmap(*back)
    assert code != 0 and "overloaded or out of order" in said
    s3.reset()
    s3.cut = {"GET": 700}  # the image is smaller, the photos are larger: it stops in the middle
    assert expmap(*back)[0] != 0
    s3.reset()
    code, out, said = expmap(*back)
    assert code == 0 and "now in" in out and "unset EXPMAP_STORAGE" in said
    assert files_of(folder) == before and not [*folder.rglob(".*.object")]
    assert objects_in(s3, bucket) == stored, "nothing is deleted"
    monkeypatch.delenv("EXPMAP_STORAGE")
    assert expmap("build", folder / "map.cfg")[0] == 0
    assert [*library.inner.glob("object-storage-until-*")]
    code, _, said = expmap(*back)
    assert code == 2 and "in its folder already" in said


def test_a_move_back_names_what_is_lost_and_asks_for_the_library_alone(
    machine, moved, library, settings, expmap, s3, bucket, monkeypatch
):
    monkeypatch.setattr("webapp.tasks.operate.move._WAIT_S", 0.2)
    machine("a")
    back = ("library", "move", "--to", "folder", "--library", library.folder)
    assert "is using this library" in expmap(*back)[2], "this process has it open"
    library.database.close()
    machine("cold")
    pointer = read_pointer(library.map_folder("row") / "photos/1.jpg")
    s3.client.delete_object(Bucket=bucket, Key=f"lib/{pointer.key}")
    cold = replace(settings, cache_folder=settings.cache_folder.with_name("empty"))
    with pytest.raises(StorageError, match="1 files are lost") as lost:
        move_to_folder(library.folder, cold, progress=Progress())
    assert lost.value.where == "row/photos/1.jpg"
    assert (library.inner / MARKER).is_file()
    assert [path.name for path in stored_files(library.map_folder("row"))] == ["1.jpg"]


def files_of(folder):
    """Return the files in a folder of a map and their times."""
    files = (path for path in folder.rglob("*") if path.is_file() and not path.name.startswith("."))
    return {
        str(path.relative_to(folder)): (path.read_bytes(), path.stat().st_mtime_ns)
        for path in files
        if "derived" not in path.parts
    }


def test_a_backup_names_what_s3_has_lost_or_damaged(machine, moved, library, s3, bucket, tmp_path):
    machine("cold")
    pointers = [read_pointer(library.map_folder("row") / f"photos/{number}.jpg") for number in (0, 1)]
    s3.client.delete_object(Bucket=bucket, Key=f"lib/{pointers[0].key}")
    s3.client.put_object(Bucket=bucket, Key=f"lib/{pointers[1].key}", Body=b"damaged")
    report = back_up(library, tmp_path / "backup.zip", parts=(), progress=Progress())
    assert report.missing == ("maps/row/photos/0.jpg", "maps/row/photos/1.jpg")
    before = (tmp_path / "backup.zip").read_bytes()
    s3.refuse = (503, "SlowDown")
    with pytest.raises(StorageUnavailable, match="overloaded or out of order"):
        back_up(library, tmp_path / "backup.zip", parts=(), progress=Progress())
    assert (tmp_path / "backup.zip").read_bytes() == before


def stored_files(folder):
    """Return the files of a map that are objects, without those of its index."""
    return sorted(pointed_path(path) for path in folder.rglob(".*.object") if "derived" not in path.parts)


def adder(map_id, *files):
    return subprocess.Popen(
        [sys.executable, "-c", ADDER, str(map_id), *map(str, files)],
        cwd=ROOT, stdout=subprocess.PIPE, text=True,
    )  # fmt: skip


def test_kills_in_the_middle_of_uploads_lose_nothing_and_leave_orphans_that_are_swept(
    machine, library, park, settings, s3, bucket, tmp_path, monkeypatch
):
    client = machine("a")
    with library.database.read() as session:
        map_id = session.query(MapRecord).filter_by(slug=park).one().id
    acknowledged = set()
    for kill in range(2):
        files = []
        for number in range(8):
            files.append(library.uploads / f"{kill}-{number}.jpg")
            files[-1].write_bytes(jpeg(100 * kill + number, side=40))
        s3.bytes_per_s = 20_000  # slow responses: most of the time is spent in uploads
        process = adder(map_id, *files)
        acknowledged |= {int(process.stdout.readline()) for _ in range(2 + kill)}
        time.sleep(0.01 * kill)
        process.kill()
        acknowledged |= {int(line) for line in process.stdout.read().split()}
        process.stdout.close()
        process.wait()
    s3.reset()
    with library.database.read() as session:
        record = session.query(MapRecord).filter_by(slug=park).one()
        rows = {photo.id: photo.sha256 for photo in maps.photos(session, record)}
    assert acknowledged <= {*rows} and len(rows) <= len(acknowledged) + 3
    cold = machine("b")
    for id, sha256 in rows.items():
        data = cold.get(f"/api/v1/maps/{park}/photos/{id}/original", buffered=True).data
        assert hashlib.sha256(data).hexdigest() == sha256
    assert send(client, jpeg(999))["id"] not in rows
    unfinished = contents.in_use().store(files[-1]) if files[-1].exists() else None
    assert unfinished is not None, "the last file was not reached"
    photo_files.sweep_orphans(library, map_id)
    for hours in (0, 12, 25):
        at(monkeypatch, hours)
        maintain_objects.sweep_objects(library, settings)
    assert len(objects_in(s3, bucket)) == len(rows) + 1


def test_a_build_that_is_killed_between_objects_loses_nothing(
    moved, library, settings, s3, bucket, monkeypatch
):
    (manifest,) = library.map_folder("row").glob("derived/map/*/manifest.json")
    before = manifest.read_bytes()
    stored = []

    def killed(self, file):
        if stored:
            raise SystemExit  # like a kill, which nothing handles
        stored.append(original(self, file))
        return stored[0]

    original = storage.ObjectStorage.store
    monkeypatch.setattr(storage.ObjectStorage, "store", killed)
    with pytest.raises(SystemExit):
        rebuild(library, settings, manifest.parent)
    monkeypatch.undo()
    assert manifest.read_bytes() == before
    report = rebuild(library, settings, manifest.parent)
    assert (report.extracted, len(objects_in(s3, bucket))) == (0, 4 + 1 + 3)


def rebuild(library, settings, folder):
    """Bring the index up to date in this process."""
    cfg = library.cfg("row")
    choice = choose("verified", detector="sift", extractor="sift")
    request = BuildRequest(cfg, read_map(cfg), folder, choice, jobs=1)
    return update_index(request, settings=settings, progress=Progress())


def test_what_does_not_fit_together_is_refused(machine, library, settings, tmp_path):
    machine("a")
    with pytest.raises(StorageError, match="are in an object storage") as unset:
        open_storage.open_storage(library, replace(settings, storage=None))
    assert settings.storage in unset.value.hint
    with pytest.raises(StorageError, match="are in an object storage"):
        open_storage.open_storage(library, replace(settings, storage="s3://another"))
    with using(None), pytest.raises(UsageError, match="would lack the photos"):
        back_up(library, tmp_path / "backup.zip", parts=(), progress=Progress())
    with pytest.raises(UsageError, match="would lack the photos"):
        move_to_file(library.folder, settings.database, progress=Progress())
    with pytest.raises(UsageError, match="need records in PostgreSQL"):
        connect(replace(settings, database=None))
