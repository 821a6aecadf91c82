"""Features of photos on disk: one photo (while an index is built), or a segment of many."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from webapp.core.retrieval.engines.types import PhotoEntry, Segment
from webapp.core.retrieval.engines.vlad import Codebook
from webapp.errors import IndexDamaged
from webapp.files.localize.arrays import REPAIR, read_arrays, write_arrays

_LARGE = ("xy", "size", "angle", "descriptors")

_ONE_FOR_ALL = {"size": "one_size", "angle": "one_angle"}
"""Arrays of which a single value is stored, under another name, if all are equal: networks give keypoints one
size and no angle."""


def write_segment(path: Path, entries: Sequence[PhotoEntry]) -> str:
    """Write photos to a segment file.

    Args:
        path: May contain `{hash}`, see `write_arrays`.
        entries: At least one.

    Returns:
        First 16 characters of the content's SHA-256.
    """
    features = [e.features for e in entries]
    arrays: dict[str, NDArray[Any]] = {
        "first": np.cumsum([0, *(len(f) for f in features)], dtype=np.int64),
        "xy": np.concatenate([f.xy for f in features]),
        "size": np.concatenate([f.size for f in features]),
        "angle": np.concatenate([f.angle for f in features]),
        "descriptors": np.concatenate([f.descriptors for f in features]),
        "photo_size": np.array([f.photo_size for f in features], np.int32),
        "fov_deg": np.array([e.fov_deg for e in entries], np.float64),
    }
    for name, one in _ONE_FOR_ALL.items():
        if len(arrays[name]) and (arrays[name] == arrays[name][0]).all():
            arrays[one] = arrays.pop(name)[:1]
    return write_arrays(path, arrays, meta={"content": [e.content for e in entries]})


def read_segment(
    path: Path, *, mapped: bool = True, in_file: bool = False, verify: bool | None = None
) -> Segment:
    """Open a segment file: memory-mapped, or in memory if there are many small ones.

    With `in_file`, the arrays of keypoints stay in the file and are read on demand: the pages of a memory map
    would stay in memory. With `verify`, checksums are compared, as in `read_arrays`. Raises IndexDamaged.
    """
    arrays, meta = read_arrays(path, mapped=mapped, in_file=_LARGE if in_file else (), verify=verify)
    try:
        for name, one in _ONE_FOR_ALL.items():
            if one in arrays:
                arrays[name] = np.broadcast_to(arrays.pop(one), len(arrays["xy"]))
        segment = Segment(content=[str(c) for c in meta["content"]], **arrays)
    except (KeyError, TypeError, ValueError) as error:
        raise _damaged(path) from error
    if not _consistent(segment):
        raise _damaged(path)
    return segment


def _damaged(path: Path) -> IndexDamaged:
    return IndexDamaged("it does not hold features", where=str(path), hint=REPAIR)


def _consistent(segment: Segment) -> bool:
    photos, rows = len(segment.content), len(segment.xy)
    first = segment.first
    return (
        segment.xy.shape == (rows, 2)
        and segment.descriptors.ndim == 2
        and len(segment.descriptors) == len(segment.size) == len(segment.angle) == rows
        and segment.photo_size.shape == (photos, 2)
        and segment.fov_deg.shape == (photos,)
        and first.shape == (photos + 1,)
        and bool(first[0] == 0 and first[-1] == rows and (np.diff(first) >= 0).all())
    )


def write_codebook(path: Path, codebook: Codebook) -> str:
    """Write a codebook atomically; `{hash}` in the name becomes its hash, which is returned."""
    return write_arrays(path, {"centres": codebook.centres, "mean": codebook.mean}, meta={})


def read_codebook(path: Path) -> Codebook:
    """Read a codebook into memory. Raises IndexDamaged."""
    arrays, _ = read_arrays(path, mapped=False)
    centres, mean = arrays.get("centres"), arrays.get("mean")
    if centres is None or mean is None or centres.ndim != 2 or centres.shape != mean.shape:
        raise IndexDamaged("it does not hold a codebook", where=str(path), hint=REPAIR)
    return Codebook(centres, mean)


def write_signatures(path: Path, signatures: NDArray[np.uint8]) -> str:
    """Write (p, b) signatures; return the hash of the file's content."""
    return write_arrays(path, {"signatures": signatures}, meta={})


def read_signatures(path: Path, codebook: Codebook, *, verify: bool = False) -> NDArray[np.uint8]:
    """Open (p, b) signatures as a memory map; with `verify`, checksums are compared, as in `read_arrays`.

    Raises IndexDamaged.
    """
    signatures = read_arrays(path, verify=verify)[0].get("signatures")
    if signatures is None or signatures.shape[1:] != (codebook.signature_bytes,):
        raise IndexDamaged("it does not hold signatures of this codebook", where=str(path), hint=REPAIR)
    return signatures
