"""Kills parts of a cluster at random under load, and checks that nothing is lost, duplicated or damaged.

    python -m benchmarks.chaos [--minutes 20] [--editors 20] [--robots 20] [--uploaders 2] [--every 10] [--s3]

Starts PostgreSQL, a scheduler with two workers of Dask, and two web nodes with a worker each, all on this
machine, with a temporary library. Every few seconds one of these is killed with SIGKILL and restarted: a web
node with all its processes, one of its processes, a worker, a worker of Dask, or PostgreSQL (SIGQUIT, like a
power cut). Meanwhile people edit maps, robots send poses, and photos are uploaded, placed and built into
indexes by jobs on Dask. With --s3 photos and indexes are in S3, each node has its own cache, and the S3
server stops responding now and then.

Prints a JSON object. Checks: each acknowledged edit is in the database unless a later one changed the same
photo; no revision was given twice; all edits are in `map.cfg`; each pose is stored once, in order; each
acknowledged photo is stored once, undamaged, at its acknowledged position; no job has failed, and the map
answers. The longest refusal is the longest time in which a client got no answer, except while PostgreSQL was
down. The exit code is 1 if a check fails, or if a refusal was longer than `--longest`.
"""

from __future__ import annotations

import argparse
import hashlib
import json
import os
import tempfile
import threading
import time
from collections import Counter
from contextlib import ExitStack
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from sqlalchemy import select

from benchmarks.chaos_cluster import Balancer, Chaos, Cluster, WebNode, tail
from benchmarks.chaos_load import PatientClient, Refusals, UnsureEditor, Uploader
from benchmarks.client import Client
from benchmarks.editing_checks import Final, check_seen, place, read_final
from benchmarks.editing_load import sign_in_links
from benchmarks.robots_load import Robot, stored_problems
from benchmarks.s3_server import BUCKET, ObjectServer
from tests.cluster.dask_cluster import DaskCluster
from tests.ports import reserved_port
from tests.postgresql_server import PostgresqlServer
from webapp.files import contents
from webapp.files.contents import connect
from webapp.missions.store import missions
from webapp.settings import Settings
from webapp.store.accounts import accounts
from webapp.store.library import Library, open_library
from webapp.store.maps import maps
from webapp.store.schema import Job, MapRecord, Photo

_NODES = 2
_DASK_WORKERS = 2
_MAPS = 2
_PHOTOS = 30
_PLAN_PX = (1600, 1200)
_JOBS_WITHIN_S = 900.0
_NEAR_PX = 20.0
_RECOVERY_S = 5.0
"""Time after a restart of PostgreSQL for connection pools and leases to recover."""


@dataclass(frozen=True)
class Site:
    """Addresses and storage of the cluster.

    Attributes:
    ----------
    address : str
        Address for clients.
    folder : Path
        Folder of the library.
    database : str
        URL of the database.
    storage : str or None
        URL of the object storage of photos, unless they are in the folder.
    """

    address: str
    folder: Path
    database: str
    storage: str | None

    def library(self) -> Library:
        """Open the library; the caller must close it."""
        return open_library(self.folder, url=self.database)

    def links(self, count: int) -> list[str]:
        """Create accounts; return links that sign in to them."""
        return [self.address + path for path in sign_in_links(self.folder, count, url=self.database)]


@dataclass
class Load:
    """All clients of the cluster."""

    editors: list[UnsureEditor]
    uploaders: list[Uploader]
    robots: list[Robot]
    refusals: Refusals

    def work(self, arguments: argparse.Namespace) -> None:
        """Run all clients in parallel for the given time."""
        seconds = 60 * arguments.minutes
        options = argparse.Namespace(seconds=seconds, hertz=5.0, beat=1.0)
        begin = time.time() + 1.0
        threads = [
            threading.Thread(target=one.work, args=(seconds,)) for one in (*self.editors, *self.uploaders)
        ]
        threads += [threading.Thread(target=robot.work, args=(begin, options)) for robot in self.robots]
        for thread in threads:
            thread.start()
        for thread in threads:
            thread.join()


