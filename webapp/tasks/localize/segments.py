"""Segments of an index: extracted photos joined, and their search data: codebook, codes or signatures."""

from __future__ import annotations

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace
from itertools import islice
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from webapp.core.features.types import Engine, Kind
from webapp.core.retrieval.engines import ivf, vlad
from webapp.core.retrieval.engines.types import PhotoEntry, Segment
from webapp.errors import IndexDamaged
from webapp.files.localize.features import (
    read_codebook,
    read_segment,
    read_signatures,
    write_codebook,
    write_segment,
    write_signatures,
)
from webapp.files.localize.index_store import (
    IndexFolder,
    Manifest,
    SegmentRecord,
    read_search_index,
    write_search_index,
)
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.computing.in_order import ExecutionTarget, in_order

_ENCODED_AT_ONCE = 65_536


class Coding(Protocol):
    """Writes the files of one search engine."""

    @property
    def engine(self) -> Engine:
        """The search engine."""

    def train(self, segments: Collection[SegmentRecord], *, total: int) -> str:
        """Write a codebook for segments that hold `total` descriptors; returns its name."""

    def encode(self, segment: str, *, codebook: str) -> str:
        """Write a segment's codes; returns their hash."""

    def holds(self, record: SegmentRecord | None, *, codebook: str) -> bool:
        """Check whether the codes of a segment, or without one the codebook, are present and intact."""


def coding_of(index: IndexFolder, engine: Engine, *, kind: Kind) -> Coding:
    return SignatureCoding(index) if engine == "vlad" else DescriptorCoding(index, kind)


@dataclass(frozen=True, slots=True)
class DescriptorCoding:
    """Inverted files with the codes of all descriptors."""

    index: IndexFolder
    kind: Kind
    engine: Engine = "ivf"

    def train(self, segments: Collection[SegmentRecord], *, total: int) -> str:
        """Write a codebook for segments that hold `total` descriptors; returns its name."""
        sample = np.concatenate(list(self._sample(segments, total=total)))
        trained = ivf.train(sample, total, kind=self.kind)
        return write_search_index(self.index.codebook_path("{hash}"), trained, kind=self.kind)

    def _sample(self, segments: Collection[SegmentRecord], *, total: int) -> Iterator[NDArray[np.uint8]]:
        """Draw the training sample: the same share of each photo, with a seed from the photo's content."""
        share = min(1.0, ivf.SAMPLE_PER_CELL * ivf.cells_for(total) / total)
        for record in segments:
            segment = read_segment(self.index.segment_path(record.name))
            for photo, content in enumerate(segment.content):
                descriptors = segment.entry(photo).features.descriptors
                rng = np.random.default_rng(int(content[:16], 16))
                # Rounded up, so that a sample is never too small and no photo with features is left out.
                count = min(len(descriptors), int(np.ceil(share * len(descriptors))))
                yield descriptors[np.sort(rng.choice(len(descriptors), count, replace=False))]

    def encode(self, segment: str, *, codebook: str) -> str:
        """Write a segment's codes; returns their hash."""
        codes = read_search_index(self.index.codebook_path(codebook), self.kind, mapped=False)
        descriptors = read_segment(self.index.segment_path(segment)).descriptors
        for start in range(0, len(descriptors), _ENCODED_AT_ONCE):
            ivf.encode(codes, np.asarray(descriptors[start : start + _ENCODED_AT_ONCE]))
        path = self.index.codes_path(segment, codebook=codebook, engine=self.engine)
        return write_search_index(path, codes, kind=self.kind)

    def holds(self, record: SegmentRecord | None, *, codebook: str) -> bool:
        """Check whether the codes of a segment, or without one the codebook, are present and intact."""
        path, rows, digest = self.index.codebook_path(codebook), 0, codebook
        if record is not None:
            path = self.index.codes_path(record.name, codebook=codebook, engine=self.engine)
            rows, digest = record.descriptors, record.codes
        try:
            return bool(read_search_index(path, self.kind, digest=digest).ntotal == rows)
        except IndexDamaged:
            return False


@dataclass(frozen=True, slots=True)
class SignatureCoding:
    """One signature per photo."""

    index: IndexFolder
    engine: Engine = "vlad"

    def train(self, segments: Collection[SegmentRecord], *, total: int) -> str:
        """Write a codebook for segments that hold `total` descriptors; returns its name."""
        opened = [read_segment(self.index.segment_path(record.name)) for record in segments]
        every = [(c, s, i) for s in opened for i, c in enumerate(s.content) if s.first[i] < s.first[i + 1]]
        # Photos of a map are ordered along a walk; the order of their hashes is random over the map.
        chosen = sorted(every, key=lambda photo: photo[0])[: vlad.SAMPLE_PHOTOS]
        photos = [np.asarray(s.entry(i).features.descriptors) for _, s, i in chosen]
        return write_codebook(self.index.codebook_path("{hash}"), vlad.train(photos))

    def encode(self, segment: str, *, codebook: str) -> str:
        """Write a segment's codes; returns their hash."""
        known = read_codebook(self.index.codebook_path(codebook))
        photos = read_segment(self.index.segment_path(segment))
        signatures = [
            vlad.signature(known, photos.descriptors[first:stop])
            for first, stop in zip(photos.first[:-1], photos.first[1:], strict=True)
        ]
        return write_signatures(
            self.index.codes_path(segment, codebook=codebook, engine=self.engine), np.array(signatures)
        )

    def holds(self, record: SegmentRecord | None, *, codebook: str) -> bool:
        """Check whether the codes of a segment, or without one the codebook, are present and intact."""
        try:
            known = read_codebook(self.index.codebook_path(codebook))
            if record is None:
                return True
            path = self.index.codes_path(record.name, codebook=codebook, engine=self.engine)
            return len(read_signatures(path, known, verify=True)) == record.photos
        except IndexDamaged:
            return False


