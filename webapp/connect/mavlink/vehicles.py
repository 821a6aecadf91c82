"""Messages of vehicles as the records of robots: poses, and how each vehicle is."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, NamedTuple

from webapp.connect.mavlink import packets
from webapp.connect.mavlink.modes import mode_name
from webapp.connect.mavlink.packets import Packet

_NO_AUTOPILOT = 8
_2D = 2
_UNKNOWN = 65_535
_MOVES_CMPS = 50
_PAYLOAD = 4
"""`MAV_BATTERY_FUNCTION`: flying does not depend on it."""

_RANGE_ERROR_M = 3.0
"""Of a receiver that states a dilution of precision only: its product with this is taken as its accuracy."""

_WITHOUT_ESTIMATE_S = 5.0
"""After this time without an estimate of the autopilot, the fixes of its receivers are taken."""

_REPORT_S, _LEAST_REPORT_S = 10.0, 2.0
_HEARD_S = 10.0
_TEXT_S = 60.0
_REORDERED_MS, _CLOCK_DIFFERS_S = 5_000, 5.0
_CLOCK_US = (1_704_067_200_000_000, 4_102_444_800_000_000)
"""2024 and 2100: a receiver that has lost count of the weeks is before, one without a date in 1970."""

_SEVERITIES = ("emergency", "alert", "critical", "error", "warning")
_DEBUG = 7
_MOST_TEXT, _TEXT_PIECE, _MOST_SAID = 200, 50, 50
_MOST_ACCURACY_M = 1e5
_MOST_STARTS = 3
"""More starts within a minute are those of two vehicles."""

NO_FIX = "positions without a fix"
AGAIN = "positions that came twice"


class Moment(NamedTuple):
    """When something was received."""

    unix_s: float
    monotonic_s: float


class _Known(NamedTuple):
    """A value, and the monotonic time at which it was received."""

    value: Any
    at_s: float = -math.inf


_NEVER = _Known(None)


@dataclass(slots=True)
class _Link:
    """How many packets of a vehicle arrive."""

    last: dict[int, int] = field(default_factory=dict)  # Sequence numbers by component
    received: int = 0
    lost: int = 0
    percent: _Known = _NEVER

    def count(self, packet: Packet) -> None:
        """Count a packet, and those that are missing before it."""
        known = self.last.get(packet.component)
        missing = 0 if known is None else (packet.sequence - known - 1) % 256
        if missing < 128:  # Otherwise it was overtaken, or came twice
            self.last[packet.component] = packet.sequence
            self.received, self.lost = self.received + 1, self.lost + missing

    def measure(self, now: Moment) -> float | None:
        """Return the percentage that arrived, measured every 10 s."""
        expected = self.received + self.lost
        if expected and now.monotonic_s - self.percent.at_s >= _REPORT_S:
            self.percent = _Known(100.0 * self.received / expected, now.monotonic_s)
            self.received = self.lost = 0
        measured: float | None = _fresh_value(self.percent, now)
        return measured


class _Text(NamedTuple):
    """A message to people, perhaps not yet complete."""

    severity: int = _DEBUG
    text: str = ""
    number: int = 0  # Identifies it if it has several pieces
    pieces: int = 0


@dataclass(slots=True)
class _Vehicle:
    """What is known of a vehicle."""

    name: str
    component: int  # The autopilot
    since_s: float
    mode: str
    heard_s: float
    link: _Link = field(default_factory=_Link)
    yaw_deg: _Known = _NEVER
    estimate: _Known = _NEVER  # Milliseconds since its start, of the last estimate
    receivers: dict[int, _Known] = field(default_factory=dict)  # Fields of their last message
    batteries: dict[int, _Known] = field(default_factory=dict)
    radio_percent: _Known = _NEVER
    start_s: float | None = None  # Unix time of its start, by its own clock
    ahead_s: float = 0.0  # Of its clock
    starts_s: list[float] = field(default_factory=list)
    is_several: bool = False
    begun: _Text = _Text()  # noqa: RUF009
    shown: _Known = _NEVER  # The message that is repeated
    said: dict[str, float] = field(default_factory=dict)  # Times of the messages of the last minute
    texts: list[str] = field(default_factory=list)  # To be reported
    reported: _Known = _NEVER


class Vehicles:
    """All vehicles of a connection.

    Args:
        names: Names by system id; the others are called `vehicle 3`.
        note: Called with what people should know.
    """

    def __init__(self, names: Mapping[int, str], *, note: Callable[[str], None]) -> None:
        self._names, self._note = names, note
        self._vehicles: dict[int, _Vehicle] = {}
        self.left_out: Counter[str] = Counter()

    def __len__(self) -> int:
        """Return how many were heard."""
        return len(self._vehicles)

    def records(self, packet: Packet, *, now: Moment) -> Iterator[dict[str, Any]]:
        """Yield the poses in a packet."""
        if packet.message == packets.RADIO_STATUS:
            self._take_radio(packet, now=now)
        vehicle = self._vehicles.get(packet.system)
        if packet.message == packets.HEARTBEAT and packet.fields["autopilot"] != _NO_AUTOPILOT:
            vehicle = self._heard(packet, now=now)
        if vehicle is None:
            return
        vehicle.link.count(packet)
        if packet.component != vehicle.component:
            return
        vehicle.heard_s = now.monotonic_s
        if packet.message in _TAKEN:
            _TAKEN[packet.message](vehicle, packet, now)
        elif packet.message == packets.SYSTEM_TIME:
            self._set_clock(vehicle, packet.fields, now=now)
        elif packet.message == packets.GLOBAL_POSITION_INT:
            yield from self._estimate(vehicle, packet.fields, now=now)
        elif packet.message in (packets.GPS_RAW_INT, packets.GPS2_RAW):
            yield from self._fix(vehicle, packet, now=now)

    def reports(self, now: Moment) -> Iterator[dict[str, Any]]:
        """Yield how vehicles are: what changed, and every 10 s while they are heard."""
        for vehicle in self._vehicles.values():
            texts, vehicle.texts = vehicle.texts, []
            for text in texts:
                yield _report(vehicle, text, now=now)
            if not texts and _is_due(vehicle, now=now):
                shown = _shown(vehicle, now=now)
                yield _report(vehicle, "" if shown is None else shown.text, now=now)

    def silent(self, packet: Packet, *, now: Moment, seconds: float) -> bool:
        """Return whether a packet is of a vehicle that has sent no estimate for so long."""
        vehicle = self._vehicles.get(packet.system)
        return (
            vehicle is not None
            and packet.component == vehicle.component
            and now.monotonic_s - max(vehicle.since_s, vehicle.estimate.at_s) > seconds
        )

    def _heard(self, packet: Packet, *, now: Moment) -> _Vehicle:
        fields, vehicle = packet.fields, self._vehicles.get(packet.system)
        mode = mode_name(
            autopilot=fields["autopilot"],
            kind=fields["type"],
            base=fields["base_mode"],
            custom=fields["custom_mode"],
        )
        if vehicle is None:
            name = self._names.get(packet.system, f"vehicle {packet.system}")
            vehicle = _Vehicle(name, packet.component, now.monotonic_s, mode, now.monotonic_s)
            self._vehicles[packet.system] = vehicle
            self._note(f"{name}: heard")
        elif packet.component == vehicle.component:
            vehicle.mode = mode
        return vehicle

    def _take_radio(self, packet: Packet, *, now: Moment) -> None:
        """Take the signal that a radio measures: of its own vehicle, or of all if it is none's."""
        signals = [signal for signal in packet.fields.values() if signal <= 254]
        if signals:
            known = _Known(100.0 * min(signals) / 254.0, now.monotonic_s)
            own = self._vehicles.get(packet.system)
            for vehicle in self._vehicles.values() if own is None else (own,):
                vehicle.radio_percent = known

    def _set_clock(self, vehicle: _Vehicle, fields: Mapping[str, Any], *, now: Moment) -> None:
        if not _CLOCK_US[0] < fields["time_unix_usec"] < _CLOCK_US[1]:
            return
        unix_s = fields["time_unix_usec"] * 1e-6
        ahead_s = unix_s - now.unix_s
        if abs(ahead_s - vehicle.ahead_s) > _CLOCK_DIFFERS_S:
            side = "ahead of" if ahead_s > 0 else "behind"
            self._note(
                f"{vehicle.name}: its clock is {abs(ahead_s):.0f} s {side} this computer's; its records "
                "are dated by it"
            )
        vehicle.ahead_s, vehicle.start_s = ahead_s, unix_s - fields["time_boot_ms"] * 1e-3

    def _estimate(
        self, vehicle: _Vehicle, fields: Mapping[str, Any], *, now: Moment
    ) -> Iterator[dict[str, Any]]:
        boot_ms, known_ms = fields["time_boot_ms"], vehicle.estimate.value
        if boot_ms and known_ms is not None and boot_ms <= known_ms:
            if known_ms - boot_ms < _REORDERED_MS:
                self.left_out[AGAIN] += 1
                return
            vehicle.start_s = None  # It was started again
            self._count_start(vehicle, now=now)
        vehicle.estimate = _Known(boot_ms, now.monotonic_s)
        connected = [one for one in _fresh(vehicle.receivers, now) if one["fix_type"]]
        fixed = [one for one in connected if one["fix_type"] >= _2D]
        if (connected and not fixed) or not (fields["lat"] or fields["lon"]):
            self.left_out[NO_FIX] += 1
            return
        heading = fields["hdg"] * 1e-2 if fields["hdg"] != _UNKNOWN else _fresh_value(vehicle.yaw_deg, now)
        time_s = now.unix_s if vehicle.start_s is None else vehicle.start_s + boot_ms * 1e-3
        accuracy_m = min(filter(None, map(_accuracy_m, fixed)), default=0.0)
        yield _pose(vehicle, fields, time_s=time_s, heading=heading, accuracy_m=accuracy_m)

    def _count_start(self, vehicle: _Vehicle, *, now: Moment) -> None:
        """Notice two vehicles that have the same system id, whose times since their starts alternate."""
        vehicle.starts_s = [*vehicle.starts_s[-_MOST_STARTS:], now.monotonic_s]
        several = len(vehicle.starts_s) > _MOST_STARTS and now.monotonic_s - vehicle.starts_s[0] < _TEXT_S
        if several and not vehicle.is_several:
            vehicle.is_several = True
            self._note(
                f"{vehicle.name}: two vehicles have the same system id: set another one "
                "(MAV_SYS_ID of PX4, MAV_SYSID or SYSID_THISMAV of ArduPilot)"
            )

    def _fix(self, vehicle: _Vehicle, packet: Packet, *, now: Moment) -> Iterator[dict[str, Any]]:
        """Remember a fix, and yield its pose if the autopilot sends no estimates."""
        fields, before = packet.fields, vehicle.receivers.get(packet.message, _Known({}))
        vehicle.receivers[packet.message] = _Known(fields, now.monotonic_s)
        if now.monotonic_s - max(vehicle.since_s, vehicle.estimate.at_s) < _WITHOUT_ESTIMATE_S:
            return
        if fields["fix_type"] < _2D or not (fields["lat"] or fields["lon"]):
            self.left_out[NO_FIX] += 1
        elif fields["time_usec"] and fields["time_usec"] == before.value.get("time_usec"):
            self.left_out[AGAIN] += 1
        elif _is_best(vehicle, packet.message, now=now):
            heading = _fresh_value(vehicle.yaw_deg, now)
            if heading is None and fields["yaw"] not in (0, _UNKNOWN):
                heading = fields["yaw"] * 1e-2
            elif heading is None and _UNKNOWN not in (fields["vel"], fields["cog"]):
                heading = fields["cog"] * 1e-2 if fields["vel"] > _MOVES_CMPS else None
            time_s = _fix_time(vehicle, fields["time_usec"], now=now)
            yield _pose(vehicle, fields, time_s=time_s, heading=heading, accuracy_m=_accuracy_m(fields))


