"""Files as objects: stored, fetched, cached and refused."""

import os
import pickle
import threading
import time
from datetime import UTC, datetime, timedelta

import pytest

from tests.s3_server import using
from webapp.errors import DiskFull, ObjectLost, StorageError, StorageUnavailable, UsageError
from webapp.files import contents
from webapp.files.contents import connect
from webapp.files.listing import list_photos
from webapp.files.object_storage import storage
from webapp.files.object_storage.bucket import Bucket
from webapp.files.object_storage.cache import Pointer, pointed_path, pointer_path, read_pointer
from webapp.settings import Settings


def file_of(folder, content, name="photo.jpg"):
    path = folder / name
    path.parent.mkdir(parents=True, exist_ok=True)
    path.write_bytes(content)
    return path


def test_a_published_file_is_an_object_that_another_machine_reads(node, s3, bucket_name, tmp_path):
    content = os.urandom(20_000_000)  # in several pieces
    path = file_of(tmp_path, content)
    os.utime(path, ns=(1, 123_456_789))
    with using(node()):
        contents.publish(path)
    assert not path.exists()
    (key,) = s3.keys(bucket_name)
    assert key.startswith("some/prefix/")
    with using(node("two")):
        there = contents.local(path)
        assert there.read_bytes() == content
        assert there.stat().st_mtime_ns == 123_456_789
        assert there.name.endswith("photo.jpg")
        assert contents.is_there(path)
        s3.requests.clear()
        assert contents.local(path) == there
        assert contents.hash_of(path) == read_pointer(path).sha256
    assert s3.requests == []


def test_without_a_storage_a_path_is_a_path(tmp_path):
    path = file_of(tmp_path, b"photo")
    contents.publish(path)
    assert contents.store(path) is None
    assert contents.local(path) == path
    assert [*tmp_path.iterdir()] == [path]


def test_a_listed_folder_shows_objects_by_the_names_of_their_files(node, tmp_path):
    path = file_of(tmp_path, b"photo", "a/photo.jpg")
    with using(node()):
        contents.publish(path)
    assert pointed_path(pointer_path(path)) == path
    assert list_photos(tmp_path / "a") == ["photo.jpg"]


def test_every_upload_has_a_key_of_its_own(node, tmp_path):
    one, path = node(), file_of(tmp_path, b"photo")
    assert one.store(path).key != one.store(path).key


def test_the_cache_stays_within_its_size_and_keeps_what_was_asked_for_lately(node, tmp_path):
    paths = [file_of(tmp_path, os.urandom(1000), f"{i}.jpg") for i in range(6)]
    with using(node()):
        for path in paths:
            contents.publish(path)
    small = node("small", limit=3500, stays_s=0.0)
    with using(small):
        for path in paths[:3]:
            contents.local(path)
            time.sleep(0.01)
        contents.local(paths[0])
        time.sleep(0.01)
        contents.local(paths[3])
        assert small.cache.size() <= 3500
        kept = {place.name[-5:] for place in small.cache.folder.glob("*/*")}
    assert {"0.jpg", "3.jpg"} <= {name[-5:] for name in kept}


def test_a_file_that_was_asked_for_is_not_evicted_before_it_can_be_opened(node, tmp_path):
    paths = [file_of(tmp_path, os.urandom(1000), f"{i}.jpg") for i in range(5)]
    with using(node()):
        for path in paths:
            contents.publish(path)
    with using(node("small", limit=1500)):
        found = [contents.local(path) for path in paths]
        assert all(place.stat().st_size == 1000 for place in found)


def test_many_readers_and_a_cache_that_is_too_small(node, tmp_path):
    written = {i: os.urandom(2000) for i in range(20)}
    paths = {i: file_of(tmp_path, content, f"{i}.jpg") for i, content in written.items()}
    with using(node()):
        for path in paths.values():
            contents.publish(path)
    wrong = []

    def read(start):
        for i in range(40):
            which = (start * 7 + i) % 20
            if contents.local(paths[which]).read_bytes() != written[which]:
                wrong.append(which)

    with using(node("small", limit=8000, stays_s=5.0)):
        threads = [threading.Thread(target=read, args=(n,)) for n in range(4)]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()
    assert wrong == []