PHOTOS_PER_SEGMENT = 1000
"""Number of photos joined at once, which bounds the memory of a build."""

_MOST_SMALL = 16
"""If more segments than this have less than half of `PHOTOS_PER_SEGMENT`, they are merged."""

_MOST_DEAD = 0.3
"""A segment is rewritten if more than this share of its photos is no longer in the map."""

_RETRAIN_GROWTH = 4
"""Growth factor of the number of descriptors beyond which the codebook is retrained."""


def intact(index: IndexFolder, manifest: Manifest, *, coding: Coding) -> Manifest:
    """Return a manifest without the entries whose files are missing or damaged, for `join` to rebuild.

    Args:
        coding: Coding of the engine that the index should have.

    Returns:
        Equal to `manifest` if no file is missing or damaged.
    """
    codebook = manifest.codebook if manifest.engine == coding.engine else ""
    if codebook and not coding.holds(None, codebook=codebook):
        codebook = ""
    kept: list[SegmentRecord] = []
    held: set[str] = set()
    for record in manifest.segments:
        try:
            held.update(read_segment(index.segment_path(record.name), verify=True).content)
        except IndexDamaged:
            continue
        whole = codebook and coding.holds(record, codebook=codebook)
        kept.append(record if whole else replace(record, codes=""))
    photos = {i: p for i, p in manifest.photos.items() if not p.content or p.content in held}
    return replace(manifest, segments=tuple(kept), photos=photos, codebook=codebook, engine=coding.engine)


def join(
    index: IndexFolder, manifest: Manifest, *, coding: Coding, settings: Settings, progress: Progress
) -> Manifest:
    """Write the segments and codes of all photos that the manifest names.

    Args:
        manifest: The wanted photos; the existing segments and codebook.

    Returns:
        With segments and codebook for these photos; their files are on disk.
    """
    wanted = {p.content: None for p in manifest.photos.values() if p.content}
    opened = {s.name: read_segment(index.segment_path(s.name)) for s in manifest.segments}
    kept = _worth_keeping(manifest.segments, opened, wanted=wanted)
    held = {c for s in kept for c in opened[s.name].content}
    entry = _Source(index, opened.values())
    missing = (c for c in wanted if c not in held)
    while chunk := list(islice(missing, PHOTOS_PER_SEGMENT)):
        progress.note("joining")
        progress.check()
        entries = [entry(c) for c in chunk]
        name = write_segment(index.segment_path("{hash}"), entries)
        kept.append(SegmentRecord(name, len(entries), sum(len(e.features) for e in entries), codes=""))
    total, at = sum(s.descriptors for s in kept), ExecutionTarget(settings, index.folder)
    if not total:
        return replace(manifest, segments=tuple(kept), codebook="", trained_for=0)
    if not manifest.codebook or total > _RETRAIN_GROWTH * manifest.trained_for:
        progress.note("training")
        (codebook,) = in_order(_train, [(kept, total)], shared=coding, at=at, progress=progress)
        kept = [replace(s, codes="") for s in kept]
        manifest = replace(manifest, codebook=codebook, trained_for=total)
    uncoded = [s.name for s in kept if not s.codes]
    found = in_order(_encode, uncoded, shared=(coding, manifest.codebook), at=at, progress=progress)
    codes = dict(zip(uncoded, found, strict=True))
    segments = (s if s.codes else replace(s, codes=codes[s.name]) for s in kept)
    return replace(manifest, segments=tuple(segments))


def _train(coding: Coding, sample: tuple[Collection[SegmentRecord], int]) -> str:
    segments, total = sample
    return coding.train(segments, total=total)


def _encode(shared: tuple[Coding, str], segment: str) -> str:
    coding, codebook = shared
    return coding.encode(segment, codebook=codebook)


def descriptors_in_map(index: IndexFolder, manifest: Manifest) -> int:
    """Count the descriptors of the photos that the manifest names."""
    wanted = {p.content for p in manifest.photos.values()}
    total = 0
    for record in manifest.segments:
        segment = read_segment(index.segment_path(record.name))
        named = [c in wanted for c in segment.content]
        total += int(np.diff(segment.first)[named].sum())
    return total


def _worth_keeping(
    records: Collection[SegmentRecord], opened: Mapping[str, Segment], *, wanted: Collection[str]
) -> list[SegmentRecord]:
    """Leave out the segments to rewrite: small ones if there are many, and ones with many removed photos."""

    def small(record: SegmentRecord) -> bool:
        return record.photos < PHOTOS_PER_SEGMENT // 2

    def sparse(record: SegmentRecord) -> bool:
        dead = sum(c not in wanted for c in opened[record.name].content)
        return dead > _MOST_DEAD * record.photos

    crowded = sum(map(small, records)) > _MOST_SMALL
    return [r for r in records if not sparse(r) and not (crowded and small(r))]


class _Source:
    """Finds a photo's features in the old segments, or else in the spool."""

    def __init__(self, index: IndexFolder, segments: Collection[Segment]) -> None:
        self._index = index
        self._place = {c: (s, i) for s in segments for i, c in enumerate(s.content)}

    def __call__(self, content: str) -> PhotoEntry:
        if content in self._place:
            segment, photo = self._place[content]
            return segment.entry(photo)
        # Not memory-mapped: a mapping keeps its file open, and the number of open files is limited.
        return read_segment(self._index.spool_path(content), mapped=False).entry(0)
