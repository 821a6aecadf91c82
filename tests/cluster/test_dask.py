"""Maps built by Dask equal those built locally, whatever process is killed meanwhile."""

import os
import re
import shutil
import sqlite3
import subprocess
import sys
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest

from tests.cluster.dask_cluster import DaskCluster
from tests.cluster.slow_job import native_threads
from tests.ports import reserved_port
from webapp.errors import Cancelled, ClusterUnavailable, MissingPart, UsageError
from webapp.extras import EXTRAS, is_installed
from webapp.files.maps.folder import read_map
from webapp.logs import carried
from webapp.progress import Progress
from webapp.tasks.computing import cluster as cluster_module
from webapp.tasks.computing.in_order import ExecutionTarget, in_order
from webapp.tasks.evaluation import evaluate
from webapp.tasks.evaluation.evaluate import with_hidden_photos
from webapp.tasks.landmarks.reconstruct import reconstruct
from webapp.tasks.localize import build_map
from webapp.tasks.localize.open_pipeline import open_pipeline
from webapp.tasks.localize.plan import OpenOptions
from webapp.threads import cores

pytestmark = pytest.mark.skipif(
    not is_installed("cluster") or os.name == "nt", reason="the extra `cluster` is not installed"
)


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    """A scheduler with two workers."""
    started = DaskCluster(tmp_path_factory.mktemp("dask"), workers=2)
    try:
        started.wait(2)
        yield started
    finally:
        started.stop()


@pytest.fixture
def on_dask(quick, cluster):
    return replace(quick, dask=cluster.address)


class Calls(Progress):
    """Calls a function once after a number of steps."""

    def __init__(self, steps, call):
        self.left, self.call, self.stop, self.notes = steps, call, False, []

    def advance(self, steps=1):
        self.left -= steps
        if self.left <= 0 and self.call:
            call, self.call = self.call, None
            call()

    def note(self, text):
        self.notes.append(text)

    def cancelled(self):
        return self.stop


def lasting(folder: Path):
    """Return all that is computed from a map, without times and checksums: bytes, or the content of JSON."""
    found = {}
    for path in sorted(folder.rglob("*")):
        if path.is_file() and path.suffix in (".features", ".ivf", ".codebook", ".arrays"):
            found[str(path.relative_to(folder))] = path.read_bytes()
        elif path.suffix == ".trials" or path.name.startswith("calibration"):
            text = re.sub(r'"\w*seconds\w*": [0-9.]+', "", path.read_text())
            found[str(path.relative_to(folder))] = re.sub(r'"check": "\w+"', "", text)
    return found


def build(cfg, settings, index, *, progress=None, **options):
    asked = OpenOptions(index=index, jobs=2, **options)
    return build_map.build_map(cfg, asked, settings=settings, progress=progress or Progress())


def test_the_same_bytes_and_answers_as_here(tmp_path, sample_folder, quick, on_dask):
    (cfg,) = sample_folder.glob("map.cfg")
    method = {"method": "verified"}
    build(cfg, quick, tmp_path / "here", **method)
    report = build(cfg, on_dask, tmp_path / "there", **method)
    here, there = lasting(tmp_path / "here"), lasting(tmp_path / "there")
    assert here.keys() == there.keys()
    assert [name for name in here if here[name] != there[name]] == []
    assert report.index.extracted == report.index.photos
    assert not [*tmp_path.rglob(".computing-*")]
    options = OpenOptions(index=tmp_path / "here", **method)
    assert answers(cfg, options, settings=quick) == answers(cfg, options, settings=on_dask)


def answers(cfg, options, *, settings):
    """Return the evaluation of the map's own photos, without times."""
    pipeline = open_pipeline(cfg, options, settings=settings, progress=Progress())
    (done,) = evaluate.evaluate_self(
        with_hidden_photos(pipeline),
        map_folder=cfg.parent,
        options=evaluate.EvaluateOptions(limit=12, hide_within_px=10.0),
    )
    found = evaluate.to_json(done)["per_query"]
    for query in found:
        query["answer"].pop("seconds")
    return found


def test_the_same_pairs_for_landmarks_as_here(tmp_path, sample_folder, on_dask):
    pytest.importorskip("pycolmap")
    rows = []
    for settings in (replace(on_dask, dask=None), on_dask):
        folder = tmp_path / ("here" if settings.dask is None else "there")
        shutil.copytree(sample_folder, folder, ignore=shutil.ignore_patterns("derived"))
        the_map = read_map(folder / "map.cfg")
        some = replace(the_map, experiences=the_map.experiences[:8], unplaced=())
        found = reconstruct(folder / "map.cfg", some, settings=settings, progress=Progress())
        with closing(sqlite3.connect(found.shared / "matches.db")) as database:
            rows.append(database.execute("SELECT * FROM two_view_geometries ORDER BY pair_id").fetchall())
    assert len(rows[0]) > 5
    assert rows[0] == rows[1]


