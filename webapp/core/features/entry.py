"""What a kind of features consists of; all other parts of the program learn it from here."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

from webapp.core.features.types import Extractor


@dataclass(frozen=True, slots=True)
class ModelFile:
    name: str  # File name
    bytes: int  # Size; 0 for a file that the user supplies
    sha256: str  # Empty for a file that the user supplies: any file of this name is accepted
    licence: str
    source: str  # Origin, in words
    address: str  # URL to fetch it from; empty for a file that can only be copied from a folder

    @property
    def published(self) -> bool:
        """Whether it is a specific file; otherwise the user supplies it."""
        return bool(self.sha256)


def supplied_file(name: str, source: str) -> ModelFile:
    return ModelFile(name, bytes=0, sha256="", licence="", source=source, address="")


@dataclass(frozen=True, slots=True)
class ModelEntry:
    """A network in an ONNX file."""

    name: str
    """As in `expmap models list`."""
    files: tuple[ModelFile, ...]
    """Files with the same weights, any one of which is enough. The first is the one to fetch."""
    load: Callable[[bytes, str], Any]
    """Makes the network from the content and the name of a file."""


@dataclass(frozen=True, slots=True)
class FeatureEntry:
    """Features that can be selected by name."""

    name: str
    """Up to its first hyphen, the name of the features whose keypoints it usually describes: `sift-plain`."""
    make: Callable[..., Extractor]
    """Makes the extractor; it takes the network, if there is one."""
    other_names: tuple[str, ...] = ()
    """In lower case, letters and digits only."""
    model: ModelEntry | None = None
    """The network that it needs, under the name of the features."""
    pair_matcher: ModelEntry | None = None
    """A network that matches the features of two photos, for `thorough` and the second look of `auto`."""
    own_keypoints: bool = False
    """It describes only its own keypoints."""
    pairs_of_bits: bool = False
    """Only `hamming2` can compare its descriptors; it is not offered as `--features`."""
    enlarges_small: bool = False
    """Small photos are enlarged first."""

    @property
    def detector(self) -> str:
        """Name of the features whose keypoints it usually describes."""
        return self.name.partition("-")[0]
