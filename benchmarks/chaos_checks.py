"""Checks of `chaos`: what was acknowledged is there, once and undamaged, and refusals were short."""

from __future__ import annotations

import hashlib
import time
from collections import Counter
from collections.abc import Hashable, Iterable
from dataclasses import asdict, dataclass
from typing import Any

from sqlalchemy import select

from benchmarks.chaos_load import Refusals, UnsureEditor, Uploader, localizing_problem
from benchmarks.chaos_site import Load, Site
from benchmarks.editing_checks import Final, Place, check_seen, place, read_final
from benchmarks.robots_load import stored_problems, stored_times
from webapp.files import contents
from webapp.store.library import Library
from webapp.store.schema import Job, MapRecord, Photo

_JOBS_WITHIN_S = 900.0
_RECOVERY_S = 5.0
"""Time after a restart of PostgreSQL for connection pools and leases to recover."""


@dataclass(frozen=True)
class Tally:
    """How many things of a kind were acknowledged, are not there, and are there more than once."""

    acknowledged: int
    lost: int
    double: int

    def __add__(self, other: Tally) -> Tally:
        return Tally(
            self.acknowledged + other.acknowledged, self.lost + other.lost, self.double + other.double
        )


def tally(acknowledged: Iterable[Hashable], stored: Iterable[Hashable]) -> Tally:
    """Compare what was acknowledged with what is stored."""
    wanted, there = set(acknowledged), Counter(stored)
    return Tally(len(wanted), len(wanted - set(there)), sum(n - 1 for n in there.values()))


@dataclass(frozen=True)
class Findings:
    """All that is wrong, and the tallies of edits, poses and photos."""

    problems: list[str]
    tallies: dict[str, Tally]


def check_load(load: Load, site: Site, library: Library, *, first: dict[str, Any]) -> Findings:
    """Wait for the jobs, and compare all that was acknowledged with the library."""
    problems = [*load.refusals.errors, *wait_for_jobs(library)]
    edits = Tally(0, 0, 0)
    for slug, before in first.items():
        served = load.editors[0].client.ask("GET", f"/maps/{slug}")["photos"]
        final = read_final(site.folder, slug, url=site.database)
        answers = acknowledged_edits(load.editors, slug)
        lost = lost_edits(slug, answers, first=before, served=served)
        edits += Tally(len(answers), len(lost), len(double_edits(slug, answers)))
        problems += edit_problems(load.editors, slug, first=before, served=served, final=final)
    for one in load.uploaders:
        problems += [*upload_problems(library, one), *answer_problems(library, one)]
    problems += [error for one in load.localizers for error in one.errors]
    problems += [problem for robot in load.robots for problem in stored_problems(library, robot)]
    problems += [f"a job of kind {kind} is {state}" for kind, state in jobs(library) if state == "failed"]
    poses = [tally(robot.made, stored_times(library, robot)) for robot in load.robots]
    photos = [tally(one.uploaded, stored_photos(library, one.slug)) for one in load.uploaders]
    tallies = {"edits": edits, "poses": sum(poses, Tally(0, 0, 0)), "photos": sum(photos, Tally(0, 0, 0))}
    return Findings(problems, tallies)


def wait_for_jobs(library: Library) -> list[str]:
    """Wait until all jobs are done; report those that are left after `_JOBS_WITHIN_S`."""
    until = time.monotonic() + _JOBS_WITHIN_S
    left = ["all"]
    while left and time.monotonic() < until:
        time.sleep(1.0)
        left = [kind for kind, state in jobs(library) if state in ("queued", "running")]
    return [f"jobs are left after {_JOBS_WITHIN_S:.0f} s: {Counter(left)}"] if left else []


def jobs(library: Library) -> list[tuple[str, str]]:
    """List kind and state of all jobs."""
    with library.database.read() as session:
        return [(job.kind, job.state) for job in session.scalars(select(Job))]


def answer_problems(library: Library, one: Uploader) -> list[str]:
    """Localize one of the map's own photos, and compare the answer with its position."""
    slug = one.slug
    photo = next((photo for photo in _photos(library, slug) if photo.is_placed), None)
    if photo is None or photo.x_px is None or photo.y_px is None:
        return [f"{slug} has no placed photo"]
    data = contents.local(library.map_folder(slug) / photo.path).read_bytes()
    problem = localizing_problem(one.client, slug, data, place=(photo.x_px, photo.y_px))
    return [] if problem is None else [problem]


