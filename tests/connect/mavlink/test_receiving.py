"""`expmap connect mavlink` by datagrams, TCP and serial ports, whatever is cut or killed."""

import os
import pty
import signal
import socket
import struct
import subprocess
import sys
import threading
import time
from contextlib import contextmanager, suppress

import pytest

from tests.connect.mavlink.vehicle import SimulatedVehicle, radio
from tests.ports import reserved_port
from tests.robot.stand_in import StandIn
from webapp.connect.mavlink.command import _Bridge, _names
from webapp.connect.mavlink.links import open_link
from webapp.connect.mavlink.packets import PacketReader
from webapp.connect.mavlink.vehicles import Vehicles
from webapp.errors import DiskFull, InputError, UsageError
from webapp.robot.content import has_spool, read_content


def until(holds):
    """Wait until a condition holds, and return it; at most a minute."""
    end = time.monotonic() + 60
    while not (found := holds()):
        assert time.monotonic() < end, "it never came"
        time.sleep(0.02)
    return found


class Bridge:
    """The command as a process."""

    def __init__(self, spool, source, *words, url):
        options = ["--url", url, "--mission", "7", "--token", "secret", "--every", "0.1", "--min-move", "0"]
        command = [sys.executable, "-m", "webapp", "connect", "mavlink", str(spool), source, *options, *words]
        self.process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)

    def kill(self):
        self.process.kill()
        self.process.communicate()

    def interrupt(self):
        """Press Ctrl-C; return the exit code and both outputs."""
        self.process.send_signal(signal.SIGINT)
        out, err = self.process.communicate(timeout=60)
        return self.process.returncode, out, err


@contextmanager
def running(spool, source, *words, url):
    bridge = Bridge(spool, source, *words, url=url)
    try:
        yield bridge
    finally:
        if bridge.process.poll() is None:
            bridge.kill()


@pytest.fixture
def port():
    """A port for datagrams that is free."""
    with socket.socket(socket.AF_INET, socket.SOCK_DGRAM) as free:
        free.bind(("127.0.0.1", 0))
        return free.getsockname()[1]


@pytest.fixture
def server():
    with StandIn() as running:
        yield running


class Sender:
    """Sends the datagrams of a vehicle to a port."""

    def __init__(self, port, vehicle=None):
        self.socket = socket.socket(socket.AF_INET, socket.SOCK_DGRAM)
        self.socket.bind(("127.0.0.1", 0))
        self.port, self.vehicle, self.boot_ms = port, vehicle or SimulatedVehicle(), 1000

    def __enter__(self):
        return self

    def __exit__(self, *_):
        self.socket.close()

    def send(self, *packets):
        for packet in packets:
            self.socket.sendto(packet, ("127.0.0.1", self.port))

    def until_heard(self, spool, written):
        """Send heartbeats until more has been written."""
        until(lambda: self.send(self.vehicle.heartbeat()) or records(spool) > written)

    def fly(self, count):
        for _ in range(count):
            self.boot_ms += 100
            self.send(self.vehicle.position(self.boot_ms, 50.0 + self.boot_ms * 1e-6))
            time.sleep(0.001)  # A burst would fill the socket of the receiver


@pytest.fixture
def sender(port):
    with Sender(port) as sender:
        yield sender


def records(spool):
    return read_content(spool).written if has_spool(spool) else 0


def poses(server):
    return [one for one in server.stored() if one["type"] == "pose"] if server.records else []


def test_datagrams_of_two_vehicles_become_records(tmp_path, server, port):
    source = f"udp:127.0.0.1:{port}"
    with (
        Sender(port) as one,
        Sender(port, SimulatedVehicle(2)) as two,
        running(tmp_path, source, "--name", "2=Rex", url=server.url) as bridge,
    ):
        one.until_heard(tmp_path, 0)
        two.until_heard(tmp_path, 1)
        one.send(b"garbage", one.vehicle.receiver(), one.vehicle.text("Hello", 4), radio(127, 254))
        one.fly(3)
        two.fly(2)
        until(lambda: len(poses(server)) == 5)
        code, out, err = bridge.interrupt()
    assert [pose["track"] for pose in poses(server)] == ["vehicle 1"] * 3 + ["Rex"] * 2
    assert poses(server)[0]["covariance"] == pytest.approx([2.25, 2.25, 0.0])
    said = [one for one in server.stored() if one["type"] == "status"]
    assert {one["mode"] for one in said} == {"Loiter"}
    assert "warning: Hello" in [one.get("text") for one in said]
    assert (code, err) == (0, "vehicle 1: heard\nRex: heard\n")
    written = len(server.stored())
    assert out == (
        f"{written} records of 2 vehicles: {server.url}/missions/7\n"
        "left out: 7 bytes that belong to no packet\n"
    )