def test_an_open_file_is_read_to_its_end_after_it_was_evicted(node, tmp_path):
    first, second = file_of(tmp_path, b"1" * 1000, "1.jpg"), file_of(tmp_path, b"2" * 1000, "2.jpg")
    with using(node()):
        contents.publish(first)
        contents.publish(second)
    with using(node("small", limit=1500, stays_s=0.0)), contents.local(first).open("rb") as opened:
        time.sleep(0.01)
        place = contents.local(first)
        time.sleep(0.01)
        contents.local(second)
        assert not place.exists()
        assert opened.read() == b"1" * 1000


def test_a_damaged_copy_is_fetched_again_and_a_wrong_object_is_refused(node, s3, bucket_name, tmp_path):
    path, one = file_of(tmp_path, b"photo"), node()
    with using(one):
        contents.publish(path)
        contents.local(path).write_bytes(b"cut")
        assert contents.local(path).read_bytes() == b"photo"
    s3.client.put_object(Bucket=bucket_name, Key=s3.keys(bucket_name)[0], Body=b"other")
    with using(node("two")), pytest.raises(StorageError, match="content other than"):
        contents.local(path)
    assert [p for p in (tmp_path / "cache-two").glob("*/*") if p.is_file()] == []


def test_an_object_that_is_lost_is_named(node, s3, bucket_name, tmp_path):
    path = file_of(tmp_path, b"photo")
    with using(node()):
        contents.publish(path)
    s3.client.delete_object(Bucket=bucket_name, Key=s3.keys(bucket_name)[0])
    with using(node("two")), pytest.raises(ObjectLost, match="missing from the object storage"):
        contents.local(path)


@pytest.mark.parametrize(
    ("refusal", "kind", "sentence"),
    [
        ((403, "AccessDenied"), StorageUnavailable, "refuses access"),
        ((503, "SlowDown"), StorageUnavailable, "overloaded or out of order"),
        ((500, "InternalError"), StorageUnavailable, "overloaded or out of order"),
        ((507, "XMinioStorageFull"), DiskFull, "is full"),
        ((400, "QuotaExceeded"), DiskFull, "is full"),
        ((404, "NoSuchBucket"), StorageUnavailable, "does not exist"),
        ((400, "BadDigest"), StorageUnavailable, "was damaged on its way"),
        ((400, "InvalidRequest"), StorageError, "refused the request: InvalidRequest"),
    ],
)
def test_a_refusal_is_one_sentence_and_the_file_stays(node, s3, tmp_path, refusal, kind, sentence):
    path, one = file_of(tmp_path, b"photo"), node()
    s3.refuse = refusal
    with using(one), pytest.raises(kind, match=sentence) as refused:
        contents.publish(path)
    assert path.read_bytes() == b"photo"
    assert not pointer_path(path).exists()
    assert str(pickle.loads(pickle.dumps(refused.value))) == str(refused.value)  # sent by a worker process


def test_a_server_that_is_silent_or_gone_is_named(node, s3, tmp_path, monkeypatch):
    path, one = file_of(tmp_path, b"photo"), node(timeout_s=0.4)
    s3.silent.set()
    begun = time.monotonic()
    with using(one), pytest.raises(StorageUnavailable, match="did not answer in time"):
        contents.publish(path)
    assert time.monotonic() - begun < 8
    s3.silent.clear()
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9")
    with using(node()), pytest.raises(StorageUnavailable, match="cannot be reached"):
        contents.publish(path)
    assert path.exists()