def _take_yaw(vehicle: _Vehicle, packet: Packet, now: Moment) -> None:
    if math.isfinite(packet.fields["yaw"]):
        vehicle.yaw_deg = _Known(math.degrees(packet.fields["yaw"]), now.monotonic_s)


def _take_battery(vehicle: _Vehicle, packet: Packet, now: Moment) -> None:
    """Take the charge of a battery; the sum of `SYS_STATUS` counts only without `BATTERY_STATUS`."""
    percent, number = packet.fields["battery_remaining"], packet.fields.get("id", -1)
    if 0 <= percent <= 100 and packet.fields.get("battery_function") != _PAYLOAD:
        if number >= 0:
            vehicle.batteries.pop(-1, None)
        elif any(one >= 0 for one in vehicle.batteries):
            return
        vehicle.batteries[number] = _Known(percent, now.monotonic_s)


def _take_text(vehicle: _Vehicle, packet: Packet, now: Moment) -> None:
    """Take a message to people, or a piece of one; a piece with room left is the last."""
    severity, number, piece = (packet.fields[name] for name in ("severity", "id", "chunk_seq"))
    raw = packet.fields["text"].partition(b"\0")[0]
    text = raw.decode("utf-8", "replace")
    if not number:
        _say(vehicle, _Text(severity, text), now=now)
        return
    begun, vehicle.begun = vehicle.begun, _Text()
    if begun.text and begun.number != number:  # Its end was lost
        _say(vehicle, begun._replace(text=f"{begun.text}…"), now=now)
        begun = _Text()
    gap = "" if piece == begun.pieces else "…"
    whole = _Text(severity, (begun.text + gap + text)[:_MOST_TEXT], number, piece + 1)
    if len(raw) < _TEXT_PIECE or len(whole.text) == _MOST_TEXT:
        _say(vehicle, whole, now=now)
    else:
        vehicle.begun = whole


