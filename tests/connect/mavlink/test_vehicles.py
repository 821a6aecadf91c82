"""Messages of vehicles become poses and statuses."""

import math

import pytest

from tests.connect.mavlink.vehicle import PX4, SimulatedVehicle, radio
from webapp.connect.mavlink.packets import PacketReader
from webapp.connect.mavlink.vehicles import AGAIN, NO_FIX, Moment, Vehicles
from webapp.robot.records import parse_record

NOW = 1_780_000_000.0


class Ground:
    """Receives packets at times that a test chooses."""

    def __init__(self, **names):
        self.notes, self.reader = [], PacketReader()
        self.vehicles = Vehicles({int(key[1:]): name for key, name in names.items()}, note=self.notes.append)

    def at(self, second, *data):
        """Return the records of packets; all are valid."""
        now, found = Moment(NOW + second, 1000.0 + second), []
        for packet in self.reader.read(b"".join(data), whole=True):
            found += self.vehicles.records(packet, now=now)
        found += self.vehicles.reports(now)
        assert [parse_record(one, now_s=NOW) for one in found] or not found
        return found

    def poses(self, second, *data):
        return [one for one in self.at(second, *data) if one["type"] == "pose"]

    def statuses(self, second, *data):
        return [one for one in self.at(second, *data) if one["type"] == "status"]


@pytest.fixture
def ground():
    return Ground()


@pytest.fixture
def drone():
    return SimulatedVehicle()


def test_a_position_has_its_height_heading_and_the_accuracy_of_the_receiver(ground, drone):
    (pose,) = ground.poses(0, drone.heartbeat(), drone.receiver(), drone.position(5000))
    assert pose == {
        "type": "pose", "track": "vehicle 1", "time": NOW, "lat": pytest.approx(50.1, abs=1e-7),
        "lon": pytest.approx(14.4, abs=1e-7), "height_m": pytest.approx(230.5), "heading_deg": 90.0,
        "covariance": pytest.approx([2.25, 2.25, 0.0]),
    }  # fmt: skip


def test_the_better_receiver_counts_and_a_dilution_where_there_is_no_accuracy(ground):
    old = SimulatedVehicle(2, version=1)
    (pose,) = ground.poses(0, old.heartbeat(), old.receiver(hdop=1.5), old.position(5000))
    assert pose["covariance"] == pytest.approx([4.5**2, 4.5**2, 0.0])
    new = SimulatedVehicle(3)
    (pose,) = ground.poses(0, new.heartbeat(), new.receiver(), new.second_receiver(), new.position(5000))
    assert pose["covariance"] == pytest.approx([4e-4, 4e-4, 0.0])
    none = SimulatedVehicle(4)
    (pose,) = ground.poses(0, none.heartbeat(), none.position(5000))
    assert "covariance" not in pose
    far = SimulatedVehicle(5)
    (pose,) = ground.poses(0, far.heartbeat(), far.receiver(accuracy_mm=2**32 - 1), far.position(5000))
    assert pose["covariance"][0] == 1e10


def test_each_system_is_a_vehicle_with_its_name():
    ground = Ground(_2="Rex")
    one, two = SimulatedVehicle(1), SimulatedVehicle(2)
    found = ground.poses(0, one.heartbeat(), two.heartbeat(), one.position(1), two.position(1))
    assert [pose["track"] for pose in found] == ["vehicle 1", "Rex"]
    assert (len(ground.vehicles), ground.notes) == (2, ["vehicle 1: heard", "Rex: heard"])


def test_ground_stations_and_other_components_are_no_vehicles(ground, drone):
    station = SimulatedVehicle(255, autopilot=8)
    assert ground.at(0, station.heartbeat(), station.position(1), drone.position(1)) == []
    assert ground.poses(1, drone.heartbeat(), drone.position(2))
    gimbal = drone.make(33, drone.position(900)[10:-2], component=154)
    assert ground.poses(2, gimbal) == []


def test_a_vehicle_without_a_fix_has_no_position(ground, drone):
    assert ground.poses(0, drone.heartbeat(), drone.receiver(fix=1), drone.position(1000)) == []
    assert ground.poses(1, drone.position(2000, 0.0, 0.0)) == []
    assert ground.vehicles.left_out == {NO_FIX: 2}
    assert len(ground.poses(2, drone.receiver(fix=0), drone.position(3000))) == 1, "it has no receiver"
    assert len(ground.poses(3, drone.receiver(fix=3), drone.position(4000))) == 1
    assert ground.poses(4, drone.receiver(fix=1), drone.position(5000)) == []


