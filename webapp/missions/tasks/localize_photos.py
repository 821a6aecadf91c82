"""Localizes photos of a mission on its map, and stores their positions as poses of a track."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np
from sqlalchemy import select
from sqlalchemy.orm import Session

from webapp.core.geometry.estimate import NoPose
from webapp.errors import InputError, NotFound, PhotoError
from webapp.missions.core.trajectory.records import Poses, join, make_poses
from webapp.missions.core.trajectory.visual import visual_fix
from webapp.missions.store import missions, tracks
from webapp.missions.store.schema import Mission, MissionPhoto
from webapp.missions.tasks import add_photo
from webapp.progress import Progress
from webapp.store.library import Library
from webapp.store.operate import jobs
from webapp.store.schema import Job
from webapp.tasks.localize import upload
from webapp.tasks.localize.map_cache import MapCache
from webapp.tasks.localize.upload import LocalizeRequest, LocalizeResult, UploadedPhoto

JOB = "mission-fix"

TRACK = "photos"
"""Name of the track of the fixes; robots may send other tracks of source `visual`."""

Write = Callable[[], AbstractContextManager[Session]]


def fix_json(result: LocalizeResult, *, time_s: float | None) -> dict[str, Any]:
    """Return the response to a robot, which is also stored with the photo.

    Args:
        time_s: When the photo was taken, Unix seconds.

    Returns:
        The object of `localize --json`, and `time`, `lat`, `lon`, `heading_deg`, `position_covariance_m2`,
            and `no_pose`: None, or why there is no position.
    """
    found = visual_fix(result.form, result.opened.pipeline.map.georeference)
    if isinstance(found, NoPose):
        nothing = dict.fromkeys(("lat", "lon", "heading_deg", "position_covariance_m2"))
        return {**result.form, "time": time_s, **nothing, "no_pose": found.reason}
    east, north, both = found.covariance_m2
    return {
        **result.form,
        "time": time_s,
        "lat": found.latlon.lat,
        "lon": found.latlon.lon,
        "heading_deg": found.heading_deg,
        "position_covariance_m2": [[east, both], [both, north]],
        "no_pose": None,
    }


def keep(session: Session, mission_id: int, *, sha256: str, fix: Mapping[str, Any]) -> None:
    """Store a fix with its photo, and as a pose of the track; it replaces an earlier fix of the photo.

    Args:
        session: Session of a write transaction.
        sha256: Of the photo.
        fix: Result of `fix_json`.

    Raises:
        NotFound: The mission or the photo no longer exists.
    """
    mission = session.get_one(Mission, mission_id, with_for_update=True)
    photo = missions.find_photo(session, mission_id, sha256)
    again = photo.fix is not None and _is_pose(photo.fix)
    photo.fix, photo.fix_state = dict(fix), "done"
    if again:
        session.flush()
        _rebuild(session, mission_id)
    elif _is_pose(fix):
        track = tracks.get_or_create(session, mission_id, source="visual", name=TRACK)
        tracks.append(session, track, _pose(fix))
    missions.count_change(mission)


def queue(session: Session, mission: Mission, *, photos: list[MissionPhoto], account_id: int) -> Job:
    """Queue the localization of photos of a mission.

    Args:
        session: Session of a write transaction.
        account_id: Account that requested it.

    Raises:
        NotFound: The mission has no map.
    """
    map_of(mission)
    for photo in photos:
        photo.fix_state = "queued"
    missions.count_change(mission)
    return jobs.enqueue(
        session,
        JOB,
        map_id=mission.map_id,
        account_id=account_id,
        arguments={"mission": mission.id},
        key=str(mission.id),
    )


def map_of(mission: Mission) -> int:
    """Return the id of the map of a mission.

    Raises:
        NotFound: The mission has no map.
    """
    if mission.map_id is None:
        raise NotFound(
            "this mission is not on a map: its photos cannot be localized",
            where=f"mission {mission.id}",
            hint="choose a map for the mission first",
        )
    return mission.map_id


def localize_waiting_photos(
    library: Library,
    mission_id: int,
    *,
    map_cache: MapCache,
    write: Write,
    progress: Progress,
) -> dict[str, int]:
    """Localize the queued photos of a mission, storing each result in its own transaction.

    Args:
        write: Opens a write transaction.
        progress: One step per photo.

    Returns:
        Numbers of photos that are `localized`, have `no_pose`, and have `failed`.

    Raises:
        NotFound: The mission no longer exists, or has no map.
        NotReady, MapError, IndexDamaged: The map cannot be used for localization.
        Cancelled
    """
    with library.database.read() as session:
        map_id = map_of(session.get_one(Mission, mission_id))
        waiting = [p for p in missions.photos(session, mission_id) if p.fix_state == "queued"]
    progress.size(len(waiting))
    counted = {"localized": 0, "no_pose": 0, "failed": 0}
    for photo in waiting:
        progress.check()
        try:
            request = LocalizeRequest((UploadedPhoto(_file(library, photo), photo.name),))
            result = upload.localize_uploads(map_cache, map_id, request=request)
        except InputError as error:
            outcome, fix = "failed", {"error": str(error)}
        else:
            fix = fix_json(result, time_s=photo.time_s)
            outcome = "localized" if fix["no_pose"] is None else "no_pose"
        counted[outcome] += _kept(photo, fix, write)
        progress.advance()
    return counted


def _file(library: Library, photo: MissionPhoto) -> Path:
    try:
        return add_photo.original(library, photo)
    except NotFound as error:
        raise PhotoError(error.message, where=error.where, hint=error.hint) from error


def _kept(result: MissionPhoto, fix: dict[str, Any], write: Write) -> int:
    """Store the result of a photo; return 1, or 0 if the photo no longer exists."""
    with write() as session:
        photo = session.get(MissionPhoto, (result.mission_id, result.sha256))
        if photo is None:
            return 0
        if "error" in fix:
            photo.fix, photo.fix_state = fix, "failed"
            missions.count_change(session.get_one(Mission, result.mission_id))
        else:
            keep(session, result.mission_id, sha256=result.sha256, fix=fix)
    return 1


def _is_pose(fix: Mapping[str, Any]) -> bool:
    return fix.get("lat") is not None and fix.get("time") is not None


def _pose(fix: Mapping[str, Any]) -> Poses:
    (east, both), (_, north) = fix["position_covariance_m2"]
    heading = np.nan if fix["heading_deg"] is None else fix["heading_deg"]
    return make_poses(
        [fix["time"]], [(fix["lat"], fix["lon"])], heading_deg=[heading], covariance_m2=[(east, north, both)]
    )


def _rebuild(session: Session, mission_id: int) -> None:
    """Rewrite the track from the fixes of all photos."""
    track = tracks.get_or_create(session, mission_id, source="visual", name=TRACK)
    tracks.clear(session, track)
    of_mission = select(MissionPhoto.fix).where(MissionPhoto.mission_id == mission_id)
    fixes = [
        fix for fix in session.scalars(of_mission.order_by(MissionPhoto.time_s)) if fix and _is_pose(fix)
    ]
    if fixes:
        tracks.append(session, track, join([_pose(fix) for fix in fixes]))
