"""Localizes uploaded photos on a map of the library, and stores the photo and the answer.

The belief of a live sequence, whose frames may be processed by different processes, is kept in a small file
in the library's folder, which expires after some minutes.
"""

from __future__ import annotations

import hashlib
import json
import secrets
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import partial
from pathlib import Path
from threading import BoundedSemaphore
from typing import Any, Literal

from webapp.core.hypotheses.jsonform import answer_to_json
from webapp.core.hypotheses.model import Answer, Evidence
from webapp.core.hypotheses.priors import CirclePrior
from webapp.core.hypotheses.sequence import Belief, belief_from_json, belief_to_json, filter_step
from webapp.errors import NotFound, UsageError
from webapp.files.atomic import write_text
from webapp.files.part_file import discard, move_in, sha256_of, show_file_as
from webapp.files.photos.photo import read_facts
from webapp.settings import Settings
from webapp.store import queries
from webapp.store.library import Library
from webapp.store.schema import MapRecord, QueryRecord
from webapp.tasks.localize import show_query, spot
from webapp.tasks.localize.map_cache import MapCache, OpenedMap
from webapp.tasks.localize.pipeline import LocalizationPipeline
from webapp.tasks.localize.plan import OpenOptions
from webapp.tasks.localize.sequence import motion
from webapp.tasks.localize.spot import Hints
from webapp.tasks.maps.add_photo import suffix_of, tidy_name
from webapp.threads import permit

Send = Callable[[Literal["progress", "first"], dict[str, Any]], None]
"""Sends a kind of event, and its data."""

MAX_PHOTOS = 8
"""Maximum number of photos of one spot in a request."""

_QUICK = BoundedSemaphore(2)
"""Concurrent localizations: more would only compete for the cores, and each needs memory for its photo."""

_THOROUGH = BoundedSemaphore(1)
"""Separate limit, so that other methods need not wait: a second or two per photo, and much memory."""


@dataclass(frozen=True, slots=True)
class UploadedPhoto:
    """A received file, and its original name."""

    path: Path
    name: str


@dataclass(frozen=True, slots=True)
class LocalizeRequest:
    """Photos to localize, and what is known about them."""

    photos: tuple[UploadedPhoto, ...]  # All taken at one spot
    options: OpenOptions = field(default_factory=OpenOptions)
    top: int = 5  # Maximum number of hypotheses
    fov_deg: float | None = None  # Horizontal field of view, instead of the one in EXIF
    near: CirclePrior | None = None  # Approximate position
    heading_deg: float | None = None  # Compass heading of the camera
    sequence: Path | None = None  # State file of the sequence to which this is the next frame; it is updated
    # Idempotency key of the client: the answer is stored once, however often the request is sent.
    key: str | None = None
    # Sends `progress` before each photo is compared, and `first`, the JSON form of the answer so far, before
    # a second look; the latter not in a sequence, whose state takes only final answers.
    send: Send | None = None


@dataclass(frozen=True, slots=True, eq=False)
class LocalizeResult:
    """An answer, not stored yet."""

    form: dict[str, Any]  # JSON form, as printed by `localize --json`
    evidence: tuple[Evidence, ...]
    best: int  # Index of the photo to which the evidence belongs
    opened: OpenedMap  # The map on which it was localized


def localize_uploads(cache: MapCache, map_id: int, *, request: LocalizeRequest) -> LocalizeResult:
    """Localize photos of one spot on a map of the library.

    Raises:
        PhotoError: One of them cannot be used.
        UsageError: No photo of the map is in the circle, or there are too many photos.
        NotReady, MapError, NotFound, IndexDamaged: The map cannot be opened.
        Busy: Too many other requests are being processed.
    """
    if not 1 <= len(request.photos) <= MAX_PHOTOS:
        raise UsageError(f"{len(request.photos)} photos", where="file", hint=f"send 1 to {MAX_PHOTOS}")
    for photo in request.photos:
        with show_file_as(photo.name, photo.path):
            read_facts(photo.path, limits=cache.settings.photo)
    ready = cache.get(map_id, request.options)
    pipeline = replace(ready.pipeline, fov_deg=request.fov_deg)
    hints = Hints(request.near, request.heading_deg)
    source = pipeline.answer_source(sequence=request.sequence is not None)
    source = replace(source, map_revision=ready.revision)
    name = ", ".join(photo.name for photo in request.photos)
    to_form = partial(answer_to_json, query=name, source=source)
    with permit(_THOROUGH if pipeline.method == "thorough" else _QUICK):
        include = spot.photos_in(pipeline, request.near)
        answers: list[Answer] = []

        def report(first: Answer) -> None:
            if request.send is not None and request.sequence is None:
                so_far, _ = spot.combine(pipeline, [*answers, first], hints=hints, top=request.top)
                request.send("first", to_form(so_far))

        for photo in request.photos:
            if request.send is not None:
                compared = {"photos": len(pipeline.map.experiences), "done": len(answers)}
                request.send("progress", {**compared, "total": len(request.photos)})
            with show_file_as(photo.name, photo.path):
                answers.append(pipeline.observe(photo.path, top=spot.ALL, include=include, on_first=report))
    if request.sequence is None:
        answer, best = spot.combine(pipeline, answers, hints=hints, top=request.top)
    else:
        frame, best = spot.combine_without_prior(pipeline, answers, hints=hints)
        answer = filter_frame(request.sequence, frame, pipeline=pipeline, top=request.top)
    return LocalizeResult(to_form(answer), answer.evidence, best, ready)


