"""A worker that updates albums is killed at every step and at random moments: nothing is lost or doubled."""

import multiprocessing
import time
from collections import Counter
from dataclasses import replace

import numpy as np
import pytest
from sqlalchemy import func, select

from tests.connect.libraries.conftest import PAGE, QUICK, Linked, at
from tests.connect.libraries.immich_server import ImmichServer, Shot, serving
from tests.killing import PRELOADED, Step, run_until
from webapp.jobs.worker import Worker
from webapp.settings import JobSettings
from webapp.store.library import open_library
from webapp.store.maps import maps
from webapp.store.photo_libraries import LinkedPhoto
from webapp.store.schema import Job, MapRecord, Photo

pytestmark = pytest.mark.slow

UPDATING = "webapp.connect.libraries.updating"
IMMICH = "webapp.connect.libraries.immich:Immich"
PHOTOS = 10
SLOW_S = 0.02
"""What an answer of the library takes, so that random moments are in the middle of something."""

BRINGING = [
    Step(f"{IMMICH}.albums"),
    Step(f"{UPDATING}:list_assets", is_after=True),
    Step(f"{IMMICH}.preview"),
    Step(f"{IMMICH}.preview", is_after=True),
    Step(f"{UPDATING}:write_bytes", is_after=True),
    Step("webapp.tasks.maps.add_photo:keep", is_after=True),
    Step(f"{UPDATING}:_Update._record"),
    Step(f"{UPDATING}:_Update._record", is_after=True),
    Step("webapp.tasks.maps.add_photo:forget_intake"),
    Step(f"{UPDATING}:add_photo", is_after=True),
    Step(f"{UPDATING}:discard", calls=1),
    Step(f"{IMMICH}.preview", calls=1, is_after=True),
    Step(f"{UPDATING}:_note_end"),
    Step("webapp.store.operate.jobs:finish"),
]
"""In the order of the work, each of which begins where the last one was killed."""

WRITING = [
    Step(f"{UPDATING}:needs_writing", is_after=True),
    Step(f"{UPDATING}:_Update._note"),
    Step(f"{UPDATING}:_Update._note", is_after=True),
    Step(f"{IMMICH}.set_position"),
    Step(f"{IMMICH}.set_position", is_after=True),
    Step(f"{UPDATING}:_Update._note", calls=1),
    Step(f"{UPDATING}:_Update._note", calls=1, is_after=True),
    Step(f"{IMMICH}.set_position", calls=1, is_after=True),
    Step(f"{UPDATING}:_note_end"),
    Step("webapp.store.operate.jobs:finish"),
]


class SlowServer(ImmichServer):
    def answer(self, *request):
        time.sleep(SLOW_S)
        return super().answer(*request)


@pytest.fixture
def shots():
    return [Shot(f"p{n}", *(at(100 * n, 50) if n % 2 else ())) for n in range(PHOTOS)]


@pytest.fixture
def server(shots):
    with serving(SlowServer(shots)) as started:
        yield started


@pytest.fixture
def settings(settings):
    return replace(settings, jobs=JobSettings(attempts=100))


@pytest.fixture
def album(client, connect, library, settings, server, park):
    """The album, linked with the map; nothing has been done yet."""
    data = {"album": next(iter(server.albums)), "map": park, "every_h": "0", "writes_back": "1"}
    assert client.post(f"{PAGE}/{connect()}/link", data=data).status_code == 303
    return Linked(client, library, settings, park)


@pytest.fixture
def placed(album):
    """The album, whose photos without a position have been placed, and are written back by a queued job."""
    album.work()
    for n in range(0, PHOTOS, 2):
        album.edit(f"p{n}", x_px=100.0 * n + 10.0, y_px=500.0)
    assert album.client.post(f"{PAGE}/albums/1/update").status_code == 303
    return album