def acknowledged_edits(editors: list[UnsureEditor], slug: str) -> list[dict[str, Any]]:
    """List the acknowledged edits of a map by their revisions."""
    answers = (answer for editor in editors if editor.log.slug == slug for answer in editor.log.answers)
    return sorted(answers, key=lambda answer: int(answer["revision"]))


def double_edits(slug: str, answers: list[dict[str, Any]]) -> list[str]:
    """Find revisions that were given twice."""
    given = Counter(answer["revision"] for answer in answers)
    return [f"{slug}: revision {revision} was given twice" for revision, n in given.items() if n > 1]


def lost_edits(
    slug: str, answers: list[dict[str, Any]], *, first: dict[str, Any], served: list[dict[str, Any]]
) -> list[str]:
    """Find photos that are not where the last acknowledged edit has put them."""
    last = _last(first, answers)
    return [
        f"{slug}: photo {photo['id']} is {place(photo)}, acknowledged was {there}"
        for photo in served
        for revision, there in [last[photo["id"]]]
        if photo["revision"] < revision or (photo["revision"] == revision and place(photo) != there)
    ]


def _last(first: dict[str, Any], answers: list[dict[str, Any]]) -> dict[int, tuple[int, Place]]:
    """Return revision and place of each photo after the last acknowledged edit of it."""
    last = {photo["id"]: (photo["revision"], place(photo)) for photo in first["photos"]}
    for answer in answers:
        last |= {photo["id"]: (answer["revision"], place(photo)) for photo in answer["photos"]}
    return last


def edit_problems(
    editors: list[UnsureEditor],
    slug: str,
    *,
    first: dict[str, Any],
    served: list[dict[str, Any]],
    final: Final,
) -> list[str]:
    """Compare the acknowledged edits of a map with its final state."""
    editors = [editor for editor in editors if editor.log.slug == slug]
    answers = acknowledged_edits(editors, slug)
    problems = [error for editor in editors for error in editor.log.errors] + double_edits(slug, answers)
    unknown = set(range(first["revision"] + 1, final.revision + 1)) - {a["revision"] for a in answers}
    lost = sum(editor.lost for editor in editors)
    if len(unknown) > lost:
        problems.append(f"{slug}: {len(unknown)} edits that nobody made, {lost} answers were lost")
    problems += [] if unknown else check_seen(answers)  # lost answers could explain differences
    problems += lost_edits(slug, answers, first=first, served=served)
    last = _last(first, answers)
    for photo in served:
        if photo["revision"] > last[photo["id"]][0] and photo["revision"] not in unknown:
            problems.append(f"{slug}: photo {photo['id']} has revision {photo['revision']} of somebody else")
        if final.rows.get(photo["id"]) != place(photo):
            problems.append(f"{slug}: the database has {final.rows.get(photo['id'])} for photo {photo['id']}")
    cfg = {photo["id"] for photo in served if photo["x_px"] is not None}
    if set(final.cfg) != cfg or final.exported_revision != final.revision:
        problems.append(f"{slug}: map.cfg has revision {final.exported_revision} of {final.revision}")
    return problems


def stored_photos(library: Library, slug: str) -> list[str]:
    """List the hashes of the photos of a map."""
    return [photo.sha256 for photo in _photos(library, slug)]


def _photos(library: Library, slug: str) -> list[Photo]:
    with library.database.read() as session:
        record = session.scalars(select(MapRecord).where(MapRecord.slug == slug)).one()
        return list(session.scalars(select(Photo).where(Photo.map_id == record.id, ~Photo.removed)))


def upload_problems(library: Library, one: Uploader) -> list[str]:
    """Compare the acknowledged photos of a map, their content and their places with the library."""
    photos = _photos(library, one.slug)
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


def longest_refusal(refusals: Refusals, outages: list[tuple[float, float]]) -> dict[str, Any]:
    """Find the longest refusal and its request; those while the database is away, separately."""
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


def figures(load: Load, findings: Findings) -> dict[str, Any]:
    """Count the clients, and what was acknowledged to them."""
    return {
        "editors": len(load.editors),
        "robots": len(load.robots),
        "localizing": len(load.localizers),
        **{name: asdict(count) for name, count in findings.tallies.items()},
        "conflicts": sum(editor.log.conflicts for editor in load.editors),
        "edits_without_an_answer": sum(editor.lost for editor in load.editors),
        "answers": sum(one.answers for one in load.localizers),
    }
