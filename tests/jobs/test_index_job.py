"""The program's own jobs, from the queue to their results."""

import json
import threading
import time
from dataclasses import replace
from datetime import timedelta

import pytest

from webapp.app.registry import REGISTRY
from webapp.core.geo.georeference import Georeference
from webapp.core.geo.types import MapPixel
from webapp.errors import ClusterUnavailable
from webapp.jobs.worker import Worker
from webapp.settings import ExtractSettings
from webapp.store import queries, sharing
from webapp.store.accounts import accounts
from webapp.store.schema import Contribution, MapRecord, Photo, QueryRecord
from webapp.tasks.computing.cluster import DaskPool
from webapp.tasks.localize import adopt_query, calibrate
from webapp.tasks.localize.adopt_query import independent_photos
from webapp.tasks.localize.map_cache import MapCache
from webapp.tasks.localize.upload import UploadedPhoto
from webapp.tasks.maps import adopt_map
from webapp.tasks.maps.contribute import Given, contribute, suggest


@pytest.fixture
def row(library, make_map):
    """Id of a map with photos."""
    make_map(library.map_folder("row"), 4)
    with library.database.write() as session:
        owner = accounts.ensure_owner(session)
    return adopt_map.adopt_map(library, "row", account_id=owner.id)


@pytest.fixture
def quick(settings):
    return replace(settings, extract=ExtractSettings(max_side_px=320, keypoints=120))


def test_index(library, quick, queue, seen, row):
    id = queue("index", map_id=row)
    Worker(library, quick, registry=REGISTRY).run(once=True)
    job = seen(id)
    assert (job["state"], job["error"]) == ("done", None)
    assert (job["result"]["photos"], job["result"]["computed"], job["result"]["failed"]) == (4, 4, [])
    assert job["done"] == job["total"] == 12  # steps: describe, compare with the others, try
    assert list(library.map_folder("row").glob("derived/**/manifest.json"))
    again = queue("index", map_id=row)
    Worker(library, quick, registry=REGISTRY).run(once=True)
    assert seen(again)["result"]["computed"] == 0


def calibrated(library, quick, queue, row):
    """Run the job; number of real queries in the calibration."""
    queue("index", map_id=row)
    Worker(library, quick, registry=REGISTRY).run(once=True)
    return calibrate.calibrated_on(library.cfg("row")).real


def test_photos_added_from_answers_are_real_queries(library, quick, queue, row):
    assert calibrated(library, quick, queue, row) == 0
    fields = {"width": 4, "height": 3, "options": {}, "answer": {"hypotheses": []}, "evidence": []}
    with library.database.write() as session:
        record = session.get(MapRecord, row)
        before = session.get_one(Photo, (row, 2)).uploaded_at - timedelta(seconds=5)
        session.get_one(Photo, (row, 0)).uploaded_at = before
        for number in range(5):
            adopted_id = {1: 2, 2: 3}.get(number)
            asked = QueryRecord(
                name="a.jpg", file=f"{number}.jpg", at=before, adopted_id=adopted_id, **fields
            )
            forgotten = queries.add(session, record, row=asked, most=1)
            assert all(old.adopted_id is None for old in forgotten)
        session.get_one(Photo, (row, 3)).x_px = None  # back in the tray
        assert independent_photos(session, record) == [(2, 0)]
        session.get_one(Photo, (row, 0)).uploaded_at = before - timedelta(seconds=5)
        session.get_one(Photo, (row, 1)).uploaded_at = before - timedelta(seconds=5)
        assert independent_photos(session, record) == [(2, 2)]
        session.get_one(Photo, (row, 3)).x_px = 5.0
    assert calibrated(library, quick, queue, row) == 2
    with library.database.write() as session:
        session.get(MapRecord, row).uses_adopted = False
    assert calibrated(library, quick, queue, row) == 0
    with library.database.write() as session:
        record = session.get(MapRecord, row)
        session.get_one(Photo, (row, 2)).removed = True
        latest = QueryRecord(name="a.jpg", file="5.jpg", at=before, **fields)
        forgotten = queries.add(session, record, row=latest, most=1)
        assert [old.adopted_id for old in forgotten] == [None, 2], "its photo was removed"


def test_a_photo_accepted_where_the_answer_was_is_no_real_query_unless_its_gps_confirms_that(
    library, quick, queue, row, monkeypatch
):
    plane = Georeference("EPSG:32633", (1, 0, 500_000, 0, -1, 5_500_000, 0, 0, 1), "affine")
    monkeypatch.setattr(adopt_query, "georeference", lambda record: plane)
    with library.database.write() as session:
        record, photos = session.get(MapRecord, row), [session.get_one(Photo, (row, id)) for id in range(4)]
        for photo, (moved, gps, accuracy_m) in zip(
            photos, [(0.5, None, None), (1.5, None, None), (0.0, 5.0, 8.0), (0.0, 5.0, 60.0)], strict=True
        ):
            photo.x_px, photo.y_px, photo.gps_lat, photo.gps_lon = 50.0, 50.0, None, None
            place = {"x_px": 50.0 - moved, "y_px": 50.0}
            fields = {"width": 4, "height": 3, "options": {}, "answer": {"hypotheses": [place]}}
            asked = QueryRecord(name="a.jpg", file="a.jpg", adopted_id=photo.id, evidence=[], **fields)
            queries.add(session, record, row=asked, most=9)
            if gps is not None:
                photo.gps_lat, photo.gps_lon = plane.latlon_of(MapPixel(50.0, 50.0 + gps))
                photo.gps_accuracy_m = accuracy_m
        assert [known.id for known in independent_photos(session, record)] == [1, 2]
        photos[2].gps_lat, photos[2].gps_lon = plane.latlon_of(MapPixel(50.0, 90.0))
        assert [known.id for known in independent_photos(session, record)] == [1]


