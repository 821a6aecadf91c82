"""GeoJSON (RFC 7946): lines are tracks; points are objects, or poses if they have times and no class.

Features with the property `drawing` are search areas, lines and markers, as in our own export.

Times of a line are in `coordinateProperties` (as in our own export), `coordTimes`, `times` or `timestamps`,
in the feature or in its properties, nested like its coordinates.
"""

from __future__ import annotations

import json
import math
import re
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, BinaryIO

from webapp.core.geo.crs import latlon_from_plane, parse_crs
from webapp.core.geo.types import LatLon
from webapp.errors import TrackError
from webapp.files.exchange.geojson import EXPORT_WGS84, NO_PLANE, is_beyond_degrees, stated_plane
from webapp.files.exchange.times import unix_time
from webapp.missions.core.drawings import Kind
from webapp.missions.core.looks import look_in_file
from webapp.missions.core.trajectory.records import SOURCES, Sighting, Source
from webapp.missions.files.drawn import GEOMETRIES, found_drawing, kind_of_drawing, turned_lon
from webapp.missions.files.readers.line_buffer import LineBuffer, LinePoint, mostly_timed
from webapp.missions.files.readers.time_units import LAST_S, ticks
from webapp.missions.files.track_chunks import (
    UNTIMED_OBJECTS,
    Findings,
    Piece,
    WorldObjects,
    object_field,
)
from webapp.missions.files.track_format import FormatAbout, TrackFormat, opened

MAX_BYTES = 20_000_000
"""Maximum file size: a file is parsed at once, and takes many times its size in memory."""

_MAX_DEPTH = 20
_TIME_LISTS = ("times", "coordTimes", "timestamps")
_TIMES = ("time", "timestamp", "datetime", "date_time")
_BETWEEN = re.compile(r"[\s\x1e]*")
_DECODER = json.JSONDecoder()
_AREAS = {"Polygon", "MultiPolygon"}
_OF_LINES = {"LineString", "MultiLineString"}


def read(file: BinaryIO, *, findings: Findings) -> Iterator[Piece]:
    """Read a file.

    Raises:
        TrackError: The file is too large, damaged, or not GeoJSON.
    """
    features = _Features(findings)
    for document in _documents(file, findings=findings):
        features.plane = stated_plane(document, error=TrackError)
        for feature in _features(document):
            yield from features.feature(feature)
    if 2 * features.beyond > features.positions:
        raise TrackError(NO_PLANE.format(features.first_beyond), hint=EXPORT_WGS84)
    yield from features.rest()


def _documents(file: BinaryIO, *, findings: Findings) -> Iterator[Any]:
    """Yield the texts of a file: usually one, or one in each line, or each after a record separator."""
    data = file.read(MAX_BYTES + 1)
    if len(data) > MAX_BYTES:
        raise TrackError(f"the GeoJSON is larger than {MAX_BYTES // 10**6} MB", hint="export a part of it")
    try:
        text = data.decode(json.detect_encoding(data)).lstrip("\ufeff")
        at = number = 0
        while (at := _BETWEEN.match(text, at).end()) < len(text):  # type: ignore[union-attr]
            try:
                document, at = _DECODER.raw_decode(text, at)
            except ValueError:
                if number and "\n" not in text[at:].strip():  # a sequence whose recording stopped
                    findings.skip("features that are cut off", where=f"feature {number + 1}")
                    return
                raise
            number += 1
            yield document
        if not number:
            raise ValueError("it is empty")
    except (ValueError, RecursionError) as error:
        raise TrackError(f"the JSON is damaged: {str(error)[:200]}", hint="export it again") from error


def _features(document: Any) -> Iterator[dict[str, Any]]:
    """Yield the features; a bare geometry counts as one."""
    kind = document.get("type") if isinstance(document, dict) else None
    if kind == "FeatureCollection":
        for feature in _list(document.get("features")):
            if isinstance(feature, dict):
                yield feature
    elif kind == "Feature":
        yield document
    elif isinstance(document, dict) and ("coordinates" in document or "geometries" in document):
        yield {"geometry": document}
    else:
        raise TrackError("the JSON is not GeoJSON", hint="it needs a type: FeatureCollection, Feature ...")