def store_result(
    library: Library,
    map_id: int,
    *,
    result: LocalizeResult,
    request: LocalizeRequest,
    account_id: int,
    settings: Settings,
) -> int:
    """Store an answer and its photo; of several photos, the one with the best evidence.

    Args:
        request: The file of its best photo is moved.
        account_id: Account of the requester.

    Returns:
        Id of the answer.

    Raises:
        NotFound: The map is gone.
        DiskFull, StorageError: Nothing was stored.
    """
    photo = request.photos[result.best]
    facts = read_facts(photo.path, limits=settings.photo)
    row = QueryRecord(
        account_id=account_id,
        name=tidy_name(photo.name),
        file=f"{secrets.token_hex(12)}.{suffix_of(facts)}",
        sha256=sha256_of(photo.path),
        width=facts.width,
        height=facts.height,
        options=_options(request),
        answer=result.form,
        evidence=[_evidence_json(e) for e in result.evidence],
        key=request.key,
    )
    with library.database.write() as session:
        record = session.get(MapRecord, map_id)
        if record is None:
            raise NotFound("the map was deleted")
        known = queries.keyed(session, record, key=request.key, account_id=account_id)
        if known is not None:  # the same request was sent twice
            return known.id
        old = queries.add(session, record, row=row, most=settings.upload.queries_per_map)
        move_in(photo.path, queries.folder(library, map_id) / row.file)
    show_query.delete_files(library, old)
    return row.id


def _options(request: LocalizeRequest) -> dict[str, Any]:
    near = request.near
    return {
        "photos": len(request.photos),
        "top": request.top,
        "fov": request.fov_deg,
        "hint": None if near is None else {"x_px": near.x, "y_px": near.y, "radius_px": near.radius},
        "heading_deg": request.heading_deg,
        "sequence": request.sequence is not None,
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


SEQUENCE_EXPIRES_S = 600.0
"""Time after its last frame at which a sequence expires."""

_SEQUENCES = "sequences"
_STATE_FORMAT = 2
"""Format of the file; a file of another format restarts the sequence."""


def state_file(library: Library, *, account_id: int, map_id: int, id: str) -> Path:
    """Return the file of a sequence, and delete expired files.

    Args:
        account_id: Owner of the sequence; the ids of different accounts are independent.
        id: Chosen by the client.
    """
    folder = library.inner / _SEQUENCES
    folder.mkdir(exist_ok=True)
    for old in folder.iterdir():
        if not _is_fresh(old):
            discard(old)
    name = hashlib.sha256(f"{account_id}/{map_id}/{id}".encode()).hexdigest()
    return folder / f"{name[:32]}.json"


def filter_frame(file: Path, answer: Answer, *, pipeline: LocalizationPipeline, top: int) -> Answer:
    """Update the belief of a sequence by the answer about its next frame, and return the filtered answer.

    Args:
        file: State of the sequence; it is overwritten. If it does not exist, a new sequence starts.
        answer: Answer from the frame alone.
        pipeline: Pipeline that gave the answer. The sequence restarts if the map has changed.
        top: Maximum number of hypotheses.

    Raises:
        StorageError: The file cannot be written.
    """
    known = _read_state(file)
    same = (known.get("format"), known.get("map")) == (_STATE_FORMAT, pipeline.map_hash)
    belief = belief_from_json(known["belief"]) if same else Belief()
    belief, joined = filter_step(belief, answer, motion=motion(pipeline), top=top)
    now = {"format": _STATE_FORMAT, "map": pipeline.map_hash, "belief": belief_to_json(belief)}
    write_text(file, json.dumps(now))
    return pipeline.limit_accuracy(joined)


def _read_state(file: Path) -> dict[str, Any]:
    if not _is_fresh(file):
        return {}
    try:
        known: dict[str, Any] = json.loads(file.read_text("utf-8"))
    except FileNotFoundError:
        return {}
    return known


def _is_fresh(file: Path) -> bool:
    try:
        return time.time() - file.stat().st_mtime <= SEQUENCE_EXPIRES_S
    except FileNotFoundError:
        return False