def test_a_part_alone_uses_all_cores_and_parts_together_one_each(tmp_path, on_dask):
    at = ExecutionTarget(on_dask, tmp_path)
    assert [*in_order(native_threads, [0.0], shared=0, at=at, progress=Progress())] == [min(2, cores())]
    many = [0.05] * 12
    assert [*in_order(native_threads, many, shared=0, at=at, progress=Progress())] == [1] * 12


def test_a_killed_worker_costs_only_its_parts(tmp_path, make_map, quick, on_dask, cluster):
    cfg = make_map(tmp_path, 60)
    third = cluster.start_worker()
    cluster.wait(3)
    build(cfg, quick, tmp_path / "here", method="vote")
    progress = Calls(5, third.kill)
    build(cfg, on_dask, tmp_path / "there", progress=progress, method="vote")
    assert third.wait(5) < 0
    assert lasting(tmp_path / "here") == lasting(tmp_path / "there")


def test_it_can_be_stopped_and_goes_on(tmp_path, make_map, quick, on_dask):
    cfg = make_map(tmp_path, 40)
    progress = Calls(5, lambda: setattr(progress, "stop", True))
    with pytest.raises(Cancelled):
        build(cfg, on_dask, tmp_path / "there", progress=progress, method="vote")
    report = build(cfg, on_dask, tmp_path / "there", method="vote")
    assert report.index.extracted <= 35
    build(cfg, quick, tmp_path / "here", method="vote")
    assert lasting(tmp_path / "here") == lasting(tmp_path / "there")


def test_a_scheduler_that_is_not_there(tmp_path, make_map, quick, monkeypatch):
    monkeypatch.setattr(cluster_module, "_CONNECT_S", 0.5)
    cfg = make_map(tmp_path, 6)
    with reserved_port() as port:
        settings = replace(quick, dask=f"tcp://127.0.0.1:{port}")
        with pytest.raises(ClusterUnavailable, match=r"tcp://.*: the Dask scheduler cannot be reached"):
            build(cfg, settings, tmp_path / "there", method="vote")
    with pytest.raises(UsageError, match="is not the address of a Dask scheduler"):
        build(cfg, replace(quick, dask="nowhere://x"), tmp_path / "there", method="vote")


def test_a_scheduler_that_is_lost(tmp_path, make_map, quick):
    cfg = make_map(tmp_path, 40)
    own = DaskCluster(tmp_path, workers=1)
    try:
        own.wait(1)
        progress = Calls(5, own.scheduler.kill)
        with pytest.raises(ClusterUnavailable, match=r"is lost|cannot be reached"):
            build(cfg, replace(quick, dask=own.address), tmp_path / "there", progress=progress, method="vote")
    finally:
        own.stop()
    report = build(cfg, quick, tmp_path / "there", method="vote")
    assert report.index.extracted <= 35


def test_workers_that_differ_are_refused(tmp_path, on_dask, monkeypatch):
    at = ExecutionTarget(on_dask, tmp_path)
    monkeypatch.setattr(cluster_module, "versions", lambda: {"numpy": "1.0"})
    with pytest.raises(UsageError, match=r"the Dask worker tcp://.* has numpy .*, this process 1\.0"):
        [*in_order(max, [1], shared=0, at=at, progress=Progress())]


def test_workers_that_do_not_see_the_folder_are_refused():
    terms = cluster_module.WorkerRequirements(
        cluster_module.versions(), Path("/nowhere/.computing-1"), None, carried()
    )
    with pytest.raises(UsageError, match="cannot see the folder /nowhere"):
        terms.check("tcp://127.0.0.1:1")


def test_errors_of_a_part_are_raised_as_they_are(tmp_path, on_dask):
    with pytest.raises(TypeError):
        [*in_order(max, ["x"], shared=0, at=ExecutionTarget(on_dask, tmp_path), progress=Progress())]


def test_without_the_extra(tmp_path, on_dask, monkeypatch):
    monkeypatch.setitem(sys.modules, "distributed", None)
    with pytest.raises(MissingPart, match="distributed is not installed") as caught:
        [*in_order(max, [1], shared=0, at=ExecutionTarget(on_dask, tmp_path), progress=Progress())]
    assert "experience-map[cluster]" in caught.value.hint
    assert "distributed" in EXTRAS["cluster"]


def test_without_the_setting_dask_is_not_loaded():
    code = "import sys, webapp.tasks.localize.build_map; sys.exit('distributed' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0
