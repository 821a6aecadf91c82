"""Filters in CQL2 text: what the classes *CQL2 Text* and *Basic CQL2* (OGC 21-065r2) demand."""

import pytest

from webapp.connect.gis.cql2 import MAX_DEPTH, parse_filter
from webapp.errors import UsageError

KINDS = {"n": "number", "s": "text", "t": "time", "b": "boolean", "a:b.c": "text", "or": "text"}
VALUES = {"n": 5, "s": "it's", "t": "2026-05-01T10:00:00+02:00", "b": True, "a:b.c": "x", "or": "y"}


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("n = 5", True), ("n <> 5", False), ("n<4.9", False), ("n >= +5.0e0", True), ("n<=-.5", False),
        ("5 < n", False), ("4 < n", True), ("5 >= n", True), ("s = 'it''s'", True), (r"s = 'it\'s'", True),
        ("s < 'j'", True), ("s='IT''S'", False),
        ("b = TRUE", True), ("false = b", False), ("TRUE", True), ("not true", False), ("n is null", False),
        ("n IS NOT NULL", True), ('"a:b.c" = \'x\' AND a:b.c = \'x\'', True), ('"or" = \'y\'', True),
        ("t = TIMESTAMP('2026-05-01T08:00:00Z')", True), ("t > timestamp('2026-05-01T08:00:00.5Z')", False),
        ("t = DATE('2026-05-01')", True), ("t > DATE('2026-05-01')", False), ("DATE('2026-04-30') < t", True),
        ("n = 1 OR n = 5 AND s = 'x'", False), ("(n = 1 OR n = 5) AND s <> 'x'", True),
        ("NOT n = 1 AND NOT (n = 2 OR n = 3)", True), ("NOT NOT n = 5", True),
    ],
)  # fmt: skip
def test_a_filter_holds_or_not(text, wanted):
    assert parse_filter(text, KINDS)(VALUES) is wanted


@pytest.mark.parametrize(
    ("text", "wanted"),
    [
        ("n = 5", None), ("n <> 5", None), ("NOT n = 5", None), ("n IS NULL", True), ("n IS NOT NULL", False),
        ("n = 5 OR TRUE", True), ("n = 5 OR FALSE", None), ("n = 5 AND FALSE", False),
        ("TRUE AND n = 5", None), ("t < DATE('2026-05-01')", None),
    ],
)  # fmt: skip
def test_what_is_unknown_neither_holds_nor_fails(text, wanted):
    assert parse_filter(text, KINDS)({"n": None, "t": "in spring"}) is wanted


@pytest.mark.parametrize(
    ("text", "at", "said"),
    [
        ("", 1, "expected a property or a value, not the end"),
        ("n", 2, "expected =, <>"),
        ("n = ", 5, "expected a number, not the end"),
        ("n = 'a'", 5, "n is compared with a number"),
        ("s = 5", 5, "s is compared with text in single quotes"),
        ("t = '2026-05-01'", 5, "t is compared with TIMESTAMP"),
        ("5 = s", 1, "s is compared with text"),
        ("n = 1e999", 5, "expected a number"),
        ("m = 5", 1, '"m" is not a property here'),
        ("n = n", 5, "expected a number"),
        ("1 = 1", 5, "expected a property"),
        ("n = 5 n = 5", 7, "expected AND, OR or the end"),
        ("n = 5 AND", 10, "expected a property or a value"),
        ("(n = 5", 7, 'expected AND, OR or ")"'),
        ("n = 5)", 6, "expected AND, OR or the end"),
        ("n == 5", 4, "expected a number"),
        ("n != 5", 3, 'unexpected character "!"'),
        ("s LIKE 'i%'", 3, "expected =, <>"),
        ("s = 'it", 5, "unterminated text"),
        ("n IS 5", 6, "expected NULL"),
        ("t = DATE('2026-05-01T10:00:00Z')", 10, "not a date"),
        ("t = TIMESTAMP('2026-05-01')", 15, "not a time"),
        ("t = TIMESTAMP('2026-13-01T10:00:00Z')", 15, "not a time"),
        ("t = DATE '2026-05-01'", 10, 'expected "("'),
        ("n = 5 AND s = ‘x’", 15, "unexpected character"),
        ("(" * 100 + "n = 5" + ")" * 100, MAX_DEPTH + 1, "nested"),
        ("NOT " * 100 + "n = 5", 4 * MAX_DEPTH + 1, "nested"),
        ("n = 5 OR " * 300 + "n = 5", 2001, "more than 2000 characters"),
    ],
)  # fmt: skip
def test_what_is_not_a_filter_is_refused_where_it_is(text, at, said):
    with pytest.raises(UsageError) as refused:
        parse_filter(text, KINDS)
    assert refused.value.where == f"filter, character {at}"
    assert said in refused.value.message


def test_a_long_chain_is_no_nesting():
    assert parse_filter(" OR ".join(["n=1"] * 280 + ["n=5"]), KINDS)(VALUES) is True
