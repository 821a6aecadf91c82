"""Tracks in XML: GPX, KML and KMZ, and hostile files."""

import io
import math
import tracemalloc
import zipfile
from pathlib import Path

import numpy as np
import pytest

from webapp.errors import TrackError
from webapp.missions.core.looks import TrackLook
from webapp.missions.files import track_chunks
from webapp.missions.files.readers import gpx, kml_reader, line_buffer
from webapp.missions.files.readers.kml_reader import opened_kml
from webapp.missions.files.track_chunks import NO_TIME, UNTIMED_OBJECTS, Findings, WorldObjects, WorldPiece
from webapp.missions.files.track_format import Selection
from webapp.missions.files.track_reader import kind_of

GPX = """<gpx xmlns="http://www.topografix.com/GPX/1/1"><metadata><time>2024-03-23T12:00:00Z</time></metadata>
<wpt lat="50.1" lon="14.2"><ele>200</ele><name>bin  A</name><type>bin</type></wpt>
<trk><name>round</name><trkseg>{points}</trkseg><trkseg><trkpt lat="50.5" lon="14.5"/></trkseg></trk>
<rte><rtept lat="1" lon="2"/></rte><trk><name>empty</name></trk></gpx>"""


def point(lat: float, time: str = "") -> str:
    return f'<trkpt lat="{lat}" lon="14.5">{f"<time>{time}</time>" if time else ""}<ele>7</ele></trkpt>'


def read_gpx(text: str | bytes) -> tuple[list[object], Findings]:
    findings = Findings()
    data = text.encode() if isinstance(text, str) else text
    return list(gpx.read(io.BytesIO(data), findings=findings)), findings


def test_a_gpx_has_tracks_routes_and_waypoints() -> None:
    points = point(50.3, "2024-03-23T12:00:00Z") + point(50.35) + point(50.4, "2024-03-23T12:00:10Z")
    (waypoint, track, route), findings = read_gpx(GPX.format(points=points))
    assert isinstance(waypoint, WorldObjects)
    (seen,) = waypoint.sightings
    assert (seen.object_id, seen.kind, seen.latlon, seen.height_m) == (
        "waypoint 1 bin A",
        "bin",
        (50.1, 14.2),
        200,
    )
    assert isinstance(track, WorldPiece)
    assert track.track == "track 1 round"
    assert np.diff(track.poses.times_s).tolist() == [10.0]
    assert track.poses.latlon[:, 0].tolist() == [50.3, 50.4]
    assert route.track == "route 1"
    assert not route.timed
    reasons = {one.reason: (one.count, one.where) for one in findings.skipped()}
    assert reasons[NO_TIME] == (2, "track 1 round")
    assert UNTIMED_OBJECTS in findings.notes


