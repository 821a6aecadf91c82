"""The figures of the benchmark that compares methods side by side."""

import json
import sys
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks import figures, held_out, processes, side_by_side


def answer(*probabilities: float, **seconds: float | None) -> dict:
    return {"hypotheses": [{"probability": p} for p in probabilities], "seconds": seconds}


def test_percentiles_are_those_of_numpy():
    values = [0.3, 0.1, 0.7, 0.2, 5.0, 0.9]
    for percent in (0, 13, 50, 95, 99, 100):
        assert figures.percentile(values, percent) == pytest.approx(np.percentile(values, percent))
    assert figures.percentile([], 50) is None


def test_a_stage_is_the_median_of_the_photos_that_had_it():
    answers = [
        answer(read=0.1, verify=None),
        answer(read=0.3, verify=0.5),
        {"query": "x", "error": "damaged"},
    ]
    stages = figures.stage_seconds(answers)
    assert stages["stage_read"] == pytest.approx(0.2)
    assert stages["stage_verify"] == 0.5
    assert stages["stage_extract"] is None


def test_strangers_count_by_their_most_probable_place():
    answers = [answer(0.2, 0.6), answer(0.49), answer(), answer(0.5), {"query": "x", "error": "damaged"}]
    result = figures.strangers(answers)
    assert (result["foreign_photos"], result["foreign_failed"], result["foreign_placed"]) == (4, 1, 2)
    assert result["foreign_share"] == 0.5
    assert result["foreign_largest"] == 0.6
    assert result["foreign_q99"] == pytest.approx(np.percentile([0.6, 0.49, 0.0, 0.5], 99))
    low, high = result["foreign_interval"]
    assert 0.0 < low < 0.5 < high < 1.0


def test_the_median_of_not_on_this_map_leaves_out_what_is_unknown():
    answers = [{**answer(0.1), "off_map_probability": off} for off in (0.9, None, 0.7, 0.95)]
    assert figures.strangers(answers)["foreign_off_map_p50"] == 0.9


def test_refused_though_right_needs_both():
    def query(probability, off, error):
        return {"answer": {**answer(probability), "off_map_probability": off}, "error_px": error}

    queries = [query(0.3, 0.6, 4.0), query(0.3, 0.6, 90.0), query(0.7, 0.2, 4.0), query(0.3, None, 4.0)]
    assert figures.refused_though_right(queries, 10.0) == 0.25
    assert figures.refused_though_right([], 10.0) is None


def test_the_mean_time_is_of_photos_that_could_be_read():
    queries = [{"answer": answer(total=0.2)}, {"answer": answer(total=1.0)}, {"answer": {"error": "damaged"}}]
    assert figures.mean_seconds(queries) == pytest.approx(0.6)
    assert figures.mean_seconds(queries[2:]) is None


def test_none_of_many_strangers_has_an_interval_from_zero():
    low, high = figures.wilson(0, 229)
    assert low == pytest.approx(0.0, abs=1e-12)
    assert high == pytest.approx(0.0165, abs=1e-4)


def test_memory_and_cpu_seconds_are_of_what_one_more_costs():
    assert figures.per_photo_kb(300.0, 200.0, photos=1000) == pytest.approx(104.8576)
    assert figures.each(11.0, 2.0, more=90) == pytest.approx(0.1)
    assert figures.each(11.0, 2.0, more=0) is None


def test_a_table_says_what_is_not_known_and_the_interval_of_what_is():
    columns = {"share": figures.with_interval("a"), "ms": figures.plain("b", 1, times=1e3)}
    rows = [
        {"name": "one", "a": 0.5, "intervals_95": {"a": [0.25, 0.75]}, "b": None},
        {"name": "two", "b": 0.2},
    ]
    assert figures.table("", columns, rows).splitlines() == [
        "                 share     ms",
        "one  0.500 [0.25 0.75]      -",
        "two                  -  200.0",
    ]


