"""Tracks in text: NMEA, TUM, KITTI and tables."""

import io
import math
from datetime import UTC, datetime

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from webapp.errors import TrackError
from webapp.files.exchange.times import unix_time
from webapp.missions.files.readers import csv_reader, nmea, trajectory_text
from webapp.missions.files.track_chunks import (
    UNTIMED,
    Findings,
    RobotObjects,
    RobotPiece,
    WorldObjects,
    WorldPiece,
)


def sentence(body: str) -> str:
    """Return an NMEA sentence with its checksum."""
    check = 0
    for letter in body.encode():
        check ^= letter
    return f"${body}*{check:02X}\r\n"


def read_nmea(text: str) -> tuple[list[WorldPiece], Findings]:
    findings = Findings()
    return list(nmea.read(io.BytesIO(text.encode()), findings=findings)), findings


def moment(*parts: int) -> float:
    return datetime(*parts, tzinfo=UTC).timestamp()


def test_sentences_of_one_time_are_one_fix() -> None:
    pieces, findings = read_nmea(
        sentence("GPGGA,235958.50,5005.100,N,01424.200,E,1,08,0.9,245.4,M,46.9,M,,")
        + sentence("GPGST,235958.50,,,,,3.0,4.0,5.0")
        + sentence("GPRMC,235958.50,A,5005.100,N,01424.200,E,10.0,084.4,230324,,")
        + sentence("GPGSV,1,1,00")
        + sentence("GPGGA,000001.00,5005.200,N,01424.200,E,1,08,0.9,246.0,M,46.9,M,,")
    )
    poses = pieces[0].poses
    assert poses.times_s.tolist() == [moment(2024, 3, 23, 23, 59, 58) + 0.5, moment(2024, 3, 24, 0, 0, 1)]
    assert poses.latlon[0] == pytest.approx([50 + 5.1 / 60, 14 + 24.2 / 60])
    assert poses.height_m.tolist() == [245.4, 246.0]
    assert poses.heading_deg[0] == 84.4
    assert math.isnan(poses.heading_deg[1])
    assert poses.covariance_m2[0].tolist() == [16.0, 9.0, 0.0], "to the east first"
    assert not findings.skipped()


def test_fixes_before_the_first_date_have_it_too() -> None:
    pieces, _ = read_nmea(
        sentence("GNGLL,5005.100,S,01424.200,W,235959,A")
        + sentence("GNZDA,000001.00,01,01,2024,00,00")
        + sentence("GNGLL,5005.100,S,01424.200,W,000002,A")
    )
    assert pieces[0].poses.times_s.tolist() == [moment(2023, 12, 31, 23, 59, 59), moment(2024, 1, 1, 0, 0, 2)]
    assert (pieces[0].poses.latlon < 0).all()


def test_what_is_left_out_of_a_log_is_counted() -> None:
    good = sentence("GPRMC,120000,A,5005.1,N,01424.2,E,0.0,,230324,,")
    pieces, findings = read_nmea(
        good
        + good.replace("5005", "5006")
        + "boot\n"
        + sentence("GPRMC,120001,V,,,,,,,230324,,")
        + sentence("GPGGA,120002,,,,,1,,,,M,,M,,")
        + sentence("GPGGA,,5005.1,N,01424.2,E,1,08,0.9,245.4,M,46.9,M,,")
        + sentence("GPGGA,120003,5005.1,N,01424.2,E,x,08,0.9,high,M,46.9,M,,")
    )
    assert len(pieces[0].poses) == 1
    counts = {one.reason: (one.count, one.where) for one in findings.skipped()}
    assert counts["sentences with a wrong checksum"] == (1, "line 2")
    assert counts["lines that are no NMEA sentences"] == (1, "line 3")
    assert counts["fixes marked invalid by the receiver"][0] == 1
    assert counts["times without a position"][0] == 1
    assert counts["sentences without a time"][0] == 1
    assert counts["sentences that cannot be read"][0] == 1


GGA = "GPGGA,12000{},5005.100,{},01424.200,{},{},08,0.9,245.4,M,46.9,M,,"
RMC = "{}RMC,12000{},A,{},N,01424.200,E,1.0,0.0,230324,,,{}"


@pytest.mark.parametrize(
    ("bad", "reason"),
    [
        (sentence(GGA.format(1, "", "E", 1)), "positions without N or S, or without E or W"),
        (sentence(GGA.format(1, "N", "", 1)), "positions without N or S, or without E or W"),
        (sentence(GGA.format(1, "N", "E", 6)), "positions that the receiver estimated without satellites"),
        (sentence(GGA.format(1, "N", "E", 8)), "positions that were simulated or entered by hand"),
        (sentence(RMC.format("GP", 1, "5005.100", "N")), "fixes marked invalid by the receiver"),
        (sentence("GNGNS,120001,5005.1,N,01424.2,E,NN,00,9.9,,,,"), "fixes marked invalid by the receiver"),
        (sentence(GGA.format(1, "N", "E", 1).replace("5005", "5065")), "sentences that cannot be read"),
        ("$GPRMC,120001,A,5005.100,N,01424.200\r\n", "sentences that are cut off"),
        ("$GPRMC,120001,A,5005.100,N,014\r\n", "sentences that are cut off"),
        ("$GPRMC,120001,A,5005.100,N,01424.200,E,1.0,0.0,230324,,,A\r\n", "sentences that are cut off"),
    ],
)
def test_sentences_without_a_whole_position_are_left_out_and_counted(bad: str, reason: str) -> None:
    good = sentence(RMC.format("GP", 0, "5005.100", "A")) + sentence(RMC.format("GP", 2, "5005.200", "A"))
    (piece,), findings = read_nmea(good + bad)
    assert piece.poses.latlon[:, 0] == pytest.approx([50 + 5.1 / 60, 50 + 5.2 / 60])
    assert [(one.reason, one.count) for one in findings.skipped()] == [(reason, 1)]


