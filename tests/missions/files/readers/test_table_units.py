"""Units, times and numbers of tables and trajectories are understood, or asked for, but never guessed."""

import io

import numpy as np
import pytest

from webapp.errors import TrackError, UsageError
from webapp.files.exchange.times import unix_time
from webapp.missions.files.readers import csv_reader, geojson_reader, trajectory_text
from webapp.missions.files.readers.csv_table import table_head
from webapp.missions.files.track_chunks import Findings

START = unix_time("2026-05-01T10:00:00Z")


def read(text, **options):
    """Read a table; return its only piece, and the findings."""
    findings = Findings()
    data = text if isinstance(text, bytes) else text.encode()
    (piece,) = csv_reader.read(io.BytesIO(data), columns=options.get("columns"), findings=findings)
    return piece, findings


@pytest.mark.parametrize(
    ("header", "first", "second"),
    [
        ("time(millisecond)", "1777629600000", "1777629601500"),
        ("timestamp [us]", "1777629600000000", "1777629601500000"),
        ("Zeit [Mikrosekunden]", "1777629600000000", "1777629601500000"),
        ("time_ns", "1777629600000000000", "1777629601500000000"),
        ("stamp (nanoseconds)", "1777629600000000000", "1777629601500000000"),
        ("t/ms", "1777629600000", "1777629601500"),
        ("time (min)", "29627160", "29627160.025"),
        ("time", "1777629600000", "1777629601500"),
        ("gpsdatetime", "2026:05:01 10:00:00", "2026:05:01 10:00:01.5"),
        ("timestampMs", "1777629600000", "1777629601500"),
        ("timeNanos", "1777629600000000000", "1777629601500000000"),
        ("Unix Timestamp [ms]", "1777629600000", "1777629601500"),
        ("%time,field.header.seq,field.header.stamp", "1777629600000000000,1,0", "1777629601500000000,2,0"),
        ("header.stamp.sec,header.stamp.nanosec", "1777629600,0", "1777629601,500000000"),
        ("secs,nsecs", "1777629600,0", "1777629601,500000000"),
    ],
)
def test_times_are_read_in_the_unit_of_the_header(header, first, second):
    piece, _ = read(f"{header},lat,lon\n{first},50,14\n{second},50.1,14\n")
    assert piece.poses.times_s == pytest.approx([START, START + 1.5], abs=1e-3)


@pytest.mark.parametrize("unit", ["ms", "millisecond", "milliseconds", "msec"])
def test_relative_times_keep_their_unit(unit):
    piece, _ = read(f"time [{unit}],lat,lon\n0,50,14\n1500,50.1,14\n")
    assert piece.poses.times_s.tolist() == [0.0, 1.5]


@pytest.mark.parametrize(
    ("columns", "rows"),
    [
        ("time(millisecond),datetime(utc)", ["0,2026-05-01 10:00:00", "500,2026-05-01 10:00:01"]),
        ("time(s),datetime(local),datetime(utc)", ["0,2026-05-01 12:00:00,2026-05-01 10:00:00"]),
        ("local_time,utc_time", ["2026-05-01 12:00:00,2026-05-01 10:00:00"]),
        ("t,Date,Time", ["0,01.05.2026,10:00:00"]),
        ("local_date,local_time,utc_date,utc_time", ["2026-05-01,12:00:00,2026-05-01,10:00:00"]),
        ("time_ms,timestamp", ["17,1777629600", "18,1777629601"]),
    ],
)
def test_absolute_times_come_before_relative_ones_and_utc_before_local_time(columns, rows):
    piece, findings = read(f"{columns},lat,lon\n" + "".join(f"{row},50,14\n" for row in rows))
    assert piece.poses.times_s[0] == START
    assert findings.notes[0].startswith("the times are read from the column ")


def test_a_local_time_is_taken_with_a_remark():
    piece, findings = read("datetime(local),lat,lon\n2026-05-01 10:00:00,50,14\n")
    assert piece.poses.times_s[0] == START
    assert "the local times of datetime(local) were read as UTC" in findings.notes


