"""Small files that want far more memory or time than they should are refused within seconds."""

import bz2

import pytest
from backports import zstd
from lz4.frame import LZ4FrameDecompressor

from benchmarks import hostile_files
from webapp.errors import TrackError
from webapp.files.gate import Budget
from webapp.missions.files import guarded_reader
from webapp.missions.files.readers import bag_limits, rosbag
from webapp.missions.files.readers.bag_limits import MAX_CHUNK, unpacked
from webapp.missions.files.track_chunks import Findings
from webapp.missions.files.track_format import Selection
from webapp.missions.files.track_reader import kind_of
from webapp.progress import Progress

SMALL = Budget(memory_mb=300, cpu_s=5, wait_s=60)
"""Seconds are those of a busy machine."""

HUGE = 600_000_000


def read(path, *, budget=SMALL):
    """Read a file as an import does; return its pieces."""
    arguments = {"selection": Selection(), "findings": Findings(), "progress": Progress()}
    return list(guarded_reader.read(path, kind_of(path), budget=budget, **arguments))


@pytest.fixture
def saved(tmp_path):
    def save(name, data):
        path = tmp_path / name
        path.write_bytes(data)
        return path

    return save


@pytest.mark.parametrize(
    ("kind", "size", "message"),
    [
        ("array in a definition", 300_000, "array of 300000 elements"),
        ("mcap zstd", HUGE, "claims to hold 600 MB"),
        ("mcap lz4", 300_000_000, "claims to hold 300 MB"),
        ("mcap that lies", HUGE, "another size than it should"),
        ("foxglove zstd", HUGE, "claims to hold 600 MB"),
        ("foxglove empty", HUGE, "records without content"),
        ("bag bz2", HUGE, "claims to hold 600 MB"),
        ("bag lz4 that lies", 300_000_000, "another size than it should"),
        ("computed column", 900_000_000, "a computed column"),
        ("view", 0, "a view or a trigger"),
        ("kmz", HUGE, "claims to hold"),
        ("fit", 9_000_000, "messages without content"),
        ("nested", 1_000_000, "nested more than"),
        ("ulog nested", 0, "nested more than"),
        ("ulog empty", HUGE, "messages without content"),
        ("dataflash", HUGE, "damaged at more than"),
        ("tlog", HUGE, "damaged at more than"),
    ],
)
def test_bombs_are_refused_at_once(saved, kind, size, message):
    with pytest.raises(TrackError, match=message):
        read(saved(*hostile_files.BOMBS[kind](size)))


@pytest.mark.parametrize(
    "more",
    [
        "CREATE TRIGGER t AFTER INSERT ON messages BEGIN SELECT 1; END;",
        "CREATE TABLE other(a, b AS (zeroblob(1000)) STORED);",
        "CREATE VIRTUAL TABLE f USING fts5(a);",
    ],
)
def test_only_plain_tables_of_a_database_are_read(saved, more):
    with pytest.raises(TrackError, match="which no recorder makes"):
        read(saved("a.db3", hostile_files.db3(more=more)))


def test_a_message_larger_than_any_is_not_read(saved, monkeypatch):
    monkeypatch.setattr(bag_limits, "MAX_CHUNK", 1000)
    path = saved("a.db3", hostile_files.db3(more="UPDATE messages SET data = zeroblob(2000);"))
    with pytest.raises(TrackError, match="too big"):
        list(rosbag.read(path, suffix=".db3", findings=Findings()))


@pytest.mark.parametrize("field", ["string[1001] x", "Other[1001] x"])
def test_arrays_of_texts_and_messages_are_limited(saved, field):
    other = "\n" + "=" * 80 + "\nMSG: geometry_msgs/Other\nint8 a\n"
    with pytest.raises(TrackError, match="array of 1001 elements"):
        read(saved("a.bag", hostile_files.ros1_bag(field + other)))