def test_files_are_fetched_together(node, s3, tmp_path):
    paths = [file_of(tmp_path, os.urandom(1000), f"{i}.jpg") for i in range(5)]
    with using(node()):
        for path in paths[:4]:
            contents.publish(path)
    lost = read_pointer(paths[3])
    one = node("two")
    one.bucket.delete(lost.key)
    at_once, most, original = [], [], one.bucket.get

    def get(key, target):
        at_once.append(key)
        time.sleep(0.2)
        most.append(len(at_once))
        original(key, target)
        at_once.remove(key)

    one.bucket.get = get
    with using(one):
        contents.fetch_together(paths)
        s3.requests.clear()
        assert all(contents.local(path).stat().st_size == 1000 for path in [*paths[:3], paths[4]])
        assert s3.requests == [] and max(most) > 1
        with pytest.raises(ObjectLost):
            contents.local(paths[3])
        s3.refuse = (503, "SlowDown")
        with pytest.raises(StorageUnavailable):
            contents.fetch_together(paths)


def test_what_is_read_once_is_not_kept_and_uses_what_is_here(node, s3, tmp_path):
    path, one, two = file_of(tmp_path, b"photo"), node(), node("two")
    with using(one):
        contents.publish(path)
    with using(two):
        with contents.read_once(path) as copy:
            assert copy.read_bytes() == b"photo"
        assert not copy.exists() and two.cache.size() == 0
        kept = contents.local(path)
        s3.requests.clear()
        with contents.read_once(path) as copy:
            assert copy == kept
        assert kept.exists() and s3.requests == []
        path.write_bytes(b"another")  # put there by hand
        with contents.read_once(path) as copy:
            assert copy == path
        path.write_bytes(b"photo")
        os.utime(path, ns=(1, read_pointer(path).mtime_ns))
        with contents.read_once(path) as copy:
            assert copy == kept


def test_a_file_comes_back_as_it_was_unless_somebody_has_replaced_it(node, s3, tmp_path):
    path, replaced, one = file_of(tmp_path, b"photo"), file_of(tmp_path, b"before", "b.jpg"), node()
    os.utime(path, ns=(1, 123_456_789))
    with using(one):
        contents.publish(path)
        contents.publish(replaced)
        replaced.write_bytes(b"after")
        contents.local(path).write_bytes(b"other")  # damaged, but of the same length
        with pytest.raises(StorageError, match="is damaged"):
            contents.bring_back(path)
        assert not path.exists() and read_pointer(path) is not None
        one.cache.folder.rename(tmp_path / "gone")
        for _ in range(2):
            contents.bring_back(path)
            contents.bring_back(replaced)
    assert (path.read_bytes(), path.stat().st_mtime_ns) == (b"photo", 123_456_789)
    assert replaced.read_bytes() == b"after"
    assert not [*tmp_path.glob(".*")]


def test_whether_the_server_answers_is_asked_seldom(node, s3, monkeypatch, caplog):
    assert contents.reachable(), "where there is no storage, none is missing"
    monkeypatch.setattr(storage, "_PROBE_S", 0.0)
    with using(node(timeout_s=0.4)):
        assert contents.reachable()
        s3.refuse = (403, "AccessDenied")
        assert not contents.reachable() and not contents.reachable()
        assert caplog.text.count("the object storage refuses access") == 1
        s3.reset()
        s3.silent.set()
        assert not contents.reachable()
        assert len(s3.requests) == 1, "it is not tried again"
        monkeypatch.setattr(storage, "_PROBE_S", 60.0)
        s3.silent.clear()
        assert not contents.reachable()
        monkeypatch.setattr(storage, "_PROBE_S", 0.0)
        assert contents.reachable()


