"""The job `mission-import`: an uploaded file becomes tracks and objects of a mission."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import asdict
from typing import Any

from webapp.errors import InputError, NotFound, UsageError
from webapp.jobs.context import Context
from webapp.missions.tasks import import_file
from webapp.missions.tasks.upload import order_of, waiting_path


def run(context: Context) -> Mapping[str, Any]:
    """Import; the argument `token` names the file. It is deleted once all of it is there."""
    arguments = context.arguments
    path = waiting_path(context.library, arguments["token"])
    if not path.is_file():
        raise NotFound("the uploaded file is not there any more", hint="upload it again")
    try:
        done = import_file.run(
            context.library,
            int(arguments["mission"]),
            order=order_of(path, arguments),
            settings=context.settings,
            progress=context.progress,
            writes=context.write,
        )
    except (InputError, UsageError):
        path.unlink(missing_ok=True)  # it is refused the next time too
        raise
    path.unlink(missing_ok=True)
    return asdict(done) | {"mission": int(arguments["mission"])}
