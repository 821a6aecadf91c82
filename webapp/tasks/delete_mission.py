"""Deletes a mission in the bin for good."""

from __future__ import annotations

import shutil

from sqlalchemy import delete, func, select

from webapp.errors import Conflict, NotFound
from webapp.store import missions
from webapp.store.library import Library
from webapp.store.schema_missions import Mission, Pose, Track

_BLOCK = 50_000
"""Poses in one transaction: others write in between."""


def run(library: Library, mission_id: int) -> None:
    """Delete a mission: its poses block by block, then all its other records, then its files.

    Killed in between, it is in the bin with fewer poses and can be deleted again; files without a mission
    are swept away.

    Raises
    ------
    NotFound
        There is no such mission.
    Conflict
        It is not in the bin.
    StorageError
        The disk refused.
    """
    while _delete_some(library, mission_id):
        pass
    with library.database.write() as session:
        session.delete(_binned(session.get(Mission, mission_id)))
    shutil.rmtree(missions.folder(library, mission_id), ignore_errors=True)


def sweep(library: Library) -> None:
    """Delete the folders of missions that are deleted: ids are never used again."""
    folders = [path for path in (library.folder / missions.FOLDER).glob("*") if path.name.isdecimal()]
    with library.database.read() as session:
        known = set(session.scalars(select(Mission.id)))
    for folder in folders:
        if int(folder.name) not in known:
            shutil.rmtree(folder, ignore_errors=True)


def _delete_some(library: Library, mission_id: int) -> bool:
    """Delete a block of poses; False when none is left."""
    with library.database.write() as session:
        _binned(session.get(Mission, mission_id))
        of_mission = select(Track.id).where(Track.mission_id == mission_id)
        first = select(Pose.track_id, func.min(Pose.number)).where(Pose.track_id.in_(of_mission))
        found = session.execute(first.group_by(Pose.track_id).limit(1)).first()
        if found is None:
            return False
        track_id, number = found
        some = (Pose.track_id == track_id, Pose.number < number + _BLOCK)
        session.execute(delete(Pose).where(*some).execution_options(synchronize_session=False))
    return True


def _binned(mission: Mission | None) -> Mission:
    if mission is None:
        raise NotFound("there is no such mission")
    if mission.binned_at is None:
        raise Conflict(
            "only missions in the bin can be deleted",
            where=f"mission {mission.id}",
            hint="put it there first",
        )
    return mission
