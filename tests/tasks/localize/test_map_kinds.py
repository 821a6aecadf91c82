"""Maps of several kinds derived from the sample map: areas, a plan not to scale, and a mixture."""

import functools
import math
import shutil
from dataclasses import replace

import numpy as np
import pytest

from benchmarks import derived_maps
from webapp.progress import Progress
from webapp.settings import ExtractSettings, Settings
from webapp.tasks.localize.open_pipeline import open_pipeline
from webapp.tasks.localize.plan import OpenOptions

pytestmark = pytest.mark.slow


def quadrants(table):
    """Gather the photos into four areas; queries go to the nearest one."""
    middle = np.array(table.size) / 2.0

    def gathered(at):
        return np.round(middle + np.sign(at - middle) * middle / 2.0)

    return replace(table, position=gathered(table.position), truth=gathered(table.truth))


def half_gathered(table):
    """Gather the photos of the left half into two areas; the others stay."""
    areas = quadrants(table)
    left = table.position[:, :1] < table.size[0] / 2.0
    queries = table.truth[:, :1] < table.size[0] / 2.0
    return replace(
        table,
        position=np.where(left, areas.position, table.position),
        truth=np.where(queries, areas.truth, table.truth),
    )


FEW = Settings(extract=ExtractSettings(keypoints=500))
"""Enough for photos with large overlap, in a third of the time."""

DERIVED = {"areas": quadrants, "snake": derived_maps.snake, "mixed": half_gathered, "as it is": lambda t: t}


OF_POSITIONS = shutil.ignore_patterns("calibration-*", "orientations-*", "pairs-*")
"""Files of an index that do not depend on the photos alone."""


@pytest.fixture(scope="module")
def opened(sample_folder, tmp_path_factory):
    """Open a derived map with a method, each once; all share what depends on the photos alone.

    The kind of the map may be given, as by a user.
    """
    folder = tmp_path_factory.mktemp("kinds")
    tables = {kind: derive(derived_maps.read(sample_folder)) for kind, derive in DERIVED.items()}
    for kind, table in tables.items():
        derived_maps.write(table, folder / kind)

    @functools.cache
    def get(kind, method, given=None):
        options = OpenOptions(method=method, jobs=1, map_kind=given)
        cfg = folder / kind / "map.cfg"
        described = next(folder.glob("*/derived"), None)
        if described and not (cfg.parent / "derived").exists():
            shutil.copytree(described, cfg.parent / "derived", ignore=OF_POSITIONS)
        pipeline = open_pipeline(cfg, options, settings=FEW, progress=Progress())
        queries = derived_maps.read(cfg.parent).queries
        return pipeline, [*zip(queries, tables[kind].truth, strict=True)]

    return get


def errors(pipeline, queries):
    first = [pipeline.localize(path, top=5).hypotheses[:1] for path, _ in queries]
    return [
        math.dist(h[0].position, truth) if h else math.inf
        for h, (_, truth) in zip(first, queries, strict=True)
    ]


def test_an_area_is_answered_as_a_whole(opened):
    pipeline, queries = opened("areas", "verified")
    assert pipeline.map_kind == "areas"
    there = {tuple(p) for p in pipeline.opened.indexed.position.tolist()}
    for path, _ in queries:
        for hypothesis in pipeline.localize(path, top=5).hypotheses:
            assert hypothesis.kind == "area"
            assert tuple(hypothesis.position) in there
            assert hypothesis.heading_deg is None and hypothesis.radius_px is None
            area = {e.position for e in pipeline.map.experiences if e.id in hypothesis.experiences}
            assert len(area) == 1


def test_areas_never_overlap(opened):
    pipeline, _ = opened("areas", "verified")
    distinct = np.unique(pipeline.opened.indexed.position, axis=0)
    apart = min(math.dist(a, b) for i, a in enumerate(distinct) for b in distinct[:i])
    assert 2.0 * pipeline.place_radius_px < apart


def test_a_mixed_map_answers_each_part_as_it_is(opened):
    pipeline, queries = opened("mixed", "verified")
    assert pipeline.map_kind == "mixed"
    kinds = {pipeline.localize(path, top=1).hypotheses[0].kind for path, _ in queries}
    assert "area" in kinds and kinds & {"position", "photo"}


@pytest.mark.parametrize("kind", DERIVED)
def test_geometry_only_helps(opened, kind):
    verified, queries = opened(kind, "verified")
    vote, same = opened(kind, "vote")
    right = sum(e <= verified.place_radius_px for e in errors(verified, queries))
    by_votes = sum(e <= verified.place_radius_px for e in errors(vote, same))
    assert right >= by_votes - 1, (right, by_votes)


def of_every(table, every, *, queries):
    """Take every n-th photo of a map, and some of its queries."""
    asked = np.linspace(0, len(table.queries) - 1, queries).round().astype(int)
    return replace(
        table,
        photos=table.photos[::every],
        position=table.position[::every],
        queries=[table.queries[n] for n in asked],
        truth=table.truth[asked],
    )


@pytest.mark.parametrize(
    ("name", "every", "kind", "within_px"),
    [("floors", 12, "areas", 400.0), ("lanes", 2, "schematic", 20.0), ("corridor", 2, "metric", 50.0)],
)
def test_geometry_only_helps_on_real_maps(shared_data, tmp_path, name, every, kind, within_px):
    table = of_every(derived_maps.read(shared_data / name), every, queries=12)
    try:
        derived_maps.write(table, tmp_path)
    except OSError:
        pytest.skip("hard links to the real data cannot be made here")
    right = {}
    for method in ("verified", "vote"):
        options = OpenOptions(method=method, features="sift", jobs=1)
        pipeline = open_pipeline(tmp_path / "map.cfg", options, settings=FEW, progress=Progress())
        found = errors(pipeline, [*zip(derived_maps.read(tmp_path).queries, table.truth, strict=True)])
        right[method] = sum(e <= within_px for e in found)
        if method == "verified":
            assert pipeline.map_kind == kind
    assert right["verified"] >= max(right["vote"] - 1, 6), right


def test_what_the_user_says_counts(opened):
    pipeline, ((query, _), *_) = opened("areas", "verified", "schematic")
    assert pipeline.map_kind == "schematic"
    assert {h.kind for h in pipeline.localize(query, top=5).hypotheses} == {"photo"}
