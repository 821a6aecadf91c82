"""NMEA logs of several receivers with one talker."""

import numpy as np
import pytest

from tests.missions.files.readers.test_text_tracks import read_nmea, sentence

ORDERS = {
    "one after the other": ("gga 0", "rmc 0", "gga 1", "rmc 1"),
    "sentence by sentence": ("gga 0", "gga 1", "rmc 1", "rmc 0"),
    "one kind only": ("gga 0", "gga 1"),
    "another kind each": ("gga 0", "rmc 1"),
}


def dm(value: float) -> str:
    return f"{int(value)}{value % 1 * 60:08.5f}".rjust(10, "0")


def gga(clock: str, lat: float, lon: float, *, talker: str = "GP") -> str:
    return sentence(f"{talker}GGA,{clock},{dm(lat)},N,{dm(lon)},E,1,08,0.9,245.4,M,46.9,M,,")


def rmc(clock: str, lat: float, lon: float, *, talker: str = "GP") -> str:
    return sentence(f"{talker}RMC,{clock},A,{dm(lat)},N,{dm(lon)},E,10.0,90.0,230324,,,A")


WRITERS = {"gga": gga, "rmc": rmc}


def place(receiver: int, second: float, *, apart: float, speed: float) -> tuple[float, float]:
    """Return the position of a receiver to the north of the first one; all go east."""
    return 50.0 + receiver * apart, 14.0 + second * speed


def log(order: tuple[str, ...], *, apart: float, speed: float, lag: int = 0) -> str:
    """Write a minute; the second receiver's sentences come so many seconds late."""
    lines = []
    for second in range(60 + lag):
        for kind, receiver in (one.split() for one in order):
            at = second - lag * int(receiver)
            if 0 <= at < 60:
                here = place(int(receiver), at, apart=apart, speed=speed)
                lines.append(WRITERS[kind](f"1200{at:02d}.00", *here))
    return "".join(lines)


@pytest.mark.parametrize("order", ORDERS.values(), ids=ORDERS)
@pytest.mark.parametrize(("apart", "speed"), [(1e-3, 1e-5), (1e-3, 0.0), (0.1, 1e-4)])
@pytest.mark.parametrize("lag", [0, 1])
def test_receivers_with_one_talker_are_tracks_of_their_own(order, apart, speed, lag):
    pieces, findings = read_nmea(log(order, apart=apart, speed=speed, lag=lag))
    assert [piece.track for piece in pieces] == ["receiver 1", "receiver 2"]
    for receiver, piece in enumerate(pieces):
        expected = [place(receiver, second, apart=apart, speed=speed) for second in range(60)]
        assert piece.poses.latlon == pytest.approx(np.array(expected), abs=2e-7)
        assert np.diff(piece.poses.times_s).tolist() == [1.0] * 59
    assert findings.notes[-1:] == ["2 receivers have positions at the same times: each is a track of its own"]
    assert not findings.skipped()


def test_two_antennas_on_a_vehicle_are_separate_even_if_their_order_changes():
    lines = []
    for second in range(60):
        both = [gga(f"1200{second:02d}", *place(n, second, apart=2e-5, speed=1e-4)) for n in (0, 1)]
        lines += both[:: -1 if second % 7 == 6 else 1]
    first, second = (piece.poses.latlon[:, 0] for piece in read_nmea("".join(lines))[0])
    assert np.ptp(first) < 1e-6
    assert np.ptp(second) < 1e-6


def test_a_receiver_that_fails_for_a_while_does_not_swap_tracks():
    lines = []
    for second in range(60):
        both = [rmc(f"1200{second:02d}", *place(n, second, apart=1e-3, speed=1e-5)) for n in (0, 1)]
        lines += both[20 < second < 30 :]
    first, second = (piece.poses for piece in read_nmea("".join(lines))[0])
    assert (len(first), len(second)) == (51, 60)
    assert np.ptp(first.latlon[:, 0]) < 1e-6
    assert np.ptp(second.latlon[:, 0]) < 1e-6