def main() -> None:
    """Run the load and print one JSON object."""
    arguments = _arguments()
    with tempfile.TemporaryDirectory() as name, ExitStack() as stack:
        folder = Path(name)
        database = PostgresqlServer()
        stack.callback(database.remove)
        url = database.new_database(empty=True)
        objects = stack.enter_context(ObjectServer(mb_s=100.0, ms=5.0)) if arguments.s3 else None
        os.environ.update(objects.environ if objects else {})
        dask = DaskCluster(_made(folder / "dask"), workers=_DASK_WORKERS)
        stack.callback(dask.stop)
        environ = {"EXPMAP_DATABASE": url, "EXPMAP_DASK": dask.address}
        if objects:
            environ["EXPMAP_STORAGE"] = f"s3://{BUCKET}/library"
        ports = [stack.enter_context(reserved_port()) for _ in range(_NODES)]
        nodes = [
            WebNode(
                folder / "maps",
                port,
                environ={**environ, "EXPMAP_CACHE_FOLDER": str(folder / f"cache-{port}")},
                log=folder / "log",
            )
            for port in ports
        ]
        cluster = Cluster(database, dask, nodes, objects)
        address = stack.enter_context(Balancer(ports)).url
        site = Site(address, folder / "maps", url, environ.get("EXPMAP_STORAGE"))
        token, missions_ = _make_library(site, arguments.robots)
        cluster.start()
        stack.callback(cluster.end)
        load, first = _set_up(site, arguments, robots=[Robot(site.address, token, id) for id in missions_])
        with Chaos(cluster, every_s=arguments.every, seed=arguments.seed) as chaos:
            load.work(arguments)
        library = site.library()
        connect(Settings(database=url, storage=site.storage, cache_folder=folder / "cache"))
        problems = [*chaos.problems, *load.refusals.errors, *_wait_for_jobs(library)]
        served = {slug: load.editors[0].client.ask("GET", f"/maps/{slug}")["photos"] for slug in first}
        for slug in first:
            final = read_final(site.folder, slug, url=url)
            problems += _edit_problems(load, slug, first=first[slug], served=served[slug], final=final)
        for one in load.uploaders:
            problems += [*_upload_problems(library, one), *_answer_problems(library, one)]
        problems += [problem for robot in load.robots for problem in stored_problems(library, robot)]
        jobs = _jobs(library)
        library.database.close()
        problems += [f"a job of kind {kind} is {state}" for kind, state in jobs if state == "failed"]
        longest = _longest(load.refusals, cluster.outages)
        if longest["s"] > arguments.longest:
            problems.append(f"a client got no answer for {longest['s']} s: {longest['request']}")
        if problems:
            print(tail(folder / "log"))
    figures = {**_figures(load, arguments), "jobs": dict(Counter(f"{k} {s}" for k, s in jobs))}
    figures |= {"killed": dict(chaos.killed), "longest_refusal": longest, "problems": problems[:50]}
    print(json.dumps(figures, indent=2))
    raise SystemExit(1 if problems else 0)


def _arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("--minutes", type=float, default=20)
    parser.add_argument("--editors", type=int, default=20)
    parser.add_argument("--robots", type=int, default=20)
    parser.add_argument("--uploaders", type=int, default=2)
    parser.add_argument("--every", type=float, default=10, help="mean seconds between two kills")
    parser.add_argument("--pause", type=float, default=2.0, help="mean seconds between two edits of a client")
    parser.add_argument(
        "--longest", type=float, default=10, help="seconds without an answer that are allowed"
    )
    parser.add_argument("--s3", action="store_true", help="photos and indexes are in S3")
    parser.add_argument("--seed", type=int, default=1)
    return parser.parse_args()


def _made(folder: Path) -> Path:
    folder.mkdir()
    return folder


def _make_library(site: Site, robots: int) -> tuple[str, list[int]]:
    """Make a library with missions and a map, since an empty one would get the sample map at the start."""
    library = site.library()
    with library.database.write() as session:
        owner = accounts.ensure_owner(session)
        maps.create(session, "Another", account_id=owner.id)
        token = accounts.new_token(session, owner, name="robots")
        ids = [missions.create(session, f"Robot {n}", account_id=owner.id).id for n in range(robots)]
    library.database.close()
    return token, ids


