"""A mission in TAK: what servers, groups and data packages get."""

import shutil
import signal
import socket
import sqlite3
import ssl
import struct
import subprocess
import sys
import threading
import time
import zipfile
from contextlib import closing
from dataclasses import replace
from xml.etree import ElementTree

import pytest

from webapp.app import main as program
from webapp.connect.tak import command
from webapp.connect.tak.events import UNKNOWN_M, CotEvent, to_protobuf, to_stream, to_xml
from webapp.connect.tak.feed import from_protobuf, from_xml
from webapp.connect.tak.incoming import Incoming
from webapp.connect.tak.link import TakLink
from webapp.connect.tak.mission import mission_events
from webapp.core.geo.types import LatLon
from webapp.errors import DatabaseUnavailable, InputError, TrackError, UsageError
from webapp.missions.core.trajectory.outgoing import ExportObject, ExportTrack, MissionExport
from webapp.missions.core.trajectory.records import make_poses

EVENT = CotEvent(
    "a.1", "a-f-G", "m-g", "Žofie <1>", LatLon(50.0, -14.5), 1714557600.25, 1714557601.0, 1714558200.0,
    height_m=210.0, radius_m=3.0, course_deg=90.0, remarks="gps & \x01",
)  # fmt: skip
EXPMAP = [sys.executable, "-m", "webapp"]
GPX = """<gpx xmlns="http://www.topografix.com/GPX/1/1" version="1.1" creator="t"><trk><name>Rex</name>
<trkseg>
<trkpt lat="50.0" lon="14.0"><time>2024-05-01T10:00:00Z</time></trkpt>
<trkpt lat="50.0002" lon="14.0"><time>2024-05-01T10:00:03Z</time></trkpt></trkseg></trk></gpx>"""


def fields(data):
    """Read a protobuf message as its wire format is specified: the values of each field number."""
    found, at = {}, 0

    def varint():
        nonlocal at
        value = shift = 0
        while True:
            byte = data[at]
            at += 1
            value |= (byte & 0x7F) << shift
            shift += 7
            if byte < 0x80:
                return value

    while at < len(data):
        tag = varint()
        if tag & 7 == 0:
            value = varint()
        else:
            size = 8 if tag & 7 == 1 else varint()
            value, at = data[at : at + size], at + size
            if tag & 7 == 1:
                (value,) = struct.unpack("<d", value)
        found[tag >> 3] = value
    return found


class Server:
    """Accepts one client and keeps what it sends."""

    def __init__(self, context=None):
        self._listening = socket.create_server(("127.0.0.1", 0))
        self._context = context
        self.port, self.got = self._listening.getsockname()[1], b""
        self._thread = threading.Thread(target=self._serve)

    def _serve(self):
        client = self._listening.accept()[0]
        client.settimeout(20)
        try:
            if self._context is not None:
                client = self._context.wrap_socket(client, server_side=True)
            while data := client.recv(4096):
                self.got += data
        except OSError:
            pass
        client.close()

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._thread.join(30)
        self._listening.close()


@pytest.fixture(scope="module")
def certificates(tmp_path_factory):
    """A self-signed certificate with its key, for both sides, as one PEM file."""
    if shutil.which("openssl") is None:
        pytest.skip("openssl is not installed")
    folder = tmp_path_factory.mktemp("certificates")
    words = (
        "req -x509 -newkey rsa:2048 -nodes -days 2 -subj /CN=localhost -addext subjectAltName=DNS:localhost"
    )
    command = ["openssl", *words.split(), "-keyout", folder / "key", "-out", folder / "certificate"]
    subprocess.run(command, check=True, capture_output=True)
    both = folder / "both.pem"
    both.write_bytes((folder / "certificate").read_bytes() + (folder / "key").read_bytes())
    return both


