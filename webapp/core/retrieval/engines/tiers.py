"""Choice of the search engine by the memory limit of an index."""

from __future__ import annotations

from webapp.core.features.types import Engine, Kind

_BYTES_A_ROW = 20
"""Bytes per keypoint: its number in the inverted lists (8), position and orientation (12)."""

_WHOLE_BELOW = 20_000
"""Below this number of descriptors they are stored uncompressed: a product quantizer would not pay."""


def is_uncompressed(descriptors: int, *, kind: Kind) -> bool:
    """Decide whether an index of this many descriptors stores them uncompressed; always for binary ones."""
    return kind == "binary" or descriptors < _WHOLE_BELOW


def bytes_in_memory(descriptors: int, *, width: int, kind: Kind) -> int:
    """Estimate the memory of an inverted file from its number of descriptors.

    Args:
        width: Bytes of a descriptor, which a product quantizer reduces to a quarter.
        kind: "float" or "binary"
    """
    kept = width if is_uncompressed(descriptors, kind=kind) else width // 4
    return descriptors * (kept + _BYTES_A_ROW)


def tier_for(descriptors: int, *, width: int, kind: Kind, memory_mb: float) -> Engine:
    """Choose the inverted file if it fits into a memory limit, megabytes (10^6 bytes), else signatures.

    Binary descriptors have no signatures: for them it is always the inverted file.
    """
    fits = bytes_in_memory(descriptors, width=width, kind=kind) <= memory_mb * 1e6
    return "ivf" if fits or kind == "binary" else "vlad"
