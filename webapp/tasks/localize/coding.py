"""Search data of an index: codes of all descriptors, or one signature per photo."""

from __future__ import annotations

from collections.abc import Collection, Iterator
from dataclasses import dataclass
from typing import Protocol

import numpy as np
from numpy.typing import NDArray

from webapp.core.features.types import Engine, Kind
from webapp.core.retrieval.engines import ivf, vlad
from webapp.errors import IndexDamaged
from webapp.files.localize.features import (
    read_codebook,
    read_segment,
    read_signatures,
    write_codebook,
    write_signatures,
)
from webapp.files.localize.index_store import (
    IndexFolder,
    SegmentRecord,
    read_search_index,
    write_search_index,
)

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
