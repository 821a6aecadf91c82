"""The filter over a sequence whose frames come one by one, to whichever process answers.

The belief about a sequence is a small file in the library's folder, which expires after some minutes.
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
"""So long after its last frame a sequence is known."""

_FOLDER = "sequences"
_FORMAT = 2
"""Of the file; one of another starts the sequence over."""


def state_file(library: Library, *, account_id: int, map_id: int, id: str) -> Path:
    """Name the file of a sequence, and delete those that are old.

    Parameters
    ----------
    account_id : int
        Whose sequence it is: nobody else's id names it.
    id : str
        Chosen by who asks.
    """
    folder = library.inner / _FOLDER
    folder.mkdir(exist_ok=True)
    for old in folder.iterdir():
        if not _fresh(old):
            discard(old)
    name = hashlib.sha256(f"{account_id}/{map_id}/{id}".encode()).hexdigest()
    return folder / f"{name[:32]}.json"


def filter_frame(file: Path, answer: Answer, *, pipeline: LocalizationPipeline, top: int) -> Answer:
    """Join the answer about the next frame with what is known.

    Parameters
    ----------
    file : Path
        Of the sequence; it is overwritten. Without one a sequence starts.
    answer : Answer
        About the frame alone.
    pipeline : LocalizationPipeline
        What gave it. The sequence starts over when the map has changed since.
    top : int
        Maximum number of hypotheses.

    Raises
    ------
    StorageError
        The file cannot be written.
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