def work(settings):
    """Do the jobs of a library, as a worker does."""
    library = open_library(settings.library, url=settings.database)
    Worker(library, settings, registry=QUICK).run(once=True)
    library.database.close()


def counted(library, slug):
    """Return the photos of the map and of the album, and the pairs of them that are on record."""
    with library.database.read() as session:
        record = session.scalars(select(MapRecord).where(MapRecord.slug == slug)).one()
        photos = {photo.id for photo in maps.photos(session, record)}
        rows = {row.asset: row.photo_id for row in session.scalars(select(LinkedPhoto))}
        distinct = session.scalar(select(func.count(Photo.sha256.distinct())))
    assert set(rows.values()) == photos and len(rows) == len(photos) == distinct
    return rows


def check_brought(album, server):
    album.work()
    rows = counted(album.library, album.slug)
    assert rows.keys() == {shot.id for shot in server.shots}
    files = [path.name for path in (album.library.map_folder(album.slug) / "photos").iterdir()]
    assert len(files) == PHOTOS
    assert {asset: photo.x_px for asset, photo in album.photos().items()} == {
        f"p{n}": pytest.approx(100.0 * n, abs=1e-6) if n % 2 else None for n in range(PHOTOS)
    }
    assert last_state(album) == "done"


def check_written(placed, server):
    placed.work()
    wanted = {f"p{n}": at(100 * n + 10, 500) for n in range(0, PHOTOS, 2)}
    found = {shot.id: (shot.lat, shot.lon) for shot in server.shots if shot.id in wanted}
    assert found == {id: pytest.approx(place, abs=1e-6) for id, place in wanted.items()}
    assert Counter(id for id, *_ in server.written) == dict.fromkeys(wanted, 1)
    rows = [placed.row(id) for id in wanted]
    assert all(row.written and row.sent_lat is None for row in rows)
    assert last_state(placed) == "done"


def last_state(album):
    with album.library.database.read() as session:
        return session.scalars(select(Job.state).where(Job.kind == "photo-library").order_by(-Job.id)).first()


def test_bringing_an_album_goes_on_after_each_kill(album, server, settings):
    before = {}
    for step in BRINGING:
        assert run_until(step, work, settings), step
        now = counted(album.library, album.slug)
        assert before.items() <= now.items(), step
        before = now
    check_brought(album, server)


def test_writing_back_goes_on_after_each_kill(placed, server, settings):
    for step in WRITING:
        assert run_until(step, work, settings), step
        assert max(Counter(id for id, *_ in server.written).values(), default=0) <= 1, step
    check_written(placed, server)


@pytest.mark.parametrize("seed", range(2))
@pytest.mark.parametrize("stage", ["album", "placed"])
def test_kills_at_random_moments(request, stage, server, settings, seed):
    album = request.getfixturevalue(stage)
    context, rng = multiprocessing.get_context("forkserver"), np.random.default_rng(seed)
    context.set_forkserver_preload(PRELOADED)
    kills = 0
    for _ in range(6):
        asked = server.asked.total()
        process = context.Process(target=work, args=(settings,))
        process.start()
        while process.exitcode is None and server.asked.total() == asked:
            process.join(0.005)
        process.join(float(rng.uniform(0.0, 0.4)))
        kills += process.exitcode is None
        process.kill()
        process.join()
        counted(album.library, album.slug)
    assert kills
    (check_brought if stage == "album" else check_written)(album, server)


def test_a_position_moved_here_after_a_kill_still_goes_back(placed, server, settings):
    """What the killed run has written is not taken for what somebody set there."""
    assert run_until(Step(f"{IMMICH}.set_position", is_after=True), work, settings)
    ((id, *_),) = server.written
    placed.edit(id, x_px=777.0, y_px=333.0)
    placed.work()
    assert (server.find(id).lat, server.find(id).lon) == pytest.approx(at(777, 333), abs=1e-6)
    assert [written for written, *_ in server.written].count(id) == 2