@dataclass(slots=True)
class _Features:
    """Converts features to pieces."""

    findings: Findings
    number: int = 0
    lines: int = 0
    # `points`, `points_of_feature`: Number of points so far in the file, and in the current feature.
    points: int = 0
    points_of_feature: int = 0
    # Points with times, by the name of their track, which follow at the end as tracks.
    poses: dict[str, list[LinePoint]] = field(default_factory=dict)
    # Number of positions without a coordinate system, of those beyond degrees, and the first of these.
    positions: int = 0
    beyond: int = 0
    first_beyond: str = ""
    plane: str | None = None  # Coordinate system of the document; None for WGS 84
    _own: str | None = None  # That of the current geometry

    def feature(self, feature: Mapping[str, Any]) -> Iterator[Piece]:
        self.number += 1
        self.points_of_feature = 0
        kind = kind_of_drawing(_properties(feature))
        if kind is not None:
            self.drawing(kind, feature)
            return
        yield from self.geometry(feature.get("geometry"), feature, depth=0)

    def drawing(self, kind: Kind, feature: Mapping[str, Any]) -> None:
        found = feature.get("geometry")
        geometry = found if isinstance(found, dict) else {}
        self._own = stated_plane(
            geometry, stated_plane(feature, self.plane, error=TrackError), error=TrackError
        )
        places = _list(geometry.get("coordinates"))
        if kind == "area":
            places = _list(places[0]) if len(places) == 1 else []
        elif kind == "marker":
            places = [places]
        points = [_point(place, math.nan, math.nan) for place in self.on_earth(places)]
        fits = geometry.get("type") == GEOMETRIES[kind]
        shape = [(point.lat, turned_lon(point.lon)) for point in points] if fits else []
        self.findings.draw(
            found_drawing(kind, _properties(feature), points=shape), where=f"feature {self.number}"
        )

    def geometry(self, geometry: Any, feature: Mapping[str, Any], *, depth: int) -> Iterator[Piece]:
        where = f"feature {self.number}"
        of_feature = stated_plane(feature, self.plane, error=TrackError)
        self._own = stated_plane(geometry, of_feature, error=TrackError)
        kind = geometry.get("type") if isinstance(geometry, dict) else None
        if kind in _AREAS:
            self.findings.skip("areas, which are not tracks", where=where)
        elif kind in _OF_LINES:
            yield from self.line(geometry.get("coordinates"), kind, feature)
        elif kind in ("Point", "MultiPoint"):
            places = geometry.get("coordinates")
            for place in self.on_earth([places] if kind == "Point" else _list(places)):
                yield from self.point(place, feature)
        elif kind == "GeometryCollection" and depth < _MAX_DEPTH:
            for inner in _list(geometry.get("geometries")):
                yield from self.geometry(inner, feature, depth=depth + 1)
        else:
            self.findings.skip("features without a position", where=where)

    def line(self, coordinates: Any, kind: str, feature: Mapping[str, Any]) -> Iterator[Piece]:
        own = _properties(feature)
        self.lines += 1
        name = f"line {self.lines} {_text(own.get('name'))}".strip()
        several = kind == "MultiLineString"
        places = self.on_earth(_joined(coordinates, several=several))
        times = _joined(_along(feature, _TIME_LISTS), several=several)
        headings = _joined(_along(feature, ("headings_deg",)), several=several)
        points = [
            _point(place, _time(_at(times, index)), _number(_at(headings, index)))
            for index, place in enumerate(places)
        ]
        if several and _along_line(feature) is not None:
            points = _without_the_meridian(points)
        source = _source(own)
        title, colour = _text(own.get("name")), _text(own.get("stroke"))
        self.findings.looks[name] = look_in_file(
            title, source, colour=colour, width_px=_number(own.get("stroke-width"))
        )
        buffer = LineBuffer(name, timed=mostly_timed(points), source=source)
        for point in points:
            yield from buffer.add(point, findings=self.findings)
        yield from buffer.flush(self.findings)

    def point(self, place: Any, feature: Mapping[str, Any]) -> Iterator[Piece]:
        self.points += 1
        self.points_of_feature += 1
        own = _properties(feature)
        along = _along_line(feature)
        if along is not None:  # a track of one pose, as in our own export
            yield from self.line([place], "LineString", _of_one(feature, along))
            return
        time_s = next((_time(own[name]) for name in _TIMES if name in own), math.nan)
        at = _point(place, time_s, _number(own.get("heading_deg", own.get("heading"))))
        if not math.isnan(time_s) and "class" not in own:
            self.poses.setdefault(_text(own.get("track")), []).append(at)
            return
        if math.isnan(at.lat) or math.isnan(at.lon):
            self.findings.skip("points without a position", where=f"feature {self.number}")
            return
        yield WorldObjects((self.sighting(at, feature),))

    def on_earth(self, places: list[Any]) -> list[Any]:
        """Transform positions to longitude and latitude."""
        if self._own is None or not places:
            self.measure(places)
            return places
        self.findings.note(f"positions were transformed from {self._own}, {parse_crs(self._own).name}")
        rows = [[_number(value) for value in [*_list(place)[:3], None, None, None][:3]] for place in places]
        latlon = latlon_from_plane(self._own, [row[:2] for row in rows])
        return [[lon, lat, row[2]] for (lat, lon), row in zip(latlon.tolist(), rows, strict=True)]

    def measure(self, places: list[Any]) -> None:
        """Count the positions that are no degrees."""
        self.positions += len(places)
        for place in places:
            x, y = [*map(_number, _list(place)[:2]), math.nan, math.nan][:2]
            if is_beyond_degrees(x, y):
                self.beyond += 1
                self.first_beyond = self.first_beyond or f"{x:.10g}, {y:.10g}"

    def sighting(self, at: LinePoint, feature: Mapping[str, Any]) -> Sighting:
        own = _properties(feature)
        name = self.id_of_point(feature)
        time_s = _time(own.get("last_time")) if math.isnan(at.time_s) else at.time_s
        if math.isnan(time_s):
            time_s = 0.0
            self.findings.note(UNTIMED_OBJECTS)
        height = None if math.isnan(at.height_m) else at.height_m
        sure = _number(own.get("confidence"))
        kind = _text(own.get("class")) or "point"
        where = LatLon(at.lat, at.lon)
        return Sighting(
            name,
            kind,
            time_s,
            where,
            height,
            confidence=None if math.isnan(sure) else sure,
            covariance_m2=object_field("covariance", own.get("covariance_m2")),
            size_m=object_field("size_m", own.get("size_m")),
            state=_text(own.get("state")),
        )

    def id_of_point(self, feature: Mapping[str, Any]) -> str:
        """Return a unique id of the point, even if its feature has several points."""
        own = _properties(feature)
        id_ = feature.get("id", own.get("id"))
        if id_ is None:
            return f"point {self.points} {_text(own.get('name'))}".strip()
        return _text(id_) if self.points_of_feature == 1 else f"{_text(id_)} {self.points_of_feature}"

    def rest(self) -> Iterator[Piece]:
        """Yield the tracks made of single points."""
        for track, points in self.poses.items():
            buffer = LineBuffer(track or "points", timed=True)
            for point in points:
                yield from buffer.add(point, findings=self.findings)
            yield from buffer.flush(self.findings)