def test_a_list_of_real_queries_counts_in_the_job(library, quick, queue, row):
    cfg = library.cfg("row")
    _, photo, x, y = cfg.read_text().splitlines()[1].split(";")[:4]
    cfg.with_name("map.queries.csv").write_text(f"path;x;y\n{photo};{x};{y}\n")
    assert calibrated(library, quick, queue, row) == 1


def test_index_of_a_method_with_a_network(library, quick, queue, seen, row, shared_models):
    asked = {"features": "xfeat", "method": "thorough"}
    id = queue("index", map_id=row, arguments=asked, key="xfeat thorough")
    worker = Worker(library, replace(quick, models=shared_models), registry=REGISTRY)
    for _ in range(2):  # the job of the library's own index comes first
        worker.run(once=True)
    result = seen(id)["result"]
    assert (seen(id)["state"], result["features"], result["method"]) == ("done", "xfeat", "thorough")
    assert list(library.map_folder("row").glob("derived/**/calibration-thorough-ivf.json"))


def test_an_index_waits_for_the_scheduler_of_dask(library, make_map, quick, queue, seen, monkeypatch):
    def away(pool):
        raise ClusterUnavailable("the Dask scheduler cannot be reached", wait_s=1)

    pytest.importorskip("distributed")
    monkeypatch.setattr(DaskPool, "_connect", away)
    make_map(library.map_folder("long"), 6)
    with library.database.write() as session:
        owner = accounts.ensure_owner(session)
    id = queue("index", map_id=adopt_map.adopt_map(library, "long", account_id=owner.id))
    worker = Worker(library, replace(quick, dask="tcp://127.0.0.1:1"), registry=REGISTRY)
    working = threading.Thread(target=worker.run)
    working.start()
    until = time.monotonic() + 30.0
    while seen(id)["note"] != "the Dask scheduler cannot be reached" and time.monotonic() < until:
        time.sleep(0.1)
    worker.stop()
    working.join()
    assert (seen(id)["state"], seen(id)["note"]) == ("queued", "the Dask scheduler cannot be reached")
    assert seen(id)["error"] is None
    Worker(library, quick, registry=REGISTRY).run(once=True)
    assert (seen(id)["state"], seen(id)["result"]["computed"]) == ("done", 6)


def test_evaluate(library, quick, queue, seen, row):
    id = queue("evaluate", map_id=row, arguments={"limit": 2})
    Worker(library, quick, registry=REGISTRY).run(once=True)
    job = seen(id)
    assert (job["state"], job["error"]) == ("done", None)
    assert {scheme: figures["queries"] for scheme, figures in job["result"].items()} == {
        "leave-one-out": 2,
        "leave-one-place-out": 2,
    }
    report = json.loads((library.map_folder("row") / "derived" / "evaluation.json").read_text())
    assert [len(part["per_query"]) for part in report] == [2, 2]


def test_a_map_without_image_has_no_index_and_says_so(library, quick, queue, seen, park):
    id = queue("index", map_id=park)
    Worker(library, quick, registry=REGISTRY).run(once=True)
    assert seen(id)["state"] == "failed"
    assert seen(id)["error"]["hint"]


def test_the_sample_of_a_new_library_is_made_once(library, settings, queue, seen, monkeypatch, make_map):
    made = []
    monkeypatch.setattr(
        "webapp.sample.make.make_sample",
        lambda _folder, *, settings, progress: made or made.append(make_map(settings.library / "sample", 2)),
    )
    with library.database.write() as session:
        owner = accounts.ensure_owner(session)
    (library.folder / ".sample.abc.tmp" / "new").mkdir(parents=True)
    for _ in range(2):
        id = queue("sample", account_id=owner.id)
        Worker(library, settings, registry=REGISTRY).run(once=True)
        assert (seen(id)["state"], seen(id)["error"]) == ("done", None)
    assert sorted(path.name for path in library.folder.iterdir()) == [".library", "sample"]
    with library.database.read() as session:
        assert [r.slug for r in session.query(MapRecord)] == ["sample"]


def test_photos_from_visitors_get_their_places_once_there_is_an_index(library, quick, queue, row, save_photo):
    with library.database.write() as session:
        record = session.get_one(MapRecord, row)
        allows = sharing.SharePermissions(contribute=True)
        share, _token = sharing.create(session, record, allows=allows, account_id=1)
        at = session.get_one(Photo, (row, 2))
        wanted = (at.x_px, at.y_px)
    cache = MapCache(library, quick)
    ids = []
    for seed, name in ((2, "there.jpg"), (77, "elsewhere.jpg")):
        file = library.uploads / name
        save_photo(file, seed)
        with file.open("ab") as end:
            end.write(b"another file")
        suggestion = suggest(cache, row, photo=UploadedPhoto(file, name))
        assert suggestion.to_find and suggestion.place is None
        given = Given(share.id, "v", file, name)
        ids.append(contribute(library, row, given=given, suggestion=suggestion, settings=quick))
    queue("index", map_id=row)
    Worker(library, quick, registry=REGISTRY).run(once=True)
    with library.database.read() as session:
        there, elsewhere = (session.get_one(Contribution, (row, id)) for id in ids)
    assert (there.x_px, there.y_px) == pytest.approx(wanted, abs=5.0)
    assert elsewhere.x_px is None
    assert not there.to_find and not elsewhere.to_find