def test_an_invalid_position_is_refused_by_the_client_only(drone):
    ground = Ground()
    with pytest.raises(Exception, match="lat"):
        ground.at(0, drone.heartbeat(), drone.position(1000, 95.0))


def test_packets_that_come_twice_or_late_are_left_out(ground, drone):
    first, second, third = (drone.position(boot) for boot in (1000, 1200, 1400))
    assert len(ground.poses(0, drone.heartbeat(), first, third, second, third, first)) == 2
    assert ground.vehicles.left_out == {AGAIN: 3}
    assert len(ground.poses(60, drone.position(300_000), drone.position(500))) == 2, "it was started again"


def test_two_vehicles_with_one_system_id_are_noticed_once(ground, drone):
    other = SimulatedVehicle()
    ground.at(0, drone.heartbeat())
    for second in range(1, 30):
        ground.at(second, drone.position(1000 * second), other.position(900_000 + 1000 * second))
    assert [note for note in ground.notes if "same system id" in note] == ground.notes[1:]
    assert len(ground.notes) == 2


def test_a_vehicle_that_counts_no_time_is_dated_by_its_arrival(ground, drone):
    found = ground.poses(0, drone.heartbeat(), drone.position(0)) + ground.poses(1, drone.position(0))
    assert [pose["time"] - NOW for pose in found] == [0.0, 1.0]


def test_positions_are_dated_by_the_clock_of_the_vehicle(ground, drone):
    start = [drone.heartbeat(), drone.clock(NOW - 2.0, 10_000)]
    (pose,) = ground.poses(0, *start, drone.position(10_500))
    assert pose["time"] == pytest.approx(NOW - 1.5)
    assert ground.notes == ["vehicle 1: heard"], "two seconds are nothing"
    (pose,) = ground.poses(20, drone.position(11_000))
    assert pose["time"] == pytest.approx(NOW - 1.0), "it was delayed on the way"
    (pose,) = ground.poses(60, drone.position(100))
    assert pose["time"] == NOW + 60, "started again, and its clock is not known yet"


@pytest.mark.parametrize("unix_s", [0.0, 5000.0, 9.4e8, 9e9])
def test_a_clock_without_a_date_is_not_believed(ground, drone, unix_s):
    (pose,) = ground.poses(0, drone.heartbeat(), drone.clock(unix_s, 10_000), drone.position(10_500))
    assert pose["time"] == NOW


def test_a_clock_that_differs_is_named_once(ground, drone):
    ground.at(0, drone.heartbeat(), drone.clock(NOW - 3600, 1000))
    (status,) = ground.statuses(20, drone.clock(NOW - 3580, 21_000))
    assert status["time"] == pytest.approx(NOW - 3580)
    assert ground.notes[1:] == [
        "vehicle 1: its clock is 3600 s behind this computer's; its records are dated by it"
    ]


def test_headings_come_from_the_attitude_where_positions_have_none(ground, drone):
    (pose,) = ground.poses(
        0, drone.heartbeat(), drone.attitude(-math.pi / 2), drone.position(1, heading_deg=None)
    )
    assert pose["heading_deg"] == pytest.approx(270.0)
    (pose,) = ground.poses(30, drone.attitude(math.nan), drone.position(2, heading_deg=None))
    assert "heading_deg" not in pose


def test_fixes_of_receivers_count_where_the_autopilot_sends_no_estimate(ground, drone):
    assert ground.poses(0, drone.heartbeat(), drone.receiver(time_us=1_000_000)) == []
    moving = {"course": 4500, "speed": 300}
    (pose,) = ground.poses(6, drone.receiver(time_us=7_000_000, **moving))
    assert (pose["time"], pose["heading_deg"]) == (NOW + 6, 45.0)
    assert ground.poses(7, drone.receiver(time_us=7_000_000), drone.receiver(fix=1)) == []
    assert ground.vehicles.left_out == {AGAIN: 1, NO_FIX: 1}
    utc = round((NOW + 8) * 1e6) - 250_000
    (pose,) = ground.poses(8, drone.second_receiver(6, yaw=36_000, time_us=utc), drone.receiver(3, time_us=9))
    assert (pose["time"], pose["heading_deg"]) == (pytest.approx(NOW + 7.75), 0.0)
    assert len(ground.poses(9, drone.position(9000))) == 1
    assert ground.poses(10, drone.receiver(time_us=11_000_000)) == []