@pytest.mark.parametrize("every", [2, 5, 9])
def test_a_receiver_that_is_slower_has_its_own_track_too(every):
    lines = []
    for second in range(60):
        lines.append(gga(f"1200{second:02d}", *place(0, second, apart=1e-3, speed=1e-5)))
        if second % every == 0:
            lines.append(gga(f"1200{second:02d}", *place(1, second, apart=1e-3, speed=1e-5)))
    first, second = (piece.poses for piece in read_nmea("".join(lines))[0])
    assert (len(first), len(second)) == (60, -(-60 // every))
    assert np.ptp(first.latlon[:, 0]) < 1e-6


def test_single_positions_elsewhere_are_left_out_with_a_count():
    lines = []
    for second in range(60):
        lines.append(gga(f"1200{second:02d}", *place(0, second, apart=1e-3, speed=1e-5)))
        if second % 30 == 0:
            lines.append(gga(f"1200{second:02d}", *place(1, second, apart=1e-3, speed=1e-5)))
    (piece,), findings = read_nmea("".join(lines))
    assert np.ptp(piece.poses.latlon[:, 0]) < 1e-6, "the first one of a time counts"
    assert [one.count for one in findings.skipped()] == [2]


def test_two_of_three_receivers_have_the_same_talker():
    lines = []
    for second in range(30):
        for number, talker in enumerate(("GP", "GP", "GL")):
            here = place(number, second, apart=1e-2, speed=1e-5)
            lines.append(gga(f"1200{second:02d}", *here, talker=talker))
    pieces, _ = read_nmea("".join(lines))
    assert sorted((piece.track, len(piece.poses)) for piece in pieces) == [
        ("GL", 30), ("GP receiver 1", 30), ("GP receiver 2", 30),
    ]  # fmt: skip


@pytest.mark.parametrize("rate", [2, 5, 10])
def test_a_receiver_that_writes_whole_seconds_is_one_and_says_what_was_left_out(rate):
    lines = []
    for tick in range(20 * rate):
        here = place(0, tick / rate, apart=0.0, speed=1e-4)
        lines += [rmc(f"1200{tick // rate:02d}", *here), gga(f"1200{tick // rate:02d}", *here)]
    (piece,), findings = read_nmea("".join(lines))
    assert len(piece.poses) == 20
    (left_out,) = findings.skipped()
    assert (left_out.reason, left_out.count) == (
        "fixes with the time of another one, perhaps of a second receiver", 20 * (rate - 1),
    )  # fmt: skip


@pytest.mark.parametrize(
    ("rate", "speed", "noise"),
    [
        (2, 0.0, 1.0),
        (2, 0.1, 0.3),
        (2, 0.2, 0.3),
        (2, 1.3, 0.3),
        (4, 1.3, 0.3),
        (4, 1.3, 0.1),
        (10, 1.3, 0.05),
    ],
)
@pytest.mark.parametrize("moving", [1, 2], ids=["always", "with stops"])
def test_noise_of_a_receiver_that_writes_whole_seconds_is_not_another_one(rate, speed, noise, moving):
    """Speed in m/s and noise in m."""
    scatter = np.random.default_rng(1).normal(0.0, noise / 111_320, (600 * rate, 2))
    lines, east = [], 0.0
    for tick, (lat, lon) in enumerate(scatter):
        second = tick // rate
        east += speed / rate / 71_500 if second // 60 % moving == 0 else 0.0
        lines.append(gga(f"12{second // 60:02d}{second % 60:02d}", 50.1 + lat, 14.1 + east + lon / 0.643))
    (piece,), findings = read_nmea("".join(lines))
    assert len(piece.poses) == 600
    (left_out,) = findings.skipped()
    assert 0.98 <= left_out.count / (600 * (rate - 1)) <= 1.0, "some are equal, as written"


@pytest.mark.parametrize("speed", [0.0, 1e-5])
@pytest.mark.parametrize("number", [2, 3])
def test_receivers_a_few_metres_apart_with_noise_are_separate(number, speed):
    scatter = np.random.default_rng(1).normal(0.0, 0.3 / 111_320, (600, number, 2))
    lines = []
    for second in range(600):
        for receiver, noise in enumerate(scatter[second]):
            here = place(receiver, second, apart=3e-5, speed=speed) + noise + 0.1
            lines.append(gga(f"12{second // 60:02d}{second % 60:02d}", *here))
    pieces, _ = read_nmea("".join(lines))
    assert [len(piece.poses) for piece in pieces] == [600] * number
    assert all(np.ptp(piece.poses.latlon[:, 0]) < 3e-5 for piece in pieces)


def test_sentences_that_are_repeated_are_not_those_of_another_receiver():
    (piece,), findings = read_nmea(
        "".join(2 * rmc(f"1200{n:02d}", *place(0, n, apart=0.0, speed=1e-4)) for n in range(20))
    )
    assert len(piece.poses) == 20
    assert not findings.skipped()