def test_a_connection_that_breaks_off_leaves_nothing(node, s3, bucket_name, tmp_path):
    content = os.urandom(9_000_000)  # two pieces
    path, one = file_of(tmp_path, content), node()
    s3.cut = {"PUT": 2_000_000}  # the first of them
    with using(one), pytest.raises(StorageUnavailable, match="to the object storage was lost"):
        contents.publish(path)
    assert path.read_bytes() == content and not pointer_path(path).exists()
    assert s3.keys(bucket_name) == [] and "Uploads" not in s3.client.list_multipart_uploads(
        Bucket=bucket_name
    )
    s3.cut = {"GET": 200_000}
    two = node("two")
    with using(one):
        contents.publish(path)
    with using(two), pytest.raises(StorageUnavailable, match="to the object storage was lost"):
        contents.local(path)
    assert two.cache.size() == 0
    s3.reset()
    with using(two):
        assert contents.local(path).read_bytes() == content


def test_an_answer_that_comes_to_a_halt_leaves_nothing(node, s3, tmp_path):
    path = file_of(tmp_path, os.urandom(300_000))
    with using(node()):
        contents.publish(path)
    s3.bytes_per_s = 50_000  # a block takes longer than the read timeout
    two = node("two", timeout_s=0.4)
    with using(two), pytest.raises(StorageUnavailable, match="did not answer in time"):
        contents.local(path)
    assert two.cache.size() == 0
    s3.bytes_per_s = 500_000  # slow, but without pauses
    with using(two):
        assert contents.local(path).stat().st_size == 300_000


def test_the_cache_is_as_large_as_the_settings_say(s3, tmp_path):
    settings = Settings(
        database="postgresql://nobody", storage="s3://bucket", cache_folder=tmp_path / "cache", cache_gb=0.25
    )
    with using(None):
        cache = connect(settings).cache
    assert (cache.limit, cache.folder) == (250_000_000, tmp_path / "cache")


@pytest.mark.parametrize("url", ["http://bucket", "s3://", "bucket/prefix"])
def test_an_address_that_is_none_is_refused(url):
    with pytest.raises(UsageError, match="not an address of an object storage"):
        Bucket(url)


def test_a_damaged_pointer_is_named(tmp_path):
    path = tmp_path / "photo.jpg"
    pointer_path(path).write_text("{}")
    with pytest.raises(StorageError, match="pointer to an object is damaged"):
        read_pointer(path)


def test_interrupted_uploads_are_dropped(node, s3, bucket_name):
    s3.client.create_multipart_upload(Bucket=bucket_name, Key="some/prefix/ab/key")
    one = node()
    begun = datetime(2010, 11, 10, tzinfo=UTC)  # moto's time of every upload
    assert one.bucket.drop_unfinished(begun_before=begun - timedelta(days=1)) == 0
    assert one.bucket.drop_unfinished(begun_before=begun + timedelta(days=1)) == 1
    assert "Uploads" not in s3.client.list_multipart_uploads(Bucket=bucket_name)


def test_a_pointer_says_what_the_file_was(node, tmp_path):
    path = file_of(tmp_path, b"photo")
    with using(node()):
        facts = path.stat()
        contents.publish(path)
        pointer = contents.pointer_of(path)
    assert isinstance(pointer, Pointer)
    assert (pointer.bytes, pointer.mtime_ns) == (5, facts.st_mtime_ns)


def test_a_name_too_long_for_a_pointer_has_none(node, tmp_path):
    path = file_of(tmp_path, b"x", name="a" * 250 + ".jpg")
    with using(node()):
        assert contents.local(path) == path


def test_a_file_that_changes_while_it_is_stored_is_refused(node, tmp_path, monkeypatch):
    path, there = file_of(tmp_path, b"before"), node()
    put = there.bucket.put

    def slowly(key, file):
        put(key, file)
        path.write_bytes(b"after it")

    monkeypatch.setattr(there.bucket, "put", slowly)
    with using(there), pytest.raises(StorageError, match="was changed while it was being stored"):
        contents.publish(path)
    assert path.read_bytes() == b"after it"
    assert not pointer_path(path).exists()
