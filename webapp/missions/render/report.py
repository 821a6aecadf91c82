"""The report of a mission in words: facts, a map and tables, from which a page and a PDF are made."""

from __future__ import annotations

import time
from collections import Counter
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

from webapp.core.geo import grids
from webapp.core.geo.types import LatLon
from webapp.missions.core import drawings as shapes
from webapp.missions.core.trajectory.outgoing import ExportDrawing, ExportObject, ExportTrack
from webapp.missions.store.schema import RobotReport
from webapp.missions.tasks.coverage import AreaSearch
from webapp.missions.tasks.export import icon
from webapp.missions.tasks.report import Deed, MissionReport, People
from webapp.render.language import Language

NOTATIONS: dict[str, Callable[[LatLon], object] | None] = {
    "degrees": None,
    "dms": grids.degrees_minutes_seconds,
    "utm": grids.utm,
    "mgrs": grids.mgrs,
}
"""Notations of positions beside decimal degrees, by the names of the switch on the pages."""

MAX_PICTURES = 200
"""Objects that are shown with a picture."""

_MOST_POINTS = 12
"""Points of a drawing that are listed."""

_MOST_CLASSES = 40
"""Classes of objects in the legend."""

Picture = Callable[[str], bytes | None]
"""Finds the small picture of a photo by its SHA-256."""


@dataclass(frozen=True, slots=True)
class Cell:
    """A cell of a table, one line of text below the other."""

    lines: tuple[str, ...] = ()
    picture: bytes | None = None  # JPEG, PNG or WebP
    colour: str | None = None  # `#rrggbb` of a swatch before the text
    head: bool = False  # Whether it names the row
    number: bool = False


@dataclass(frozen=True, slots=True)
class Section:
    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple[Cell, ...], ...]
    remarks: tuple[str, ...] = ()


@dataclass(frozen=True, slots=True)
class LegendEntry:
    text: str
    colour: str | None = None
    icon: bytes | None = None  # PNG


@dataclass(frozen=True, slots=True)
class ReportContent:
    language: str
    kind: str  # What it is: "Mission report"
    title: str
    note: str
    facts: tuple[tuple[str, str], ...]
    map_jpeg: bytes | None
    map_words: str  # What the map shows, for those who do not see it
    legend: tuple[LegendEntry, ...]
    sections: tuple[Section, ...]
    remarks: tuple[str, ...]  # How to read it


def write_content(
    report: MissionReport,
    *,
    map_jpeg: bytes | None,
    picture: Picture | None,
    language: Language,
    positions: str = "degrees",
) -> ReportContent:
    """Put a report into words.

    Args:
        picture: None without pictures.
        positions: One of `NOTATIONS`.
    """
    _ = language.text
    words = _Words(report, language, NOTATIONS[positions], picture)
    sections = [words.tracks(), words.areas(), words.objects(), words.drawings()]
    if report.people is not None:
        sections += words.of_people(report.people)
    return ReportContent(
        language=language.code,
        kind=_("Mission report"),
        title=report.mission.name,
        note="" if report.people is None else report.people.note,
        facts=tuple(words.facts()),
        map_jpeg=map_jpeg,
        map_words=_("Map with the tracks, areas, lines, markers and objects of the mission"),
        legend=tuple(words.legend()),
        sections=tuple(section for section in sections if section is not None and section.rows),
        remarks=tuple(words.remarks()),
    )