def test_xml_has_the_attributes_of_cursor_on_target():
    event = ElementTree.fromstring(to_xml(EVENT))
    assert event.attrib == {
        "version": "2.0", "uid": "a.1", "type": "a-f-G", "how": "m-g", "time": "2024-05-01T10:00:00.250Z",
        "start": "2024-05-01T10:00:01.000Z", "stale": "2024-05-01T10:10:00.000Z",
    }  # fmt: skip
    point = {name: float(value) for name, value in event.find("point").attrib.items()}
    assert point == {"lat": 50.0, "lon": -14.5, "hae": 210.0, "ce": 3.0, "le": 9999999.0}
    assert event.find("detail/contact").get("callsign") == "Žofie <1>"
    assert event.find("detail/remarks").text == "gps & ?"
    assert event.find("detail/track").get("course") == "90.000"


def test_protobuf_has_the_fields_of_version_1():
    cot = fields(fields(to_protobuf(EVENT))[2])
    detail = fields(cot.pop(15))
    assert cot == {
        1: b"a-f-G", 5: b"a.1", 6: 1714557600250, 7: 1714557601000, 8: 1714558200000, 9: b"m-g",
        10: 50.0, 11: -14.5, 12: 210.0, 13: 3.0, 14: 9999999.0,
    }  # fmt: skip
    assert fields(detail[2]) == {2: "Žofie <1>".encode()}
    assert (fields(detail[7]), detail[1]) == ({2: 90.0}, b"<remarks>gps &amp; ?</remarks>")


def test_radii_are_of_68_percent_and_dismissed_objects_are_left_out():
    poses = make_poses([5.0, 6.0], [(50.0, 14.0), (50.1, 14.0)], covariance_m2=[(1, 1, 0), (4, 4, 0)])
    track = ExportTrack(1, "odometry", "Rex", 2, 1.0, None, lambda: [poses])
    objects = [
        ExportObject(name, "victim", LatLon(50, 14), 1.0, 2.0, None, 0.8, 3, None, state=state)
        for name, state in (("a", "confirmed"), ("b", "dismissed"))
    ]
    mission = MissionExport("Search", (track,), ("victim",), lambda: objects)
    robot, victim = mission_events(mission, key="k.", now_s=10.0, keep_s=60.0)
    assert (robot.uid, robot.callsign, robot.latlon.lat, robot.start_s, robot.stale_s) == (
        "k.track-1", "Rex", 50.1, 6.0, 66.0
    )  # fmt: skip
    assert robot.radius_m == pytest.approx(2 * 1.515)
    assert (victim.uid, victim.stale_s) == ("k.object-a", 70.0)
    assert victim.remarks == "confirmed, sightings: 3, probability: 80%"


def test_a_stream_of_messages_over_tcp():
    with Server() as server, TakLink(f"tcp://127.0.0.1:{server.port}", protobuf=True) as link:
        assert link.send([EVENT, EVENT]) == 2
    assert server.got == 2 * to_stream(EVENT)
    length = (server.got[1] & 0x7F) | server.got[2] << 7
    assert server.got[3:][:length] == to_protobuf(EVENT)


def test_tls_with_a_client_certificate(certificates):
    context = ssl.create_default_context(ssl.Purpose.CLIENT_AUTH, cafile=certificates)
    context.load_cert_chain(certificates)
    context.verify_mode = ssl.CERT_REQUIRED
    with Server(context) as server:
        address = f"tls://localhost:{server.port}"
        with TakLink(address, certificate=certificates, authority=certificates) as link:
            link.send([EVENT])
    assert server.got == to_xml(EVENT)
    with Server(context) as server, pytest.raises(InputError, match=r"TLS failed.*--authority"):
        TakLink(f"tls://localhost:{server.port}", certificate=certificates)


def test_multicast():
    group = "239.2.3.1"
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as heard:
        heard.bind((group, 0))
        member = socket.inet_aton(group) + socket.inet_aton("127.0.0.1")
        heard.setsockopt(socket.IPPROTO_IP, socket.IP_ADD_MEMBERSHIP, member)
        heard.settimeout(20)
        address = f"udp://{group}:{heard.getsockname()[1]}"
        with TakLink(address, protobuf=True, interface="127.0.0.1") as link:
            link.send([EVENT])
        assert heard.recv(65535) == b"\xbf\x01\xbf" + to_protobuf(EVENT)


