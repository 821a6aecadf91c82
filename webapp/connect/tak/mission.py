"""A mission as events, and as a data package."""

from __future__ import annotations

import io
import math
import uuid
import zipfile
from collections.abc import Iterable, Iterator, Sequence

from webapp.connect.tak.events import UNKNOWN_M, CotEvent, to_xml
from webapp.core.geo.types import LatLon
from webapp.files.exchange.xml import quoted
from webapp.missions.core.trajectory.outgoing import ExportObject, ExportTrack, MissionExport
from webapp.missions.core.trajectory.records import Poses, covariance_radius_m

_HOW = {"gps": "m-g", "manual": "h-e"}
"""How the poses of a source were obtained; those of all others were computed."""


def mission_events(mission: MissionExport, *, key: str, now_s: float, keep_s: float) -> Iterator[CotEvent]:
    """Yield the last pose of each track, and each object that was not dismissed.

    Args:
        key: Begins each `uid`: the same for the same mission, so that events replace earlier ones.
        keep_s: How long TAK programs show an event after its time, seconds.
    """
    for track in mission.tracks:
        *_, last = (None, *track.poses())
        if last is not None:
            uid = f"{key}track-{track.id}"
            yield _position(track, last.take(slice(-1, None)), uid, now_s=now_s, keep_s=keep_s)
    for found in mission.objects():
        if found.state != "dismissed":
            yield _object(found, f"{key}object-{found.id}", now_s=now_s, keep_s=keep_s)


def _position(track: ExportTrack, last: Poses, uid: str, *, now_s: float, keep_s: float) -> CotEvent:
    lat, lon = last.latlon[0].tolist()
    height, heading = float(last.height_m[0]), float(last.heading_deg[0])
    start_s = float(last.times_s[0]) if track.timed else now_s
    return CotEvent(
        uid=uid,
        type="a-f-G",
        how=_HOW.get(track.source, "m-f"),
        callsign=track.name or track.source,
        latlon=LatLon(lat, lon),
        time_s=now_s,
        start_s=start_s,
        stale_s=start_s + keep_s,
        height_m=UNKNOWN_M if math.isnan(height) else height,
        radius_m=_radius(last.covariance_m2[0].tolist()),
        course_deg=None if math.isnan(heading) else heading,
        remarks=track.title,
    )


def _object(found: ExportObject, uid: str, *, now_s: float, keep_s: float) -> CotEvent:
    facts = [found.state, f"sightings: {found.sightings}"]
    if found.confidence is not None:
        facts.append(f"probability: {found.confidence:.0%}")
    return CotEvent(
        uid=uid,
        type="b-m-p-s-m",
        how="m-f",
        callsign=f"{found.kind} {found.id}",
        latlon=found.latlon,
        time_s=now_s,
        start_s=found.last_time_s,
        stale_s=now_s + keep_s,
        height_m=UNKNOWN_M if found.height_m is None else found.height_m,
        radius_m=_radius(found.covariance_m2),
        remarks=", ".join(facts),
    )


def _radius(covariance_m2: Sequence[float] | None) -> float:
    known = covariance_radius_m(covariance_m2)
    return UNKNOWN_M if known is None else known


def data_package(name: str, events: Iterable[CotEvent]) -> bytes:
    """Write a data package (a zip), which TAK programs import from a file."""
    made = io.BytesIO()
    contents = []
    with zipfile.ZipFile(made, "w", zipfile.ZIP_DEFLATED) as package:
        for event in events:
            folder = str(uuid.uuid5(uuid.NAMESPACE_URL, event.uid))
            entry = f"{folder}/{folder}.cot"
            package.writestr(entry, to_xml(event))
            uid = f'<Parameter name="uid" value={quoted(event.uid)}/>'
            contents.append(f'<Content ignore="false" zipEntry="{entry}">{uid}</Content>')
        parameters = (
            f'<Parameter name="uid" value="{uuid.uuid4()}"/><Parameter name="name" value={quoted(name)}/>'
        )
        package.writestr(
            "MANIFEST/manifest.xml",
            f'<MissionPackageManifest version="2"><Configuration>{parameters}</Configuration>'
            f"<Contents>{''.join(contents)}</Contents></MissionPackageManifest>\n",
        )
    return made.getvalue()