def test_a_status_has_battery_link_and_mode_and_is_repeated(ground, drone):
    (status,) = ground.statuses(0, drone.heartbeat(), drone.charge(80))
    assert status == {
        "type": "status", "track": "vehicle 1", "time": NOW, "battery_percent": 80, "link_percent": 100.0,
        "mode": "Loiter",
    }  # fmt: skip
    assert ground.statuses(1, drone.heartbeat(6)) == [], "not so soon"
    (status,) = ground.statuses(3, drone.heartbeat(6))
    assert status["mode"] == "RTL"
    assert ground.statuses(9, drone.heartbeat(6), drone.charge(80)) == []
    assert [one["time"] for one in ground.statuses(14, drone.heartbeat(6))] == [NOW + 14]
    assert ground.statuses(30) == [], "nothing is reported of a vehicle that is not heard"


def test_the_emptiest_battery_for_flying_counts(ground, drone):
    batteries = [drone.battery(70), drone.battery(40, number=1), drone.battery(5, number=2, function=4)]
    (status,) = ground.statuses(0, drone.heartbeat(), drone.charge(90), *batteries, drone.charge(20))
    assert status["battery_percent"] == 40
    (status,) = ground.statuses(30, drone.heartbeat(), drone.battery(-1))
    assert "battery_percent" not in status


def test_the_link_is_the_share_of_packets_that_arrive(ground, drone):
    made = [drone.heartbeat() for _ in range(21)]
    ground.at(0, made[0])
    (status,) = ground.statuses(11, *made[1::2], made[1], made[20])
    assert status["link_percent"] == pytest.approx(100 * 11 / 20, abs=0.1)


def test_a_weak_radio_counts_for_all_vehicles(ground):
    one, two = SimulatedVehicle(1), SimulatedVehicle(2)
    ground.at(0, one.heartbeat(), two.heartbeat())
    found = ground.statuses(11, radio(127, 200), one.heartbeat(), two.heartbeat())
    assert [status["link_percent"] for status in found] == [50.0, 50.0]
    found = ground.statuses(22, radio(255, 255), radio(51, 255, system=2), one.heartbeat(), two.heartbeat())
    assert [status["link_percent"] for status in found] == [100.0, 20.1]


def test_messages_are_said_once_and_the_gravest_is_repeated(ground, drone):
    found = ground.statuses(
        0, drone.heartbeat(), drone.text("Arming motors"), drone.text("Bad\x07 compass", 4)
    )
    assert [one["text"] for one in found] == ["Arming motors", "warning: Bad compass"]
    found = ground.statuses(
        3, drone.text("Takeoff"), drone.text("Bad\x07 compass", 4), drone.text("trace", 7)
    )
    assert [one["text"] for one in found] == ["Takeoff"]
    (status,) = ground.statuses(14, drone.heartbeat())
    assert status["text"] == "warning: Bad compass"
    (status,) = ground.statuses(80, drone.heartbeat())
    assert "text" not in status


def test_long_messages_are_joined(ground, drone):
    said = "x" * 50 + "y" * 50 + "end"
    pieces = [drone.text(said[n * 50 :][:50], 2, number=9, piece=n) for n in range(3)]
    found = ground.statuses(0, drone.heartbeat(), *pieces)
    assert [one["text"] for one in found] == [f"critical: {said}"]
    lost = [drone.text("a" * 50, 2, number=10), drone.text("b", 2, number=10, piece=2)]
    begun = [drone.text("c" * 50, 2, number=11), drone.text("d", 2, number=12)]
    found = ground.statuses(3, *lost, *begun)
    assert [one["text"] for one in found] == [
        "critical: " + "a" * 50 + "…b", "critical: " + "c" * 50 + "…", "critical: d"
    ]  # fmt: skip


def test_endless_messages_are_limited(ground, drone):
    found = ground.statuses(0, drone.heartbeat(), *(drone.text(f"message {n}") for n in range(500)))
    assert len(found) == 50
    endless = [drone.text("é" * 25, number=5, piece=n) for n in range(200)]
    (status,) = ground.statuses(100, *endless)[:1]
    assert len(status["text"]) == 200


def test_px4_has_its_modes(ground):
    wing = SimulatedVehicle(4, kind=1, autopilot=PX4)
    (status,) = ground.statuses(0, wing.heartbeat(4 << 16 | 5 << 24))
    assert status["mode"] == "Return"
