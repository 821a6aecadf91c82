"""Metrics for Prometheus, protected by a token."""

import json
import os
import re
import subprocess
import sys
from dataclasses import replace
from pathlib import Path

import pytest
from prometheus_client.parser import text_string_to_metric_families

from tests.s3_server import using
from webapp.errors import MissingPart, StorageError
from webapp.files import contents
from webapp.files.object_storage.bucket import Bucket, watch
from webapp.files.object_storage.cache import ObjectCache
from webapp.files.object_storage.storage import ObjectStorage
from webapp.settings import METRICS_FOLDER
from webapp.store.operate import jobs
from webapp.store.operate.jobs import Limits
from webapp.web import make_app
from webapp.web.operate import metrics
from webapp.web.state import Parts

ROOT = Path(__file__).resolve().parents[3]
COUNTING = """
import sys
from types import SimpleNamespace
from webapp.errors import StorageError
from webapp.web.operate.metrics import _Metrics

def away():
    raise StorageError("not now")

counted = _Metrics()
counted.looks.labels("open").inc(int(sys.argv[1]))
place = SimpleNamespace(database=SimpleNamespace(read=away), folder=".")
print(counted.text(place).decode())
"""
TOKEN = {"Authorization": "Bearer long-and-secret"}


@pytest.fixture
def settings(settings):
    return replace(settings, serve=replace(settings.serve, metrics_token="long-and-secret"))


@pytest.fixture
def figures(stranger):
    """Request the metrics, and return them by name and labels."""

    def ask():
        answer = stranger.get("/metrics", headers=TOKEN)
        assert answer.status_code == 200
        families = text_string_to_metric_families(answer.text)
        samples = [sample for family in families for sample in family.samples]
        return {(sample.name, *sample.labels.values()): sample.value for sample in samples}

    return ask


@pytest.fixture
def stored(app, s3, tmp_path):
    """A file that is an object, and a machine without a copy."""
    bucket, path = Bucket(f"s3://{s3.new_bucket()}"), tmp_path / "photo.jpg"
    path.write_bytes(b"photo")
    with using(ObjectStorage(bucket, ObjectCache(tmp_path / "warm", limit=10**6))):
        contents.publish(path)
    yield path, ObjectStorage(bucket, ObjectCache(tmp_path / "cold", limit=10**6))
    watch(None)


def test_only_with_the_token(stranger, client):
    for browser in (stranger, client):
        assert browser.get("/metrics").status_code == 401
        assert browser.get("/metrics", headers={"Authorization": "Bearer wrong"}).status_code == 401
    assert stranger.get("/metrics", headers=TOKEN).mimetype == "text/plain"


def test_requests_are_counted_by_their_routes(client, figures, park):
    for _ in range(2):
        client.get(f"/api/v1/maps/{park}")
    client.open("/nowhere", method="BREW")
    found = figures()
    routes = [key[2] for key in found if key[0] == "expmap_requests_total"]
    (route,) = [route for route in routes if route.endswith("/maps/<slug>")]
    assert found["expmap_requests_total", "GET", route, "200"] == 2
    assert found["expmap_request_seconds_count", route] == 2
    assert found["expmap_requests_total", "other", "none", "404"] == 1


def test_the_queue_the_disk_and_answers(app, library, figures):
    with library.database.write() as session:
        for kind in ("a", "b", "c"):
            jobs.enqueue(session, kind)
        jobs.lease(session, "gone", limits=Limits(seconds=-1.0, attempts=3))
    with app.app_context():
        metrics.count_answer({"extract": 0.02, "retrieve": None, "total": 0.2})
    metrics.look_counter(app)(False)
    found = figures()
    names = ("expmap_database_up", "expmap_jobs_waiting", "expmap_jobs_running", "expmap_leases_ended")
    assert [found[name,] for name in names] == [1, 2, 1, 1]
    assert 0 <= found["expmap_jobs_oldest_seconds",] < 3600
    assert 0 < found["expmap_disk_free_bytes",] < found["expmap_disk_size_bytes",]
    assert found["expmap_answer_seconds_sum", "extract"] == pytest.approx(0.02)
    assert found["expmap_map_cache_total", "opened"] == 1


def test_without_its_database_the_rest_is_known(library, figures, monkeypatch):
    def away():
        raise StorageError("the database server cannot be reached")

    monkeypatch.setattr(library.database, "read", away)
    found = figures()
    assert found["expmap_database_up",] == 0
    assert ("expmap_jobs_waiting",) not in found
    assert found["expmap_disk_size_bytes",] > 0


@pytest.mark.slow
def test_what_processes_count_is_added_up(tmp_path):
    environ = {**os.environ, METRICS_FOLDER: str(tmp_path)}
    for count, total in ((2, 2), (3, 5)):
        command = [sys.executable, "-c", COUNTING, str(count)]
        done = subprocess.run(command, cwd=ROOT, env=environ, capture_output=True, text=True, check=False)
        assert f'expmap_map_cache_total{{result="open"}} {total}.0' in done.stdout, done.stderr


def test_the_board_asks_for_figures_that_there_are(app, stranger, client, park, stored):
    client.get(f"/api/v1/maps/{park}")
    with app.app_context():
        metrics.count_answer({"extract": 0.02, "total": 0.2})
    metrics.look_counter(app)(True)
    path, cold = stored
    with using(cold):
        contents.local(path)
        families = text_string_to_metric_families(stranger.get("/metrics", headers=TOKEN).text)
    labels = {}
    for sample in (sample for family in families for sample in family.samples):
        labels.setdefault(sample.name, {"instance"}).update(sample.labels)
    board = json.loads((ROOT / "docs" / "grafana-board.json").read_text("utf-8"))
    asked = [target["expr"] for panel in board["panels"] for target in panel["targets"]]
    asked += [one["query"] for one in board["templating"]["list"] if one["type"] == "query"]
    known = set()
    for text in asked:
        used = set(re.findall(r"expmap_\w+", text))
        assert used, text
        assert used <= set(labels), text
        known |= used
        named = set(re.findall(r"(\w+)=~?\"", text))
        for group in re.findall(r"by \(([^)]*)\)", text):
            named |= {label.strip() for label in group.split(",")}
        assert all(named <= labels[name] for name in used), text
    shown, given = (
        {re.sub(r"_(total|sum|count|bucket|created)$", "", name) for name in names}
        for names in (known, labels)
    )
    assert shown == given, "figures that it does not show"


def test_the_object_storage_and_its_cache(app, figures, stored, s3):
    path, cold = stored
    with using(cold):
        contents.local(path)
        contents.local(path)
        s3.refuse = (503, "SlowDown")
        assert not contents.reachable()
        found = figures()
        assert found["expmap_storage_cache_bytes",] == 5
    counted = {
        (operation, result): found["expmap_storage_requests_total", operation, result]
        for operation, result in (("put", "done"), ("get", "done"), ("probe", "failed"))
    }
    assert set(counted.values()) == {1}
    assert ("expmap_storage_requests_total", "get", "failed") not in found
    assert found["expmap_storage_seconds_count", "probe"] == 1
    assert (found["expmap_storage_cache_total", "miss"], found["expmap_storage_cache_total", "hit"]) == (1, 1)
    assert ("expmap_storage_cache_bytes",) not in figures()


@pytest.mark.usefixtures("sqlite_only")
def test_without_the_client_library_it_says_what_to_install(settings, absent):
    absent("cluster")
    with pytest.raises(MissingPart, match="prometheus_client"):
        make_app(settings, Parts((), {}, {}, {}))