def test_lower_case_other_line_ends_and_text_after_the_checksum_do_no_harm() -> None:
    text = sentence("GPRMC,120000,A,5005.100,n,01424.200,e,1.0,0.0,230324,,,A")
    for end in ("\r", "\n", ",1777629600000\r\n", " 12:00:01\r"):
        pieces, findings = read_nmea(text.replace("\r\n", end) * 3000)
        assert pieces[0].poses.latlon[0] == pytest.approx([50 + 5.1 / 60, 14 + 24.2 / 60])
        assert not findings.skipped()


def test_gns_alone_is_enough() -> None:
    text = sentence("GNGNS,120001,5005.1,N,01424.2,E,AAN,12,0.8,245.4,46.9,,")
    (piece,), _ = read_nmea(text)
    assert piece.poses.height_m.tolist() == [245.4]


def test_fixes_from_before_the_receiver_knew_the_date_are_left_out() -> None:
    early = "".join(
        sentence(f"GPGGA,00000{n},5005.1,N,01424.2,E,1,08,0.9,245.4,M,46.9,M,,")
        + sentence(f"GPRMC,00000{n},{state},5005.1,N,01424.2,E,1.0,0.0,060180,,,A")
        for n, state in enumerate("VVA")
    )
    late = "".join(sentence(RMC.format("GP", n, "5005.100", "A")) for n in range(3))
    (piece,), findings = read_nmea(early + late)
    assert piece.poses.times_s.tolist() == [moment(2024, 3, 23, 12, 0, n) for n in range(3)]
    assert findings.skipped()[0].reason == "fixes from before the receiver knew the date"
    assert findings.skipped()[0].count == 3
    (piece,), findings = read_nmea(early)
    assert findings.notes == ["the receiver did not know the date: times count from 1980-01-06"]


def test_two_receivers_in_one_log_are_two_tracks() -> None:
    pairs = [
        sentence(RMC.format("GP", n, f"5005.10{n}", "A")) + sentence(RMC.format("GN", n, f"5006.10{n}", "A"))
        for n in range(5)
    ]
    pieces, findings = read_nmea("".join(pairs))
    assert [(piece.track, len(piece.poses)) for piece in pieces] == [("GP", 5), ("GN", 5)]
    assert [piece.poses.latlon[0, 0] for piece in pieces] == pytest.approx([50 + 5.1 / 60, 50 + 6.1 / 60])
    assert findings.notes == ["the fixes of several receivers are separate: GN, GP"]
    one_after_the_other = "".join(pair.split("\r\n")[n >= 3] + "\r\n" for n, pair in enumerate(pairs))
    assert len(read_nmea(one_after_the_other)[0]) == 1, "a receiver may change its talker"


def read_text(text: str, layout: trajectory_text.Layout) -> tuple[list[RobotPiece], Findings]:
    findings = Findings()
    return list(trajectory_text.read(io.BytesIO(text.encode()), layout, findings=findings)), findings


def test_a_tum_trajectory_is_read() -> None:
    pieces, findings = read_text(
        "# a remark\n1.5 1 2 3 0 0 0.7071067811865476 0.7071067811865476\n2.5 nan 2 3 0 0 0 1\n1 2\n", "tum"
    )
    poses = pieces[0].poses
    assert poses.times_s.tolist() == [1.5]
    assert poses.xyz_m.tolist() == [[1.0, 2.0, 3.0]]
    assert poses.yaw_rad[0] == pytest.approx(math.pi / 2)
    assert findings.skipped()[0].count == 2


def test_a_kitti_trajectory_is_turned_from_the_camera() -> None:
    # 10 m ahead, 3 m to the right, 1 m down, turned a quarter to the right
    pieces, findings = read_text("1 0 0 0 0 1 0 0 0 0 1 0\n0 0 1 3 0 1 0 1 -1 0 0 10\n", "kitti")
    poses = pieces[0].poses
    assert poses.times_s.tolist() == [0.0, 0.1]
    assert poses.xyz_m[1].tolist() == [10.0, -3.0, -1.0]
    assert poses.yaw_rad == pytest.approx([0.0, -math.pi / 2])
    assert "ten a second" in findings.notes[0]


def test_a_trajectory_without_poses_is_refused() -> None:
    with pytest.raises(TrackError, match="no pose"):
        read_text("# nothing\n", "tum")


