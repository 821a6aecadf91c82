"""A mission in TAK: what servers, groups and data packages get."""

import shutil
import socket
import ssl
import struct
import subprocess
import threading
import zipfile
from xml.etree import ElementTree

import pytest

from webapp.app import main as program
from webapp.connect.tak.events import CotEvent, to_protobuf, to_stream, to_xml
from webapp.connect.tak.link import TakLink
from webapp.connect.tak.mission import mission_events
from webapp.core.geo.types import LatLon
from webapp.errors import InputError, UsageError
from webapp.missions.core.trajectory.outgoing import ExportObject, ExportTrack, MissionExport
from webapp.missions.core.trajectory.records import make_poses

EVENT = CotEvent(
    "a.1", "a-f-G", "m-g", "Žofie <1>", LatLon(50.0, -14.5), 1714557600.25, 1714557601.0, 1714558200.0,
    height_m=210.0, radius_m=3.0, course_deg=90.0, remarks="gps & \x01",
)  # fmt: skip
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
    robot, victim = mission_events(mission, key="k", now_s=10.0, keep_s=60.0)
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


def test_the_command_writes_a_data_package_and_sends(tmp_path, monkeypatch, capsys):
    monkeypatch.setenv("EXPMAP_LIBRARY", str(tmp_path / "library"))
    (tmp_path / "track.gpx").write_text(GPX)

    def expmap(*words):
        with pytest.raises(SystemExit) as ended:
            program.main([str(word) for word in words])
        return ended.value.code, capsys.readouterr().out

    expmap("mission", "new", "Search <1>")
    assert expmap("mission", "import", 1, tmp_path / "track.gpx")[0] == 0
    assert expmap("connect", "tak", 1, tmp_path / "a.zip") == (0, f"wrote {tmp_path / 'a.zip'}\n")
    with zipfile.ZipFile(tmp_path / "a.zip") as package:
        manifest = ElementTree.fromstring(package.read("MANIFEST/manifest.xml"))
        (content,) = manifest.findall("Contents/Content")
        event = ElementTree.fromstring(package.read(content.get("zipEntry")))
    assert manifest.find("Configuration/Parameter[@name='name']").get("value") == "Search <1>"
    assert content.find("Parameter").get("value") == event.get("uid")
    assert float(event.find("point").get("lat")) == 50.0002
    with Server() as server:
        code, out = expmap("connect", "tak", 1, f"tcp://127.0.0.1:{server.port}")
    assert (code, out) == (0, f"sent 1 items to tcp://127.0.0.1:{server.port}\n")
    assert ElementTree.fromstring(server.got).get("uid") == event.get("uid")
