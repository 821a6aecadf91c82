"""NMEA 0183 logs of GPS receivers.

Consecutive sentences with the same time of day form one fix: RMC has the date, position, speed and course,
GGA and GNS position and height, GLL position, GST the accuracy. A fix without a date gets the one that puts
it nearest to the previous fix. WPL is a waypoint. Receivers in one log, which take turns, are distinguished
by their talkers (`GP`, `GN`), and those with one talker by their positions at the same times.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from datetime import UTC, date, datetime, time, timedelta
from functools import reduce
from itertools import pairwise, permutations
from operator import xor
from typing import BinaryIO

from webapp.core.geo.types import LatLon
from webapp.files.text_file import numbered_lines
from webapp.missions.core.trajectory.records import Sighting, make_poses
from webapp.missions.files.track_chunks import (
    CHUNK,
    UNTIMED_OBJECTS,
    Findings,
    Piece,
    WorldObjects,
    WorldPiece,
)
from webapp.missions.files.track_format import FormatAbout, TrackFormat, opened

_INVALID = "fixes marked invalid by the receiver"
_ESTIMATED = "positions that the receiver estimated without satellites"
_MADE_UP = "positions that were simulated or entered by hand"
_CUT = "sentences that are cut off"
_SAME_TIME = "fixes with the time of another one, perhaps of a second receiver"

_LEAST = {"RMC": 9, "GGA": 6, "GNS": 6, "GLL": 4, "GST": 8, "ZDA": 4, "WPL": 5}
"""Sentences that are used, and how many fields they have at least."""

_AT = {"RMC": 2, "GGA": 1, "GNS": 1, "GLL": 0, "WPL": 0}
"""Index of the latitude, which is followed by N or S, the longitude, and E or W."""

_CLOCK_AT = {"GLL": 4}
_BY_MODE = {"N": _INVALID, "E": _ESTIMATED, "S": _MADE_UP, "M": _MADE_UP}
_BY_QUALITY = {0: _INVALID, 6: _ESTIMATED, 7: _MADE_UP, 8: _MADE_UP}
_SENTENCE = re.compile(r"([A-Z][A-Z0-9]{4,5}),([^*]*)(?:\*([0-9A-Fa-f]{2}).*)?", re.DOTALL)
_ANGLE = re.compile(r"(\d{1,3})(\d\d(?:\.\d*)?)")
_CLOCK = re.compile(r"(\d\d)(\d\d)(\d\d)(?:\.(\d*))?")
_MOST_DEG = {"NS": 90.0, "EW": 180.0}
"""Of the letters of both sides; the second one is negative."""

_FIRST_YEAR = 1990
"""Receivers that do not know the date yet begin in 1980."""

_APART_M = 30.0
"""The positions of sentences of other kinds, at one time, are those of one receiver up to this distance."""

_LEAST_TOGETHER, _TOGETHER = 2, 0.1
"""Least number and share of times at which several receivers have positions."""

_MOST_RECEIVERS = 4
_TO_AND_FRO = 1.15
"""Least ratio of the way through the positions of several receivers to their own ways."""

_LASTING = 0.5
"""Largest change of the offset of a receiver from another one, from one time to the next, to the offset."""

_TURNS = 0.5
"""Least share of changes of the talker for which a log has two receivers: one changes it rarely."""


class _Unreadable(ValueError):
    """A sentence is left out; its text is the reason."""


@dataclass(frozen=True, slots=True)
class _Sentence:
    """A sentence that is used; unknown numbers are NaN."""

    kind: str  # RMC, GGA ...
    talker: str  # GP, GN ...
    clock: time | None = None
    day: date | None = None
    lat: float = math.nan
    lon: float = math.nan
    height_m: float = math.nan
    heading_deg: float = math.nan
    var_e: float = math.nan
    var_n: float = math.nan
    bad: str = ""  # Why its position is not used
    name: str = ""  # Of a waypoint

    @property
    def moment(self) -> datetime | None:
        """Date and time; None if either is unknown."""
        if self.day is None or self.clock is None:
            return None
        return datetime.combine(self.day, self.clock, tzinfo=UTC)

    @property
    def place(self) -> LatLon | None:
        return None if math.isnan(self.lat) else LatLon(self.lat, self.lon)


def _is_sentence(line: str) -> bool:
    """Return whether a line holds an NMEA sentence, possibly after a logger's own time stamp."""
    _, dollar, body = line.partition("$")
    return bool(dollar) and len(body) > 6 and body[:5].isalnum() and body[:5].isupper() and body[5] == ","


