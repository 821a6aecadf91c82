"""Missions as JSON for pages and programs, and for visitors, who get only what the share shows."""

from __future__ import annotations

import math
from dataclasses import asdict
from datetime import datetime
from typing import Any

from flask import url_for
from sqlalchemy.orm import Session

from webapp.core.geo.types import LatLon
from webapp.core.mapmodel.checks import MAX_NUMBER
from webapp.errors import NotFound
from webapp.missions.core.trajectory.drift import LoopClosure, measure_closure
from webapp.missions.core.trajectory.records import Poses
from webapp.missions.store import missions, tracks, way
from webapp.missions.store.missions import Entry
from webapp.missions.store.schema import Mission, MissionObject, MissionPhoto, ObjectSighting, Track
from webapp.missions.store.shares import OpenedMission
from webapp.missions.web.api_objects import object_json, sighting_json
from webapp.store.schema import Account, MapRecord
from webapp.web.maps import state as map_state
from webapp.web.sharing.shared_state import answer_for_visitors

_OF_THE_EARTH = ("metres_per_pixel", "latlon_grid")
"""Fields of a georeference that visitors get; its control points, for instance, are left out."""


def summary(session: Session, mission: Mission, *, account: Account) -> dict[str, Any]:
    return entry_json(missions.entry(session, mission, account=account))


def entry_json(entry: Entry) -> dict[str, Any]:
    """Return the summary of a list entry; the fields of `MissionSummary`."""
    mission = entry.mission
    return {
        "id": mission.id,
        "name": mission.name,
        "url": f"/missions/{mission.id}",
        "map": entry.slug,
        "role": entry.role,
        "can_edit": entry.role in ("owner", "editor"),
        "binned": mission.binned_at is not None,
        "keep": mission.keep,
        "revision": mission.revision,
        "created_at": _iso_time(mission.created_at),
        "changed_at": _iso_time(mission.changed_at),
        "ended_at": _iso_time(mission.ended_at),
        "poses": entry.poses,
        **_way(entry.tracks),
        "objects": entry.objects,
        "photos": entry.photos,
    }


def whole(session: Session, mission: Mission, *, account: Account) -> dict[str, Any]:
    """Return a mission without its poses, objects and photos; the fields of `MissionState`."""
    entry = missions.entry(session, mission, account=account)
    return {
        **entry_json(entry),
        "note": mission.note,
        "start": mission.start,
        "drawings_revision": mission.drawings_revision,
        "tracks": [track_json(session, track) for track in entry.tracks],
        "satellite": satellite(session, mission),
        "cursor": cursor(mission.revision, {track.id: track.poses for track in entry.tracks}),
    }


def track_json(session: Session, track: Track) -> dict[str, Any]:
    """Return a track as JSON; the fields of `TrackOut`."""
    ends = tracks.at(session, track, sorted({0, track.poses - 1})) if track.poses else None
    known = track if track.timed else None
    return {
        "id": track.id,
        "source": track.source,
        "name": track.name,
        "look": asdict(tracks.look_of(track)),
        "poses": track.poses,
        "skipped": track.skipped,
        "removed": track.removed,
        "thinned_m": track.thinned_m,
        "distance_m": track.distance_m,
        "duration_s": _duration_s(track),
        "timed": track.timed,
        "first_time_s": known and known.first_time_s,
        "last_time_s": known and known.last_time_s,
        "bounds": _bounds(track),
        "last": None if ends is None else last_json(ends),
        "closing": None if ends is None else _closing(track, ends),
    }


def last_json(poses: Poses) -> dict[str, Any]:
    lat, lon = poses.latlon[-1].tolist()
    heading = float(poses.heading_deg[-1])
    covariance = poses.covariance_m2[-1].tolist()
    return {
        "time_s": float(poses.times_s[-1]),
        "lat": lat,
        "lon": lon,
        "heading_deg": None if heading != heading else heading,
        "covariance_m2": covariance if all(map(math.isfinite, covariance)) else None,
    }


def satellite(session: Session, mission: Mission, *, base: str | None = None) -> dict[str, Any] | None:
    """Return the image of a mission's map, with its georeference; `base` as for `satellite_json`."""
    record = _map(session, mission)
    found = None if record is None else map_state.image(record, base=base)
    if found is None or found["satellite"] is None:
        return None
    return {**found["satellite"], "georeference": found["georeference"]}


def cursor(revision: int, poses: dict[int, int]) -> str:
    """Return the cursor of a mission: its revision, and the number of poses of each track."""
    return "-".join([str(revision), *(f"{id}.{count}" for id, count in sorted(poses.items()))])


