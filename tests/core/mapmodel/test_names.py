"""Valid names of photos in a map, and whole pixels."""

from pathlib import PurePosixPath

import pytest
from hypothesis import given
from hypothesis import strategies as st

from webapp.core.geo.types import round_half_up
from webapp.core.mapmodel.findings import Code, quoted
from webapp.core.mapmodel.paths import name_problem


@pytest.mark.parametrize(
    "name", ["a.jpg", "a b/ž.jpg", "./a.jpg", "a//b.jpg", "..a/b...jpg", "IMG 12:30.jpg", "~/a", "é" * 127]
)
def test_good_names(name: str) -> None:
    assert name_problem(name) is None


@pytest.mark.parametrize(
    ("name", "code", "better"),
    [
        ("/a.jpg", Code.PATH_LEAVES_FOLDER, None),
        ("\\\\server\\a.jpg", Code.PATH_LEAVES_FOLDER, None),
        ("d:\\a.jpg", Code.PATH_LEAVES_FOLDER, None),
        ("HTTP://x/a.jpg", Code.PATH_LEAVES_FOLDER, None),
        ("a/../b.jpg", Code.PATH_LEAVES_FOLDER, "b.jpg"),
        ("a/../../b.jpg", Code.PATH_LEAVES_FOLDER, None),
        ("a\\..\\..\\b.jpg", Code.PATH_LEAVES_FOLDER, None),
        ("a\\b.jpg", Code.BACKSLASH_IN_PATH, "a/b.jpg"),
        ("a.jpg ", Code.UNWRITABLE_NAME, "a.jpg"),
        ("a;b", Code.UNWRITABLE_NAME, None),
        ("a\rb", Code.CONTROL_CHARACTER, None),
        ("  ", Code.EMPTY_NAME, None),
        ("é" * 128, Code.UNWRITABLE_NAME, None),
        ("a/" * 500 + "b", Code.UNWRITABLE_NAME, None),
    ],
)
def test_refused_names(name: str, code: Code, better: str | None) -> None:
    problem = name_problem(name)
    assert problem is not None
    assert (problem.code, problem.better) == (code, better)


@given(st.text(st.sampled_from("./\\a:; C"), max_size=10))
def test_accepted_names_stay_below_the_folder(name: str) -> None:
    if name_problem(name) is None:
        path = PurePosixPath(name)
        assert not path.is_absolute() and ".." not in path.parts and "\\" not in name


@given(st.floats(-1e6, 1e6))
def test_rounding_is_to_the_nearest(value: float) -> None:
    assert abs(round_half_up(value) - value) <= 0.5 + 1e-9


@given(st.text())
def test_quoted_text_is_one_printable_line(text: str) -> None:
    assert "\n" not in quoted(text) and quoted(text).encode() and len(quoted(text)) < 700