def read_csv(text: str | bytes, columns: str | None = None) -> tuple[list[object], Findings]:
    findings = Findings()
    data = text.encode() if isinstance(text, str) else text
    return list(csv_reader.read(io.BytesIO(data), columns=columns, findings=findings)), findings


@pytest.mark.parametrize("delimiter", [",", ";", "\t", "|"])
def test_tables_of_any_delimiter_are_read(delimiter: str) -> None:
    comma = "," if delimiter == ";" else "."
    rows = ["time,lat,lon,accuracy", "2024-03-23T12:00:00Z,50@5,14@25,2", "1711195201,50@6,14@25,", "x,,1,2"]
    text = "\r\n".join(rows).replace(",", delimiter).replace("@", comma)
    (piece,), findings = read_csv(b"\xef\xbb\xbf" + text.encode())
    assert isinstance(piece, WorldPiece)
    assert piece.poses.times_s.tolist() == [1711195200.0, 1711195201.0]
    assert piece.poses.latlon.tolist() == [[50.5, 14.25], [50.6, 14.25]]
    assert piece.poses.covariance_m2[0].tolist() == [4.0, 4.0, 0.0]
    assert np.isnan(piece.poses.covariance_m2[1]).all()
    assert findings.skipped()[0].reason == "rows without a position"
    assert findings.skipped()[0].where == "line 4"


def test_a_table_without_a_header_needs_numbers() -> None:
    (piece,), _ = read_csv("1700000000000 500000000 142500000\n", "time=1:ms, lat=2:e7, lon=3:e7")
    assert piece.poses.times_s.tolist() == [1700000000.0]
    assert piece.poses.latlon[0] == pytest.approx([50.0, 14.25])
    with pytest.raises(TrackError, match="no columns of positions"):
        read_csv("1700000000,50,14\n")


@pytest.mark.parametrize("zeros", ["", "000", "000000", "000000000"])
def test_times_of_any_unit_are_seconds(zeros: str) -> None:
    (piece,), _ = read_csv(f"time,lat,lon\n1711195200{zeros},50,14\n")
    assert piece.poses.times_s.tolist() == [1711195200.0]


def test_a_carriage_return_within_a_line_is_a_space() -> None:
    findings = Findings()
    text = b"time,lat,lon,id\n1,50,14,a\rb\n2,\r50,14,c\n"
    pieces = list(csv_reader.read(io.BytesIO(text), columns=None, findings=findings))
    found = [one for piece in pieces if isinstance(piece, WorldObjects) for one in piece.sightings]
    assert [one.object_id for one in found] == ["a b", "c"]


def test_rows_with_an_id_are_objects() -> None:
    pieces, _ = read_csv("t,x,y,id,class,score\n1,0,0,,,\n2,3,1,car7,car,0.5\n3,1,0,,,\n")
    first, objects, last = pieces
    assert isinstance(first, RobotPiece), "the frame begins before what is seen in it"
    assert isinstance(objects, RobotObjects)
    assert objects.sightings[0].xyz_m == (3.0, 1.0, 0.0)
    assert (objects.sightings[0].kind, objects.sightings[0].confidence) == ("car", 0.5)
    assert last.poses.times_s.tolist() == [3.0]
    (world,), _ = read_csv("time,lat,lon,id\n5,50,14,bin\n")
    assert isinstance(world, WorldObjects)
    assert world.sightings[0].kind == "object"


def test_sources_of_a_table_stay_apart() -> None:
    pieces, _ = read_csv("source,track,time,lat,lon\ngps,,1,50,14\nfused,,1,50,14\nelse,,2,50,14\n")
    assert {piece.source: len(piece.poses) for piece in pieces} == {"gps": 2, "fused": 1}


def test_tracks_of_a_table_stay_apart_and_keep_their_order() -> None:
    pieces, findings = read_csv("track,lat,lon\na,50,14\nb,51,14\na,50.1,14\n")
    assert {piece.track: piece.poses.times_s.tolist() for piece in pieces} == {"a": [0.0, 1.0], "b": [0.0]}
    assert not any(piece.timed for piece in pieces)
    assert findings.notes == [UNTIMED]


@pytest.mark.parametrize(
    ("text", "seconds"),
    [
        ("1970-01-02T00:00:00Z", 86400.0),
        ("1970-01-01T01:00:00.25+01:00", 0.25),
        ("19700101T000001", 1.0),
        ("1970-01-01 00:01", 60.0),
        ("1970-01-02", 86400.0),
        ("1901-12-13T20:45:52Z", -2147483648.0),
        ("2016-12-31T23:59:60Z", 1483228800.0),
    ],
)
def test_times_are_read(text: str, seconds: float) -> None:
    assert unix_time(text) == seconds


@given(
    st.one_of(st.text(max_size=30), st.from_regex(r"[0-9]{4}-[0-9]{2}-[0-9]{2}T[0-9:]{8}(Z|[+-][0-9:]{5})"))
)
def test_what_is_no_time_is_nan(text: str) -> None:
    assert isinstance(unix_time(text), float)
