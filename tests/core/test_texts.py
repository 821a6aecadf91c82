"""Texts of users may have any letter, but no control characters."""

import pytest

from webapp.core.geo.floors import floor_name_problem
from webapp.core.mapmodel.control_points import name_problem
from webapp.core.mapmodel.notes import NOTE_TEXT, title_problem
from webapp.core.texts import has_controls, is_line, looks, plain, significant, tidy_name, visible

FAMILY = "👨\u200d👩\u200d👧"


@pytest.mark.parametrize("line", ["Où\u00a0?", "«\u202fParc\u202f»", FAMILY, "شاهد\u200c", "\U0001fae9"])
def test_lines_have_no_break_spaces_joined_emoji_and_new_ones(line):
    assert is_line(line, most=60)
    assert [
        check(line) for check in (title_problem, NOTE_TEXT.problem, floor_name_problem, name_problem)
    ] == [None] * 4


@pytest.mark.parametrize(
    "line",
    [
        *("", " a", "a\u00a0", "a\nb", "a\x00", "a\x85b", "a\u2028b", "a\ud800", "a\uffff", "a" * 121),
        *("\u200b", "\u200d\u200d", "a\u202eb", "\u2067a"),
    ],
)
def test_what_is_no_line(line):
    assert not is_line(line, most=120)
    assert all(check(line) for check in (title_problem, floor_name_problem, name_problem))


def test_line_breaks_are_controls_unless_they_are_allowed():
    assert has_controls("a\nb") and not has_controls("a\nb", besides="\n\t")
    assert has_controls("a\n\x07", besides="\n")


@pytest.mark.parametrize(
    ("name", "kept"),
    [
        ("  Parc\u00a0: \u202f nord ", "Parc : nord"),
        ("Cafe\u0301", "Café"),
        (FAMILY, FAMILY),
        ("a\u202eb\u2066c", "abc"),
        ("\u200b\u200d", None),
        ("\u202e", None),
        ("a\x00b", None),
        ("x" * 13, None),
    ],
)
def test_names_are_kept_tidy(name, kept):
    assert tidy_name(name, most=12) == kept


def test_what_looks_the_same_is_found_but_letters_of_other_case_are_others():
    assert {visible(name) for name in ("gate 1", "gate\u00a01", "ga\u200bte  1")} == {"gate 1"}
    assert visible("Gate 1") != visible("gate 1")


def test_names_that_look_the_same_are_the_same():
    assert {plain(name) for name in ("Ana B", "ANA\u00a0b", "a\u200bna  b", "Ａna b")} == {"ana b"}


@pytest.mark.parametrize(
    ("one", "other"),
    [
        ("Jana", "J\u0430n\u0430"),  # Cyrillic
        ("JANA", "\u0408\u0410\u039d\u0410"),  # Cyrillic and Greek capitals
        ("Caf\u00e9", "cafe\u0301"),
        ("admin", "adm\u0131n"),
        ("owner", "\u043ewner\u200b"),
        ("Petr Nov\u00e1k", "Petr\u202f Nov\u00e1k\u00ad"),
    ],
)
def test_names_that_look_alike(one, other):
    assert looks(one) == looks(other)


@pytest.mark.parametrize(
    ("one", "other"), [("Jana", "Jan"), ("Иван", "Олег"), ("Zoé", "Zoe"), ("Лев", "Лёв")]
)
def test_names_that_do_not_look_alike(one, other):
    assert looks(one) != looks(other)


@pytest.mark.parametrize("power", range(-9, 10))
def test_a_number_of_any_size_has_its_three_first_digits(power):
    for n in range(1, 1000, 7):
        value = (1.0 + n * 0.008999) * 10.0**power
        text = significant(value)
        assert "e" not in text.lower()
        assert abs(float(text) - value) <= 0.0051 * value, (value, text)
        assert float(significant(-value)) == -float(text)


def test_round_numbers_are_short():
    assert [significant(n) for n in (0.0, 0.0999, 0.1, 999.7, 1234.5, 2.0)] == [
        "0",
        "0.0999",
        "0.1",
        "1000",
        "1230",
        "2",
    ]
