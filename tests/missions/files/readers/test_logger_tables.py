"""Tables of loggers and datasets: columns, units, dates and axes of many kinds."""

import io
import math
import time

import numpy as np
import pytest

from webapp.errors import UsageError
from webapp.files.exchange.times import unix_time
from webapp.missions.files.readers import csv_reader
from webapp.missions.files.readers.csv_table import table_head
from webapp.missions.files.track_chunks import (
    BAD_COVARIANCE,
    FEW_TIMES,
    NO_TIME,
    Findings,
    RobotPiece,
    WorldObjects,
    WorldPiece,
)


def read(text: str, **options: str) -> tuple[list[object], Findings]:
    findings = Findings()
    columns, axes = options.get("columns"), options.get("axes")
    return list(
        csv_reader.read(io.BytesIO(text.encode()), columns=columns, axes=axes, findings=findings)
    ), findings


def test_a_logger_with_hemispheres_units_and_two_columns_of_time() -> None:
    (piece,), findings = read(
        "INDEX,DATE,TIME,VALID,LATITUDE,N/S,LONGITUDE,E/W,HEIGHT,SPEED,HEADING,\n"
        "1,2008/01/27,13:03:22.836,No fix,57.7,S,12.0,W,98.470 m,0.000 km/h,10.0,\n"
        "2,2008/01/27,14:14:35.500,SPS,57.7,S,12.0,W,22.480 m,0.000 km/h,10.0,\n"
        "3,2008/01/27,14:14:36.500,SPS,57.7,N,12.0,E,75 ft,0.000 km/h,20.0,\n"
    )
    assert isinstance(piece, WorldPiece)
    assert piece.poses.latlon.tolist() == [[-57.7, -12.0], [57.7, 12.0]]
    assert piece.poses.times_s[0] == unix_time("2008-01-27T14:14:35.5Z")
    assert piece.poses.height_m.tolist() == pytest.approx([22.48, 22.86])
    assert piece.poses.heading_deg.tolist() == [10.0, 20.0]
    assert [one.reason for one in findings.skipped()] == ["fixes marked invalid by the receiver"]


@pytest.mark.parametrize(
    "place",
    ["S50 06.000,W14 30.000", "50.1°S,14.5°W", '"50°06\'00.0"" S","14°30\'00.0"" W"', "-50 6 0,-14 30 0"],
)
def test_angles_in_degrees_minutes_and_seconds(place: str) -> None:
    (piece,), _ = read(f"No,Latitude,Longitude\n1,{place}\n")
    assert piece.poses.latlon[0] == pytest.approx([-50.1, -14.5])


def test_a_hemisphere_in_a_column_without_a_name() -> None:
    (piece,), _ = read("Lat\t\tLon\t\tAltitude (m)\n50.5\tS\t14.5\tW\t300\n")
    assert piece.poses.latlon.tolist() == [[-50.5, -14.5]]
    assert piece.poses.height_m.tolist() == [300.0]


@pytest.mark.parametrize(
    ("rows", "expected"),
    [
        (["27/01/2008,10:00:00"], "2008-01-27T10:00:00Z"),
        (["01/02/2008,10:00:00", "01/27/2008,10:00:00"], "2008-01-02T10:00:00Z"),
        (["01.02.2008,10:00"], "2008-02-01T10:00:00Z"),
        (["080127,100000"], "2008-01-27T10:00:00Z"),
        (["27-Jan-2008,1:00:00 PM"], "2008-01-27T13:00:00Z"),
        (["01/02/2008,10:00:00"], None),
        (["2008-01-27,"], None),
    ],
)
def test_dates_are_read_in_their_order_or_not_at_all(rows: list[str], expected: str | None) -> None:
    (piece,), findings = read("Date,Time,lat,lon\n" + "".join(f"{row},50,14\n" for row in rows))
    assert piece.timed == (expected is not None)
    if expected:
        assert piece.poses.times_s[0] == unix_time(expected)
    else:
        assert "nothing in the column" in findings.notes[-2]


def test_the_order_of_dates_can_be_given() -> None:
    (piece,), _ = read(
        "d,t,lat,lon\n01/02/2008,10:00,50,14\n", columns="date=d:dmy, time=t, lat=lat, lon=lon"
    )
    assert piece.poses.times_s[0] == unix_time("2008-02-01T10:00:00Z")


def test_days_of_a_spreadsheet_are_times() -> None:
    (piece,), _ = read("day,lat,lon\n38542.5,50,14\n", columns="time=day:excel, lat=lat, lon=lon")
    assert piece.poses.times_s.tolist() == [unix_time("2005-07-09T12:00:00Z")]


def test_a_column_of_times_that_has_none_is_refused() -> None:
    with pytest.raises(UsageError, match="nothing in the column 'name' is a time"):
        read("name,lat,lon\nbin,50,14\n", columns="time=name, lat=lat, lon=lon")


def test_no_time_is_invented() -> None:
    (piece,), findings = read("time,lat,lon\n100,50,14\n,50.1,14\n102,50.2,14\n")
    assert piece.poses.times_s.tolist() == [100.0, 102.0]
    assert [(one.reason, one.where) for one in findings.skipped()] == [(NO_TIME, "line 3")]
    (piece,), findings = read("time,lat,lon\n100,50,14\n,50.1,14\n,50.2,14\n")
    assert not piece.timed
    assert len(piece.poses) == 3
    assert [one.reason for one in findings.skipped()] == [FEW_TIMES]