def test_nothing_is_lost_while_the_server_is_away_and_the_program_is_killed(tmp_path, port, sender):
    source = f"udp:127.0.0.1:{port}"
    with reserved_port() as web:
        url, spool, expected = f"http://127.0.0.1:{web}", tmp_path / "spool", 0
        for _ in range(3):
            with running(spool, source, url=url) as bridge:
                sender.until_heard(spool, records(spool))
                status = records(spool)
                sender.fly(50)
                expected += 50
                until(lambda before=status: records(spool) >= before + 50)
                bridge.kill()
        with StandIn(port=web) as server, running(spool, source, url=url) as bridge:
            sender.until_heard(spool, records(spool))
            until(lambda: len(poses(server)) == expected)
            assert bridge.interrupt()[0] == 0
            assert len(server.stored()) == records(spool)
    boots = [round((pose["lat"] - 50.0) * 1e6) for pose in poses(server)]
    assert boots == list(range(1100, 1100 + 100 * expected, 100))


@pytest.mark.slow
def test_kills_in_the_middle_of_uploads_double_nothing(tmp_path, server, port, sender):
    for _ in range(3):
        with running(tmp_path, f"udp:127.0.0.1:{port}", url=server.url) as bridge:
            before = len(poses(server))
            sender.until_heard(tmp_path, records(tmp_path))
            until(lambda known=before: sender.fly(5) or len(poses(server)) > known)
            bridge.kill()
    with running(tmp_path, f"udp:127.0.0.1:{port}", url=server.url) as bridge:
        sender.until_heard(tmp_path, records(tmp_path))
        until(lambda: len(server.stored()) == records(tmp_path))
        assert bridge.interrupt()[0] == 0
    places = [pose["lat"] for pose in poses(server)]
    assert places == sorted(set(places))
    assert len(server.stored()) == records(tmp_path)


def test_without_a_server_the_rest_is_named(tmp_path, port, sender):
    with reserved_port() as web:
        url = f"http://127.0.0.1:{web}"
        with running(tmp_path, f"udp:127.0.0.1:{port}", url=url) as bridge:
            sender.until_heard(tmp_path, 0)
            code, out, err = bridge.interrupt()
    assert (code, "records are still waiting" in err, "of 1 vehicles" in out) == (1, True, True)


