"""The list of answers' photos that people have added to a map: real queries with known places."""

from __future__ import annotations

import json
from collections.abc import Sequence
from pathlib import Path
from typing import NamedTuple

from webapp.errors import StorageError
from webapp.files import atomic
from webapp.files.listing import DERIVED


class AdoptedPhoto(NamedTuple):
    """A photo that was a query before it became one of the map."""

    id: int
    newer: int
    """Photos from this id on were added after it had been localized."""


def path(cfg: Path) -> Path:
    """Return the file of a map's list."""
    return cfg.parent / DERIVED / f"{cfg.stem}.adopted.json"


def write(cfg: Path, photos: Sequence[AdoptedPhoto]) -> None:
    """Replace the list, unless it is the same. Raises StorageError."""
    if tuple(photos) != read(cfg):
        atomic.write_text(path(cfg), json.dumps(photos))


def read(cfg: Path) -> tuple[AdoptedPhoto, ...]:
    """Read the list; empty for a map that has none, as outside of a library. Raises StorageError."""
    try:
        return tuple(AdoptedPhoto(int(id), int(newer)) for id, newer in json.loads(path(cfg).read_text()))
    except FileNotFoundError:
        return ()
    except (OSError, ValueError, TypeError) as error:
        hint = "delete it: the next build of the index writes it again"
        raise StorageError(
            "the list of adopted photos cannot be read", where=str(path(cfg)), hint=hint
        ) from error
