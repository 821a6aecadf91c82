"""`--sequence` on the command line."""

import json
from datetime import datetime, timedelta
from pathlib import Path

import piexif
import pytest

from webapp.files.photos.exif_write import CameraTags, exif_bytes
from webapp.progress import Progress
from webapp.settings import PhotoLimits, Settings
from webapp.tasks.localize import build_map, sequence
from webapp.tasks.localize.plan import OpenOptions

START = datetime(2024, 5, 1, 12, 0, 0)


@pytest.fixture(scope="module")
def cfg(make_map, tmp_path_factory) -> Path:
    cfg = make_map(tmp_path_factory.mktemp("map"), 6)
    lines = [f"photos/{i}.jpg;{100 * i + 100};{110}" for i in range(6)]
    (cfg.parent / "queries.csv").write_text("\n".join(["path;x;y", *lines]) + "\n")
    build_map.build_map(cfg, OpenOptions(features="sift"), settings=Settings(), progress=Progress())
    return cfg


@pytest.fixture
def dated(cfg, tmp_path):
    """Four photos of the map: three named in the reverse order of their times, and one 20 s later."""
    paths = []
    for number, (name, after_s) in enumerate((("c", 0), ("b", 2), ("a", 4), ("d", 24))):
        path = tmp_path / f"{name}.jpg"
        path.write_bytes((cfg.parent / "photos" / f"{number}.jpg").read_bytes())
        tags = CameraTags(START + timedelta(seconds=after_s), 28)
        piexif.insert(exif_bytes(tags), str(path))
        paths.append(path)
    return paths


def test_a_walk_is_answered_frame_by_frame(expmap, cfg):
    photos = [cfg.parent / "photos" / f"{i}.jpg" for i in range(4)]
    code, out, _ = expmap("localize", cfg, *photos, "--sequence", "--speed", 100, "--json")
    answers = json.loads(out)
    assert code == 0
    assert [a["query"] for a in answers] == [str(p) for p in photos]
    assert all(a["sequence"] is True for a in answers)
    code, out, _ = expmap("localize", cfg, *photos, "--sequence", "--speed", 100)
    assert (code, len(out.strip().split("\n\n"))) == (0, 4)


def test_evaluation_says_that_it_was_a_sequence(expmap, cfg):
    queries = cfg.parent / "queries.csv"
    code, out, _ = expmap("evaluate", cfg, queries, "--sequence", "--speed", 100, "--limit", 3, "--json")
    figures = json.loads(out)
    assert code == 0
    assert figures["sequence"] is True
    assert all(query["answer"]["sequence"] for query in figures["per_query"])
    assert [query["path"] for query in figures["per_query"]] == [f"photos/{i}.jpg" for i in (0, 2, 4)]


def test_a_broken_frame_is_reported_and_the_others_continue(expmap, cfg, tmp_path):
    photo, broken = cfg.parent / "photos" / "1.jpg", tmp_path / "broken.jpg"
    broken.write_bytes(b"no photo")
    code, out, err = expmap("localize", cfg, photo, broken, photo, "--sequence", "--json")
    answers = json.loads(out)
    assert code == 1 and "broken.jpg" in err
    assert ["error" in a for a in answers] == [False, True, False]


def test_photos_are_put_in_the_order_of_their_times(expmap, cfg, dated, tmp_path):
    broken = tmp_path / "broken.jpg"
    broken.write_bytes(b"no photo")
    named = [broken, *sorted(dated)]
    ordered, steps = sequence.by_time(named, limits=PhotoLimits())
    assert [p.stem for p in ordered] == ["c", "b", "a", "d", "broken"]
    assert [steps.get(p) for p in ordered] == [None, 1.0, 1.0, 10.0, None]
    _, out, _ = expmap("localize", cfg, *named, "--sequence", "--by-time", "--json")
    assert [Path(a["query"]).stem for a in json.loads(out)] == ["c", "b", "a", "d", "broken"]


def test_later_frames_count_where_that_is_wanted(expmap, cfg, tmp_path):
    photos = [cfg.parent / "photos" / f"{i}.jpg" for i in range(4)]
    broken = tmp_path / "broken.jpg"
    broken.write_bytes(b"no photo")
    given = ("--sequence", "--speed", 100, "--json")
    _, out, _ = expmap("localize", cfg, *photos, *given)
    code, smoothed, err = expmap("localize", cfg, *photos[:2], broken, *photos[2:], *given, "--smooth")
    assert code == 1 and "broken.jpg" in err
    filtered, smoothed = json.loads(out), json.loads(smoothed)
    assert "error" in smoothed.pop(2)
    assert [a["query"] for a in smoothed] == [str(p) for p in photos]
    assert all(a["sequence"] is True for a in smoothed)
    first = [a[0]["hypotheses"][0]["probability"] for a in (filtered, smoothed)]
    assert first[1] > first[0]


def test_a_smoothed_sequence_is_evaluated(expmap, cfg):
    queries = cfg.parent / "queries.csv"
    code, out, _ = expmap("evaluate", cfg, queries, "--sequence", "--smooth", "--limit", 3, "--json")
    figures = json.loads(out)
    assert code == 0 and figures["sequence"] is True
    assert [query["path"] for query in figures["per_query"]] == [f"photos/{i}.jpg" for i in (0, 2, 4)]


@pytest.mark.parametrize(
    ("arguments", "where"),
    [
        (("localize", "photos/1.jpg", "--speed", 5), "--speed"),
        (("localize", "photos/1.jpg", "--by-time"), "--by-time"),
        (("evaluate", "queries.csv", "--smooth"), "--smooth"),
        (("localize", "photos/1.jpg", "--sequence", "--by-time"), "--by-time"),
        (("evaluate", "queries.csv", "--speed", 5), "--speed"),
        (("evaluate", "--self", "--sequence"), "--sequence"),
    ],
)
def test_what_does_not_go_together_is_refused(expmap, cfg, arguments, where):
    command, *rest = arguments
    given = [cfg.parent / a if isinstance(a, str) and not a.startswith("-") else a for a in rest]
    code, _, err = expmap(command, cfg, *given)
    assert code == 2 and where in err