@pytest.mark.parametrize(
    ("unit", "metres"),
    [("km", 1000.0), ("in", 0.0254), ("feet", 0.3048), ("yd", 0.9144), ("dm", 0.1), ("miles", 1609.344)],
)
def test_lengths_are_read_in_the_unit_of_the_header(unit, metres):
    piece, _ = read(f"time,x [{unit}],y ({unit})\n1,2,0\n2,0,3\n")
    assert piece.poses.xyz_m[:, :2] == pytest.approx(np.array([[2.0, 0.0], [0.0, 3.0]]) * metres)
    piece, _ = read(f"time,x [{unit}],y [{unit}]\n1,2,0\n2,0,3\n", columns="time=time, x=2, y=3")
    assert piece.poses.xyz_m[0, 0] == pytest.approx(2 * metres), "also where the columns are given"


@pytest.mark.parametrize(
    ("unit", "lat"),
    [
        ("decimal degrees", "50.1"),
        ("°", "50.1"),
        ("min", "3006"),
        ("mrad", "874.4099552"),
        ("degE7", "501000000"),
    ],
)
def test_angles_are_read_in_the_unit_of_the_header(unit, lat):
    piece, _ = read(f"lat [{unit}],lon [deg]\n{lat},14\n")
    assert piece.poses.latlon[0, 0] == pytest.approx(50.1, abs=1e-8)


@pytest.mark.parametrize(
    "header", ["x [furlong],y [m]", "time (fortnight),lat,lon", "lat [ddmm.mmmm],lon", "x (deg),y"]
)
def test_an_unknown_unit_of_a_time_or_a_position_is_refused_by_name(header):
    with pytest.raises(TrackError, match=r"the unit '(furlong|fortnight|ddmm\.mmmm|deg)' of the column"):
        read(f"{header}\n1,2,3\n")


def test_an_unknown_unit_of_a_given_column_is_refused():
    with pytest.raises(UsageError, match="x has no unit 'furlong'"):
        read("x [furlong],y\n1,2\n", columns="x=1, y=2")


def test_another_column_in_an_unknown_unit_is_left_out_with_a_remark():
    piece, findings = read("lat,lon,height [hPa]\n50,14,1013\n")
    assert piece.poses.height_m[0] != piece.poses.height_m[0]
    assert "'height [hPa]' is left out, as its unit 'hpa' is not known" in findings.notes[0]


@pytest.mark.parametrize(
    ("header", "row"),
    [
        ("Zeit;Breitengrad;Längengrad;Höhe (m)", "2026-05-01 10:00:00;50,1;14,4;230,5"),
        ("Čas;Zeměpisná šířka;Zeměpisná délka;Nadmořská výška [m]", "2026-05-01 10:00:00;50,1;14,4;230,5"),
        ("Fecha y hora;Latitud;Longitud;Altitud (metros)", "2026-05-01 10:00:00;50,1;14,4;230,5"),
        ("Horodatage;Latitude;Longitude;Hauteur (mètres)", "2026-05-01 10:00:00;50,1;14,4;230,5"),
    ],
)
def test_headers_of_the_languages_of_the_program(header, row):
    for data in (f"{header}\n{row}\n".encode(), f"sep=;\r\n{header}\r\n{row}\r\n".encode()):
        piece, _ = read(data)
        assert piece.poses.times_s[0] == START
        assert [*piece.poses.latlon[0], piece.poses.height_m[0]] == [50.1, 14.4, 230.5]


