"""NMEA 0183 logs of GPS receivers.

Consecutive sentences with the same time of day form one fix: RMC has the date, position, speed and course,
GGA and GNS position and height, GLL position, GST the accuracy. A fix without a date gets the one that puts
it nearest to the previous fix. WPL is a waypoint. Two receivers in one log, which take turns, are
distinguished by their talkers (`GP`, `GN`).
"""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import UTC, date, datetime, time, timedelta
from typing import BinaryIO

from webapp.files.text_file import numbered_lines
from webapp.missions.core.trajectory.records import Sighting, make_poses
from webapp.missions.files.readers.nmea_sentences import (
    Sentence,
    has_checksum,
    is_sentence,
    sentences,
)
from webapp.missions.files.track_chunks import (
    CHUNK,
    UNTIMED_OBJECTS,
    Findings,
    Piece,
    WorldObjects,
    WorldPiece,
)
from webapp.missions.files.track_format import FormatAbout, TrackFormat, opened

_FIRST_YEAR = 1990
"""Receivers that do not know the date yet begin in 1980."""

_TURNS = 0.5
"""Least share of changes of the talker for which a log has two receivers: one changes it rarely."""


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

    def take(self, sentence: Sentence) -> None:
        """Merge a sentence."""
        self.bad = self.bad or sentence.bad
        for name in ("lat", "lon", "height_m", "heading_deg", "var_e", "var_n"):
            if not math.isnan(value := getattr(sentence, name)):
                setattr(self, name, value)


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
    for where, sentence in sentences(file, checked=survey.checked, findings=findings):
        if sentence.kind == "WPL":
            findings.note(UNTIMED_OBJECTS)
            yield WorldObjects((_waypoint(sentence),))
            continue
        if survey.first is None:
            findings.note("no sentence has a date: times count from 1970-01-01")
        name = sentence.talker if survey.talkers else ""
        log = logs.setdefault(name, _Log(name, survey, _Calendar(survey.first)))
        log.add(sentence, where, findings=findings)
        yield from log.pieces(CHUNK)
    for log in logs.values():
        log.finish(where, findings=findings)
        yield from log.pieces(1)


@dataclass(frozen=True, slots=True)
class _Survey:
    """Properties of a whole log."""

    first: datetime | None  # The first date, which also serves for the fixes before it
    checked: bool  # Whether its sentences have checksums
    talkers: tuple[str, ...]  # Of two or more receivers; empty for one


def _survey(file: BinaryIO) -> _Survey:
    checks = Counter(has_checksum(line) for _, line in numbered_lines(file) if is_sentence(line))
    checked = checks[True] > checks[False]
    file.seek(0)
    moments: list[datetime] = []
    turns = _Turns()
    for _, sentence in sentences(file, checked=checked, findings=Findings()):
        if (moment := sentence.moment) is not None and (not moments or moments[0].year < _FIRST_YEAR):
            moments = [moment] if not moments or moment.year >= _FIRST_YEAR else moments
        turns.add(sentence)
    return _Survey(moments[0] if moments else None, checked, turns.talkers())


@dataclass(slots=True)
class _Turns:
    """Counts how often the talker of each kind of sentences changes."""

    last: dict[str, Sentence] = field(default_factory=dict)
    counts: dict[str, Counter[str]] = field(default_factory=dict)
    changes: Counter[str] = field(default_factory=Counter)

    def add(self, sentence: Sentence) -> None:
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


@dataclass(slots=True)
class _Log:
    """The fixes of a receiver."""

    name: str
    survey: _Survey
    calendar: _Calendar
    rows: list[tuple[float, ...]] = field(default_factory=list)
    fix: _Fix | None = None
    has_no_date: bool = False  # Whether the receiver does not know the date yet, unlike later

    def add(self, sentence: Sentence, where: str, *, findings: Findings) -> None:
        if sentence.clock is None:
            findings.skip("sentences without a time", where=where)
            return
        if self.fix is not None and self.fix.clock != sentence.clock:
            self.finish(where, findings=findings)
        moment, first = sentence.moment, self.survey.first
        if moment is not None and first is not None:
            self.has_no_date = moment.year < _FIRST_YEAR <= first.year
            self.calendar.near = self.calendar.near if self.has_no_date else moment
        if sentence.kind != "ZDA":
            self.fix = self.fix or _Fix(sentence.clock)
            self.fix.take(sentence)

    def finish(self, where: str, *, findings: Findings) -> None:
        """Add the current fix, if any, to the rows."""
        fix, self.fix = self.fix, None
        if fix is None:
            return
        if self.has_no_date:
            findings.skip("fixes from before the receiver knew the date", where=where)
            return
        when = self.calendar.unix_time(fix.clock)
        if fix.bad:
            findings.skip(fix.bad, where=where)
        elif math.isnan(fix.lat):
            findings.skip("times without a position", where=where)
        else:
            place = (fix.lat, fix.lon, fix.height_m)
            self.rows.append((when, *place, fix.heading_deg, fix.var_e, fix.var_n))

    def pieces(self, least: int) -> Iterator[WorldPiece]:
        """Yield the rows, if there are at least so many."""
        if len(self.rows) >= least:
            rows, self.rows = self.rows, []
            yield _piece(self.name, rows)


def _waypoint(sentence: Sentence) -> Sighting:
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
    is_one=lambda beginning: any(map(is_sentence, beginning.lines)),
    read=opened(lambda file, _, findings: read(file, findings=findings)),
    numbered="waypoint",
    about=FormatAbout(
        tracks="RMC, GGA, GNS, GLL, with ZDA for the date and GST for the accuracy; one for each of several "
        "receivers",
        objects="WPL",
        left_out="other sentences, those cut off, fixes marked as invalid, estimated or simulated",
        written_by="GPS receivers, chart plotters",
    ),
)