@pytest.mark.parametrize("address", ["http://tak:1", "tcp://", "tcp://a:b", "tak", "tcp://[::1"])
def test_wrong_addresses_are_refused(address):
    with pytest.raises(UsageError, match="not the address of a TAK server"):
        TakLink(address)


def test_a_dead_server_and_needless_certificates_are_explained(tmp_path):
    with socket.create_server(("127.0.0.1", 0)) as closed:
        port = closed.getsockname()[1]
    with pytest.raises(InputError, match=r"cannot send: .*refused.*is the TAK server running"):
        TakLink(f"tcp://127.0.0.1:{port}")
    with pytest.raises(UsageError, match="certificates need TLS"):
        TakLink("tcp://127.0.0.1:1", authority=tmp_path)


@pytest.fixture
def expmap(tmp_path, monkeypatch, capsys):
    """Runs a command on a library of the test and returns exit code, standard output and standard error."""
    monkeypatch.setenv("EXPMAP_LIBRARY", str(tmp_path / "library"))

    def call(*words):
        with pytest.raises(SystemExit) as ended:
            program.main([str(word) for word in words])
        output = capsys.readouterr()
        return ended.value.code, output.out, output.err

    return call


@pytest.fixture
def search(tmp_path, expmap):
    """A mission with one track of two poses."""
    (tmp_path / "track.gpx").write_text(GPX)
    expmap("mission", "new", "Search <1>")
    assert expmap("mission", "import", 1, tmp_path / "track.gpx")[0] == 0
    return 1


def test_the_command_writes_a_data_package_and_sends(search, expmap, tmp_path):
    assert expmap("connect", "tak", "send", 1, tmp_path / "a.zip") == (0, f"wrote {tmp_path / 'a.zip'}\n", "")
    with zipfile.ZipFile(tmp_path / "a.zip") as package:
        manifest = ElementTree.fromstring(package.read("MANIFEST/manifest.xml"))
        (content,) = manifest.findall("Contents/Content")
        event = ElementTree.fromstring(package.read(content.get("zipEntry")))
    assert manifest.find("Configuration/Parameter[@name='name']").get("value") == "Search <1>"
    assert content.find("Parameter").get("value") == event.get("uid")
    assert float(event.find("point").get("lat")) == 50.0002
    with Server() as server:
        code, out, _ = expmap("connect", "tak", "send", 1, f"tcp://127.0.0.1:{server.port}")
    assert (code, out) == (0, f"sent 1 items to tcp://127.0.0.1:{server.port}\n")
    assert ElementTree.fromstring(server.got).get("uid") == event.get("uid")


@pytest.mark.parametrize(("write", "read"), [(to_xml, from_xml), (to_protobuf, from_protobuf)])
def test_what_is_written_is_read(write, read):
    assert read(write(EVENT)) == replace(EVENT, remarks="gps & ?")


TAKPROTO = bytes.fromhex(
    "12c2010a09612d662d472d552d432a10414e44524f49442d64656164626565663080b2ec97de3338"
    "80b2ec97de3340d8a38398de334a036d2d6751098a1f63ee1a4940598351499d80a62f4061000000"
    "0000706f4069000000000000124071000000e0cf1263417a5c12110a092a3a2d313a737463701204"
    "414c46411a130a044379616e120b5465616d204d656d6265722a020857321a0a05504958454c1208"
    "4154414b2d4349561a0233342203352e323a1209000000000000f83f110000000000f47040"
)
"""A position with group, battery and device as takproto 3.0.1 wrote it from the XML of ATAK."""


def test_what_takproto_writes_is_read():
    read = from_protobuf(TAKPROTO)
    assert (read.uid, read.type, read.callsign) == ("ANDROID-deadbeef", "a-f-G-U-C", "ALFA")
    assert (read.latlon, read.height_m, read.radius_m) == (LatLon(50.2104, 15.8252), 251.5, 4.5)
    assert (read.time_s, read.stale_s, read.course_deg) == (1777629600.0, 1777629975.0, 271.25)