def test_the_map_of_one_photo_stands_alone(tmp_path):
    (tmp_path / "map" / "photos").mkdir(parents=True)
    for name in ("plan.png", "photos/a b.jpg", "photos/c.jpg"):
        (tmp_path / "map" / name).write_text(name)
    cfg = tmp_path / "map" / "map.cfg"
    cfg.write_text("plan.png;10;20\n3;photos/a b.jpg;1;2\n4;photos/c.jpg;5;6\n")
    small = side_by_side.one_photo_map(cfg, tmp_path / "small")
    assert small.read_text() == "plan.png;10;20\n3;photos/a b.jpg;1;2\n"
    assert (small.parent / "photos" / "a b.jpg").read_text() == "photos/a b.jpg"
    assert not (small.parent / "photos" / "c.jpg").exists()


def test_photos_of_a_folder_are_known_by_their_endings(tmp_path):
    (tmp_path / "in").mkdir()
    for name in ("b.JPG", "a.png", "list.csv", "in/c.heic"):
        (tmp_path / name).touch()
    assert [p.name for p in side_by_side.photos_in(tmp_path)] == ["a.png", "b.JPG", "c.heic"]


@pytest.mark.skipif(sys.platform == "win32", reason="there are no such figures of a process on Windows")
def test_what_a_program_took_is_measured():
    work = "import json, time; t = bytearray(100 << 20); t[::4096] = b'x' * len(t[::4096])\n"
    work += "s = time.process_time()\nwhile time.process_time() < s + 0.2: pass\nprint(json.dumps({'a': 1}))"
    done = processes.run([sys.executable, "-c", work])
    assert done.printed == {"a": 1}
    assert 0.2 <= done.cpu_seconds <= done.seconds + 0.1
    assert done.peak_rss_mb > 100


@pytest.mark.skipif(sys.platform != "linux", reason="there is no /proc")
def test_private_memory_is_that_without_mapped_files(tmp_path):
    file = tmp_path / "mapped"
    file.write_bytes(bytes(80 << 20))
    work = "import mmap, os, time; t = bytearray(50 << 20); t[::4096] = b'x' * len(t[::4096])\n"
    work += f"m = mmap.mmap(os.open({str(file)!r}, os.O_RDONLY), 0, prot=mmap.PROT_READ); s = m[::4096]\n"
    work += "time.sleep(0.3); print('\"%s\"' % os.environ.get('MALLOC_ARENA_MAX'))"
    done = processes.run([sys.executable, "-c", work], one_heap=True)
    assert done.printed == "1"
    assert done.private_mb is not None and 50 < done.private_mb < 80
    assert done.peak_rss_mb > done.private_mb + 70


@pytest.mark.skipif(sys.platform == "win32", reason="there are no such figures of a process on Windows")
def test_a_program_that_fails_is_reported_with_its_messages():
    fails = [
        sys.executable,
        "-c",
        "import sys; print('[]'); print('no weights', file=sys.stderr); sys.exit(4)",
    ]
    with pytest.raises(processes.ProgramFailed, match="no weights") as caught:
        processes.run(fails)
    assert caught.value.code == 4
    assert json.dumps(processes.run(fails, accepted=(4,)).printed) == "[]"


@pytest.mark.parametrize(("limit", "queries"), [(0, 3), (2, 2)])
def test_each_map_held_out_is_asked_all_its_queries_unless_they_are_limited(
    tmp_path, monkeypatch, limit, queries
):
    (tmp_path / "queries.csv").write_text("path;x;y\n" + "".join(f"{n}.jpg;{n};0\n" for n in range(3)))
    monkeypatch.setattr(held_out, "open_pipeline", lambda *_, **__: SimpleNamespace(opened=None))
    monkeypatch.setattr(held_out.calibrate, "run_trials", lambda *_, **__: {})
    monkeypatch.setattr(held_out, "_case", lambda _, path, truth: (path.name, truth))
    arguments = SimpleNamespace(index=None, limit=limit, foreign=None)
    measured = held_out._measure(tmp_path / "map.cfg", "sift", arguments, within={})
    assert len(measured.queries) == queries and measured.queries[0] == ("0.jpg", (0.0, 0.0))