@dataclass(slots=True)
class _Words:
    report: MissionReport
    language: Language
    notation: Callable[[LatLon], object] | None
    picture: Picture | None
    sources: Mapping[str, str] = field(init=False)
    states: Mapping[str, str] = field(init=False)
    names: Mapping[int, str] = field(init=False)
    """Names of tracks by their ids."""

    def __post_init__(self) -> None:
        _ = self.language.text
        self.sources = {
            "fused": _("Corrected"),
            "gps": _("GPS"),
            "odometry": _("Odometry"),
            "visual": _("Visual fixes"),
            "manual": _("By hand"),
        }
        self.states = {
            "found": _("found"),
            "confirmed": _("confirmed"),
            "cleared": _("cleared"),
            "dismissed": _("dismissed"),
        }
        self.names = {track.id: self._name(track) for track in self.report.mission.tracks}

    def facts(self) -> list[tuple[str, str]]:
        _, say, way = self.language.text, self.language, self.report.way
        areas = [drawing for drawing in self.report.mission.drawings if drawing.kind == "area"]
        facts = [
            (_("Start"), _unless_none(way.first_time_s, say.time)),
            (_("End"), _unless_none(way.last_time_s, say.time)),
            (_("Duration"), say.duration(way.duration_s) if way.duration_s else ""),
            (_("Distance"), say.length(way.distance_m) if self.report.mission.tracks else ""),
            (_("Map"), self.report.map_name or ""),
            (_("Objects"), say.number(self.report.object_count)),
            (_("Search areas"), self._sum_of_areas(areas) if areas else ""),
        ]
        if self.report.ended_at is None:
            facts.append((_("State"), _("has not been ended: more may come")))
        else:
            facts.append((_("Ended"), say.time(self.report.ended_at.timestamp())))
        facts.append((_("Report made"), say.time(time.time())))
        return [fact for fact in facts if fact[1]]

    def remarks(self) -> list[str]:
        _, way = self.language.text, self.report.way
        at = way.first_time_s or time.time()
        zone, offset = self.language.zone, self.language.offset(at)
        said = _("All times are those of %(zone)s, at the start %(offset)s.", zone=zone, offset=offset)
        remarks = [
            _("All times are in UTC.") if zone == "UTC" else said,
            _("Positions are latitude and longitude in WGS 84."),
        ]
        if self.report.mission.tracks:
            remarks.append(
                _(
                    "Distance and duration of the mission are those of its best tracks: several that "
                    "recorded the same way count once. On the map, long tracks are drawn with fewer points."
                )
            )
        return remarks

    def legend(self) -> list[LegendEntry]:
        _ = self.language.text
        shown = [track for track in self.report.mission.tracks if not track.look.hidden]
        entries = [LegendEntry(self.names[track.id], colour=track.colour) for track in shown]
        words = {
            "area": (_("area: to do"), _("area: assigned"), _("area: searched")),
            "line": (_("line"),) * 3,
            "marker": (_("marker"),) * 3,
        }
        for drawing in self.report.mission.drawings:
            state = 2 if drawing.searched else 1 if drawing.assigned else 0
            entry = LegendEntry(words[drawing.kind][state], colour=drawing.colour)
            if entry not in entries:
                entries.append(entry)
        counts = Counter(one.kind for one in self.report.objects)
        for kind, count in counts.most_common(_MOST_CLASSES):
            entries.append(LegendEntry(f"{kind} ({self.language.number(count)})", icon=icon(kind)))
        return entries

    def tracks(self) -> Section:
        _ = self.language.text
        rows = []
        for track in sorted(self.report.mission.tracks, key=lambda one: (one.name, one.source, one.id)):
            first, last = track.first_time_s, track.last_time_s
            long = "–" if first is None or last is None else self.language.duration(last - first)
            hidden = _("hidden on the map") if track.look.hidden else ""
            about = [self.names[track.id], self._thinning(track), hidden]
            rows.append(
                (
                    Cell(_filled(about), colour=track.colour, head=True),
                    Cell((self.sources[track.source],)),
                    Cell(_filled([_unless_none(first, self.language.time)])),
                    Cell(_filled([_unless_none(last, self.language.time)])),
                    _number(long),
                    _number(self.language.length(track.distance_m)),
                )
            )
        columns = (_("Track"), _("Source"), _("Start"), _("End"), _("Duration"), _("Distance"))
        return Section(_("Tracks"), columns, tuple(rows))

    def areas(self) -> Section:
        _ = self.language.text
        areas = [drawing for drawing in self.report.mission.drawings if drawing.kind == "area"]
        searches = self.report.searches
        rows = [
            (
                Cell(_filled([area.name, area.note]), colour=area.colour, head=True),
                _number(self.language.area(shapes.area_m2(shapes.to_metres(list(area.points))))),
                _number(_unless_none(area.radius_m, self.language.length)),
                _number(self._covered(searches.get(area.id))),
                Cell(tuple(self._searchers(searches.get(area.id)))),
                Cell(tuple(self._state_of_area(area))),
            )
            for area in areas
        ]
        columns = (_("Area"), _("Size"), _("Radius"), _("Covered"), _("By which tracks"), _("State"))
        remarks = [
            _(
                "Covered is the share of the area that tracks have passed within the radius. The times are "
                "when a track was first and last that near."
            )
        ]
        if any(area.id not in searches for area in areas):
            remarks.append(_("Where the share is missing, computing it took too long."))
        if any(not found.coverage.exact for found in searches.values()):
            remarks.append(_("≈: poses of the tracks were removed, so the share is approximate."))
        return Section(_("Search areas"), columns, tuple(rows), tuple(remarks))

    def objects(self) -> Section:
        _, say = self.language.text, self.language
        rows, pictures = [], 0
        for found in self.report.objects:
            picture = None
            if self.picture is not None and found.photo and pictures < MAX_PICTURES:
                picture = self.picture(found.photo)
                pictures += picture is not None
            rows.append(
                (
                    Cell((found.id,), picture=picture, head=True),
                    Cell((found.kind,)),
                    _number("–" if found.confidence is None else say.percent(found.confidence)),
                    Cell(tuple(self._place(found.latlon, found.height_m))),
                    Cell(tuple(self._seen(found))),
                    Cell(tuple(self._state_of_object(found))),
                )
            )
        remarks = []
        if self.report.object_count > len(rows):
            remarks.append(
                _(
                    "The first %(shown)s of %(all)s objects; the export “CSV of the objects” has all.",
                    shown=say.number(len(rows)),
                    all=say.number(self.report.object_count),
                )
            )
        if pictures == MAX_PICTURES:
            remarks.append(_("Only the first %(n)s pictures are included.", n=MAX_PICTURES))
        columns = (_("Object"), _("Class"), _("Confidence"), _("Position"), _("Seen"), _("State"))
        return Section(_("Objects"), columns, tuple(rows), tuple(remarks))

    def drawings(self) -> Section:
        _, ngettext = self.language.text, self.language.plural
        kinds = {"line": _("line"), "marker": _("marker")}
        rows = []
        for one in self.report.mission.drawings:
            if one.kind == "area":
                continue
            points = [line for at in one.points[:_MOST_POINTS] for line in self._place(at)]
            if len(one.points) > _MOST_POINTS:
                more = len(one.points) - _MOST_POINTS
                points.append(ngettext("and %(num)s point more", "and %(num)s points more", num=more))
            long = shapes.length_m(shapes.to_metres(list(one.points))) if one.kind == "line" else None
            rows.append(
                (
                    Cell(_filled([one.name, one.note]), colour=one.colour, head=True),
                    Cell((kinds[one.kind],)),
                    _number("–" if long is None else self.language.length(long)),
                    Cell(tuple(points)),
                    Cell(_filled([one.created_by, self.language.time(one.created_time_s)])),
                )
            )
        columns = (_("Name"), _("Kind"), _("Length"), _("Position"), _("Drawn"))
        return Section(_("Lines and markers"), columns, tuple(rows))

    def of_people(self, people: People) -> list[Section]:
        return [self._robots(people), self._silences(people), self._changes(people), self._people(people)]

    def _robots(self, people: People) -> Section:
        _, say = self.language.text, self.language
        rows = []
        for robot in people.robots:
            said = robot.status or RobotReport()
            shares = [None if v is None else v / 100 for v in (said.battery_percent, said.link_percent)]
            rows.append(
                (
                    Cell((self._robot(robot.name),), head=True),
                    Cell((say.time(robot.heard_time_s),)),
                    *(_number(_unless_none(share, say.percent)) for share in shares),
                    Cell(_filled([said.mode])),
                    Cell(_filled([said.text])),
                )
            )
        columns = (_("Robot"), _("Last heard"), _("Battery"), _("Link"), _("Mode"), _("Message"))
        return Section(_("Robots, drones and phones"), columns, tuple(rows))

    def _silences(self, people: People) -> Section:
        _, say = self.language.text, self.language
        rows = tuple(
            (
                Cell((self._robot(one.robot),), head=True),
                Cell((say.span(one.since_s, one.until_s),)),
                _number(say.duration(one.until_s - one.since_s)),
            )
            for one in people.silences
        )
        limit = people.silent_after_s
        said = _("Alarm when silent for %(time)s.", time=say.duration(limit)) if limit else ""
        columns = (_("Robot"), _("Silent"), _("Duration"))
        return Section(_("Alarms: silences"), columns, rows, _filled([said]))

    def _changes(self, people: People) -> Section:
        _ = self.language.text
        rows = tuple(
            (
                Cell((self.language.time(one.time_s),)),
                Cell((one.object_id,), head=True),
                Cell((self.states[one.state],)),
                Cell((one.by,)),
                Cell(_filled([one.note])),
            )
            for one in people.changes
        )
        columns = (_("Time"), _("Object"), _("State"), _("Set by"), _("Note"))
        return Section(_("Log of the objects"), columns, rows)

    def _people(self, people: People) -> Section:
        _ = self.language.text
        rows = [
            (Cell((name,), head=True), Cell(tuple(self._deed(deed, n) for deed, n in deeds.items())))
            for name, deeds in people.deeds.items()
        ]
        return Section(_("Who took part"), (_("Name"), _("What")), tuple(rows))

    def _deed(self, deed: Deed, count: int) -> str:
        _, ngettext = self.language.text, self.language.plural
        if deed == "made":
            return _("made the mission")
        if deed == "phone":
            return _("sent positions from a phone")
        if deed == "drew":
            return ngettext(
                "drew %(num)s area, line or marker", "drew %(num)s areas, lines and markers", num=count
            )
        if deed == "searched":
            return ngettext("marked %(num)s area as searched", "marked %(num)s areas as searched", num=count)
        return ngettext(
            "set the state of an object %(num)s time", "set the state of objects %(num)s times", num=count
        )

    def _name(self, track: ExportTrack) -> str:
        source = self.sources[track.source]
        return track.look.title or (f"{source}: {track.name}" if track.name else source)

    def _thinning(self, track: ExportTrack) -> str:
        _, number = self.language.text, self.language.number(track.removed)
        if not track.removed:
            return ""
        if track.thinned_m is None:
            return _("%(number)s poses between its ends were removed", number=number)
        return _(
            "%(number)s poses were removed, which changes it by %(error)s at most",
            number=number,
            error=self.language.length(track.thinned_m),
        )

    def _robot(self, name: str) -> str:
        _ = self.language.text
        return name or _("Robot")

    def _place(self, at: LatLon, height_m: float | None = None) -> list[str]:
        _, lines = self.language.text, [grids.decimal(at)]
        other = None if self.notation is None else self.notation(at)
        if other is not None:
            lines.append(str(other))
        if height_m is not None:
            lines.append(_("height %(height)s", height=self.language.length(height_m)))
        return lines

    def _seen(self, found: ExportObject) -> list[str]:
        ngettext = self.language.plural
        times = ngettext("%(num)s time", "%(num)s times", num=found.sightings)
        if found.first_time_s == found.last_time_s:
            return [times, self.language.time(found.first_time_s)]
        return [times, self.language.span(found.first_time_s, found.last_time_s)]

    def _state_of_object(self, found: ExportObject) -> list[str]:
        lines = [self.states[found.state], found.state_by or ""]
        lines.append(_unless_none(found.state_time_s, self.language.time))
        return [line for line in lines if line]

    def _state_of_area(self, area: ExportDrawing) -> list[str]:
        _ = self.language.text
        lines = [_("assigned to %(name)s", name=area.assigned)] if area.assigned else []
        if area.searched_time_s is None:
            return lines or [_("to do")]
        by = area.searched_by
        lines.append(_("marked as searched by %(name)s", name=by) if by else _("marked as searched"))
        return [*lines, self.language.time(area.searched_time_s)]

    def _covered(self, found: AreaSearch | None) -> str:
        if found is None or found.coverage.share is None:
            return "–"
        return ("" if found.coverage.exact else "≈ ") + self.language.percent(found.coverage.share)

    def _searchers(self, found: AreaSearch | None) -> list[str]:
        lines = []
        for one in () if found is None else sorted(found.by, key=lambda part: -part.share):
            text = f"{self.names.get(one.track, '–')}: {self.language.percent(one.share)}"
            if one.first_time_s is not None and one.last_time_s is not None:
                text += f", {self.language.span(one.first_time_s, one.last_time_s)}"
            lines.append(text)
        return lines or ["–"]

    def _sum_of_areas(self, areas: Sequence[ExportDrawing]) -> str:
        size = sum(shapes.area_m2(shapes.to_metres(list(area.points))) for area in areas)
        ngettext = self.language.plural
        number = ngettext("%(num)s area", "%(num)s areas", num=len(areas))
        searched = sum(area.searched is True for area in areas)
        done = ngettext("%(num)s marked as searched", "%(num)s marked as searched", num=searched)
        return f"{number}, {self.language.area(size)}, {done}"


def _number(text: str) -> Cell:
    return Cell((text,) if text else (), number=True)


def _filled(lines: Sequence[str | None]) -> tuple[str, ...]:
    return tuple(line for line in lines if line)


def _unless_none(value: float | None, write: Callable[[float], str]) -> str:
    return "" if value is None else write(value)