def test_arrays_of_numbers_may_be_long_and_definitions_not(saved):
    with pytest.raises(TrackError, match="the bag cannot be read"):  # its one message is empty
        read(saved("a.bag", hostile_files.ros1_bag("float64[100000] x")))
    long = "# a comment\n" * (bag_limits.MAX_DEFINITION // 10)
    with pytest.raises(TrackError, match="definition is longer than"):
        read(saved("a.bag", hostile_files.ros1_bag(long)))


@pytest.mark.parametrize("compression", ["lz4", "bz2", "zstd"])
def test_chunks_of_several_frames_are_unpacked_to_their_size_and_no_further(compression):
    starts = {
        "lz4": LZ4FrameDecompressor,
        "bz2": bz2.BZ2Decompressor,
        "zstd": zstd.ZstdDecompressor,
    }
    decompressor = starts[compression]
    data = hostile_files.zeros(9_000_000, compression)
    assert unpacked(data, size=9_000_000, start=decompressor) == bytes(9_000_000)
    for wrong in (8_999_999, 9_000_001):
        with pytest.raises(TrackError, match="another size"):
            unpacked(data, size=wrong, start=decompressor)
    with pytest.raises(TrackError, match="claims to hold"):
        unpacked(data, size=MAX_CHUNK + 1, start=decompressor)
    assert unpacked(b"", size=0, start=decompressor) == b""


def test_blanks_between_positions_take_no_time(saved):
    blanks = " " * 1_000_000
    path = saved("a.kml", hostile_files.kml(f"14,50{blanks},{blanks}7 15 ,51 {blanks}"))
    (piece,) = read(path)
    assert piece.poses.latlon.tolist() == [[50.0, 14.0], [51.0, 15.0]]
    assert piece.poses.height_m[0] == 7.0


def test_a_file_that_takes_too_much_memory_is_one_clear_error(saved):
    path = saved("a.kml", hostile_files.kml("1,1 " * 1_000_000))
    with pytest.raises(TrackError, match="it needs more than 20 MB of memory to be read"):
        read(path, budget=Budget(memory_mb=20, cpu_s=20, wait_s=60))


def test_the_head_of_an_xml_file_is_all_that_its_kind_takes(saved):
    data = hostile_files.gpx(2_000_000).replace(b"<trk>", b"<!-- " + b"x" * 2_000_000 + b" --><trk>")
    assert kind_of(saved("a.gpx", data)).name == "gpx"
    with pytest.raises(TrackError, match="the XML is damaged"):
        kind_of(saved("b.gpx", b"<!-- " + b"x" * 2_000_000 + b" -->" + data))


def test_a_file_may_not_have_tracks_without_end(saved, monkeypatch):
    monkeypatch.setattr(guarded_reader, "MAX_TRACKS", 100)
    track = b'<trk><trkseg><trkpt lat="1" lon="1"/></trkseg></trk>'
    path = saved("a.gpx", b'<gpx version="1.1">' + track * 101 + b"</gpx>")
    with pytest.raises(TrackError, match="more than 100 tracks"):
        read(path)


def test_very_many_positions_at_one_time_take_no_time(saved):
    lines = (
        f"$GPGGA,120000,50{n % 60:02}.{n % 999:03},N,01424.{n % 997:03},E,1,8,1,2,M,,M,,"
        for n in range(20_000)
    )
    (piece,) = read(saved("a.nmea", "\n".join(lines).encode()))
    assert len(piece.poses) == 1


def test_a_solution_with_very_wide_headers_takes_no_time(saved):
    header = "% GPST latitude(deg) longitude(deg) height(m) Q " + "a " * 30_000
    assert read(saved("a.pos", "\n".join([header] * 100).encode())) == []


def test_a_table_in_a_code_page_with_very_wide_headers_takes_no_time(saved):
    header = ",".join(["č" * 20] * 3000)
    with pytest.raises(TrackError, match="no columns of positions"):
        read(saved("a.csv", "\n".join([header] * 100).encode("cp1250")))
