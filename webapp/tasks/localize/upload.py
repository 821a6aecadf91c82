"""Says where photos that somebody sent were taken, and remembers photo and answer."""

from __future__ import annotations

import secrets
from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from threading import BoundedSemaphore
from typing import Any

from webapp.core.hypotheses.circle_prior import CirclePrior
from webapp.core.hypotheses.jsonform import AnswerSource, answer_to_json
from webapp.core.hypotheses.model import Answer, Evidence
from webapp.errors import NotFound, UsageError
from webapp.files.part_file import move_in, told_as
from webapp.files.photos.photo import read_facts
from webapp.settings import Settings
from webapp.store.library import Library
from webapp.store.localize import queries
from webapp.store.schema import MapRecord, QueryRecord
from webapp.tasks.localize import follow_sequence, hinted, show_query
from webapp.tasks.localize.hinted import Hints
from webapp.tasks.localize.open_maps import ReadyMap, ReadyMaps, Way
from webapp.tasks.localize.photo import PhotoLocalizer
from webapp.tasks.maps.add_photo import suffix_of, tidy_name

MOST_PHOTOS = 8
"""Of one spot, in one question."""

_QUICK = BoundedSemaphore(2)
"""More at the same time would only wait for each other, and each takes memory for its photo."""

_THOROUGH = BoundedSemaphore(1)
"""Takes a second or two a photo, and memory for its networks: others do not wait for it."""


@dataclass(frozen=True, slots=True)
class Sent:
    """A file that has arrived, and what its sender calls it."""

    path: Path
    name: str


@dataclass(frozen=True, slots=True)
class Question:
    """What is to be localized, and what is known about it.

    Attributes
    ----------
    photos : tuple of Sent
        All taken at one spot.
    way : Way
    top : int
        At most so many hypotheses.
    fov_deg : float or None
        Horizontal field of view, instead of what EXIF says.
    near : Near or None
        About where they were taken.
    heading_deg : float or None
        Where the camera looked.
    sequence : Path or None
        What is known of the sequence that this is the next frame of; written anew.
    key : str or None
        By which who asks knows this question: its answer is kept once, however often it is sent.
    """

    photos: tuple[Sent, ...]
    way: Way = field(default_factory=Way)
    top: int = 5
    fov_deg: float | None = None
    near: CirclePrior | None = None
    heading_deg: float | None = None
    sequence: Path | None = None
    key: str | None = None


@dataclass(frozen=True, slots=True, eq=False)
class Asked:
    """An answer, not remembered yet.

    Attributes
    ----------
    form : dict
        As `localize --json` prints it.
    evidence : tuple of Evidence
    best : int
        Number of the photo that the evidence is about.
    ready : ReadyMap
        What answered.
    """

    form: dict[str, Any]
    evidence: tuple[Evidence, ...]
    best: int
    ready: ReadyMap


def run(ready_maps: ReadyMaps, map_id: int, *, question: Question, settings: Settings) -> Asked:
    """Localize photos of one spot on a map of the library.

    Raises
    ------
    PhotoError
        One of them cannot be used.
    UsageError
        A circle without a photo of the map; too many photos.
    NotReady, MapError, NotFound, IndexDamaged
        The map cannot answer.
    """
    if not 1 <= len(question.photos) <= MOST_PHOTOS:
        raise UsageError(f"{len(question.photos)} photos", where="file", hint=f"send 1 to {MOST_PHOTOS}")
    for photo in question.photos:
        with told_as(photo.name, photo.path):
            read_facts(photo.path, limits=settings.photo)
    ready = ready_maps.get(map_id, question.way)
    localizer = replace(ready.localizer, fov_deg=question.fov_deg)
    hints = Hints(question.near, question.heading_deg)
    with _THOROUGH if localizer.method == "thorough" else _QUICK:
        answers = [_look(localizer, photo, hints) for photo in question.photos]
    if question.sequence is None:
        answer, best = hinted.join(localizer, answers, hints=hints, top=question.top)
    else:
        frame, best = hinted.weigh(localizer, answers, hints=hints)
        answer = follow_sequence.run(question.sequence, frame, localizer=localizer, top=question.top)
    source = AnswerSource(
        localizer.method,
        localizer.features,
        localizer.map.georeference,
        ready.revision,
        sequence=question.sequence is not None,
    )
    name = ", ".join(photo.name for photo in question.photos)
    form = answer_to_json(answer, query=name, source=source)
    return Asked(form, answer.evidence, best, ready)


def remember(
    library: Library, map_id: int, *, asked: Asked, question: Question, account_id: int, settings: Settings
) -> int:
    """Keep an answer and the photo that it is about; of several photos, the one that says most.

    Parameters
    ----------
    library : Library
    map_id : int
    asked : Asked
    question : Question
        Its file is moved.
    account_id : int
        Who asked.
    settings : Settings

    Returns
    -------
    int
        Id of the answer.

    Raises
    ------
    NotFound
        The map is gone.
    DiskFull, StorageError
        Nothing was kept.
    """
    photo = question.photos[asked.best]
    facts = read_facts(photo.path, limits=settings.photo)
    row = QueryRecord(
        account_id=account_id,
        name=tidy_name(photo.name),
        file=f"{secrets.token_hex(12)}.{suffix_of(facts)}",
        width=facts.width,
        height=facts.height,
        options=_options(question),
        answer=asked.form,
        evidence=[_evidence_json(e) for e in asked.evidence],
        key=question.key,
    )
    with library.database.write() as session:
        record = session.get(MapRecord, map_id)
        if record is None:
            raise NotFound("the map is gone")
        known = queries.keyed(session, record, key=question.key, account_id=account_id)
        if known is not None:  # sent twice at the same time
            return known.id
        old = queries.add(session, record, row=row, most=settings.upload.queries_per_map)
        move_in(photo.path, queries.folder(library, map_id) / row.file)
    show_query.delete_files(library, old)
    return row.id


def _look(localizer: PhotoLocalizer, photo: Sent, hints: Hints) -> Answer:
    with told_as(photo.name, photo.path):
        return hinted.look(localizer, photo.path, hints=hints)


def _options(question: Question) -> dict[str, Any]:
    near = question.near
    return {
        "photos": len(question.photos),
        "top": question.top,
        "fov": question.fov_deg,
        "hint": None if near is None else {"x_px": near.x, "y_px": near.y, "radius_px": near.radius},
        "heading_deg": question.heading_deg,
        "sequence": question.sequence is not None,
    }


def _evidence_json(evidence: Evidence) -> dict[str, Any]:
    return {
        "experience": evidence.experience,
        "query_xy": _rounded(evidence.query_xy.tolist()),
        "photo_xy": _rounded(evidence.photo_xy.tolist()),
        "inlier": evidence.inlier.tolist(),
    }


def _rounded(points: Sequence[Sequence[float]]) -> list[list[float]]:
    return [[round(x, 1), round(y, 1)] for x, y in points]