@pytest.mark.parametrize(
    ("rows", "heights"),
    [
        (["50,1;14,4;1.234", "50,2;14,4;1.235"], [1234.0, 1235.0]),
        (["50,1;14,4;1.200,5", "50,2;14,4;999,5"], [1200.5, 999.5]),
        (["50.1;14.4;1,234", "50.2;14.4;1,235.5"], [1234.0, 1235.5]),
        (["50.1;14.4;1.234", "50.2;14.4;1.235"], [1.234, 1.235]),
        (["50,1;14,4;1,234", "50,2;14,4;1,235"], [1.234, 1.235]),
        (["50,1;14,4;1.234", "50,2;14,4;12,5"], [1234.0, 12.5]),
        (["50,1;14,4;1 234,5", "50,2;14,4;1 235"], [1234.5, 1235.0]),
        (["50.1;14.4;1'234.5", "50.2;14.4;1'235"], [1234.5, 1235.0]),
    ],
)
def test_marks_of_numbers_are_decided_by_whole_columns(rows, heights):
    piece, findings = read("lat;lon;height\n" + "\n".join(rows) + "\n")
    assert piece.poses.height_m.tolist() == heights
    assert piece.poses.latlon[0].tolist() == [50.1, 14.4]
    grouped = "1.2" in rows[0] or "1,2" in rows[0]
    assert any("separate thousands" in note for note in findings.notes) == (grouped and heights[0] > 1000)


@pytest.mark.parametrize("line", ["sep=;", '"sep=;"', "SEP=;"])
def test_the_line_of_excel_is_no_header(tmp_path, line):
    path = tmp_path / "a.csv"
    path.write_text(f"{line}\nlat;lon\n50,5;14,5\n")
    assert table_head(path, None).columns == {"lat": 0, "lon": 1}
    path.write_text(f"{line}\na;b\n50,5;14,5\n")
    head = table_head(path, None)
    assert (head.header, head.rows) == (("a", "b"), (("50,5", "14,5"),))
    assert table_head(path, "lat=a, lon=b").columns == {"lat": 0, "lon": 1}


def test_commas_may_separate_thousands_in_quotes():
    piece, findings = read('lat,lon,height\n50.1,14.4,"1,234"\n50.1,14.4,"1,235.5"\n')
    assert piece.poses.height_m.tolist() == [1234.0, 1235.5]
    assert findings.notes[0].startswith("commas in height separate thousands")


def test_decimal_commas_may_be_quoted():
    piece, findings = read('time,lat,lon,height\n1,"50,1","14,4","230,25"\n')
    assert [*piece.poses.latlon[0], piece.poses.height_m[0]] == [50.1, 14.4, 230.25]
    assert any(note.startswith("commas are decimal") for note in findings.notes)


def test_angles_with_the_word_deg():
    piece, _ = read("""GPSLatitude,GPSLongitude\n"50 deg 6' 0.00"" N","14 deg 24' 0.00"" W"\n""")
    assert piece.poses.latlon[0] == pytest.approx([50.1, -14.4])


@pytest.mark.parametrize(
    ("scale", "name"), [(1e3, "milliseconds"), (1e6, "microseconds"), (1e9, "nanoseconds")]
)
def test_times_of_a_tum_trajectory_may_be_in_smaller_units(scale, name):
    findings = Findings()
    text = (
        "".join(f"{int((START + n) * scale)} {n} 0 0 0 0 0 1\n" for n in range(3)) + "1e300 0 0 0 0 0 0 1\n"
    )
    (piece,) = trajectory_text.read(io.BytesIO(text.encode()), "tum", findings=findings)
    assert piece.poses.times_s.tolist() == [START, START + 1, START + 2]
    assert any(f"were read as {name} since 1970" in note for note in findings.notes)
    assert findings.skipped()[0].count == 1


def test_times_of_geojson_follow_the_same_rule():
    geometry = '{"type": "Point", "coordinates": [14, 50]}'
    text = f'{{"type": "Feature", "geometry": {geometry}, "properties": {{"time": %d}}}}'
    for scale in (1, 10**3, 10**6, 10**9):
        data = (text % (START * scale)).encode()
        (piece,) = geojson_reader.read(io.BytesIO(data), findings=Findings())
        assert piece.poses.times_s.tolist() == [START]


WEEK, SECONDS = 2416, 468018  # of GPS at 2026-05-01 10:00:00 UTC, which is 18 s behind


