"""Writes a mission as KML 2.3, piece by piece: tracks with times, objects with their time spans.

KML 2.3 adopted `gx:Track` as `Track`, with the same content; the older name is used because more programs
support it. A track is written as a `gx:MultiTrack`; as times must ascend within a `gx:Track`, a new one
begins where time does not advance.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator, Mapping
from itertools import pairwise

import numpy as np

from webapp.core.geo.types import LatLon
from webapp.files.exchange.kml import coordinates, extended_data, picture_description, point, write_kml
from webapp.files.exchange.times import utc, utc_or_none
from webapp.files.exchange.xml import element
from webapp.missions.core.trajectory.outgoing import ExportDrawing, ExportObject, ExportTrack, MissionExport
from webapp.missions.core.trajectory.records import Poses
from webapp.missions.core.trajectory.symbols import kind_colour
from webapp.missions.files.drawn import continuous, drawing_facts


def format_mission_kml(
    mission: MissionExport, *, icons: Mapping[str, str] | None = None, photos: Mapping[str, str] | None = None
) -> Iterator[bytes]:
    """Write a mission.

    Args:
        icons: Path in the KMZ of the icon of each class of objects; classes without one get coloured pins.
        photos: Path in the KMZ of a picture of each photo, by its SHA-256.

    Yields:
        UTF-8. Unknown heights are written as 0, which has no effect since tracks are clamped to the ground.
    """
    return write_kml(_pieces(mission, icons or {}, photos=photos or {}))


def format_network_link(title: str, *, href: str, refresh_s: float) -> bytes:
    """Write a KML that only links to another one, to be fetched at an interval.

    Args:
        href: Absolute URL.
        refresh_s: Interval, seconds.

    Returns:
        UTF-8.
    """
    lines = (
        f"<NetworkLink>{element('name', title)}<Link>{element('href', href)}",
        f"<refreshMode>onInterval</refreshMode>{element('refreshInterval', f'{refresh_s:g}')}",
        "</Link></NetworkLink>\n",
    )
    return b"".join(write_kml(lines))


def _pieces(mission: MissionExport, icons: Mapping[str, str], *, photos: Mapping[str, str]) -> Iterator[str]:
    yield f"<Document>{element('name', mission.name)}<open>1</open>\n"
    styles = {kind: f"kind-{number}" for number, kind in enumerate(mission.kinds)}
    for kind, style in styles.items():
        yield _kind_style(kind, style, icons.get(kind))
    for track in mission.tracks:
        yield _track_style(track)
    yield "<Folder><name>Tracks</name>\n"
    for track in mission.tracks:
        yield from _track(track)
    yield "</Folder>\n<Folder><name>Objects</name>\n"
    for found in mission.objects():
        yield _object(found, styles.get(found.kind), picture=photos.get(found.photo or ""))
    yield "</Folder>\n"
    if mission.drawings:
        yield "<Folder><name>Drawings</name>\n"
        yield from map(_drawing, mission.drawings)
        yield "</Folder>\n"
    yield "</Document>\n"


def _kind_style(kind: str, style: str, icon: str | None) -> str:
    if icon is None:
        look = f"<color>{_colour(kind_colour(kind))}</color>"
    else:
        look = (
            f"<Icon>{element('href', icon)}</Icon>"
            '<hotSpot x="0.5" y="0.5" xunits="fraction" yunits="fraction"/>'
        )
    return f'<Style id="{style}"><IconStyle>{look}</IconStyle></Style>\n'


def _track_style(track: ExportTrack) -> str:
    colour = _colour(track.colour)
    return (
        f'<Style id="track-{track.id}"><IconStyle><color>{colour}</color><scale>0.7</scale></IconStyle>'
        f"<LineStyle><color>{colour}</color><width>{track.width_px:g}</width></LineStyle></Style>\n"
    )


def _track(track: ExportTrack) -> Iterator[str]:
    yield f'<Placemark id="t-{track.id}">{element("name", track.title)}'
    if track.look.hidden:
        yield "<visibility>0</visibility>"
    yield f"<styleUrl>#track-{track.id}</styleUrl>"
    facts = {"source": track.source, "poses": track.count, "distance_m": f"{track.distance_m:.2f}"}
    yield extended_data(facts | ({"remark": track.remark} if track.remark else {}))
    if track.timed:
        yield from _timed(track)
    else:
        yield "<LineString><tessellate>1</tessellate><coordinates>\n"
        for part in track.poses():
            table = np.column_stack([part.latlon, np.nan_to_num(part.height_m, nan=0.0)]).tolist()
            yield "".join(f"{lon:.9f},{lat:.9f},{height:.3f}\n" for lat, lon, height in table)
        yield "</coordinates></LineString>"
    yield "</Placemark>\n"


def _timed(track: ExportTrack) -> Iterator[str]:
    yield "<gx:MultiTrack>"
    yield "<altitudeMode>clampToGround</altitudeMode><gx:interpolate>1</gx:interpolate>\n"
    for part in _ascending(track.poses()):
        yield _part(part)
    yield "</gx:MultiTrack>"


def _ascending(parts: Iterable[Poses]) -> Iterator[Poses]:
    """Split each part where time does not advance."""
    for part in parts:
        cuts = [0, *(np.flatnonzero(np.diff(part.times_s) <= 0) + 1).tolist(), len(part)]
        for first, end in pairwise(cuts):
            yield part.take(slice(first, end))


def _part(poses: Poses) -> str:
    whens = "".join(f"<when>{time}</when>\n" for time in utc(poses.times_s))
    table = np.column_stack([poses.latlon, np.nan_to_num(poses.height_m, nan=0.0)]).tolist()
    coords = "".join(f"<gx:coord>{lon:.9f} {lat:.9f} {height:.3f}</gx:coord>\n" for lat, lon, height in table)
    angles = ""
    if np.isfinite(poses.heading_deg).all():
        # heading only: in KML 2.3, tilt and roll apply only to tracks with a model
        angles = "".join(f"<gx:angles>{heading:.3f}</gx:angles>\n" for heading in poses.heading_deg.tolist())
    return f"<gx:Track><altitudeMode>clampToGround</altitudeMode>\n{whens}{coords}{angles}</gx:Track>\n"


def _object(found: ExportObject, style: str | None, *, picture: str | None) -> str:
    first, last = utc([found.first_time_s, found.last_time_s])
    facts = {
        "id": found.id,
        "class": found.kind,
        "sightings": found.sightings,
        "height_m": found.height_m,
        "confidence": found.confidence,
        "covariance_m2": _three(found.covariance_m2),
        "size_m": _three(found.size_m),
        "state": found.state,
        "state_time": utc_or_none(found.state_time_s),
        "state_by": found.state_by,
    }
    about = "" if picture is None else picture_description(picture)
    return (
        f"<Placemark>{element('name', f'{found.kind} {found.id}')}{about}"
        f"<TimeSpan><begin>{first}</begin><end>{last}</end></TimeSpan>"
        f"{f'<styleUrl>#{style}</styleUrl>' if style else ''}"
        f"{extended_data(facts)}{point(found.latlon, found.height_m)}</Placemark>\n"
    )


def _drawing(drawing: ExportDrawing) -> str:
    places = [coordinates(LatLon(*point)) for point in continuous(drawing.points)]
    if drawing.kind == "area":
        ring = f"<LinearRing>{element('coordinates', ' '.join([*places, places[0]]))}</LinearRing>"
        shape = f"<Polygon><tessellate>1</tessellate><outerBoundaryIs>{ring}</outerBoundaryIs></Polygon>"
    elif drawing.kind == "line":
        shape = (
            f"<LineString><tessellate>1</tessellate>{element('coordinates', ' '.join(places))}</LineString>"
        )
    else:
        shape = f"<Point>{element('coordinates', places[0])}</Point>"
    line = _colour(drawing.colour)
    style = (
        f"<Style><IconStyle><color>{line}</color></IconStyle>"
        f"<LineStyle><color>{line}</color><width>3</width></LineStyle>"
        f"<PolyStyle><color>55{line[2:]}</color></PolyStyle></Style>"
    )
    facts = {
        name: str(value).lower() if isinstance(value, bool) else value
        for name, value in drawing_facts(drawing).items()
    }
    return (
        f'<Placemark id="drawing-{drawing.id}">{element("name", drawing.name)}{style}'
        f"{extended_data(facts)}{shape}</Placemark>\n"
    )


def _three(values: tuple[float, float, float] | None) -> str | None:
    return None if values is None else " ".join(f"{value:.6g}" for value in values)


def _colour(rgb: str) -> str:
    """Convert `#rrggbb` to KML's order: opacity, blue, green, red."""
    return f"ff{rgb[5:7]}{rgb[3:5]}{rgb[1:3]}"
