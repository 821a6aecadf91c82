"""The jobs of missions; `webapp.app.registry` registers them."""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import asdict, replace
from functools import partial
from typing import Any

from sqlalchemy.orm import Session

from webapp.errors import Cancelled, Conflict, IndexDamaged, InputError, NotFound, NotReady, UsageError
from webapp.files.gate import budget_for
from webapp.jobs import map_jobs
from webapp.jobs.context import Context
from webapp.missions.tasks import (
    delete,
    fuse,
    import_file,
    localize_photos,
    staged_file,
    thin_tracks,
    track_display,
)
from webapp.missions.tasks.import_file import MissionToMake
from webapp.missions.tasks.import_order import order_of, waiting_path
from webapp.store.operate import jobs
from webapp.store.schema import Job
from webapp.tasks.localize.map_cache import MapCache

_LISTED = 100
"""Maximum number of rejected fixes listed in the result of a fusion; the report has all."""


def import_mission_file(context: Context) -> Mapping[str, Any]:
    """Import an uploaded file into a mission.

    The argument `token` identifies the file, which is deleted once it is imported or refused.
    """
    arguments = context.arguments
    path = waiting_path(context.library, arguments["token"])
    if not path.is_file():
        raise NotFound("the uploaded file no longer exists", hint="upload it again")
    try:
        done = import_file.import_track_file(
            context.library,
            _destination(context),
            order=order_of(path, arguments),
            settings=context.settings,
            progress=context.progress,
            writes=context.write,
        )
    except (InputError, UsageError):
        path.unlink(missing_ok=True)  # a retry would fail too
        raise
    path.unlink(missing_ok=True)
    return asdict(done)


def _destination(context: Context) -> int | MissionToMake:
    """Return the target of an import: an existing mission, or a new one, whose id the job then stores."""
    arguments = context.arguments
    if arguments["mission"] is not None:
        return int(arguments["mission"])

    def remember(session: Session, id: int) -> None:
        job = jobs.find(session, context.lease.job_id)
        job.arguments = {**job.arguments, "mission": id}

    if context.account_id is None:
        raise NotFound("the account that requested this mission no longer exists")
    return MissionToMake(arguments["mission_name"], context.account_id, context.map_id, remember)


def inspect_mission_file(context: Context) -> dict[str, Any]:
    """Report the content of the staged file that the argument `file` names."""
    arguments = context.arguments
    if context.account_id is None:
        raise NotFound("the account that uploaded this file no longer exists")
    staged = staged_file.find(context.library, arguments["file"], account_id=context.account_id)
    budget = budget_for(staged.path, context.settings.files)
    return staged_file.inspect_staged(staged, arguments, budget=budget, progress=context.progress)


def localize_mission_photos(context: Context) -> dict[str, Any]:
    """Localize the waiting photos of the mission with the id `mission`; if killed, finished ones are kept."""
    try:
        return _localize(context)
    except (NotReady, IndexDamaged):
        context.progress.note("building the index of the map")
        map_jobs.build_map_index(replace(context, arguments={}))
        return _localize(context)


def _localize(context: Context) -> dict[str, Any]:
    return localize_photos.localize_waiting_photos(
        context.library,
        int(context.arguments["mission"]),
        map_cache=MapCache(context.library, context.settings),
        write=context.write,
        progress=context.progress,
    )


def fuse_mission(context: Context) -> dict[str, Any]:
    """Fuse the mission with the id `mission`; if killed, the previous fused track is kept."""
    arguments = context.arguments
    report = fuse.fuse_mission(
        context.library,
        int(arguments["mission"]),
        write=partial(_write_unless_cancelled, context),
        progress=context.progress,
        odometry=arguments.get("odometry"),
    )
    return {**report, "gated": report["gated"][:_LISTED]}


@contextmanager
def _write_unless_cancelled(context: Context) -> Iterator[Session]:
    """Open a write transaction of a job, unless somebody has cancelled it and does not expect its result."""
    with context.write() as session:
        if session.get_one(Job, context.lease.job_id).cancel_wanted:
            raise Cancelled("stopped; what was finished is kept")
        yield session


def build_track_pieces(context: Context) -> dict[str, Any]:
    """Build display pieces for new poses of the mission with the id `mission`; if killed, pieces are kept."""
    mission_id = int(context.arguments["mission"])
    built = track_display.build_pieces(
        context.library, mission_id, write=context.write, progress=context.progress
    )
    return {"pieces": built}


def thin_old_tracks(context: Context) -> dict[str, Any]:
    """Thin the tracks that are due by the settings; if killed, finished tracks are kept.

    A mission that changes meanwhile is left for the next run.
    """
    thinned = removed = 0
    for rule in thin_tracks.rules(context.settings.missions):
        with context.library.database.read() as session:
            ids = thin_tracks.due(session, rule)
        context.progress.size(len(ids))
        for id in ids:
            try:
                for track in thin_tracks.thin_mission(
                    context.library, id, rule=rule, write=context.write, progress=context.progress
                ):
                    thinned, removed = thinned + 1, removed + track.before - track.after
            except (Conflict, NotFound) as error:
                context.progress.note(str(error))
            context.progress.advance()
    return {"tracks": thinned, "removed_poses": removed}


def delete_mission(context: Context) -> None:
    """Delete the mission with the id `mission`; if killed, a later run continues."""
    mission_id = int(context.arguments["mission"])
    delete.delete_mission(context.library, mission_id, write=context.write, progress=context.progress)
