"""Kinds of jobs for tests; as a program, a worker that knows them."""

import logging
import os
import sys
import time
from dataclasses import replace
from pathlib import Path

from webapp import errors
from webapp.errors import ProcessLost, StorageError
from webapp.jobs.kinds import JobRegistry, Kind
from webapp.jobs.worker import Worker
from webapp.settings import JobSettings, Settings
from webapp.store.library import open_library
from webapp.store.maps import maps
from webapp.store.schema import MapRecord
from webapp.tasks.maps.delete_map import delete_map


def count(context):
    """Create a file per step, and never repeat a step."""
    steps = context.arguments["steps"]
    todo = [context.library.inner / f"step-{n}" for n in range(steps)]
    context.progress.size(len(todo))
    todo = [path for path in todo if not path.exists()]
    context.progress.skip(steps - len(todo))
    for path in todo:
        context.progress.check()
        time.sleep(context.arguments.get("seconds", 0.1))
        path.touch()
        context.progress.note(path.name)
        context.progress.advance()
    return {"steps": len(todo)}


def fine(context):
    return {"map": context.map_id}


def refuse(context):
    context.progress.size(2)
    context.progress.advance(2)
    raise StorageError("the disk is full", where="here", hint="free some space")


def mistake(context):
    return {"never": 1 // 0}


def lose(context):
    """Lose a worker process in the first attempts."""
    tries = context.library.inner / "tries"
    tries.write_text(tries.read_text() + "x" if tries.exists() else "x")
    if len(tries.read_text()) <= context.arguments["times"]:
        raise ProcessLost("a worker process was killed")
    return {"tries": len(tries.read_text())}


def away(context):
    """Require something unavailable until a file `back` exists."""
    if not (context.library.inner / "back").exists():
        kind = getattr(errors, context.arguments.get("error", "StorageUnavailable"))
        raise kind("it cannot be reached", wait_s=context.arguments["wait_s"])


def outlive(context):
    """Write for a map that is deleted meanwhile."""
    with context.library.database.write() as session:
        record = session.get(MapRecord, context.map_id)
        maps.put_into_bin(record)
        slug = record.slug
    delete_map(context.library, context.map_id)
    folder = context.library.map_folder(slug) / "derived" / "map"
    folder.mkdir(parents=True)
    (folder / "manifest.json").write_text("{}")


def stubborn(context):
    """Ignore requests to stop for longer than a worker waits."""
    (context.library.inner / "begun").touch()
    time.sleep(context.arguments["seconds"])


def write(context):
    """Rename the map as soon as a file `go` exists; create a file `tried`, whatever the outcome."""
    while not (context.library.inner / "go").exists():
        time.sleep(0.02)
    try:
        with context.write() as session:
            session.get_one(MapRecord, context.map_id).name = "Written"
    finally:
        (context.library.inner / "tried").touch()


if __name__ == "__main__":
    logging.basicConfig(level=logging.INFO)
    longs = {name: Kind(f"kinds_for_tests:{name}") for name in ("count", "stubborn", "write")}
    registry = JobRegistry(longs | {"fine": Kind("kinds_for_tests:fine", short=True)})
    folder = Path(sys.argv[1])
    limits = JobSettings(lease_s=float(sys.argv[2]), stop_s=0.5, export_s=0.2)
    settings = replace(Settings(), library=folder, jobs=limits)
    working = Worker(
        open_library(folder, url=os.environ.get("EXPMAP_DATABASE")),
        settings,
        registry=registry,
        only_short="short" in sys.argv,
    )
    working.stop_on_signals()
    working.run()
