"""What an evaluation asks for, and what it gives."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Literal, Protocol

from webapp.core.evaluation.rows import Row, row
from webapp.core.evaluation.types import QueryResult, Summary
from webapp.core.hypotheses.model import Answer
from webapp.core.hypotheses.places import MapKind
from webapp.core.mapmodel.model import Map

Scheme = Literal["queries", "leave-one-out", "leave-one-place-out"]


class Localize(Protocol):
    """Localizes one photo."""

    def __call__(self, photo_path: Path, *, top: int, hide: frozenset[int] = frozenset()) -> Answer:
        """Localize a photo as if the experiences `hide` were not on the map.

        Raises
        ------
        PhotoError
            The photo cannot be used.
        """


class Localizer(Protocol):
    """What an evaluation needs: answers, and what gave them."""

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
        """How far off a right hypothesis may be, map pixels."""

    @property
    def map_kind(self) -> MapKind:
        """What the positions of the map's photos are."""

    @property
    def build_seconds(self) -> float | None:
        """Time the index took; None where that is not known any more."""

    @property
    def calibration_seconds(self) -> float | None:
        """Time the calibration of the probabilities took; None where there is none."""

    @property
    def index_bytes(self) -> int:
        """Size of the index."""

    @property
    def localize(self) -> Localize:
        """Localizes a photo."""


@dataclass(frozen=True, slots=True)
class EvaluateOptions:
    """What can be chosen about an evaluation."""

    limit: int | None = None
    """Maximum number of queries, evenly spread; None takes all."""

    top: int = 5
    """Hypotheses a query; the figures look at the first five."""

    seed: int = 0
    """Of the bootstrap's random numbers."""

    hide_within_px: float | None = None
    """For queries from the map itself: photos so near are hidden too; 0 hides those at the same position."""

    sequence: bool = False
    """The queries are frames of a sequence: the localizer joins each with those before."""


@dataclass(frozen=True, slots=True)
class Subject:
    """What was measured: a localizer's own facts, and where its photos are.

    Attributes
    ----------
    map_folder : Path
        What the paths of the map's photos are relative to.
    method, features, map, map_hash, place_radius_px, map_kind, build_seconds, calibration_seconds,
    index_bytes
        As `Localizer` has them.
    sequence : bool
        As `EvaluateOptions` has it.
    """

    map_folder: Path
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
    """Results and figures, and how they came about.

    Attributes
    ----------
    scheme : {"queries", "leave-one-out", "leave-one-place-out"}
        Photos of a list; the map's own, each hidden; the same with all photos near it hidden.
    hide_within_px : float or None
        How near, in the third scheme.
    query_folder : Path
        What the paths of the queries are relative to.
    peak_rss_mb : float or None
        Largest memory of this process up to the end, 2^20 bytes; None where the system does not say.
    versions : dict of str to str
        Of Python, of the libraries that decide the results, and of this program.
    """

    subject: Subject
    scheme: Scheme
    hide_within_px: float | None
    query_folder: Path
    results: tuple[QueryResult, ...]
    summary: Summary
    seed: int
    peak_rss_mb: float | None
    versions: dict[str, str]

    @property
    def rows(self) -> list[Row]:
        """The table of the experiment, one line a query."""
        radius, georeference = self.subject.place_radius_px, self.subject.map.georeference
        if georeference is None:
            return [row(r, place_radius_px=radius, metres_per_pixel=None) for r in self.results]
        return [
            row(r, place_radius_px=radius, metres_per_pixel=georeference.metres_per_pixel(r.truth))
            for r in self.results
        ]