def test_a_long_gpx_comes_in_pieces_that_fit_together(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(line_buffer, "CHUNK", 4)
    points = "".join(
        point(50 + i * 1e-4, f"1970-01-01T00:00:{i:02d}Z" if i % 3 else "") for i in range(1, 50)
    )
    pieces, _ = read_gpx(GPX.format(points=points))
    track = [piece for piece in pieces if isinstance(piece, WorldPiece) and piece.track == "track 1 round"]
    assert len(track) > 5
    times = [t for piece in track for t in piece.poses.times_s.tolist()]
    assert times == [i for i in range(1, 50) if i % 3]


def test_memory_does_not_grow_with_a_gpx() -> None:
    points = "".join(point(50 + i * 1e-6, "1970-01-01T00:00:00Z") for i in range(10_000))
    data = io.BytesIO(GPX.format(points=points).encode())
    tracemalloc.start()
    for _ in gpx.read(data, findings=Findings()):
        pass
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 2_500_000


KML = """<kml xmlns="http://www.opengis.net/kml/2.2" xmlns:gx="http://www.google.com/kml/ext/2.2"><Document>
<Placemark><name>way</name><LineString><coordinates>14,50,1 14.1,50
</coordinates></LineString></Placemark>
<Placemark><name>drive</name><gx:MultiTrack><gx:Track><when>1970-01-01T00:00:05Z</when>
<when>1970-01-01T00:00:07Z</when><when>1970-01-01T00:00:08Z</when><gx:coord>14 50 2</gx:coord>
<gx:coord>14 50.1</gx:coord><gx:angles>90 0 0</gx:angles><gx:angles>-90 0 0</gx:angles></gx:Track>
</gx:MultiTrack></Placemark>
<Placemark><name>bin</name><TimeStamp><when>1970-01-01T00:00:09Z</when></TimeStamp>
<Point><coordinates> 14.2 , 50.2 </coordinates></Point></Placemark>
<Placemark><Polygon/></Placemark><NetworkLink/></Document></kml>"""


def read_kml(text: str, tracks: tuple[str, ...] = ()) -> tuple[list[object], Findings]:
    findings = Findings()
    return list(kml_reader.read(io.BytesIO(text.encode()), findings=findings, tracks=tracks)), findings


def test_a_kml_has_lines_tracks_and_points() -> None:
    (line, track, objects), findings = read_kml(KML)
    assert line.track == "way 1"
    assert line.poses.latlon.tolist() == [[50.0, 14.0], [50.0, 14.1]]
    assert line.poses.height_m[0] == 1.0
    assert math.isnan(line.poses.height_m[1])
    assert track.poses.times_s.tolist() == [5.0, 7.0]
    assert track.poses.heading_deg.tolist() == [90.0, 270.0]
    (seen,) = objects.sightings
    assert (seen.object_id, seen.time_s, seen.latlon) == ("placemark 3 bin", 9.0, (50.2, 14.2))
    message = {one.reason: one.count for one in findings.skipped()}
    assert message["times or positions of a track without their counterpart"] == 1
    assert message["areas, which are not tracks"] == 1
    assert message["links to other files, which are not followed"] == 1


def test_a_drawing_is_refused_unless_lines_are_named() -> None:
    mark = "<Placemark><name>{}</name><LineString><coordinates>1,2 3,4</coordinates></LineString></Placemark>"
    drawing = "<kml>" + "".join(mark.format(f"n{i}") for i in range(kml_reader.MAX_LINES + 1)) + "</kml>"
    with pytest.raises(TrackError, match="drawing"):
        read_kml(drawing)
    pieces, findings = read_kml(drawing, tracks=("n7",))
    assert [piece.track for piece in pieces] == ["n7 1"]
    assert findings.skipped()[0].count == kml_reader.MAX_LINES


@pytest.mark.parametrize(
    ("data", "message"),
    [
        (b'<!DOCTYPE gpx [<!ENTITY a "b">]><gpx>&a;</gpx>', "document type"),
        (b'<!DOCTYPE gpx SYSTEM "http://192.0.2.1/x.dtd"><gpx/>', "document type"),
        (b"<gpx><trk>", "damaged"),
        (b'<?xml version="1.0" encoding="nonsense"?><gpx/>', "damaged"),
        (b'<?xml version="1.0" encoding="gb18030"?><gpx/>', "damaged"),
        (b"<a>" * 100_000, "nested"),
    ],
)
def test_bad_xml_is_refused(data: bytes, message: str) -> None:
    with pytest.raises(TrackError, match=message):
        read_gpx(data)


def test_a_kmz_of_very_many_files_is_refused(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(kml_reader, "_MAX_FILES", 10)
    path = tmp_path / "a.kmz"
    with zipfile.ZipFile(path, "w") as archive:
        for number in range(2000):
            archive.writestr(f"pictures/{number:060}.png", b"")
    with pytest.raises(TrackError, match="more than 10 files"), kml_reader.opened_kml(path):
        pytest.fail("it was opened")


STYLED = """<kml xmlns="http://www.opengis.net/kml/2.2" xmlns:gx="http://www.google.com/kml/ext/2.2"
xmlns:kml="http://www.opengis.net/kml/2.2"><Document>
<StyleMap id="map"><Pair><key>highlight</key><styleUrl>#none</styleUrl></Pair>
<Pair><key>normal</key><styleUrl>#red</styleUrl></Pair></StyleMap>
<Style id="red"><LineStyle><color>7f0000FF</color><width>4</width></LineStyle></Style>
<gx:CascadingStyle kml:id="web"><Style>
<LineStyle><color>ffff0000</color><width>0.2</width></LineStyle></Style>
</gx:CascadingStyle>
{}</Document></kml>"""


@pytest.mark.parametrize(
    ("style", "look"),
    [
        ("<styleUrl>#red</styleUrl>", TrackLook("Ridge", "#ff0000", 4.0)),
        ("<styleUrl>#map</styleUrl>", TrackLook("Ridge", "#ff0000", 4.0)),
        ("<styleUrl>#web</styleUrl>", TrackLook("Ridge", "#0000ff", 1.0)),
        ("<styleUrl>other.kml#red</styleUrl>", TrackLook("Ridge")),
        (
            "<styleUrl>#red</styleUrl><Style><LineStyle><width>99</width></LineStyle></Style>",
            TrackLook("Ridge", "#ff0000", 12.0),
        ),
        ("<Style><LineStyle><color>red</color><width>x</width></LineStyle></Style>", TrackLook("Ridge")),
        ("<Style><LineStyle><color>ffb27200</color></LineStyle></Style>", TrackLook("Ridge")),  # that of GPS
    ],
)
def test_a_line_of_a_kml_keeps_its_name_colour_and_width(style: str, look: TrackLook) -> None:
    line = "<LineString><coordinates>14,50 14.1,50</coordinates></LineString>"
    _, findings = read_kml(STYLED.format(f"<Placemark><name> Ridge </name>{style}{line}</Placemark>"))
    assert findings.looks == {"Ridge 1": look}


def test_a_kmz_is_read_from_its_doc_kml(tmp_path: Path) -> None:
    path = tmp_path / "a.kmz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("other.kml", "<kml/>")
        archive.writestr("doc.kml", KML)
    with opened_kml(path) as file:
        assert len(list(kml_reader.read(file, findings=Findings()))) == 3


def test_a_zip_bomb_is_refused_before_it_is_unpacked(tmp_path: Path) -> None:
    path = tmp_path / "a.kmz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("doc.kml", b" " * 20_000_000)
    tracemalloc.start()
    with pytest.raises(TrackError, match="claims to hold"), opened_kml(path):
        pass
    _, peak = tracemalloc.get_traced_memory()
    tracemalloc.stop()
    assert peak < 2_000_000


def test_damaged_zips_are_reported(tmp_path: Path) -> None:
    path = tmp_path / "a.kmz"
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("doc.kml", KML)
    data = bytearray(path.read_bytes())
    data[60:70] = b"0123456789"
    path.write_bytes(data)
    with pytest.raises(TrackError, match="damaged"), opened_kml(path) as file:
        list(kml_reader.read(file, findings=Findings()))
    path.write_bytes(data[:100])
    with pytest.raises(TrackError, match="damaged"), opened_kml(path):
        pass
    with zipfile.ZipFile(path, "w") as archive:
        archive.writestr("readme.txt", "x")
    with pytest.raises(TrackError, match="no KML"), opened_kml(path):
        pass


def test_the_first_place_of_a_reason_is_kept() -> None:
    findings = track_chunks.Findings()
    findings.skip("a", where="line 3")
    findings.skip("a", where="line 9", count=4)
    findings.skip("b", where="line 1", count=0)
    assert findings.skipped() == (track_chunks.Skipped("a", 5, "line 3"),)


def network_link(href: str) -> str:
    return f"<NetworkLink><Link><href>{href}</href></Link></NetworkLink>"


def line_of(name: str, lat: float) -> str:
    text = f"<LineString><coordinates>14,{lat} 14.1,{lat}</coordinates></LineString>"
    return f"<Placemark><name>{name}</name>{text}</Placemark>"


def test_documents_in_a_kmz_are_read_where_it_links_to_them(tmp_path: Path) -> None:
    path = tmp_path / "a.kmz"
    links = ["parts/one%20day.kml#top", "parts/none.kml", "http://example.com/x.kml"]
    documents = {
        "doc.kml": "".join(map(network_link, links)) + line_of("main", 50),
        "parts/one day.kml": line_of("one", 51) + network_link("..\\two.kml") + network_link("../doc.kml"),
        "two.kml": line_of("two", 52),
        "other.kml": line_of("other", 53),
    }
    with zipfile.ZipFile(path, "w") as archive:
        for name, text in documents.items():
            archive.writestr(name, f"<kml><Document>{text}</Document></kml>")
    findings = Findings()
    pieces = list(kml_reader.FORMATS[1].read(path, Selection(), findings))
    assert [piece.track for piece in pieces] == ["main 1", "one 2", "two 3"]
    assert [one.count for one in findings.skipped()] == [2], "a missing document, and one elsewhere"


@pytest.mark.parametrize("blanks", [b"  \n", b"\xef\xbb\xbf \t", b"\r\n" * 100])
def test_blanks_before_an_xml_do_no_harm(tmp_path: Path, blanks: bytes) -> None:
    text = '<?xml version="1.0"?>' + GPX.format(points=point(50.3, "2024-03-23T12:00:00Z"))
    path = tmp_path / "a.gpx"
    path.write_bytes(blanks + text.encode())
    pieces = list(kind_of(path).read(path, Selection(), Findings()))
    assert pieces[1].poses.times_s.tolist() == [1_711_195_200.0]
