"""Inverted file with compressed descriptors: the engine for maps of any size.

A codebook (k-means cells, and a product quantizer for float descriptors) is trained once on a sample;
immutable segments contain the codes of photos added since. All segments share the codebook, so that a query
is assigned to cells only once. Jégou et al. 2011; 4-bit codes: André et al. 2017, by Faiss.
"""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import faiss
import numpy as np
from numpy.typing import NDArray

from webapp.core.features.types import Kind
from webapp.core.retrieval.engines.types import Neighbours, is_uncompressed, merge_nearest, no_neighbours

SAMPLE_PER_CELL = 40
"""Descriptors per cell for k-means."""

_CELLS_OVER_ROOT = 4.0
_MOST_CELLS = 65_536
_PROBES = 4
_PROBES_WHEN_SMALL = 16
_FEW_CELLS = 256
"""Cells searched per descriptor, on large and on small maps, and maximum number of cells of small maps."""

_MANY_CELLS = 1000
_CODES, _LOOKED_AT_FOR_EACH = 32, 8
"""From this many cells on, the nearest ones are searched by 4-bit codes, and a multiple of the number wanted
is compared exactly: this finds .997 of the nearest four for SIFT and XFeat in .6 of the time."""

_PROBES_BINARY = 48
"""Cells of bit strings have irregular borders: searching few cells misses half of the nearest neighbours."""


def cells_for(descriptors: int) -> int:
    cells = int(_CELLS_OVER_ROOT * descriptors**0.5)
    return max(1, min(cells, descriptors // SAMPLE_PER_CELL, _MOST_CELLS))


def train(sample: NDArray[np.uint8], descriptors: int, *, kind: Kind) -> Any:
    """Train an empty index.

    Args:
        sample: (n, d) uint8. Sample of the map's descriptors; `SAMPLE_PER_CELL * cells_for(descriptors)` are
            enough.
        descriptors: Number of descriptors of the map.
        kind: "float" or "binary"
    """
    cells, width = cells_for(descriptors), sample.shape[1]
    if kind == "binary":
        binary = faiss.index_binary_factory(8 * width, f"BIVF{cells}")
        binary.train(np.ascontiguousarray(sample))
        return binary
    whole = is_uncompressed(descriptors, kind=kind)
    codes = "SQ8_direct" if whole else f"PQ{width // 2}x4fs"
    index: Any = faiss.index_factory(width, f"IVF{cells},{codes}")
    if whole:
        index.by_residual = False  # a byte can store a component, but not its difference to a cell's centre
    index.cp.seed = 1
    index.cp.min_points_per_centroid = 1
    index.cp.max_points_per_centroid = SAMPLE_PER_CELL
    index.train(sample.astype(np.float32))
    return index


def encode(codebook: Any, descriptors: NDArray[np.uint8]) -> None:
    """Add (n, d) uint8 descriptors, in their order, to a copy of the codebook, which is changed in place."""
    if isinstance(codebook, faiss.IndexBinary):
        codebook.add(np.ascontiguousarray(descriptors))
    else:
        codebook.add(descriptors.astype(np.float32))


def _cell_search(index: Any) -> Any:
    """Build a search over the centres of an index's cells, without a second copy of these."""
    if isinstance(index, faiss.IndexBinary) or index.nlist < _MANY_CELLS:
        return index.quantizer
    centres = index.quantizer.reconstruct_n(0, index.nlist)
    codes: Any = faiss.index_factory(index.d, f"PQ{_CODES}x4fs")
    codes.pq.cp.niter = 3  # few: rebuilt each time a map is opened, and more are hardly better
    codes.train(centres)
    codes.add(centres)
    search = faiss.IndexRefine(codes, index.quantizer)
    search.k_factor = _LOOKED_AT_FOR_EACH
    return search


class InvertedFile:
    """Search over the segments of one codebook.

    Args:
        segments: Each from `train` and `encode`; may be memory-mapped.
    """

    def __init__(self, segments: Sequence[Any]) -> None:
        self._segments = [s for s in segments if s.ntotal]
        for segment in self._segments:
            probes = _PROBES if segment.nlist > _FEW_CELLS else _PROBES_WHEN_SMALL
            if isinstance(segment, faiss.IndexBinary):
                probes = _PROBES_BINARY
            segment.nprobe = min(segment.nlist, probes)
        self._cells: Any = _cell_search(self._segments[0]) if self._segments else None

    def search(self, descriptors: NDArray[np.uint8], k: int) -> Neighbours:
        """Find approximately the k nearest map descriptors of each of (n, d) uint8 descriptors."""
        if not self._segments or not len(descriptors):
            return no_neighbours(len(descriptors), k)
        if isinstance(self._segments[0], faiss.IndexBinary):
            return self._search_binary(np.ascontiguousarray(descriptors), k)
        query = descriptors.astype(np.float32)
        to_cell, cell = self._cells.search(query, self._segments[0].nprobe)
        first, parts = 0, []
        for segment in self._segments:
            squared, row = segment.search_preassigned(query, k, cell, to_cell)
            distance = np.where(row >= 0, np.sqrt(np.maximum(squared, 0.0)), np.inf).astype(np.float32)
            parts.append(Neighbours(distance, np.where(row >= 0, row + first, -1)))
            first += segment.ntotal
        return parts[0] if len(parts) == 1 else merge_nearest(parts, k)

    def _search_binary(self, query: NDArray[np.uint8], k: int) -> Neighbours:
        first, parts = 0, []
        for segment in self._segments:
            bits, row = segment.search(query, k)
            distance = np.where(row >= 0, bits, np.inf).astype(np.float32)
            parts.append(Neighbours(distance, np.where(row >= 0, row + first, -1)))
            first += segment.ntotal
        return merge_nearest(parts, k)