def _say(vehicle: _Vehicle, said: _Text, *, now: Moment) -> None:
    """Report a message, unless it was reported within a minute, and repeat the gravest one for a minute."""
    text = " ".join("".join(one if one.isprintable() else " " for one in said.text).split())
    if said.severity < len(_SEVERITIES):
        text = f"{_SEVERITIES[said.severity]}: {text}"
    text, at_s = text[:_MOST_TEXT], now.monotonic_s
    vehicle.said = {one: since_s for one, since_s in vehicle.said.items() if at_s - since_s < _TEXT_S}
    if not text or said.severity >= _DEBUG or (text not in vehicle.said and len(vehicle.said) >= _MOST_SAID):
        return
    shown = _shown(vehicle, now=now)
    if shown is None or said.severity <= shown.severity:
        vehicle.shown = _Known(said._replace(text=text), at_s)
    if text not in vehicle.said:
        vehicle.said[text] = at_s
        vehicle.texts.append(text)


_TAKEN: Mapping[int, Callable[[_Vehicle, Packet, Moment], None]] = {
    packets.ATTITUDE: _take_yaw,
    packets.SYS_STATUS: _take_battery,
    packets.BATTERY_STATUS: _take_battery,
    packets.STATUSTEXT: _take_text,
}


def _fresh_value(known: _Known, now: Moment) -> Any:
    return known.value if now.monotonic_s - known.at_s < _HEARD_S else None