NO_EVENT = [
    b"<event/>",
    b"<other/>",
    b"<event uid='a' type='a-f-G' time='2024-05-01T10:00:00Z'",
    to_xml(EVENT).replace(b'time="2024', b'time="soon'),
    to_xml(EVENT).replace(b'lat="50', b'lat="95'),
    b"<!DOCTYPE e [<!ENTITY a 'a'>]>" + to_xml(EVENT).partition(b"\n")[2],
]


@pytest.mark.parametrize("data", NO_EVENT)
def test_what_is_no_event_is_refused(data):
    with pytest.raises(TrackError):
        from_xml(data)


@pytest.mark.parametrize("data", [b"", b"\xff" * 40, to_protobuf(EVENT)[:-3], b"\x12\x03\x52\x05\x00"])
def test_a_damaged_message_is_refused(data):
    with pytest.raises(TrackError):
        from_protobuf(data)


def test_positions_become_poses_and_markers_objects_once():
    incoming = Incoming(own="mine.", newest={})
    marker = replace(EVENT, uid="m", type="b-m-p-s-m", callsign="Bag", radius_m=UNKNOWN_M)
    events = [
        EVENT,
        marker,
        EVENT,  # Sent again
        replace(EVENT, uid="mine.track-1"),
        replace(EVENT, uid="shape", type="u-d-f"),
        replace(EVENT, uid="no fix", latlon=LatLon(0.0, 0.0)),
        replace(EVENT, uid="other"),  # The same callsign
        replace(EVENT, time_s=EVENT.time_s + 5.0, how="h-e"),
    ]
    pose, found, other, later = incoming.records(events, now_s=EVENT.time_s)
    assert {**pose, "covariance": None} == {
        "type": "pose", "source": "gps", "time": EVENT.time_s, "lat": 50.0, "lon": -14.5, "height_m": 210.0,
        "heading_deg": 90.0, "covariance": None, "track": pose["track"],
    }  # fmt: skip
    assert pose["covariance"] == pytest.approx([(3.0 / 1.515) ** 2] * 2 + [0.0])
    assert pose["track"].startswith("Žofie <1> (") and pose["track"] != other["track"]
    assert (found["class"], found["id"][:5], "covariance" in found) == ("marker", "Bag (", False)
    assert (later["source"], later["track"]) == ("manual", pose["track"])
    assert incoming.left_out == {"u-d-f": 1, "a-f-G": 1}
    assert [
        *Incoming(own="mine.", newest={pose["track"]: EVENT.time_s}).records([EVENT], now_s=EVENT.time_s)
    ] == []


def test_a_time_in_the_future_keeps_nothing_out():
    incoming = Incoming(own="mine.", newest={})
    events = [replace(EVENT, time_s=EVENT.time_s + 1e9), EVENT]
    assert [found["time"] for found in incoming.records(events, now_s=EVENT.time_s)] == [EVENT.time_s]
    assert incoming.left_out == {"times in the future": 1}


def test_what_senders_choose_is_neither_printed_as_it_is_nor_counted_without_end():
    incoming = Incoming(own="mine.", newest={})
    events = [replace(EVENT, uid=str(n), type=f"\x1b]0;{n}") for n in range(200)]
    assert [*incoming.records(events, now_s=EVENT.time_s)] == []
    assert len(incoming.left_out) == 51 and incoming.left_out["other types"] == 150
    assert all(reason.isprintable() for reason in incoming.left_out)


def test_a_busy_database_is_waited_for(search, monkeypatch):
    answers = iter([DatabaseUnavailable("the database is busy", wait_s=1.0), {"stored": 1}])

    def store(*_, **__):
        if isinstance(found := next(answers), Exception):
            raise found
        return found

    monkeypatch.setattr(command, "store_keyed_batch", store)
    monkeypatch.setattr(command.time, "sleep", lambda _: None)
    assert command._store(None, search, [{"type": "pose"}]) == 1


