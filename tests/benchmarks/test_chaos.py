"""`benchmarks.chaos` detects lost and duplicate edits and poses, long outages and errors of old programs."""

import json
from datetime import UTC, datetime
from types import SimpleNamespace

import pytest

from benchmarks.chaos_checks import Tally, edit_problems, longest_refusal, lost_edits, tally
from benchmarks.chaos_load import Refusals, Streak
from benchmarks.chaos_upgrade import Migration, Update, as_tables, old_errors
from benchmarks.editing_checks import Final

SLUG = "park"


def photo(number, revision, x):
    return {"id": number, "revision": revision, "x_px": x, "y_px": x, "heading_deg": None}


def editor(*answers, lost=0):
    known = [
        {"revision": revision, "photos": [photo(number, revision, x)], "known": {}}
        for revision, number, x in answers
    ]
    return SimpleNamespace(lost=lost, log=SimpleNamespace(slug=SLUG, errors=[], answers=known))


SERVED = [photo(0, 4, 8.0), photo(1, 4, 9.0)]


def problems(*editors, served, revision, exported=None):
    first = {"revision": 3, "photos": [photo(0, 1, 5.0), photo(1, 2, None)]}
    rows = {one["id"]: (one["x_px"], one["y_px"], None) for one in served}
    cfg = {one["id"]: (0, 0) for one in served if one["x_px"] is not None}
    final = Final(revision, exported or revision, rows, cfg)
    return edit_problems(list(editors), SLUG, first=first, served=served, final=final)


def test_what_was_acknowledged_last_is_right():
    served = [photo(0, 5, 8.0), photo(1, 4, 9.0)]
    assert problems(editor((4, 1, 9.0)), editor((5, 0, 8.0)), served=served, revision=5) == []


def test_an_edit_without_an_answer_may_be_there_or_not():
    served = [photo(0, 5, 8.0), photo(1, 4, 9.0)]
    assert problems(editor((4, 1, 9.0), lost=1), served=served, revision=5) == []
    assert problems(editor((4, 1, 9.0), lost=1), served=[photo(0, 1, 5.0), served[1]], revision=4) == []


@pytest.mark.parametrize(
    ("editors", "served", "revision", "exported", "problem"),
    [
        ([editor((4, 1, 9.0))], [photo(0, 1, 5.0), photo(1, 2, None)], 4, None, "acknowledged was (9.0, 9.0"),
        ([editor((4, 1, 9.0)), editor((4, 0, 8.0))], SERVED, 4, None, "given twice"),
        ([editor((4, 1, 9.0))], [photo(0, 5, 7.0), photo(1, 4, 9.0)], 5, None, "edits that nobody made"),
        ([editor((4, 1, 9.0))], [photo(0, 1, 5.0), photo(1, 4, 9.0)], 4, 3, "map.cfg has revision 3 of 4"),
    ],
)  # fmt: skip
def test_what_is_lost_double_or_not_exported_is_found(editors, served, revision, exported, problem):
    found = problems(*editors, served=served, revision=revision, exported=exported)
    assert any(problem in one for one in found), found


def test_refusals_while_the_database_was_away_are_counted_apart():
    times = [(10.0, 12.5, "a"), (20.0, 22.0, "b"), (100.0, 109.0, "c"), (205.0, 206.0, "d")]
    found = longest_refusal(Refusals(times=times), [(101.0, 103.0), (190.0, 201.0)])
    assert found == {"s": 2.5, "with_the_database_away_s": 9.0, "request": "a", "refusals": 4}


def test_an_edit_that_a_later_one_without_an_answer_has_changed_is_not_lost():
    first = {"photos": [photo(0, 1, 5.0)]}
    answers = [{"revision": 2, "photos": [photo(0, 2, 6.0)]}]
    for served, lost in (
        (photo(0, 2, 6.0), 0),
        (photo(0, 3, 9.0), 0),
        (photo(0, 2, 9.0), 1),
        (first["photos"][0], 1),
    ):
        assert len(lost_edits(SLUG, answers, first=first, served=[served])) == lost


def test_what_is_lost_and_stored_twice_is_counted():
    assert tally([1.0, 2.0, 3.0], [1.0, 3.0, 3.0, 3.0, 4.0]) == Tally(3, lost=1, double=2)
    assert Tally(3, 1, 2) + Tally(1, 0, 0) == Tally(4, 1, 2)


def test_a_refusal_lasts_from_the_first_failure_to_the_next_success():
    refusals = Refusals()
    streak = Streak(refusals)
    streak.succeeded()
    assert refusals.times == []
    streak.failed("first", since=10.0)
    streak.failed("second", since=11.0)
    streak.succeeded()
    streak.succeeded()
    ((begin, end, what),) = refusals.times
    assert (what, begin, end > begin) == ("first", 10.0, True)


def test_errors_of_old_programs_count_from_the_migration_on(tmp_path):
    log = tmp_path / "8000-old"
    at = "2026-11-30T10:00:{:02}.000+00:00"
    lines = [
        {"time": at.format(1), "level": "error", "message": "too early"},
        {
            "time": at.format(5),
            "level": "info",
            "message": "GET /readyz 503",
            "route": "/readyz",
            "status": 503,
        },
        {"time": at.format(5), "level": "info", "message": "GET /maps 200", "route": "/maps", "status": 200},
        {"time": at.format(6), "level": "info", "message": "GET /maps 503", "route": "/maps", "status": 503},
        {"time": at.format(7), "level": "error", "message": "no column", "traceback": "UndefinedColumn"},
    ]
    log.write_text("\n".join(["a library's line", *map(json.dumps, lines), '{"cut": "o']), "utf-8")
    found = old_errors([log], since=datetime(2026, 11, 30, 10, 0, 2, tzinfo=UTC))
    assert found == ["an old program: GET /maps 503 ", "an old program: no column UndefinedColumn"]


def test_tables_have_what_is_asked_for():
    counts = {"editors": 2, "edits": {"acknowledged": 9, "lost": 1, "double": 2}, "answers": 4}
    update = Update(Migration(datetime.now(UTC), "0025 to 0039", 0.5), 0.0, 61.2)
    lines = as_tables(counts, longest={"s": 1.9, "refusals": 3}, errors=["one"], update=update).splitlines()
    assert "| edits | 9 | 1 | 2 |" in lines
    assert "| longest time without an answer | 1.9 s |" in lines
    assert "| errors of old programs after the migration | 1 |" in lines
    assert "| migration from 0025 to 0039 | 0.5 s |" in lines