def test_a_lost_connection_is_made_again(tmp_path, server):
    vehicle = SimulatedVehicle()
    with socket.create_server(("127.0.0.1", 0)) as listening:

        def serve():
            for boot in (1000, 2000):
                client = listening.accept()[0]
                whole = vehicle.heartbeat() + vehicle.position(boot)
                client.sendall(whole[:30])
                until(lambda known=boot: known == 1000 or poses(server))
                client.sendall(whole[30:])
                until(lambda known=boot: len(poses(server)) == known // 1000)
                client.close()

        thread = threading.Thread(target=serve, daemon=True)
        thread.start()
        source = f"tcp:127.0.0.1:{listening.getsockname()[1]}"
        with running(tmp_path, source, url=server.url) as bridge:
            until(lambda: len(poses(server)) == 2)
            thread.join(30)
            code, _, err = bridge.interrupt()
    assert code == 0
    assert "the connection was closed; trying again" in err and "connected again" in err


def test_a_serial_port_is_read_and_its_vehicle_asked(tmp_path, server):
    ours, theirs = pty.openpty()
    vehicle, reader, asked = SimulatedVehicle(), PacketReader(), []
    with running(tmp_path, f"serial:{os.ttyname(theirs)}:57600", "--rate", "5", url=server.url) as bridge:
        os.set_blocking(ours, False)

        def ask():
            os.write(ours, vehicle.heartbeat())
            with suppress(BlockingIOError):
                asked.extend(reader.read(os.read(ours, 4096), whole=False))
            return len(asked) >= 7

        until(ask)
        os.write(ours, b"\x11\x13\n" + vehicle.position(1000))
        until(lambda: poses(server))
        assert bridge.interrupt()[0] == 0
    os.close(ours)
    os.close(theirs)
    wanted = {one.fields["param1"]: one.fields["param2"] for one in asked}
    assert (wanted[33.0], wanted[1.0], len(wanted)) == (200_000.0, 1_000_000.0, 7)
    assert {one.fields["target_system"] for one in asked} == {1}


def test_datagrams_are_answered_only_if_asked_for(tmp_path, server, port, sender):
    with running(tmp_path, f"udp:127.0.0.1:{port}", url=server.url) as bridge:
        sender.until_heard(tmp_path, 0)
        sender.fly(1)
        until(lambda: poses(server))
        assert bridge.interrupt()[0] == 0
    sender.socket.setblocking(False)
    with pytest.raises(BlockingIOError):
        sender.socket.recv(100)


NO_SOURCE = ["udp:0.0.0.0", "14550", "http://a:1", "tcp:host:0", "udp:a:99999", "serial:x:12"]


@pytest.mark.parametrize("source", NO_SOURCE)
def test_what_is_no_source_is_refused(source):
    with pytest.raises(UsageError):
        open_link(source)


def test_sources_that_do_not_open_are_explained(tmp_path, port):
    (tmp_path / "file").write_bytes(b"")
    with pytest.raises(InputError, match="not a serial port"):
        open_link(f"serial:{tmp_path / 'file'}:57600")
    with pytest.raises(InputError, match="No such file"):
        open_link(f"serial:{tmp_path / 'none'}:57600")
    with reserved_port() as closed, pytest.raises(InputError, match="refused"):
        open_link(f"tcp:127.0.0.1:{closed}")
    with open_link(f"udp:127.0.0.1:{port}"), pytest.raises(InputError, match="in use"):
        open_link(f"udp:127.0.0.1:{port}")


def test_names_of_vehicles():
    assert _names(["1=Rex", "20=Big = drone"]) == {1: "Rex", 20: "Big = drone"}
    for wrong in ("Rex", "0=Rex", "256=Rex", "1=", "1=a\nb"):
        with pytest.raises(UsageError, match="--name 1=Rex"):
            _names([wrong])
    with pytest.raises(UsageError, match="the same name"):
        _names(["1=Rex", "2=Rex"])


class Full:
    """A client whose spool is full from the third record on, and refuses what is invalid."""

    def __init__(self):
        self.taken = []

    def send(self, record):
        if abs(record.get("lat", 0.0)) > 90.0:
            raise InputError("out of range", where="lat")
        if len(self.taken) == 2:
            raise DiskFull("the spool is full")
        self.taken.append(record)


class Played:
    """A link that has these datagrams, and then ends."""

    is_whole = True

    def __init__(self, *packets):
        self.packets = list(packets)

    def read(self, wait_s):
        if not self.packets:
            raise InputError("over")
        return self.packets.pop(0)


def test_a_full_spool_and_an_invalid_position_end_nothing(capsys):
    vehicle, client = SimulatedVehicle(), Full()
    bridge = _Bridge(client, Vehicles({}, note=lambda _: None), rate_hz=None)
    places = [vehicle.position(1000, 95.0), *(vehicle.position(2000 + n) for n in range(4))]
    with pytest.raises(InputError, match="over"):
        bridge._take(Played(vehicle.heartbeat(), *places, struct.pack("<I", 5)))
    assert (bridge.written, len(client.taken)) == (2, 2)
    assert bridge.left_out() == {
        "bytes that belong to no packet": 4,
        "records with an invalid lat": 1,
        "records for which there was no room in the spool": 3,
    }
    assert capsys.readouterr().err == "the spool is full\n"