def _fresh(known: Mapping[int, _Known], now: Moment) -> list[Any]:
    values = (_fresh_value(one, now) for one in known.values())
    return [value for value in values if value is not None]


def _accuracy_m(fix: Mapping[str, Any]) -> float:
    """Return the accuracy of a fix; 0 if it is unknown."""
    if fix["h_acc"]:
        return min(float(fix["h_acc"]) * 1e-3, _MOST_ACCURACY_M)
    return fix["eph"] * 1e-2 * _RANGE_ERROR_M if fix["eph"] != _UNKNOWN else 0.0


def _is_best(vehicle: _Vehicle, receiver: int, *, now: Moment) -> bool:
    """Return whether no other receiver has a better fix."""
    types = {
        number: known.value["fix_type"]
        for number, known in vehicle.receivers.items()
        if _fresh_value(known, now) is not None
    }
    return receiver == max(types, key=lambda number: (types[number], -number))


def _fix_time(vehicle: _Vehicle, time_us: int, *, now: Moment) -> float:
    """Date a fix by the date or the time since the start that it has, or by this computer."""
    if _CLOCK_US[0] < time_us < _CLOCK_US[1]:
        return time_us * 1e-6
    if vehicle.start_s is not None and 0 < time_us < _CLOCK_US[0]:
        return vehicle.start_s + time_us * 1e-6
    return now.unix_s


def _pose(
    vehicle: _Vehicle, fields: Mapping[str, Any], *, time_s: float, heading: float | None, accuracy_m: float
) -> dict[str, Any]:
    record: dict[str, Any] = {
        "type": "pose",
        "track": vehicle.name,
        "time": time_s,
        "lat": fields["lat"] * 1e-7,
        "lon": fields["lon"] * 1e-7,
        "height_m": fields["alt"] * 1e-3,
    }
    if heading is not None:
        record["heading_deg"] = heading % 360.0
    if accuracy_m:
        record["covariance"] = [accuracy_m**2, accuracy_m**2, 0.0]
    return record


def _shown(vehicle: _Vehicle, *, now: Moment) -> _Text | None:
    """Return the message to repeat, as people see the latest report only."""
    return vehicle.shown.value if now.monotonic_s - vehicle.shown.at_s <= _TEXT_S else None


def _battery(vehicle: _Vehicle, now: Moment) -> int | None:
    return min(_fresh(vehicle.batteries, now), default=None)


def _is_due(vehicle: _Vehicle, *, now: Moment) -> bool:
    """Return whether a vehicle that is heard has something new to say, or has said nothing for a while."""
    since_s = now.monotonic_s - vehicle.reported.at_s
    if now.monotonic_s - vehicle.heard_s > _HEARD_S or since_s < _LEAST_REPORT_S:
        return False
    said = vehicle.reported.value or {}
    changed = (said.get("mode"), said.get("battery_percent")) != (vehicle.mode, _battery(vehicle, now))
    return changed or since_s >= _REPORT_S


def _report(vehicle: _Vehicle, text: str, *, now: Moment) -> dict[str, Any]:
    shares = [vehicle.link.measure(now), _fresh_value(vehicle.radio_percent, now)]
    values = {
        "battery_percent": _battery(vehicle, now),
        "link_percent": min((round(share, 1) for share in shares if share is not None), default=None),
        "mode": vehicle.mode,
        "text": text or None,
    }
    record = {"type": "status", "track": vehicle.name, "time": now.unix_s + vehicle.ahead_s}
    record |= {name: value for name, value in values.items() if value is not None}
    vehicle.reported = _Known(record, now.monotonic_s)
    return record
