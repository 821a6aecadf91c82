"""Moves a library to PostgreSQL and S3 and back, and compares its files and answers.

    python -m benchmarks.there_and_back MAP.cfg [--queries 20] [--json OUT]

A library is made from a copy of the map, whose index is built by a worker. Then its records are moved to
PostgreSQL and its photos and index to S3, and back to SQLite and the folder, by `expmap library move`.
Before, between and after, `map.cfg`, each photo and the answers to the map's own photos, cropped at the
edges, are read by new processes; in S3 with an empty cache, and after the files were deleted from the folder.
Workers do that ten minutes after the upload: the benchmark sets the pointers' times back instead of waiting.

Prints the seconds of each move, and the numbers of files and answers that differ. The exit code is 1 if any
differ, or if the folder still had a photo when all of them should have been read from S3.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Mapping, Sequence
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from benchmarks.s3_cold import cut_photos
from benchmarks.s3_server import BUCKET, ObjectServer
from tests.postgresql_server import PostgresqlServer
from webapp.files import contents
from webapp.files.contents import connect
from webapp.files.maps.folder import read_map
from webapp.files.object_storage.cache import SUFFIX
from webapp.settings import Settings
from webapp.store.accounts import accounts
from webapp.store.library import open_library
from webapp.tasks.maps.adopt_map import adopt_map

_SLUG = "moved"


def main() -> int:
    """Move the library there and back; return 1 if something differs."""
    parser = argparse.ArgumentParser(description=(__doc__ or "").partition("\n")[0])
    parser.add_argument("cfg", type=Path)
    parser.add_argument("--queries", type=int, default=20)
    parser.add_argument("--json", type=Path)
    asked = parser.parse_args()
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        server = PostgresqlServer()
        stack.callback(server.remove)
        objects = stack.enter_context(ObjectServer(mb_s=100.0, ms=5.0))
        os.environ.update(objects.environ)
        database = server.new_database(empty=True)
        library = make_library(asked.cfg, folder / "maps")
        queries = [*cut_photos(library / _SLUG / "map.cfg", folder / "queries", asked.queries)]
        result = move(library, queries, database=database, cache=folder / "cache")
    text = json.dumps(result, indent=1)
    print(text)
    if asked.json:
        asked.json.write_text(text)
    return 0 if result["equal"] else 1


def make_library(cfg: Path, folder: Path) -> Path:
    """Make a library with a copy of a map, and build its index."""
    shutil.copytree(cfg.parent, folder / _SLUG, ignore=shutil.ignore_patterns("derived"))
    if cfg.name != "map.cfg":
        (folder / _SLUG / cfg.name).rename(folder / _SLUG / "map.cfg")
    library = open_library(folder)
    with library.database.write() as session:
        owner = accounts.ensure_owner(session)
    adopt_map(library, _SLUG, account_id=owner.id)
    library.database.close()
    _expmap({}, "worker", "--once", "--library", str(folder))
    return folder


def move(library: Path, queries: Sequence[Path], *, database: str, cache: Path) -> dict[str, Any]:
    """Move a library there and back, and read it before, between and after."""
    records = {"EXPMAP_DATABASE": database}
    both = {**records, "EXPMAP_STORAGE": f"s3://{BUCKET}/library", "EXPMAP_CACHE_FOLDER": str(cache)}
    before = read(library, queries, environ={})
    seconds = {
        "to postgresql": _move(library, "postgresql", records),
        "to s3": _move(library, "s3", both),
    }
    _leave_objects_only(library, both)
    shutil.rmtree(cache, ignore_errors=True)
    there = read(library, queries, environ=both)
    seconds |= {"to folder": _move(library, "folder", both), "to sqlite": _move(library, "sqlite", records)}
    after = read(library, queries, environ={})
    return {
        "files": len(before.files),
        "answers": len(before.answers),
        "seconds": seconds,
        "only pointers in the folder, there": there.pointers,
        "differ there": before.differences(there),
        "differ after": before.differences(after),
        "equal": before.same(there) and before.same(after) and there.pointers == len(there.files) - 1,
    }


def _leave_objects_only(library: Path, environ: Mapping[str, str]) -> None:
    """Store the index in S3, too, and delete the files that have become objects."""
    _expmap(environ, "build", str(library / _SLUG / "map.cfg"), "--method", "verified")
    for pointer in library.rglob(f".*{SUFFIX}"):
        os.utime(pointer, (0, 0))
    _move(library, "s3", environ)


@dataclass(frozen=True, slots=True)
class State:
    """Files and answers of a library.

    Attributes:
    ----------
    files : dict of str to str
        SHA-256 of `map.cfg` and the photos.
    answers : list
        Without times.
    pointers : int
        Number of photos of which the folder has only a pointer.
    """

    files: dict[str, str]
    answers: list[Any]
    pointers: int

    def same(self, other: State) -> bool:
        """Return whether files and answers are the same."""
        return self.files == other.files and self.answers == other.answers

    def differences(self, other: State) -> dict[str, int]:
        """Count the files and answers that differ from another state."""
        names = self.files.keys() | other.files.keys()
        pairs = zip(self.answers, other.answers, strict=True)
        return {
            "files": sum(self.files.get(name) != other.files.get(name) for name in names),
            "answers": sum(one != another for one, another in pairs),
        }


def read(library: Path, queries: Sequence[Path], *, environ: Mapping[str, str]) -> State:
    """Hash the files of the map, and localize queries in a separate process."""
    cfg = library / _SLUG / "map.cfg"
    said = _expmap(environ, "localize", str(cfg), *map(str, queries), "--json", "--method", "verified")
    connect(
        Settings(
            database=environ.get("EXPMAP_DATABASE"),
            storage=environ.get("EXPMAP_STORAGE"),
            cache_folder=Path(environ["EXPMAP_CACHE_FOLDER"]) if environ else None,
        )
    )
    photos = [cfg.parent / experience.photo for experience in read_map(cfg).experiences]
    files = {path.name: path for path in (cfg, *photos)}
    hashes = {
        name: hashlib.sha256(contents.local(path).read_bytes()).hexdigest() for name, path in files.items()
    }
    return State(hashes, _without_times(json.loads(said)), sum(not p.is_file() for p in photos))


def _without_times(answer: Any) -> Any:
    if isinstance(answer, dict):
        return {key: _without_times(value) for key, value in answer.items() if "seconds" not in key}
    return [_without_times(one) for one in answer] if isinstance(answer, list) else answer


def _move(library: Path, to: str, environ: Mapping[str, str]) -> float:
    begin = time.perf_counter()
    _expmap(environ, "library", "move", "--to", to, "--library", str(library))
    return round(time.perf_counter() - begin, 1)


def _expmap(environ: Mapping[str, str], *words: str) -> str:
    print("running expmap", *words[:3], file=sys.stderr)
    command = [sys.executable, "-m", "webapp", *words]
    done = subprocess.run(
        command, env={**os.environ, **environ}, stdout=subprocess.PIPE, text=True, check=True
    )
    return done.stdout


if __name__ == "__main__":
    sys.exit(main())
