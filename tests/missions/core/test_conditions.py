"""Conditions are parsed to trees, and each error has a position."""

import pytest
from hypothesis import given
from hypothesis import strategies as st

from webapp.errors import UsageError
from webapp.missions.core.filters import (
    MAX_CHARACTERS,
    MAX_DEPTH,
    AllOf,
    Among,
    AnyOf,
    Between,
    Comparison,
    Like,
    Not,
    SortOrder,
    Unknown,
    parse_columns,
    parse_condition,
    parse_order,
)

COLUMNS = {"class": "text", "confidence": "number", "time": "time"}
CAR = Comparison("class", "=", "car")


def parsed(text):
    return parse_condition(text, COLUMNS)


@pytest.mark.parametrize(
    ("text", "expected"),
    [
        ("", None),
        ("  \n", None),
        ("class = 'car'", CAR),
        ("CLASS='car'", CAR),
        ("(class == 'car')", CAR),
        ("class <> 'car'", Comparison("class", "!=", "car")),
        ("class = 'it''s'", Comparison("class", "=", "it's")),
        ("class = ''", Comparison("class", "=", "")),
        ("confidence>=-.5e1", Comparison("confidence", ">=", -5.0)),
        ("confidence < 1.", Comparison("confidence", "<", 1.0)),
        ("confidence between 0 and 1 and class='car'", AllOf((Between("confidence", 0, 1), CAR))),
        ("class not in ('a','b')", Not(Among("class", ("a", "b")))),
        ("class like '%r'", Like("class", "%r")),
        ("confidence is null", Unknown("confidence")),
        ("confidence is not null", Not(Unknown("confidence"))),
        ("not not class = 'car'", Not(Not(CAR))),
        ("time > '1970-01-02'", Comparison("time", ">", 86400.0)),
        ("time > '1970-01-02T02:00:00+02:00'", Comparison("time", ">", 86400.0)),
        ("time > 5", Comparison("time", ">", 5.0)),
    ],
)
def test_a_condition_is_understood(text, expected):
    assert parsed(text) == expected


def test_and_binds_more_than_or_and_not_more_than_and():
    tree = parsed("class='a' or not class='b' and class='c'")
    a, b, c = (Comparison("class", "=", letter) for letter in "abc")
    assert tree == AnyOf((a, AllOf((Not(b), c))))
    assert parsed("(class='a' or class='b') and class='c'") == AllOf((AnyOf((a, b)), c))


@pytest.mark.parametrize(
    ("text", "at", "message"),
    [
        ("clas = 'car'", 1, "no column"),
        ("class = 'car' AND", 18, "a column"),
        ("class = 'car", 9, "unterminated"),
        ("class = car", 9, "single quotes"),
        ('class = "car"', 9, "unexpected character"),
        ("class ; drop table", 7, "unexpected character"),
        ("class = 'a' -- x", 13, "unexpected character"),
        ("class = 5", 9, "expected text"),
        ("confidence = 'x'", 14, "a number"),
        ("confidence like 'x'", 12, "LIKE"),
        ("confidence = 1e999", 14, "too large"),
        ("(class = 'car'", 15, '")"'),
        ("class = 'car')", 14, "the end"),
        ("class in ()", 11, "expected text"),
        ("class in ('a' 'b')", 15, "a comma"),
        ("class between 'a' or 'b'", 19, "AND"),
        ("class is 5", 10, "NULL"),
        ("class", 6, "a comparison"),
        ("time > 'yesterday'", 8, "not a time"),
        ("1 = 1", 1, "a column"),
        ("select = 1", 1, "no column"),
        ("and = 1", 1, "a column"),
        ("class = 'a\x00b'", 11, "invalid character"),
        ("class = '\ud800'", 10, "invalid character"),
    ],
)
def test_an_error_has_its_position(text, at, message):
    with pytest.raises(UsageError) as caught:
        parsed(text)
    assert caught.value.where == f"where, character {at}"
    assert message in caught.value.message


def test_what_is_too_deep_long_or_many_is_refused():
    deepest = "(" * MAX_DEPTH + "class='a'" + ")" * MAX_DEPTH
    assert parsed(deepest) == Comparison("class", "=", "a")
    for text in (f"({deepest})", "not " * 1000 + "class='a'", "x" * (MAX_CHARACTERS + 1)):
        with pytest.raises(UsageError):
            parsed(text)
    with pytest.raises(UsageError, match="200 values"):
        parsed(f"confidence in ({','.join('1' * 300)})")


def test_columns_and_orders():
    assert parse_columns("", COLUMNS) == parse_columns("*", COLUMNS) == list(COLUMNS)
    assert parse_columns("time, CLASS,time", COLUMNS) == ["time", "class"]
    assert parse_order("", COLUMNS) == []
    assert parse_order("time desc, class asc,confidence", COLUMNS) == [
        SortOrder("time", True),
        SortOrder("class", False),
        SortOrder("confidence", False),
    ]
    for parse in (parse_columns, parse_order):
        for text in ("time,", "time time2", "count(*)", "time; select", "password", "*,time", "1"):
            with pytest.raises(UsageError, match="character"):
                parse(text, COLUMNS)


words = st.sampled_from(
    [
        "class",
        "time",
        "'a'",
        "''",
        "5",
        "-1e3",
        "and",
        "OR",
        "not",
        "(",
        ")",
        "in",
        "between",
        "like",
        "is",
        "null",
        "=",
        "!=",
        "<",
        ",",
        "*",
        "--",
        ";",
        "'",
        '"',
        "\\",
        "0x1",
        "%",
        "é",
        "\x00",
    ]
)


@given(st.one_of(st.lists(words, max_size=30).map(" ".join), st.text(max_size=60)))
def test_any_text_is_understood_or_refused_with_its_place(text):
    for parse in (parse_condition, parse_columns, parse_order):
        try:
            parse(text, COLUMNS)
        except UsageError as error:
            at = int(error.where.rpartition(" ")[2])
            assert 1 <= at <= len(text) + 1
