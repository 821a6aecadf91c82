"""The global descriptors of a map's photos, stored next to its indexes: one file per model.

They refer to photos by content and do not depend on the features of an index, so that all indexes share them.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import lru_cache
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from webapp.errors import IndexDamaged, StorageError
from webapp.files.contents import facts_of
from webapp.files.localize.arrays import read_arrays, write_arrays

FORMAT = 1
"""To be increased when the vectors change their meaning."""


@dataclass(frozen=True, slots=True, eq=False)
class StoredVectors:
    contents: list[str]  # SHA-256 of the photo files
    vectors: NDArray[np.float16]  # (n, d) float16. In the same order.
    weights: str  # `GlobalDescriptor.weights` of the model


def file_name(weights: str) -> str:
    return f"global-{weights}.arrays"


def write(path: Path, stored: StoredVectors) -> None:
    """Replace the file. Raises StorageError."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise StorageError(
            f"the folder cannot be created: {error.strerror}", where=str(path.parent)
        ) from error
    meta = {"format": FORMAT, "weights": stored.weights, "contents": stored.contents}
    write_arrays(path, {"vectors": stored.vectors}, meta=meta)


def read(path: Path, *, weights: str) -> StoredVectors | None:
    """Read the file; None if it is missing, unusable or of another model, so that it is recomputed.

    An unchanged file is read once: the looks at a map share it.
    """
    seen = facts_of(path)
    return None if seen is None else _read(path, weights, seen)


@lru_cache(maxsize=4)
def _read(path: Path, weights: str, seen: tuple[int, int]) -> StoredVectors | None:
    try:
        arrays, meta = read_arrays(path, mapped=False)
        stored = StoredVectors(list(meta["contents"]), arrays["vectors"], str(meta["weights"]))
        fits = meta["format"] == FORMAT and stored.weights == weights
        whole = stored.vectors.ndim == 2 and len(stored.vectors) == len(stored.contents)
        return stored if fits and whole else None
    except (IndexDamaged, KeyError, TypeError):
        return None