def read_cursor(text: str) -> tuple[int, dict[int, int]] | None:
    """Parse the result of `cursor`; return None for any other text."""
    revision, *parts = text.split("-")
    pairs = [part.split(".") for part in parts]
    numbers = [revision, *(number for pair in pairs for number in pair)]
    if not all(n.isascii() and n.isdecimal() and len(n) < 16 and int(n) <= MAX_NUMBER for n in numbers):
        return None
    if not all(len(pair) == 2 for pair in pairs):
        return None
    return int(revision), {int(id): int(count) for id, count in pairs}


def _way(found: list[Track]) -> dict[str, float | None]:
    """Return the length, duration and times of a mission."""
    return asdict(way.of_tracks(found))


def _duration_s(track: Track) -> float:
    if not track.timed:
        return 0.0
    return (track.last_time_s or 0.0) - (track.first_time_s or 0.0)


def _map(session: Session, mission: Mission) -> MapRecord | None:
    return None if mission.map_id is None else session.get(MapRecord, mission.map_id)


def _iso_time(at: datetime | None) -> str | None:
    return None if at is None else at.isoformat(timespec="seconds")


def _bounds(track: Track) -> list[float] | None:
    sides = (track.min_lat, track.min_lon, track.max_lat, track.max_lon)
    known = [side for side in sides if side is not None]
    return known if len(known) == len(sides) else None


def _fix_for_visitors(photo: MissionPhoto) -> dict[str, Any] | None:
    if photo.fix is None or photo.fix_state != "done":
        return None
    return answer_for_visitors(photo.fix, exif=False)


def _closing(track: Track, ends: Poses) -> dict[str, float] | None:
    bounds = _bounds(track)
    if bounds is None or len(ends) < 2:
        return None
    first, last = (LatLon(*latlon) for latlon in ends.latlon.tolist())
    south, west, north, east = bounds
    found = measure_closure(first, last, distance_m=track.distance_m, bounds=(south, west, north, east))
    return {"gap_m": found.gap_m, "share": found.share} if isinstance(found, LoopClosure) else None


def shared_mission(session: Session, opened: OpenedMission, *, token: str) -> dict[str, Any]:
    """Return a shared mission without its poses, objects and photos.

    Fields that the page of a mission needs have the same names as for its owners; the note is left out.
    """
    mission = opened.mission
    found = tracks.list_tracks(session, mission.id)
    _, objects, shared_photos = missions.counts(session, mission.id)
    return {
        "id": mission.id,
        "name": mission.name,
        "revision": mission.revision,
        "ended_at": None if mission.ended_at is None else mission.ended_at.isoformat(timespec="seconds"),
        "drawings_revision": mission.drawings_revision,
        "tracks": [track_json(session, track) for track in found],
        "objects": objects,
        "photos": shared_photos if opened.share.photos else 0,
        "satellite": _satellite(session, opened, token),
        "cursor": cursor(mission.revision, {track.id: track.poses for track in found}),
    }


def shared_object(opened: OpenedMission, row: MissionObject) -> dict[str, Any]:
    """Return an object as JSON, without names of people; its photo only if the share shows photos."""
    photo = row.photo_sha if opened.share.photos else None
    return {**object_json(row), "photo": photo, "state_by": None}


def shared_sighting(opened: OpenedMission, row: ObjectSighting) -> dict[str, Any]:
    return {**sighting_json(row), "photo": row.photo_sha if opened.share.photos else None}


def shared_photo(token: str, photo: MissionPhoto) -> dict[str, Any]:
    """Return a photo as JSON, without its EXIF and its file name."""
    named: dict[str, Any] = {"token": token, "sha256": photo.sha256}
    return {
        "sha256": photo.sha256,
        "width": photo.width,
        "height": photo.height,
        "object": photo.object_id,
        "fix": _fix_for_visitors(photo),
        "url": url_for("api_shared_missions.photo_preview", **named),
        "thumb": url_for("api_shared_missions.photo_thumb", **named),
    }


def shared_photos(session: Session, opened: OpenedMission) -> list[MissionPhoto]:
    return missions.photos(session, opened.mission.id) if opened.share.photos else []


def find_shared_photo(session: Session, opened: OpenedMission, *, sha256: str) -> MissionPhoto:
    """Find a photo that a share shows.

    Raises:
        NotFound: The share does not show it.
    """
    if not opened.share.photos:
        raise NotFound("photos are not shared here")
    return missions.find_photo(session, opened.mission.id, sha256)


def _satellite(session: Session, opened: OpenedMission, token: str) -> dict[str, Any] | None:
    base = f"/api/v1/shared-missions/{token}/satellite"
    found = satellite(session, opened.mission, base=base)
    if found is None:
        return None
    earth = found["georeference"]
    return {**found, "georeference": None if earth is None else {key: earth[key] for key in _OF_THE_EARTH}}