def _sentences(file: BinaryIO, *, checked: bool, findings: Findings) -> Iterator[tuple[str, _Sentence]]:
    """Yield the sentences that are used, each with its line.

    Args:
        file: At its beginning.
        checked: Whether those of this log have checksums: one without is then damaged.
    """
    for number, line in numbered_lines(file):
        where = f"line {number}"
        if not _is_sentence(line):
            findings.skip("lines that are no NMEA sentences", where=where, count=int(bool(line.strip())))
            continue
        for text in line.split("$")[1:]:
            if text[2:5] not in _LEAST:
                continue
            try:
                yield where, _parse(text.strip(), checked=checked)
            except _Unreadable as error:
                findings.skip(str(error), where=where)


def _has_checksum(text: str) -> bool:
    return bool(re.search(r"\*[0-9A-Fa-f]{2}", text))


def _parse(text: str, *, checked: bool) -> _Sentence:
    """Parse a sentence without its dollar sign; text after the checksum is ignored.

    Raises:
        Unreadable
    """
    found = _SENTENCE.fullmatch(text)
    if found is None:
        raise _Unreadable("sentences that cannot be read" if _has_checksum(text) else _CUT)
    if found[3] is None and checked:
        raise _Unreadable(_CUT)
    if found[3] is not None and reduce(xor, text.partition("*")[0].encode(), 0) != int(found[3], 16):
        raise _Unreadable("sentences with a wrong checksum")
    talker, kind, fields = found[1][:2], found[1][2:5], [field.strip() for field in found[2].split(",")]
    if len(fields) < _LEAST[kind]:
        raise _Unreadable("sentences that cannot be read" if found[3] else _CUT)
    try:
        return _parsed(kind, talker, fields)
    except _Unreadable:
        raise
    except ValueError as error:
        raise _Unreadable("sentences that cannot be read") from error


def _parsed(kind: str, talker: str, fields: list[str]) -> _Sentence:
    if kind == "WPL":
        lat, lon = _position(fields)
        if math.isnan(lat):
            raise _Unreadable("waypoints without a position")
        return _Sentence(kind, talker, lat=lat, lon=lon, name=" ".join(fields[4].split()))
    clock = _clock(_field(fields, _CLOCK_AT.get(kind, 0)))
    if kind == "ZDA":
        days = [int(field) if field else 0 for field in fields[1:4]]
        return _Sentence(kind, talker, clock, date(days[2], days[1], days[0]) if days[2] else None)
    if kind == "GST":
        north, east = _number(fields[5]), _number(fields[6])
        return _Sentence(kind, talker, clock, var_e=east**2, var_n=north**2)
    lat, lon = _position(fields[_AT[kind] :])
    bad = _bad(kind, fields)
    if kind != "RMC":
        height = _number(_field(fields, 8)) if kind in ("GGA", "GNS") else math.nan
        return _Sentence(kind, talker, clock, lat=lat, lon=lon, height_m=height, bad=bad)
    day = datetime.strptime(fields[8], "%d%m%y").date() if fields[8] else None
    heading = _number(fields[7]) if _number(fields[6]) > 0.0 else math.nan
    return _Sentence(kind, talker, clock, day, lat, lon, heading_deg=heading, bad=bad)


def _bad(kind: str, fields: list[str]) -> str:
    """Return why the position of a fix is not used; empty if it is."""
    if kind == "GGA":
        return _BY_QUALITY.get(int(fields[5]), "") if fields[5] else _INVALID
    if kind == "GNS":
        modes = set(fields[5].upper()) - {"N"}
        return _INVALID if not modes else _BY_MODE.get(modes.pop(), "") if len(modes) == 1 else ""
    status, mode = (1, 11) if kind == "RMC" else (5, 6)
    if _field(fields, status).upper() == "V":
        return _INVALID
    return _BY_MODE.get(_field(fields, mode).upper(), "")


def _field(fields: list[str], index: int) -> str:
    return fields[index] if index < len(fields) else ""


