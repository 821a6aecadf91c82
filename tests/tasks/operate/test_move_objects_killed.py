"""A move of photos into S3 and back is killed at every step: no file is lost, and the next run goes on."""

import os
from dataclasses import replace
from datetime import timedelta

import pytest

from tests.killing import Step, run_until
from tests.s3_server import using
from webapp.cli.library import existing_library
from webapp.errors import UsageError
from webapp.files import contents
from webapp.files.contents import connect
from webapp.files.object_storage.cache import pointed_path
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.store import clock
from webapp.store.accounts import accounts
from webapp.tasks.maps import adopt_map
from webapp.tasks.operate import maintain_objects, move

pytestmark = pytest.mark.slow

STORAGE, MOVE = "webapp.files.object_storage.storage", "webapp.tasks.operate.move"
CONTENTS = "webapp.files.contents"
FILES = 4

INTO_S3 = [
    Step("webapp.tasks.operate.open_storage:_claim", is_after=True),
    Step(f"{STORAGE}:ObjectStorage.store"),
    Step(f"{STORAGE}:ObjectStorage.store", is_after=True),
    Step("webapp.tasks.operate.maintain_objects:write_pointer", is_after=True),
    Step("webapp.files.object_storage.cache:ObjectCache.adopt", is_after=True),
    Step(f"{STORAGE}:ObjectStorage.store", calls=1, is_after=True),
    Step(f"{MOVE}:move_to_storage", is_after=True),
]
BACK = [
    Step(f"{CONTENTS}:shutil.copyfile", is_after=True),
    Step(f"{CONTENTS}:move_in"),
    Step(f"{CONTENTS}:move_in", is_after=True),
    Step(f"{CONTENTS}:discard", is_after=True),
    Step(f"{MOVE}:now"),
    Step(f"{MOVE}:move_to_folder", is_after=True),
]
"""In the order of the work, each of which begins where the last one was killed."""


def into_s3(settings, variables):
    os.environ.update(variables)
    with existing_library(settings) as library:
        return move.move_to_storage(library, settings, progress=Progress())


def back(settings, variables):
    os.environ.update(variables)
    return move.move_to_folder(settings.library, settings, progress=Progress())


@pytest.fixture
def database_url(postgresql):
    """The address of a database on the server: SQLite does not support object storage."""
    url = postgresql.new_database()
    yield url
    postgresql.drop(url)


@pytest.fixture
def bucket(s3):
    yield s3.new_bucket()
    contents.use(None)


@pytest.fixture
def settings(new_library, make_map, tmp_path, database_url, bucket):
    """Settings with an object storage, for a library whose photos are still files."""
    library = new_library(tmp_path / "library")
    make_map(library.map_folder("row"), FILES - 1)
    with library.database.write() as session:
        owner = accounts.ensure_owner(session)
    adopt_map.adopt_map(library, "row", account_id=owner.id)
    library.database.close()
    return Settings(
        library=library.folder,
        database=database_url,
        storage=f"s3://{bucket}/lib",
        cache_folder=tmp_path / "cache",
    )


def paths(settings):
    folder = settings.library / "row"
    return [folder / "plan.png", *(folder / "photos" / f"{number}.jpg" for number in range(FILES - 1))]


def files(settings):
    """Return the content and the time of each file in the folder."""
    return {path.name: (path.read_bytes(), path.stat().st_mtime_ns) for path in paths(settings)}


def readable(settings, cache):
    """Return the content of each file as a machine with an empty cache reads it."""
    with using(connect(replace(settings, cache_folder=cache))):
        return {path.name: contents.local(path).read_bytes() for path in paths(settings)}


def objects(s3, bucket):
    return [key for key in s3.keys(bucket) if key != "lib/library"]


def pointers(settings):
    return sorted(settings.library.rglob(".*.object"))


def test_a_move_into_s3_and_back_can_be_killed_anywhere(settings, s3, bucket, tmp_path, monkeypatch):
    variables = {name: value for name, value in os.environ.items() if name.startswith("AWS_")}
    before = files(settings)
    content = {name: data for name, (data, _) in before.items()}
    for number, step in enumerate(INTO_S3):
        assert run_until(step, into_s3, settings, variables), step
        assert files(settings) == before, step
        assert readable(settings, tmp_path / f"cold-{number}") == content, step
    assert into_s3(settings, variables).files == 0
    assert len(pointers(settings)) == FILES
    assert len(objects(s3, bucket)) == FILES + 2, "two were stored when it was killed before their pointers"
    with existing_library(settings) as library:
        for hours in (0, 12, 25):
            at = clock.now() + timedelta(hours=hours)
            monkeypatch.setattr(maintain_objects, "now", lambda at=at: at)
            maintain_objects.sweep_objects(library, settings)
    stored = objects(s3, bucket)
    assert len(stored) == FILES

    for pointer in pointers(settings):
        pointed_path(pointer).unlink()
    cold = replace(settings, cache_folder=tmp_path / "empty")
    for number, step in enumerate(BACK):
        assert run_until(step, back, cold, variables), step
        assert readable(settings, tmp_path / f"cold-back-{number}") == content, step
    with pytest.raises(UsageError, match="in its folder already"):
        back(cold, variables)
    assert files(settings) == before
    assert pointers(settings) == [] and not list(settings.library.rglob("*.part"))
    assert objects(s3, bucket) == stored, "nothing is deleted"
