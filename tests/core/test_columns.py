"""Recognising the columns of a table."""

import re
import time
from pathlib import Path

import pytest

from webapp.core.columns import POSE_FIELDS, Column, guess_columns, parse_columns, read_header
from webapp.errors import TrackError, UsageError

HEADER = ["stamp", "Latitude", "Longitude", "yaw", "a:b"]


def test_columns_are_named_or_numbered_with_units() -> None:
    found = parse_columns("time=stamp:ms, lat=latitude, lon=3:e7, heading=yaw:rad, height=a:b", HEADER)
    assert found["time"] == Column(0, 1e-3)
    assert found["lat"] == Column(1, 1.0)
    assert found["lon"] == Column(2, 1e-7)
    assert found["heading"].scale == pytest.approx(57.29577951)
    assert found["height"] == Column(4, 1.0), "a colon can belong to the name"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("speed=stamp", "not a field"),
        ("time", "not a field"),
        ("time=when", "no column"),
        ("time=9", "no column"),
        ("lat=2:furlong, lon=3", "no unit"),
        ("time=1", "no column holds a position"),
        ("time=1, lat=2", "only one of the two"),
    ],
)
def test_bad_columns_are_refused(text: str, message: str) -> None:
    with pytest.raises(UsageError, match=message):
        parse_columns(text, HEADER)


@pytest.mark.parametrize(
    ("header", "expected"),
    [
        (
            "timestamp_ms;Latitude [deg];Longitude [deg];Alt (ft)",
            {"time": 1e-3, "lat": 1, "lon": 1, "height": 0.3048},
        ),
        ("t,x,y,theta", {"time": 1, "x": 1, "y": 1, "yaw": 1}),
        ("GPS Lat,GPS Lon,height_m,heading_deg", {"lat": 1, "lon": 1, "height": 1, "heading": 1}),
        ("id,class,lat,lon,confidence", {"id": 1, "class": 1, "lat": 1, "lon": 1, "confidence": 1}),
        ("time,time_s,lat,lon,var_e_m2", {"time": 1, "lat": 1, "lon": 1, "var_e": 1}),
    ],
)
def test_headers_are_guessed(header: str, expected: dict[str, float]) -> None:
    found = guess_columns(header.split(";" if ";" in header else ","))
    assert {field: column.scale for field, column in found.items()} == expected


def test_a_table_without_known_columns_is_refused() -> None:
    with pytest.raises(TrackError, match="no columns of positions"):
        guess_columns(["a", "b"])


def test_the_docs_have_every_field_and_unit() -> None:
    text = (Path(__file__).resolve().parents[2] / "docs" / "track-files.md").read_text(encoding="utf-8")
    table = text.split("| field | units | what |")[1].split("\n\n")[0]
    message = {
        field: [unit for unit in units.strip().split(", ") if unit]
        for fields, units in re.findall(r"^\| (`[^|]+) \|([^|]*)\|", table, re.MULTILINE)
        for field in re.findall(r"`(\w+)`", fields)
    }
    assert message.keys() == POSE_FIELDS.units.keys()
    for field, units in POSE_FIELDS.units.items():
        assert set(filter(None, units)) <= set(message[field]), field


@pytest.mark.parametrize(
    "cell", ["a" + "_" * 30_000 + "b", "x" + "(a)" * 2000, "a" + " /" * 8000, "\ufdfa" * 90]
)
def test_long_cells_are_no_headers_and_take_no_time(cell: str) -> None:
    before = time.process_time()
    assert [read_header(cell).field for _ in range(20)] == [None] * 20
    with pytest.raises(TrackError):
        guess_columns([cell, "b"])
    with pytest.raises(UsageError):
        parse_columns("lat=1, lon=2:parsec", [cell, cell])
    assert time.process_time() - before < 1