def _number(text: str) -> float:
    return float(text) if text else math.nan


def _clock(text: str) -> time | None:
    if not text:
        return None
    found = _CLOCK.fullmatch(text)
    if found is None:
        raise ValueError(text)
    return time(int(found[1]), int(found[2]), int(found[3]), int(f"{found[4] or ''}000000"[:6]))


def _position(fields: list[str]) -> tuple[float, float]:
    """Return latitude and longitude; NaN if the fields are empty."""
    lat, north, lon, east = fields[:4]
    if not lat or not lon:
        return math.nan, math.nan
    return _degrees(lat, north, sides="NS"), _degrees(lon, east, sides="EW")


def _degrees(text: str, side: str, *, sides: str) -> float:
    """Convert an angle in degrees and minutes, `5005.100`, to degrees."""
    found = _ANGLE.fullmatch(text)
    if found is None or float(found[2]) >= 60.0:
        raise ValueError(text)
    if side.upper() not in tuple(sides):
        raise _Unreadable("positions without N or S, or without E or W")
    size = int(found[1]) + float(found[2]) / 60.0
    if size > _MOST_DEG[sides]:
        raise ValueError(text)
    return -size if side.upper() == sides[1] else size


@dataclass(slots=True)
class _Fix:
    """A fix, merged from the sentences with one time of day."""

    clock: time
    lat: float = math.nan
    lon: float = math.nan
    height_m: float = math.nan
    heading_deg: float = math.nan
    var_e: float = math.nan
    var_n: float = math.nan
    bad: str = ""  # Why it is left out
    replaced: int = 0  # Number of fixes with its time that it has replaced
    # The position that each kind of its sentences has.
    kinds: dict[str, LatLon | None] = field(default_factory=dict)

    @property
    def place(self) -> LatLon | None:
        return None if math.isnan(self.lat) else LatLon(self.lat, self.lon)

    def take(self, sentence: _Sentence) -> None:
        """Merge a sentence."""
        self.bad = self.bad or sentence.bad
        for name in ("lat", "lon", "height_m", "heading_deg", "var_e", "var_n"):
            if not math.isnan(value := getattr(sentence, name)):
                setattr(self, name, value)
        self.kinds[sentence.kind] = sentence.place

    def off_m(self, sentence: _Sentence) -> float:
        """Return how far it is from a sentence; infinite if it has such a sentence with another position."""
        place, other = self.place, sentence.place
        if self.kinds.get(sentence.kind, other) != other:
            return math.inf
        if place is None or other is None:
            return _APART_M
        return 0.0 if place == other else _apart_m(place, other)


@dataclass(slots=True)
class _Epochs:
    """Gathers sentences by time of day: the fix of a receiver, or those of several."""

    depth: int = 1  # Times that are open at once; receivers whose sentences take turns may lag behind
    open: dict[time, list[_Fix]] = field(default_factory=dict)
    last: _Fix | None = None

    def add(self, sentence: _Sentence) -> None:
        assert sentence.clock is not None, "without a time there is no fix"
        fixes = self.open.setdefault(sentence.clock, [])
        found = fixes[0] if len(fixes) == 1 else None  # as usual
        if len(fixes) > 1:
            found = min(fixes, key=lambda fix: (fix.off_m(sentence), fix is not self.last))
        if found is None or found.off_m(sentence) > _APART_M:
            found = self._next(fixes, sentence.clock)
        found.take(sentence)
        self.last = found

    def _next(self, fixes: list[_Fix], clock: time) -> _Fix:
        """Return a new fix; of very many at one time the last one is replaced."""
        if len(fixes) <= _MOST_RECEIVERS:
            fixes.append(_Fix(clock))
        else:
            fixes[-1].replaced += 1
            fixes[-1].kinds.clear()
        return fixes[-1]

    def closed(self, *, all: bool = False) -> Iterator[list[_Fix]]:
        """Remove and yield the fixes of the times that are complete."""
        while len(self.open) > (0 if all else self.depth):
            yield self.open.pop(next(iter(self.open)))