def _point(place: Any, time_s: float, heading_deg: float) -> LinePoint:
    values = [_number(value) for value in _list(place)[:3]]
    lon, lat, height = values + [math.nan] * (3 - len(values))
    return LinePoint(time_s, lat, lon, height, heading_deg)


def _without_the_meridian(points: list[LinePoint]) -> list[LinePoint]:
    """Remove the points that our export inserts where a track crosses the 180th meridian."""
    added = {
        index + offset
        for index in range(len(points) - 1)
        if abs(points[index].lon) == 180.0 and points[index + 1].lon == -points[index].lon
        for offset in (0, 1)
    }
    return [point for index, point in enumerate(points) if index not in added]


def _of_one(feature: Mapping[str, Any], along: Mapping[str, Any]) -> dict[str, Any]:
    """Convert a feature of one pose to that of a line."""
    return {**feature, "coordinateProperties": {name: [value] for name, value in along.items()}}


def _along_line(feature: Mapping[str, Any]) -> dict[str, Any] | None:
    """Return `coordinateProperties` of the feature, or else of its properties."""
    found = feature.get("coordinateProperties", _properties(feature).get("coordinateProperties"))
    return found if isinstance(found, dict) else None


def _along(feature: Mapping[str, Any], names: tuple[str, ...]) -> Any:
    """Return the values per position that a feature has under one of these names."""
    places = (_along_line(feature) or {}, _properties(feature))
    found = (place[name] for place in places for name in names if name in place)
    return next(found, [])


def _joined(values: Any, *, several: bool) -> list[Any]:
    return [value for part in _list(values) for value in _list(part)] if several else _list(values)


def _properties(feature: Mapping[str, Any]) -> dict[str, Any]:
    found = feature.get("properties")
    return found if isinstance(found, dict) else {}


def _source(own: Mapping[str, Any]) -> Source:
    return next((source for source in SOURCES if source == own.get("source")), "gps")


def _list(value: Any) -> list[Any]:
    return value if isinstance(value, list) else []


def _at(values: list[Any], index: int) -> Any:
    return values[index] if index < len(values) else None


def _text(value: Any) -> str:
    return " ".join(str(value).split()) if isinstance(value, str | int | float) else ""


def _number(value: Any) -> float:
    if not isinstance(value, int | float) or isinstance(value, bool):
        return math.nan
    try:
        number = float(value)
    except OverflowError:  # integers in JSON are unlimited
        return math.nan
    return number if math.isfinite(number) else math.nan


def _time(value: Any) -> float:
    """Parse a time: ISO 8601, or a number since 1970."""
    if isinstance(value, str):
        return unix_time(value)
    number = _number(value)
    number /= ticks(number)
    return number if abs(number) < LAST_S else math.nan


FORMAT = TrackFormat(
    "geojson",
    "GeoJSON",
    "GeoJSON",
    endings=(".geojson", ".json"),
    is_one=lambda beginning: beginning.is_json,
    read=opened(lambda file, _, findings: read(file, findings=findings)),
    numbered="point",
    about=FormatAbout(
        tracks="lines, with times in `coordinateProperties`, `coordTimes` or `times`; points with a time; "
        "also a sequence of features, one in each line; other systems (`crs`) are transformed to WGS 84; "
        f"up to {MAX_BYTES // 10**6} MB",
        objects="other points",
        left_out="areas",
        written_by="QGIS, web maps, this program",
    ),
)