@pytest.mark.parametrize(
    ("header", "seconds"),
    [
        ("week,tow", SECONDS),
        ("GPS Week,GPS Seconds", SECONDS),
        ("gps_week,sow [s]", SECONDS),
        ("GPSWeek,GPSSecond", SECONDS),
        ("wn,iTOW", SECONDS * 1000),
        ("week,tow [ms]", SECONDS * 1000),
        ("GWk,GMS", SECONDS * 1000),
        ("Week,TOW", SECONDS * 1000),
        ("week,time", SECONDS),
        ("week,gps_time", SECONDS),
        ("week,seconds_of_week", f"{SECONDS}.000"),
    ],
)
def test_weeks_of_gps_and_their_seconds_are_converted_to_utc(header, seconds):
    piece, findings = read(f"{header},lat,lon\n{WEEK},{seconds},50,14\n{WEEK},{seconds},50.1,14\n")
    assert piece.timed
    assert piece.poses.times_s.tolist() == [START, START]
    (note,) = findings.notes
    assert note.startswith("the times are weeks of GPS and seconds of the week in ")


@pytest.mark.parametrize(
    ("header", "cells"),
    [
        ("week,tow,utc_time", f"{WEEK},5,2026-05-01T10:00:00Z"),
        ("timestamp,week,tow", f"1777629600,{WEEK},5"),
        ("local_time,week,tow", f"2026-05-01 12:00:00,{WEEK},{SECONDS}"),
        ("time,week,tow", f"0.5,{WEEK},{SECONDS}"),
    ],
)
def test_utc_comes_before_weeks_of_gps_and_these_before_local_and_relative_times(header, cells):
    piece, _ = read(f"{header},lat,lon\n{cells},50,14\n")
    assert piece.poses.times_s.tolist() == [START]


@pytest.mark.parametrize(
    ("header", "cells", "times", "note"),
    [
        ("week", f"{WEEK}", [0.0], "the weeks of GPS are not used: no column has the seconds of the week"),
        ("tow", f"{SECONDS}", [SECONDS], "the seconds of a week in tow have no week: they count from 1970"),
        ("week,tow", f"{WEEK - 2048},{SECONDS}", None, "week 368 is one of 1980 to 1999"),
    ],
)
def test_half_a_time_of_gps_is_said(header, cells, times, note):
    piece, findings = read(f"{header},lat,lon\n{cells},50,14\n")
    assert times is None or piece.poses.times_s.tolist() == times
    assert any(one.startswith(note) for one in findings.notes)


@pytest.mark.parametrize("week", ["week", "Week Number", "weekno"])
def test_weeks_of_a_calendar_leave_relative_times_alone(week):
    piece, findings = read(f"time,{week},lat,lon\n0,18,50,14\n1.5,18,50.1,14\n")
    assert piece.poses.times_s.tolist() == [0.0, 1.5]
    assert not any("week" in note for note in findings.notes)


@pytest.mark.parametrize("week", ["gps_week", "GPSWeek", "wn", "GWk"])
def test_weeks_of_ten_bits_with_relative_times_are_those_of_gps(week):
    piece, findings = read(f"time,{week},lat,lon\n{SECONDS},{WEEK - 2048},50,14\n")
    assert piece.poses.times_s.tolist() == [START - 2048 * 7 * 86_400 + 18 - 4], "4 leap seconds in 1987"
    assert any(note.startswith("week 368 is one of 1980 to 1999") for note in findings.notes)


def test_weeks_can_be_named_and_need_their_seconds():
    text = f"a,b,lat,lon\n{WEEK},{SECONDS}000,50,14\n"
    piece, _ = read(text, columns="week=a, tow=b:ms, lat=lat, lon=lon")
    assert piece.poses.times_s.tolist() == [START]
    with pytest.raises(UsageError, match="needs both week and tow"):
        read(text, columns="week=a, lat=lat, lon=lon")


def test_numbers_that_are_no_degrees_are_refused_in_a_sentence():
    with pytest.raises(TrackError, match="the numbers of 'Lat', such as 501000000, are no degrees"):
        read("Lat,Lon\n501000000,144000000\n")
    piece, _ = read("Lat,Lon\n501000000,144000000\n", columns="lat=Lat:e7, lon=Lon:e7")
    assert piece.poses.latlon.tolist() == [[pytest.approx(50.1), pytest.approx(14.4)]]