@dataclass(slots=True)
class _Crowd:
    """Counts the positions at the same times.

    A receiver that writes whole seconds has several as well. But these lie along its way, and those of
    several receivers to and fro; or else they are noise, and the offsets between receivers last.
    """

    epochs: _Epochs = field(default_factory=lambda: _Epochs(depth=2))
    times: int = 0
    numbers: Counter[int] = field(default_factory=Counter)
    before: list[LatLon] = field(default_factory=list)
    compared: int = 0  # Pairs of times
    apart: int = 0  # Those with the positions of several receivers

    def add(self, sentence: _Sentence) -> None:
        if sentence.clock is not None and sentence.kind not in ("ZDA", "WPL"):
            self.epochs.add(sentence)
            self.count(self.epochs.closed())

    def count(self, closed: Iterator[list[_Fix]]) -> None:
        for fixes in closed:
            places = [fix.place for fix in fixes if fix.place is not None and not fix.bad]
            self.times += bool(places)
            self.numbers[len(places)] += len(places) > 1
            if len(places) > 1 and len(places) == len(self.before):
                self.compared += 1
                self.apart += any(_are_apart(self.before, order) for order in (places, places[::-1]))
            self.before = places if len(places) > 1 else self.before

    def receivers(self) -> int:
        self.count(self.epochs.closed(all=True))
        ((number, _),) = self.numbers.most_common(1) or [(1, 0)]
        several = self.numbers.total()
        if several < max(_LEAST_TOGETHER, _TOGETHER * self.times) or number > _MOST_RECEIVERS:
            return 1
        return number if 2 * self.apart > self.compared else 1


def _are_apart(before: list[LatLon], places: list[LatLon]) -> bool:
    """Return whether the positions at two times are those of several receivers, in the same order."""
    all_m = sum(_apart_m(*pair) for pair in pairwise([before[-1], *places]))
    each_m = sum(map(_apart_m, before, places)) / len(places)
    offsets = [
        (_offset_m(*a), _offset_m(*b)) for a, b in zip(pairwise(before), pairwise(places), strict=True)
    ]
    return all_m > _TO_AND_FRO * each_m and all(abs(b - a) < _LASTING * abs(b) for a, b in offsets)


@dataclass(slots=True)
class _Receiver:
    """The way of a receiver so far."""

    before: LatLon | None = None
    last: LatLon | None = None

    def move(self, place: LatLon) -> None:
        self.before, self.last = self.last, place

    def off_m(self, place: LatLon) -> float:
        """Return how far a position is from where the receiver goes at its velocity."""
        if self.last is None:
            return _APART_M
        before = self.before or self.last
        ahead = LatLon(2.0 * self.last.lat - before.lat, 2.0 * self.last.lon - before.lon)
        return _apart_m(ahead, place)


def _offset_m(a: LatLon, b: LatLon) -> complex:
    """Return how far a position is east (real) and north (imaginary) of another one, roughly."""
    east = math.remainder(a.lon - b.lon, 360.0) * math.cos(math.radians(a.lat))
    return 111_320.0 * complex(east, a.lat - b.lat)


def _apart_m(a: LatLon, b: LatLon) -> float:
    return abs(_offset_m(a, b))


def _whose(places: list[LatLon], receivers: list[_Receiver]) -> tuple[int, ...]:
    """Return the index of the receiver of each position, at most one for each.

    Usually they come in the same order each time.
    """
    costs = {
        order: sum(receivers[index].off_m(place) for index, place in zip(order, places, strict=True))
        for order in permutations(range(len(receivers)), len(places))
    }
    best, usual = min(costs, key=costs.__getitem__), tuple(range(len(receivers)))
    return usual if usual in costs and costs[usual] <= 2.0 * costs[best] else best


