"""How a map is opened: what was requested, and the plan in which everything left open is resolved."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from webapp.core.features.table import FeatureChoice, Method, choose
from webapp.core.hypotheses.places import MapKind


@dataclass(frozen=True, slots=True)
class OpenOptions:
    """Requested options; None selects a default."""

    method: Method = "auto"
    features: str = "auto"
    detector: str | None = None
    extractor: str | None = None
    matcher: str | None = None
    index: Path | None = None
    """Folder for the indexes, instead of `derived` next to the map."""
    jobs: int | None = None
    map_fov_deg: float | None = None
    """Horizontal field of view of map photos whose EXIF does not state theirs."""
    right_within_px: float | None = None
    """Place radius, instead of the one derived from the map."""
    map_kind: MapKind | None = None
    """Kind of the map, instead of the one inferred from positions and relative poses of the photos."""
    build: bool = True
    """Update the index; if False, use the existing one unchanged."""

    @property
    def names_features(self) -> bool:
        """Whether the features were requested explicitly."""
        return self.features != "auto" or bool(self.detector or self.extractor)

    def choose(self, method: Method) -> FeatureChoice:
        """Resolve the features for a method; `auto` takes its default.

        Raises:
            UsageError: The combination is not possible.
        """
        return choose(
            method,
            features=self.features,
            detector=self.detector,
            extractor=self.extractor,
            matcher=self.matcher,
        )


@dataclass(frozen=True, slots=True)
class LookPlan:
    """How a map is opened for one look. See `OpenOptions` for the other fields."""

    method: Method
    """Not `auto`."""
    choice: FeatureChoice
    keeps_matcher: bool
    """The matcher was requested; otherwise a large map gets one that fits into memory."""
    is_second: bool
    """An installed network matches the best photos."""
    index: Path | None
    jobs: int | None
    map_fov_deg: float | None
    right_within_px: float | None
    map_kind: MapKind | None
    build: bool

    def with_kind_of(self, first: MapKind) -> LookPlan:
        """Let a second look use the kind of map that the first one determined.

        On a mixed map, each look determines the areas by itself.
        """
        return self if first == "mixed" else replace(self, map_kind=first)


@dataclass(frozen=True, slots=True)
class MapPlan:
    """How a map is opened: the requested method, and its looks."""

    method: Method
    looks: tuple[LookPlan, ...]
    """One, or for `auto` a second one with other features if their models are installed."""
    landmarks_on_demand: bool
    """Method `landmarks` on a map without landmarks: the look is `verified`."""
    budget_s: float
    """Maximum time of a second look per photo."""
