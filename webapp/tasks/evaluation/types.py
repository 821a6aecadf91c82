"""Input and results of an evaluation."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

from webapp.core.evaluation.metrics import QueryResult, Row, Summary, row
from webapp.core.hypotheses.model import Answer
from webapp.core.hypotheses.places import MapKind
from webapp.core.mapmodel.model import Map

Scheme = Literal["queries", "leave-one-out", "leave-one-place-out"]


class Localize(Protocol):
    def __call__(self, photo_path: Path, *, top: int, hide: frozenset[int] = frozenset()) -> Answer:
        """Localize a photo as if the experiences `hide` were not on the map."""


class Localizer(Protocol):
    """What an evaluation needs: a method that localizes photos, and its description."""

    @property
    def method(self) -> str:
        """Name of the method."""

    @property
    def features(self) -> str:
        """Name of the features, `auto` resolved."""

    @property
    def map(self) -> Map:
        """The map that photos are localized on."""

    @property
    def map_hash(self) -> str:
        """Hash of the map's photos and positions."""

    @property
    def place_radius_px(self) -> float:
        """Largest error of a correct hypothesis, map pixels."""

    @property
    def map_kind(self) -> MapKind:
        """Kind of the map: metric, areas, schematic or mixed."""

    @property
    def build_seconds(self) -> float | None:
        """Build time of the indexes; None if unknown."""

    @property
    def calibration_seconds(self) -> float | None:
        """Duration of the calibrations; None for a method without calibration."""

    @property
    def index_bytes(self) -> int:
        """Size of the indexes on disk."""

    @property
    def localize(self) -> Localize:
        """Localizes a photo."""


@dataclass(frozen=True, slots=True)
class EvaluateOptions:
    limit: int | None = None
    """Maximum number of queries, evenly spread; None takes all."""

    top: int = 5
    """Hypotheses per query; the figures use at most the first five."""

    seed: int = 0
    """Seed of the bootstrap."""

    hide_within_px: float | None = None
    """For queries from the map itself: photos within this distance are hidden, too; 0 for equal positions."""

    sequence: bool = False
    """The queries are frames of a sequence, and each is localized with those before."""


@dataclass(frozen=True, slots=True)
class Subject:
    """What was evaluated: the properties of a `Localizer`, and the folder of its photos."""

    map_folder: Path  # Folder to which the paths of the map's photos are relative
    method: str
    features: str
    map: Map
    map_hash: str
    place_radius_px: float
    map_kind: MapKind
    build_seconds: float | None
    calibration_seconds: float | None
    index_bytes: int
    sequence: bool = False


@dataclass(frozen=True, slots=True)
class Evaluation:
    """Results and figures of an evaluation, with the conditions needed to reproduce it."""

    subject: Subject
    # "queries", "leave-one-out" or "leave-one-place-out". Photos of a list; the map's own photos, each
    # hidden; the same with all nearby photos hidden.
    scheme: Scheme
    hide_within_px: float | None  # Radius of the photos hidden in the third scheme
    query_folder: Path  # Folder to which the paths of the queries are relative
    results: tuple[QueryResult, ...]
    summary: Summary
    seed: int
    # Peak memory of this process, 2^20 bytes; None if the system does not report it.
    peak_rss_mb: float | None
    # Versions of Python, of the libraries that affect the results, and of this program.
    versions: dict[str, str]

    @property
    def rows(self) -> list[Row]:
        """The table of results, one row per query."""
        radius, georeference = self.subject.place_radius_px, self.subject.map.georeference
        if georeference is None:
            return [row(r, place_radius_px=radius, metres_per_pixel=None) for r in self.results]
        return [
            row(r, place_radius_px=radius, metres_per_pixel=georeference.metres_per_pixel(r.truth))
            for r in self.results
        ]
