"""What a visitor is told of a shared mission: nothing that the share does not give."""

from __future__ import annotations

from typing import Any

from flask import url_for
from sqlalchemy.orm import Session

from webapp.errors import NotFound
from webapp.missions.store import missions, tracks
from webapp.missions.store.schema import MissionObject, MissionPhoto, ObjectSighting
from webapp.missions.store.shares import OpenedMission
from webapp.missions.web import state
from webapp.missions.web.api_objects import object_json
from webapp.web.sharing.shared_state import located

_OF_THE_EARTH = ("metres_per_pixel", "latlon_grid")
"""Of a georeference: how it was found is not told."""


def whole(session: Session, opened: OpenedMission, *, token: str) -> dict[str, Any]:
    """Tell all of a shared mission but its poses, objects and photos themselves.

    What the page of a mission needs has the names that its owners see; the note is the owners' own.
    """
    mission = opened.mission
    found = tracks.listed(session, mission.id)
    _, objects, photos = missions.counts(session, mission.id)
    return {
        "id": mission.id,
        "name": mission.name,
        "revision": mission.revision,
        "ended_at": None if mission.ended_at is None else mission.ended_at.isoformat(timespec="seconds"),
        "tracks": [state.track_json(session, track) for track in found],
        "objects": objects,
        "photos": photos if opened.share.photos else 0,
        "satellite": _satellite(session, opened, token),
        "cursor": state.cursor(mission.revision, {track.id: track.poses for track in found}),
    }


def object_of(opened: OpenedMission, row: MissionObject) -> dict[str, Any]:
    """Tell of an object; its photo only where photos are shown."""
    return {**object_json(row), "photo": row.photo_sha if opened.share.photos else None}


def sighting_of(opened: OpenedMission, row: ObjectSighting) -> dict[str, Any]:
    """Tell where an object was seen once."""
    return {
        "time_s": row.time_s,
        "lat": row.lat,
        "lon": row.lon,
        "height_m": row.height_m,
        "confidence": row.confidence,
        "photo": row.photo_sha if opened.share.photos else None,
    }


def photo_of(token: str, photo: MissionPhoto) -> dict[str, Any]:
    """Tell of a photo without what its EXIF or the name of its file says."""
    named: dict[str, Any] = {"token": token, "sha256": photo.sha256}
    return {
        "sha256": photo.sha256,
        "width": photo.width,
        "height": photo.height,
        "object": photo.object_id,
        "fix": located(photo.fix, exif=False) if photo.fix and photo.fix_state == "done" else None,
        "url": url_for("api_shared_missions.photo_preview", **named),
        "thumb": url_for("api_shared_missions.photo_thumb", **named),
    }


def photos(session: Session, opened: OpenedMission) -> list[MissionPhoto]:
    """List the photos that a share shows."""
    return missions.photos(session, opened.mission.id) if opened.share.photos else []


def photo(session: Session, opened: OpenedMission, *, sha256: str) -> MissionPhoto:
    """Find a photo whose pictures a share gives.

    Raises
    ------
    NotFound
        The share gives no pictures of it.
    """
    if not opened.share.photos:
        raise NotFound("photos are not shared here")
    return missions.find_photo(session, opened.mission.id, sha256)


def _satellite(session: Session, opened: OpenedMission, token: str) -> dict[str, Any] | None:
    base = f"/api/v1/shared-missions/{token}/satellite"
    found = state.satellite(session, opened.mission, base=base)
    if found is None:
        return None
    earth = found["georeference"]
    return {**found, "georeference": None if earth is None else {key: earth[key] for key in _OF_THE_EARTH}}
