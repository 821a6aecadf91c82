"""Signatures of photos on disk, and the codebook they are made with."""

from __future__ import annotations

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from webapp.core.retrieval.engines.vlad import Codebook
from webapp.errors import IndexDamaged
from webapp.files.localize.arrays import REPAIR, read_arrays, write_arrays


def write_codebook(path: Path, codebook: Codebook) -> str:
    """Write a codebook, whole or not at all; `{hash}` in the name becomes its hash, which is returned."""
    return write_arrays(path, {"centres": codebook.centres, "mean": codebook.mean}, meta={})


def read_codebook(path: Path) -> Codebook:
    """Read a codebook into memory.

    Raises
    ------
    IndexDamaged
    """
    arrays, _ = read_arrays(path, mapped=False)
    centres, mean = arrays.get("centres"), arrays.get("mean")
    if centres is None or mean is None or centres.ndim != 2 or centres.shape != mean.shape:
        raise IndexDamaged("it does not hold a codebook", where=str(path), hint=REPAIR)
    return Codebook(centres, mean)


def write_signatures(path: Path, signatures: NDArray[np.uint8]) -> str:
    """Write (p, b) signatures; returns the hash of what is in the file."""
    return write_arrays(path, {"signatures": signatures}, meta={})


def read_signatures(path: Path, codebook: Codebook) -> NDArray[np.uint8]:
    """Open (p, b) signatures by memory map.

    Raises
    ------
    IndexDamaged
    """
    signatures = read_arrays(path)[0].get("signatures")
    if signatures is None or signatures.shape[1:] != (codebook.signature_bytes,):
        raise IndexDamaged("it does not hold signatures of this codebook", where=str(path), hint=REPAIR)
    return signatures
