"""Filters a live sequence whose frames may be processed by different processes.

The belief of a sequence is kept in a small file in the library's folder, which expires after some minutes.
"""

from __future__ import annotations

import hashlib
import json
import time
from pathlib import Path
from typing import Any

from webapp.core.hypotheses.model import Answer
from webapp.core.hypotheses.sequence import Belief, belief_from_json, belief_to_json, filter_step
from webapp.files.atomic import write_text
from webapp.files.part_file import discard
from webapp.store.library import Library
from webapp.tasks.localize.pipeline import LocalizationPipeline
from webapp.tasks.localize.sequence import motion

MAX_AGE_S = 600.0
"""Time after its last frame at which a sequence expires."""

_FOLDER = "sequences"
_FORMAT = 2
"""Format of the file; a file of another format restarts the sequence."""


def state_file(library: Library, *, account_id: int, map_id: int, id: str) -> Path:
    """Return the file of a sequence, and delete expired files.

    Args:
        account_id: Owner of the sequence; the ids of different accounts are independent.
        id: Chosen by the client.
    """
    folder = library.inner / _FOLDER
    folder.mkdir(exist_ok=True)
    for old in folder.iterdir():
        if not _fresh(old):
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
    known = _read(file)
    same = (known.get("format"), known.get("map")) == (_FORMAT, pipeline.map_hash)
    belief = belief_from_json(known["belief"]) if same else Belief()
    belief, joined = filter_step(belief, answer, motion=motion(pipeline), top=top)
    now = {"format": _FORMAT, "map": pipeline.map_hash, "belief": belief_to_json(belief)}
    write_text(file, json.dumps(now))
    return pipeline.limit_accuracy(joined)


def _read(file: Path) -> dict[str, Any]:
    if not _fresh(file):
        return {}
    try:
        known: dict[str, Any] = json.loads(file.read_text("utf-8"))
    except FileNotFoundError:
        return {}
    return known


def _fresh(file: Path) -> bool:
    try:
        return time.time() - file.stat().st_mtime <= MAX_AGE_S
    except FileNotFoundError:
        return False