EUROC = (
    "#timestamp [ns], p_RS_R_x [m], p_RS_R_y [m], p_RS_R_z [m], q_RS_w [], q_RS_x [], q_RS_y [], q_RS_z []\n"
    "1403636580838555648,4.5,-1.7,0.7,1,0,0,0\n"
    "1403636580843555648,4.6,-1.7,0.7,0.7071067811865476,0,0,0.7071067811865476\n"
)


def test_a_header_that_is_a_remark_and_orientations_as_quaternions() -> None:
    (piece,), _ = read(EUROC)
    assert isinstance(piece, RobotPiece)
    assert piece.poses.times_s == pytest.approx([1403636580.838555648, 1403636580.843555648], abs=1e-6)
    assert piece.poses.xyz_m[0].tolist() == [4.5, -1.7, 0.7]
    assert piece.poses.yaw_rad == pytest.approx([0.0, math.pi / 2])


def test_numbers_of_frames_are_times_where_they_are_nanoseconds() -> None:
    header = "# frame_id, translation_x, translation_y, translation_z\n"
    (piece,), _ = read(header + "1585745345000000000,1,2,3\n")
    assert (piece.timed, piece.poses.times_s.tolist()) == (True, [1585745345.0])
    (piece,), _ = read(header + "7,1,2,3\n8,2,2,3\n")
    assert not piece.timed


def test_headings_on_the_earth_come_from_quaternions() -> None:
    (piece,), _ = read("time,lat,lon,qx,qy,qz,qw\n1e9,50,14,0,0,0,1\n2e9,50,14,0,0,1,0\n")
    assert piece.poses.heading_deg.tolist() == pytest.approx([90.0, 270.0])


@pytest.mark.parametrize("spread", ["-5,1,0", "1,1,2", "1e300,1,0"])
def test_a_covariance_of_an_object_that_is_none_is_left_out(spread: str) -> None:
    header = "time,lat,lon,id,class,var_e_m2,var_n_m2,cov_en_m2"
    text = f"{header}\n1,50,14,car 1,car,4,2,1\n2,50,14,car 2,car,{spread}\n3,50,14,car 3,car,,,\n"
    pieces, findings = read(text)
    seen = [piece.sightings[0] for piece in pieces if isinstance(piece, WorldObjects)]
    assert [one.covariance_m2 for one in seen] == [(4.0, 2.0, 1.0), None, None]
    assert BAD_COVARIANCE in findings.notes


def test_axes_of_a_table_can_be_given() -> None:
    (piece,), _ = read("time,x,y,z\n1,10,2,3\n", axes="camera")
    assert piece.poses.xyz_m.tolist() == [[3.0, -10.0, -2.0]]
    (piece,), _ = read("time,x,y,z\n1,10,2,3\n", axes="ned")
    assert np.allclose(piece.poses.xyz_m, [[10.0, -2.0, -3.0]])


@pytest.mark.parametrize(
    "text",
    [
        "# " + "a" + "_" * 60_000 + "b\n1;2\n",
        ("# " + "a,b" * 10_000 + "\n") * 100 + "1;2\n",
        ";".join(["t"] * 5000) + ";lat;lon\n" + (";".join(["1"] * 5000) + ";50;14\n") * 200,
    ],
    ids=["long comment", "many comments", "many times"],
)
def test_the_head_of_a_strange_table_takes_little_time(tmp_path, text):
    (tmp_path / "log.csv").write_text(text)
    before = time.process_time()
    table_head(tmp_path / "log.csv", None)
    assert time.process_time() - before < 1.5


def test_a_header_in_a_comment_is_found_above_others(tmp_path):
    comments = "# time, lat, lon\n" + "# made by a logger of five words\n" * 100
    (tmp_path / "log.csv").write_text(f"{comments}1,50,14\n")
    assert table_head(tmp_path / "log.csv", None).columns == {"time": 0, "lat": 1, "lon": 2}


def test_times_that_begin_late_are_kept(monkeypatch):
    monkeypatch.setattr(csv_reader, "_SAMPLED", 20)
    rows = ["time,lat,lon", *[",50,14"] * 18, *(f"{number},50,14" for number in range(1000, 1060))]
    pieces, findings = read("\n".join(rows))
    assert [piece.timed for piece in pieces] == [True]
    assert sum(len(piece.poses) for piece in pieces) == 60
    assert [(one.reason, one.count) for one in findings.skipped()] == [(NO_TIME, 18)]


@pytest.mark.parametrize(
    ("header", "page"),
    [
        ("Čas;Zeměpisná šířka;Zeměpisná délka;Nadmořská výška", "cp1250"),
        ("Čas;Šířka;Délka;Výška", "cp1250"),
        ("Zeit;Geografische Breite;Geografische Länge;Höhe", "cp1252"),
        ("Uhrzeit;Nördliche Breite;Östliche Länge;Höhe über Meer", "cp1252"),
        ("Czas;Szerokość geograficzna;Długość geograficzna;Wysokość", "cp1250"),
        ("Date et heure;Latitude (degrés);Longitude (degrés);Altitude (mètres)", "cp1252"),
        ("Fecha y hora;Latitud;Longitud;Elevación", "cp1252"),
    ],
)
@pytest.mark.parametrize("is_utf8", [True, False])
def test_headers_in_a_code_page_of_windows_are_understood(header, page, is_utf8):
    text = f"{header}\n2026-05-01 10:00:00;50,1;14,4;200\n2026-05-01 10:00:01;50,2;14,4;201\n"
    file = io.BytesIO(text.encode("utf-8" if is_utf8 else page))
    (piece,) = csv_reader.read(file, columns=None, findings=Findings())
    assert piece.poses.latlon.tolist() == [[50.1, 14.4], [50.2, 14.4]]
    assert piece.poses.height_m.tolist() == [200.0, 201.0]
    assert piece.timed