def test_only_what_changed_is_sent_again():
    content = command._content
    still = replace(EVENT, start_s=EVENT.time_s)
    assert content(still) == content(replace(still, time_s=9e9, start_s=9e9, stale_s=9.1e9))
    for change in ({"course_deg": 91.0}, {"height_m": 211.0}, {"radius_m": 4.0}, {"start_s": 1.0}):
        assert content(replace(EVENT, **change)) != content(EVENT)


class Interrupt:
    """Ends what runs in this thread as Ctrl-C does, once a condition holds."""

    def __init__(self, holds):
        self._thread = threading.Thread(target=self._wait, args=(holds,))

    def _wait(self, holds):
        until = time.monotonic() + 60
        try:
            while not holds() and time.monotonic() < until:
                time.sleep(0.05)
        finally:
            signal.raise_signal(signal.SIGINT)

    def __enter__(self):
        self._thread.start()
        return self

    def __exit__(self, *_):
        self._thread.join(90)


def poses(library, mission):
    """Times of the poses of each track."""
    with closing(sqlite3.connect(library / ".library" / "library.db")) as database:
        query = (
            "select name, time_s from pose join track on track.id = track_id where mission_id = ? order by 2"
        )
        return database.execute(query, (mission,)).fetchall()


def test_positions_of_a_server_become_tracks_and_a_lost_connection_is_made_again(expmap, tmp_path):
    expmap("mission", "new", "Search")
    later = replace(EVENT, time_s=EVENT.time_s + 9.0)
    with socket.create_server(("127.0.0.1", 0)) as listening:

        def serve():
            for data in (to_xml(EVENT) + b"<event>no</event>", to_xml(EVENT) + to_xml(later)):
                client = listening.accept()[0]
                assert b"t-x-c-t" in client.recv(4096)
                client.sendall(data[:30])
                time.sleep(0.2)
                client.sendall(data[30:])
                client.close()

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        address = f"tcp://127.0.0.1:{listening.getsockname()[1]}"
        with Interrupt(lambda: len(poses(tmp_path / "library", 1)) == 2):
            code, out, err = expmap("connect", "tak", "receive", 1, address)
        thread.join(30)
    assert (code, out) == (0, "stored 2 records in mission 1\nleft out: 1 of unreadable\n")
    assert "the server closed the connection" in err and "connected again" in err
    (name, first), (same, second) = poses(tmp_path / "library", 1)
    assert (name, second - first) == (same, 9.0)


def test_datagrams_of_a_group_are_received(expmap, tmp_path):
    expmap("mission", "new", "Search")
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        port = free.getsockname()[1]
    group = f"udp://239.2.3.1:{port}"

    def stored():
        with TakLink(group, protobuf=True, interface="127.0.0.1") as link:
            link.send([EVENT])
        return poses(tmp_path / "library", 1)

    with Interrupt(stored):
        code, out, _ = expmap("connect", "tak", "receive", 1, group, "--interface", "127.0.0.1")
    assert (code, out) == (0, "stored 1 records in mission 1\n")


def test_following_sends_what_is_new(search, expmap, tmp_path):
    with Server() as server:

        def moved():
            if server.got.count(b"</event>") == 1:
                (tmp_path / "more.gpx").write_text(GPX.replace("Rex", "Ben"))
                subprocess.run([*EXPMAP, "mission", "import", "1", tmp_path / "more.gpx"], check=True)
            return server.got.count(b"</event>") >= 2

        with Interrupt(moved):
            address = f"tcp://127.0.0.1:{server.port}"
            code, out, _ = expmap("connect", "tak", "send", 1, address, "--follow", 0.2)
    assert (code, out) == (0, f"sent 2 items to {address}\n")
    first, second = server.got.split(b"</event>")[:2]
    assert b"Rex" in first and b"Ben" in second


def test_a_missing_mission_and_a_file_to_follow_are_refused(search, expmap, tmp_path):
    code, _, err = expmap("connect", "tak", "receive", 9, "tcp://127.0.0.1:1")
    assert (code, "mission not found" in err) == (1, True)
    code, _, err = expmap("connect", "tak", "send", 1, tmp_path / "a.zip", "--follow", 1)
    assert (code, "--follow needs an address" in err) == (2, True)