def _set_up(site: Site, arguments: argparse.Namespace, *, robots: list[Robot]) -> tuple[Load, dict[str, Any]]:
    """Make maps with photos of noise, and accounts; return the clients and the state of the edited maps."""
    links = site.links(1 + arguments.editors + arguments.uploaders)
    owner = Client(site.address, links[0])
    plan = site.folder.with_name("plan.png")
    cv2.imwrite(str(plan), np.full((_PLAN_PX[1], _PLAN_PX[0], 3), 200, np.uint8))
    draw = np.random.default_rng(arguments.seed)
    photos = [site.folder.with_name(f"{number}.jpg") for number in range(_PHOTOS)]
    for path in photos:
        cv2.imwrite(str(path), draw.integers(0, 255, (120, 160, 3), np.uint8))
    edited = [owner.make_map(f"Edited {n}", satellite=plan, photos=photos) for n in range(_MAPS)]
    filled = [owner.make_map(f"Filled {n}", satellite=plan, photos=[]) for n in range(arguments.uploaders)]
    refusals = Refusals()
    people = [PatientClient(site.address, link, refusals) for link in links[1:]]
    editors = [
        UnsureEditor(client, edited[n % _MAPS], seed=n, pause_s=arguments.pause)
        for n, client in enumerate(people[: arguments.editors])
    ]
    uploaders = [
        Uploader(client, slug, seed=1000 + n, pause_s=5.0)
        for n, (client, slug) in enumerate(zip(people[arguments.editors :], filled, strict=True))
    ]
    first = {slug: owner.ask("GET", f"/maps/{slug}") for slug in edited}
    return Load(editors, uploaders, robots, refusals), first


def _wait_for_jobs(library: Library) -> list[str]:
    """Wait until all jobs are done; report those that are left after `_JOBS_WITHIN_S`."""
    until = time.monotonic() + _JOBS_WITHIN_S
    left = ["all"]
    while left and time.monotonic() < until:
        time.sleep(1.0)
        left = [kind for kind, state in _jobs(library) if state in ("queued", "running")]
    return [f"jobs are left after {_JOBS_WITHIN_S:.0f} s: {Counter(left)}"] if left else []


def _jobs(library: Library) -> list[tuple[str, str]]:
    with library.database.read() as session:
        return [(job.kind, job.state) for job in session.scalars(select(Job))]


def _answer_problems(library: Library, one: Uploader) -> list[str]:
    """Localize one of the map's own photos, and compare the answer with its position."""
    slug = one.slug
    with library.database.read() as session:
        record = session.scalars(select(MapRecord).where(MapRecord.slug == slug)).one()
        photo = session.scalars(
            select(Photo).where(Photo.map_id == record.id, Photo.x_px.is_not(None), ~Photo.removed)
        ).first()
    if photo is None:
        return [f"{slug} has no placed photo"]
    data = contents.local(library.map_folder(slug) / photo.path).read_bytes()
    answer = one.client.call("POST", f"/maps/{slug}/localize", files={"file": ("query.jpg", data)})
    found = answer.json().get("hypotheses", []) if answer.ok else []
    if found and np.hypot(found[0]["x_px"] - photo.x_px, found[0]["y_px"] - photo.y_px) < _NEAR_PX:
        return []
    return [f"{slug} answers {answer.status_code} {answer.text[:300]}"]


