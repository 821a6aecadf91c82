"""Writes a mission as GeoJSON (RFC 7946), piece by piece: a line for each track, a point for each object.

Drawings follow, with the property `drawing`; an area across the 180th meridian has longitudes beyond 180.
Colours are properties of simplestyle 1.1.

The times of a line's positions are in its `coordinateProperties`, nested like its coordinates. A track that
crosses the 180th meridian is cut there into several lines, as the standard recommends.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Iterator

import numpy as np
from numpy.typing import NDArray

from webapp.files.exchange.geojson import point_feature, to_json, write_collection
from webapp.files.exchange.times import utc, utc_or_none
from webapp.missions.core.trajectory.outgoing import ExportDrawing, ExportObject, ExportTrack, MissionExport
from webapp.missions.core.trajectory.records import Poses, join, make_poses
from webapp.missions.core.trajectory.symbols import kind_colour
from webapp.missions.files.drawn import GEOMETRIES, continuous, drawing_facts


def format_mission_geojson(mission: MissionExport) -> Iterator[bytes]:
    """Write a mission.

    Yields:
        UTF-8. Unknown values are null; an unknown height is omitted from the position.
    """
    return write_collection(mission.name, _features(mission))


def _features(mission: MissionExport) -> Iterator[Iterable[str]]:
    for track in mission.tracks:
        yield track_feature(track)
    for found in mission.objects():
        yield [object_feature(found)]
    for drawing in mission.drawings:
        yield [_drawing(drawing)]


def track_feature(track: ExportTrack) -> Iterator[str]:
    """Write a track as a feature, in parts."""
    facts = {
        "source": track.source,
        "name": track.label,
        "poses": track.count,
        "distance_m": round(track.distance_m, 3),
        "stroke": track.colour,
        "stroke-width": track.width_px,
    }
    if track.look.hidden:
        facts["hidden"] = True
    if track.removed:
        facts |= {"removed_poses": track.removed, "thinned_m": track.thinned_m}
    over = track.bounds is not None and track.bounds[3] - track.bounds[1] > 180.0
    kind = "Point" if track.count == 1 else "MultiLineString" if over else "LineString"
    yield f'{{"type":"Feature","id":"track-{track.id}","geometry":{{"type":"{kind}","coordinates":'
    yield from _nested(track, _positions, kind=kind)
    yield f'}},"properties":{to_json(facts)[:-1]},"coordinateProperties":{{'
    if track.timed:
        yield '"times":'
        yield from _nested(track, lambda poses: [f'"{time}"' for time in utc(poses.times_s)], kind=kind)
        yield ","
    yield '"headings_deg":'
    yield from _nested(track, _headings, kind=kind)
    yield "}}}"


def _nested(track: ExportTrack, written: Callable[[Poses], list[str]], *, kind: str) -> Iterator[str]:
    """Write one value for each pose, nested like the coordinates of the geometry."""
    if kind == "Point":
        yield from (written(part)[0] for part in track.poses())
        return
    several = kind == "MultiLineString"
    lines = cut_at_meridian(track.poses()) if several else ((part, False) for part in track.poses())
    yield "[[" if several else "["
    comma = ""
    for part, ends in lines:
        yield comma + ",".join(written(part)) + ("],[" if ends else "")
        comma = "" if ends else ","
    yield "]]" if several else "]"


def cut_at_meridian(parts: Iterable[Poses]) -> Iterator[tuple[Poses, bool]]:
    """Cut at the 180th meridian: each line ends, and the next one begins, with a pose on the meridian.

    Yields:
        At least one pose.
        Whether a line ends with them.
    """
    last: list[Poses] = []
    for part in parts:
        joined, first = join([*last, part]), len(last)
        for at in np.flatnonzero(np.abs(np.diff(joined.latlon[:, 1])) > 180.0).tolist():
            end, begin = _on_the_meridian(joined.take(slice(at, at + 2)))
            yield join([joined.take(slice(first, at + 1)), end]), True
            yield begin, False
            first = at + 1
        yield joined.take(slice(first, None)), False
        last = [joined.take(slice(-1, None))]


def _on_the_meridian(two: Poses) -> tuple[Poses, Poses]:
    """Interpolate the pose where two cross the meridian; return it with the longitude of either side."""
    a, b = two.latlon[:, 1].tolist()
    side = math.copysign(180.0, a)
    way = b + 2.0 * side - a
    share = (side - a) / way if way else 0.0

    def between(values: NDArray[np.float64]) -> NDArray[np.float64]:
        return (1.0 - share) * values[:1] + share * values[1:]

    lat = between(two.latlon)[0, 0]
    ends = [
        make_poses(between(two.times_s), [(lat, lon)], height_m=between(two.height_m))
        for lon in (side, -side)
    ]
    return ends[0], ends[1]


def _positions(poses: Poses) -> list[str]:
    table = np.column_stack([poses.latlon, poses.height_m]).tolist()
    return [
        f"[{lon:.9f},{lat:.9f}]" if height != height else f"[{lon:.9f},{lat:.9f},{height:.3f}]"
        for lat, lon, height in table
    ]


def _headings(poses: Poses) -> list[str]:
    return ["null" if heading != heading else f"{heading:.3f}" for heading in poses.heading_deg.tolist()]


def object_feature(found: ExportObject) -> str:
    first, last = utc([found.first_time_s, found.last_time_s])
    properties = {
        "class": found.kind,
        "confidence": found.confidence,
        "sightings": found.sightings,
        "first_time": first,
        "last_time": last,
        "photo": found.photo,
        "covariance_m2": found.covariance_m2,
        "size_m": found.size_m,
        "state": found.state,
        "state_time": utc_or_none(found.state_time_s),
        "state_by": found.state_by,
        "marker-color": kind_colour(found.kind),
    }
    return point_feature(found.id, found.latlon, properties=properties, height_m=found.height_m)


def _drawing(drawing: ExportDrawing) -> str:
    places = [[round(lon, 9), round(lat, 9)] for lat, lon in continuous(drawing.points)]
    coordinates: object = places
    if drawing.kind == "area":
        coordinates = [[*places, places[0]]]
    elif drawing.kind == "marker":
        coordinates = places[0]
    feature = {
        "type": "Feature",
        "id": f"drawing-{drawing.id}",
        "geometry": {"type": GEOMETRIES[drawing.kind], "coordinates": coordinates},
        "properties": drawing_facts(drawing)
        | {"marker-color" if drawing.kind == "marker" else "stroke": drawing.colour},
    }
    return to_json(feature)
