"""Joins finished photos into the segments of an index, and trains its codebook."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import replace
from itertools import islice

import numpy as np
from numpy.typing import NDArray

from webapp.core.features.types import Kind
from webapp.core.index import ivf
from webapp.core.index.segment import PhotoEntry
from webapp.files.featurefile import read_segment, write_segment
from webapp.files.indexstore import (
    IndexFolder,
    Manifest,
    SegmentRecord,
    read_search_index,
    write_search_index,
)
from webapp.progress import Progress

PHOTOS_PER_SEGMENT = 1000
"""Bounds the memory of a build: so many photos are joined at once."""

_MOST_SMALL = 16
"""More segments than this with less than half of that are joined into full ones."""

_MOST_DEAD = 0.3
"""Share of photos no longer in the map from which the rest is written anew."""

_RETRAIN_GROWTH = 4
"""A codebook trained on a map this many times smaller no longer divides it well."""


def join(index: IndexFolder, manifest: Manifest, *, kind: Kind, progress: Progress) -> Manifest:
    """Make segments and codes of all photos that the manifest names.

    Parameters
    ----------
    index : IndexFolder
    manifest : Manifest
        The photos as they should be; segments and codebook as they are.
    kind : {"float", "binary"}
    progress : Progress

    Returns
    -------
    Manifest
        With the segments and the codebook that hold those photos; their files are on disk.
    """
    wanted = list(dict.fromkeys(p.content for p in manifest.photos.values() if p.content))
    kept = [] if _worn(index, manifest, set(wanted)) else list(manifest.segments)
    held = {c for s in kept for c in read_segment(index.segment_path(s.name)).content}
    source = _Source(index, manifest)
    missing = iter([c for c in wanted if c not in held])
    while chunk := list(islice(missing, PHOTOS_PER_SEGMENT)):
        progress.check()
        entries = [source.entry(c) for c in chunk]
        name = write_segment(index.segment_path("{hash}"), entries)
        kept.append(SegmentRecord(name, len(entries), sum(len(e.features) for e in entries), codes=""))
    total = sum(s.descriptors for s in kept)
    if not total:
        return replace(manifest, segments=tuple(kept), codebook="", trained_for=0)
    if not manifest.codebook or total > _RETRAIN_GROWTH * manifest.trained_for or not manifest.segments:
        progress.note("training")
        codebook = _train(index, kept, total=total, kind=kind)
        kept = [replace(s, codes="") for s in kept]
        manifest = replace(manifest, codebook=codebook, trained_for=total)
    coded = []
    for segment in kept:
        progress.check()
        has_codes = bool(segment.codes)
        coded.append(segment if has_codes else _encode(index, segment, codebook=manifest.codebook, kind=kind))
    return replace(manifest, segments=tuple(coded))


def _worn(index: IndexFolder, manifest: Manifest, wanted: set[str]) -> bool:
    """Tell whether the segments are so many, or hold so much that is gone, that they are better rewritten."""
    held = sum(s.photos for s in manifest.segments)
    alive = sum(
        c in wanted for s in manifest.segments for c in read_segment(index.segment_path(s.name)).content
    )
    small = sum(s.photos < PHOTOS_PER_SEGMENT // 2 for s in manifest.segments)
    return small > _MOST_SMALL or held - alive > _MOST_DEAD * held


class _Source:
    """Finds a photo's features in the spool or in the old segments."""

    def __init__(self, index: IndexFolder, manifest: Manifest) -> None:
        self._index = index
        self._segments = [read_segment(index.segment_path(s.name)) for s in manifest.segments]
        self._place = {c: (s, i) for s in self._segments for i, c in enumerate(s.content)}

    def entry(self, content: str) -> PhotoEntry:
        if content in self._place:
            segment, photo = self._place[content]
            return segment.entry(photo)
        return read_segment(self._index.spool_path(content)).entry(0)


def _train(index: IndexFolder, segments: list[SegmentRecord], *, total: int, kind: Kind) -> str:
    sample = np.concatenate(list(_sample(index, segments, total)))
    return write_search_index(index.codebook_path("{hash}"), ivf.train(sample, total, kind=kind), kind=kind)


def _sample(index: IndexFolder, segments: Iterable[SegmentRecord], total: int) -> Iterator[NDArray[np.uint8]]:
    """Draw the training sample: an equal share of each photo, chosen by the photo's content alone."""
    share = min(1.0, ivf.SAMPLE_PER_CELL * ivf.cells_for(total) / total)
    for record in segments:
        segment = read_segment(index.segment_path(record.name))
        for photo, content in enumerate(segment.content):
            descriptors = segment.entry(photo).features.descriptors
            rng = np.random.default_rng(int(content[:16], 16))
            # Rounded up, so that a sample is never too small and no photo with features is left out.
            count = min(len(descriptors), int(np.ceil(share * len(descriptors))))
            yield descriptors[np.sort(rng.choice(len(descriptors), count, replace=False))]


def _encode(index: IndexFolder, segment: SegmentRecord, *, codebook: str, kind: Kind) -> SegmentRecord:
    codes = read_search_index(index.codebook_path(codebook), kind, mapped=False)
    ivf.encode(codes, np.asarray(read_segment(index.segment_path(segment.name)).descriptors))
    path = index.codes_path(segment.name, codebook)
    return replace(segment, codes=write_search_index(path, codes, kind=kind))
