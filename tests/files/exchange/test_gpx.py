"""GPX: tracks with times, and protection from hostile files."""

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from webapp.errors import TrackError
from webapp.files.exchange import gpx
from webapp.files.exchange.gpx import parse_gpx

HEAD = '<?xml version="1.0" encoding="UTF-8"?>\n<gpx version="1.1" xmlns="http://www.topografix.com/GPX/1/1">'


def text(*points, head=HEAD):
    """Return a GPX file of (lat, lon, time or None)."""
    inner = "".join(
        f'<trkpt lat="{lat}" lon="{lon}">{f"<time>{time}</time>" if time else ""}</trkpt>'
        for lat, lon, time in points
    )
    return f"{head}<trk><name>š</name><trkseg>{inner}</trkseg></trk></gpx>"


GOOD = text((50, 14, "2026-05-01T10:00:00Z"), (50.1, 14.1, "2026-05-01T12:00:10+02:00"), (50.2, 14.2, None))


def test_times_are_utc():
    track = parse_gpx(GOOD.encode())
    assert (track.times_s - track.times_s[0]).tolist() == [0, 10]
    assert track.times_s[0] == 1777629600
    assert track.latlon.tolist() == [[50, 14], [50.1, 14.1]]


def test_a_time_without_zone_is_utc():
    track = parse_gpx(text((1, 2, "2026-05-01T10:00:00"), (1, 3, "2026-05-01T10:00:01Z")).encode())
    assert track.times_s.tolist() == [1777629600, 1777629601]


@pytest.mark.parametrize(
    ("codec", "named"),
    [("utf-8", "UTF-8"), ("utf-8-sig", "UTF-8"), ("utf-16", "UTF-16"), ("cp1250", "windows-1250")],
)
def test_codings(codec, named):
    assert len(parse_gpx(GOOD.replace("UTF-8", named).encode(codec))) == 2


def test_positions_off_the_earth_are_left_out():
    times = [f"2026-05-01T10:00:0{n}Z" for n in range(5)]
    points = zip((50, 95, 50, 51, "nan"), (14, 14, 200, 14, 14), times, strict=True)
    assert parse_gpx(text(*points).encode()).latlon.tolist() == [[50, 14], [51, 14]]


BOMB = '<!DOCTYPE lolz [<!ENTITY a "lol"><!ENTITY b "&a;&a;&a;&a;&a;&a;&a;&a;">]>'


@pytest.mark.parametrize("codec", ["utf-8", "utf-16", "utf-8-sig"])
@pytest.mark.parametrize("declares", [BOMB, BOMB.lower(), '<!DOCTYPE gpx SYSTEM "file:///etc/passwd">'])
def test_document_types_are_rejected(codec, declares):
    data = GOOD.replace("\n", "\n" + declares).replace("š", "&b;").encode(codec)
    with pytest.raises(TrackError, match=r"document type|damaged"):
        parse_gpx(data)


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"", "XML is damaged"),
        (b"hello", "XML is damaged"),
        (b"<gpx>", "XML is damaged"),
        (b"\xff\xfe\x00", "XML is damaged"),
        (b"\xff\xff", "XML is damaged"),
        (b"<html></html>", "no track"),
        (b"<gpx></gpx>", "no track"),
        (b'<?xml version="1.0" encoding="utf-7"?><gpx/>', "XML is damaged"),
        (b'<?xml version="1.0" encoding="UTF-16"?><gpx/>', "XML is damaged"),
        (text((1, 2, None), (1, 2, None)).encode(), "of 2 points of the track, 0 have"),
        (text((1, 2, "2026-05-01T10:00:00Z"), (3, 4, "2026-05-01T10:00:00Z")).encode(), "1 have"),
        (text(("x", 2, "2026-05-01T10:00:00Z")).encode(), "of 1 points of the track, 0 have"),
        (text((1, 2, "yesterday")).encode(), "0 have"),
        (text((1, 2, "2026-13-45T99:00:00Z")).encode(), "0 have"),
        (text((1, 2, "2026-05-01T10:00:00+30")).encode(), "0 have"),
        (b"<gpx>" + b"<a>" * 50_000, "nested"),
    ],
)
def test_files_without_a_usable_track_are_rejected(data, says):
    with pytest.raises(TrackError, match=says):
        parse_gpx(data)


def test_size_and_number_of_points_are_limited(monkeypatch):
    monkeypatch.setattr(gpx, "MAX_FIXES", 2)
    with pytest.raises(TrackError, match="more than 2 points"):
        parse_gpx(GOOD.encode())
    monkeypatch.setattr(gpx, "MAX_BYTES", 100)
    with pytest.raises(TrackError, match="larger than"):
        parse_gpx(GOOD.encode())


@settings(deadline=None)
@given(st.binary(max_size=200), st.integers(0, len(GOOD)))
def test_damage_is_never_more_than_an_error(noise, at):
    data = GOOD.encode()
    try:
        parse_gpx(data[:at] + noise + data[at + len(noise) :])
    except TrackError as error:
        assert error.message


def test_real_files(shared_data):
    counts = {}
    for path in [*sorted((shared_data / "robot").glob("*.gpx")), shared_data / "robot" / "billion.kml"]:
        try:
            counts[path.name] = len(parse_gpx(path.read_bytes()))
        except TrackError as error:
            counts[path.name] = error.message.split(",")[0]
    assert counts["korita-zbevnica.gpx"] > 500
    assert "no track" in counts["unicode_with_bom.gpx"]
    assert "document type" in counts["billion.kml"]