def read(file: BinaryIO, *, findings: Findings) -> Iterator[Piece]:
    """Read a log; sentences of other types are ignored.

    Args:
        file: At its beginning; must be seekable.
    """
    survey = _survey(file)
    if survey.talkers:
        findings.note(f"the fixes of several receivers are separate: {', '.join(survey.talkers)}")
    if survey.first is not None and survey.first.year < _FIRST_YEAR:
        findings.note(f"the receiver did not know the date: times count from {survey.first.date()}")
    logs: dict[str, _Log] = {}
    where = "line 1"
    file.seek(0)
    for where, sentence in _sentences(file, checked=survey.checked, findings=findings):
        if sentence.kind == "WPL":
            findings.note(UNTIMED_OBJECTS)
            yield WorldObjects((_waypoint(sentence),))
            continue
        if survey.first is None:
            findings.note("no sentence has a date: times count from 1970-01-01")
        name = sentence.talker if survey.talkers else ""
        if name not in logs:
            logs[name] = _Log(name, survey)
            number = len(logs[name].receivers)
            note = f"{number} receivers have positions at the same times: each is a track of its own"
            findings.note(note if number > 1 else "")
        log = logs[name]
        log.add(sentence, where, findings=findings)
        yield from log.pieces(CHUNK)
    for log in logs.values():
        log.finish(where, findings=findings, all=True)
        yield from log.pieces(1)


@dataclass(frozen=True, slots=True)
class _Survey:
    """Properties of a whole log."""

    first: datetime | None  # The first date, which also serves for the fixes before it
    checked: bool  # Whether its sentences have checksums
    talkers: tuple[str, ...]  # Of two or more receivers; empty for one
    receivers: Mapping[str, int]  # Their number by talker; those of all talkers under ""


def _survey(file: BinaryIO) -> _Survey:
    checks = Counter(_has_checksum(line) for _, line in numbered_lines(file) if _is_sentence(line))
    checked = checks[True] > checks[False]
    file.seek(0)
    moments: list[datetime] = []
    turns = _Turns()
    crowd = _Crowd()
    for _, sentence in _sentences(file, checked=checked, findings=Findings()):
        if (moment := sentence.moment) is not None and (not moments or moments[0].year < _FIRST_YEAR):
            moments = [moment] if not moments or moment.year >= _FIRST_YEAR else moments
        turns.add(sentence)
        crowd.add(sentence)
    talkers = turns.talkers()
    receivers = _receivers(file, checked=checked) if talkers else {"": crowd.receivers()}
    return _Survey(moments[0] if moments else None, checked, talkers, receivers)


def _receivers(file: BinaryIO, *, checked: bool) -> dict[str, int]:
    file.seek(0)
    crowds: dict[str, _Crowd] = {}
    for _, sentence in _sentences(file, checked=checked, findings=Findings()):
        crowds.setdefault(sentence.talker, _Crowd()).add(sentence)
    return {talker: crowd.receivers() for talker, crowd in crowds.items()}


@dataclass(slots=True)
class _Turns:
    """Counts how often the talker of each kind of sentences changes."""

    last: dict[str, _Sentence] = field(default_factory=dict)
    counts: dict[str, Counter[str]] = field(default_factory=dict)
    changes: Counter[str] = field(default_factory=Counter)

    def add(self, sentence: _Sentence) -> None:
        if sentence.place is None or sentence.kind == "WPL":
            return
        before = self.last.get(sentence.kind, sentence)
        self.last[sentence.kind] = sentence
        self.counts.setdefault(sentence.kind, Counter())[sentence.talker] += 1
        twice = before.clock == sentence.clock and before.place == sentence.place
        self.changes[sentence.kind] += before.talker != sentence.talker and not twice

    def talkers(self) -> tuple[str, ...]:
        """Return the talkers of different receivers; none if there is one receiver."""
        found: set[str] = set()
        for kind, counts in self.counts.items():
            fewest = min(counts.values())
            if len(counts) > 1 and fewest > 1 and self.changes[kind] >= _TURNS * 2 * fewest:
                found |= counts.keys()
        return tuple(sorted(found))


@dataclass(slots=True)
class _Calendar:
    """Infers dates: a time of day belongs to the day that puts it nearest to the last known moment."""

    near: datetime | None

    def unix_time(self, clock: time) -> float:
        near = self.near or datetime.combine(date(1970, 1, 1), clock, tzinfo=UTC)
        days = [near.date() + timedelta(days=k) for k in (-1, 0, 1)]
        moments = [datetime.combine(day, clock, tzinfo=UTC) for day in days]
        self.near = min(moments, key=lambda moment: abs(moment - near))
        return self.near.timestamp()