def _edit_problems(
    load: Load, slug: str, *, first: dict[str, Any], served: list[dict[str, Any]], final: Final
) -> list[str]:
    """Compare the acknowledged edits of a map with its final state."""
    editors = [editor for editor in load.editors if editor.log.slug == slug]
    answers = sorted((a for e in editors for a in e.log.answers), key=lambda answer: int(answer["revision"]))
    problems = [error for editor in editors for error in editor.log.errors]
    given = Counter(answer["revision"] for answer in answers)
    problems += [f"{slug}: revision {revision} was given twice" for revision, n in given.items() if n > 1]
    unknown = set(range(first["revision"] + 1, final.revision + 1)) - set(given)
    lost = sum(editor.lost for editor in editors)
    if len(unknown) > lost:
        problems.append(f"{slug}: {len(unknown)} edits that nobody made, {lost} answers were lost")
    problems += [] if unknown else check_seen(answers)  # lost answers could explain differences
    last = {photo["id"]: (photo["revision"], place(photo)) for photo in first["photos"]}
    for answer in answers:
        last |= {photo["id"]: (answer["revision"], place(photo)) for photo in answer["photos"]}
    for photo in served:
        revision, there = last[photo["id"]]
        if photo["revision"] < revision or (photo["revision"] == revision and place(photo) != there):
            problems.append(f"{slug}: photo {photo['id']} is {place(photo)}, acknowledged was {there}")
        if photo["revision"] > revision and photo["revision"] not in unknown:
            problems.append(f"{slug}: photo {photo['id']} has revision {photo['revision']} of somebody else")
        if final.rows.get(photo["id"]) != place(photo):
            problems.append(f"{slug}: the database has {final.rows.get(photo['id'])} for photo {photo['id']}")
    cfg = {photo["id"] for photo in served if photo["x_px"] is not None}
    if set(final.cfg) != cfg or final.exported_revision != final.revision:
        problems.append(f"{slug}: map.cfg has revision {final.exported_revision} of {final.revision}")
    return problems


def _upload_problems(library: Library, one: Uploader) -> list[str]:
    with library.database.read() as session:
        record = session.scalars(select(MapRecord).where(MapRecord.slug == one.slug)).one()
        photos = list(session.scalars(select(Photo).where(Photo.map_id == record.id, ~Photo.removed)))
    rows = Counter(photo.sha256 for photo in photos)
    problems = [*one.errors]
    problems += [
        f"{one.slug}: photo {sha[:12]} was acknowledged and is lost" for sha in one.uploaded - set(rows)
    ]
    problems += [f"{one.slug}: photo {sha[:12]} is there {n} times" for sha, n in rows.items() if n > 1]
    problems += [f"{one.slug}: photo {sha[:12]} comes from nowhere" for sha in set(rows) - one.tried]
    for photo in photos:
        data = contents.local(library.map_folder(one.slug) / photo.path).read_bytes()
        if hashlib.sha256(data).hexdigest() != photo.sha256:
            problems.append(f"{one.slug}: {photo.path} is damaged")
    there = {photo.id: (photo.x_px, photo.y_px) for photo in photos}
    problems += [
        f"{one.slug}: photo {id} is at {there.get(id)}, acknowledged was {at}"
        for id, at in one.placed.items()
        if there.get(id) != at
    ]
    return problems


def _longest(refusals: Refusals, outages: list[tuple[float, float]]) -> dict[str, Any]:
    """Find the longest refusal and its request; those during outages of the database are kept apart."""
    away = [(begin, end + _RECOVERY_S) for begin, end in outages]
    kinds = {"s": 0.0, "with_the_database_away_s": 0.0}
    longest = ""
    for begin, end, what in refusals.times:
        overlaps = any(begin < until and end > since for since, until in away)
        name = "with_the_database_away_s" if overlaps else "s"
        if name == "s" and end - begin > kinds["s"]:
            longest = what
        kinds[name] = max(kinds[name], end - begin)
    seconds = {name: round(value, 1) for name, value in kinds.items()}
    return {**seconds, "request": longest, "refusals": len(refusals.times)}


def _figures(load: Load, arguments: argparse.Namespace) -> dict[str, Any]:
    return {
        "minutes": arguments.minutes,
        "editors": len(load.editors),
        "robots": len(load.robots),
        "edits": sum(len(editor.log.answers) for editor in load.editors),
        "conflicts": sum(editor.log.conflicts for editor in load.editors),
        "edits_without_an_answer": sum(editor.lost for editor in load.editors),
        "poses": sum(len(robot.made) for robot in load.robots),
        "photos": sum(len(one.uploaded) for one in load.uploaders),
        "load": round(os.getloadavg()[0], 1),
    }


if __name__ == "__main__":
    main()
