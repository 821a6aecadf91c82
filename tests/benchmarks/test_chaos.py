"""`benchmarks.chaos` detects lost and duplicate edits and long outages."""

from types import SimpleNamespace

import pytest

from benchmarks.chaos import _edit_problems, _longest
from benchmarks.chaos_load import Refusals
from benchmarks.editing_checks import Final

pytestmark = pytest.mark.slow

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
    load = SimpleNamespace(editors=list(editors))
    return _edit_problems(load, SLUG, first=first, served=served, final=final)


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
    found = _longest(Refusals(times=times), [(101.0, 103.0), (190.0, 201.0)])
    assert found == {"s": 2.5, "with_the_database_away_s": 9.0, "request": "a", "refusals": 4}