class _Log:
    """The fixes of the receivers with one talker."""

    def __init__(self, name: str, survey: _Survey) -> None:
        self.name, self.first = name, survey.first
        self.calendar = _Calendar(survey.first)
        self.receivers = [_Receiver() for _ in range(survey.receivers[name])]
        self.rows: list[list[tuple[float, ...]]] = [[] for _ in self.receivers]
        self.epochs = _Epochs(depth=min(len(self.receivers), 2))
        self.has_no_date = False  # Whether the receiver does not know the date yet, unlike later

    def add(self, sentence: _Sentence, where: str, *, findings: Findings) -> None:
        if sentence.clock is None:
            findings.skip("sentences without a time", where=where)
            return
        if sentence.clock not in self.epochs.open:
            self.epochs.open[sentence.clock] = []
            self.finish(where, findings=findings)
        moment = sentence.moment
        if moment is not None and self.first is not None:
            self.has_no_date = moment.year < _FIRST_YEAR <= self.first.year
            self.calendar.near = self.calendar.near if self.has_no_date else moment
        if sentence.kind != "ZDA":
            self.epochs.add(sentence)

    def finish(self, where: str, *, findings: Findings, all: bool = False) -> None:
        """Add the fixes of the times that are complete to the rows."""
        for fixes in self.epochs.closed(all=all):
            good = [fix for fix in self.one_each(fixes, where, findings=findings) if fix.place is not None]
            places = [fix.place for fix in good if fix.place is not None]
            for fix, place, index in zip(good, places, _whose(places, self.receivers), strict=True):
                self.receivers[index].move(place)
                when = self.calendar.unix_time(fix.clock)
                row = (when, *place, fix.height_m, fix.heading_deg, fix.var_e, fix.var_n)
                self.rows[index].append(row)

    def one_each(self, fixes: list[_Fix], where: str, *, findings: Findings) -> Iterator[_Fix]:
        """Yield the usable fixes of one time, at most one for each receiver."""
        if self.has_no_date:
            findings.skip("fixes from before the receiver knew the date", where=where, count=len(fixes))
            return
        placed = sum(fix.place is not None for fix in fixes) + sum(fix.replaced for fix in fixes)
        findings.skip(_SAME_TIME, where=where, count=max(placed - len(self.receivers), 0))
        if len(self.receivers) == 1:
            fixes = fixes[:1]
        for fix in [fix for fix in fixes if fix.bad or fix.place is None]:
            findings.skip(fix.bad or "times without a position", where=where)
        yield from [fix for fix in fixes if not fix.bad and fix.place is not None][: len(self.receivers)]

    def pieces(self, least: int) -> Iterator[WorldPiece]:
        """Yield the rows of the receivers that have at least so many."""
        for index, rows in enumerate(self.rows):
            if len(rows) >= least:
                self.rows[index] = []
                several = f"receiver {index + 1}" if len(self.receivers) > 1 else ""
                yield _piece(f"{self.name} {several}".strip(), rows)


def _waypoint(sentence: _Sentence) -> Sighting:
    place = sentence.place
    assert place is not None, "waypoints have positions"
    return Sighting(f"waypoint {sentence.name}".strip(), "waypoint", 0.0, place)


def _piece(name: str, rows: list[tuple[float, ...]]) -> WorldPiece:
    times, lat, lon, height, heading, var_e, var_n = (list(column) for column in zip(*rows, strict=True))
    covariance = [(e, n, 0.0 if not math.isnan(e) else math.nan) for e, n in zip(var_e, var_n, strict=True)]
    latlon = list(zip(lat, lon, strict=True))
    poses = make_poses(times, latlon, height_m=height, heading_deg=heading, covariance_m2=covariance)
    return WorldPiece(name, "gps", poses)


FORMAT = TrackFormat(
    "nmea",
    "NMEA 0183",
    "NMEA",
    endings=(".nmea", ".nma", ".log"),
    is_one=lambda beginning: any(map(_is_sentence, beginning.lines)),
    read=opened(lambda file, _, findings: read(file, findings=findings)),
    numbered="waypoint",
    about=FormatAbout(
        tracks="RMC, GGA, GNS, GLL, with ZDA for the date and GST for the accuracy; one for each of several "
        "receivers, which talkers or positions at the same times distinguish",
        objects="WPL",
        left_out="other sentences, those cut off, fixes marked as invalid, estimated or simulated",
        written_by="GPS receivers, chart plotters",
    ),
)
