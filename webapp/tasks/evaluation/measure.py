"""Localizes photos with known positions, in this process or on Dask."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

from webapp.core.evaluation.types import QueryResult
from webapp.core.features.table import Method
from webapp.core.hypotheses.calibration import Calibration
from webapp.errors import PhotoError
from webapp.files.localize.calibration import StoredCalibration
from webapp.progress import Progress
from webapp.tasks.computing.in_order import ExecutionTarget, in_order
from webapp.tasks.evaluation.types import Localize
from webapp.tasks.localize import geometry, orient_map
from webapp.tasks.localize.open_again import MapSource, RebuiltValue
from webapp.tasks.localize.pipeline import LocalizationPipeline


class QueryTrial(NamedTuple):
    """A query without an answer, its photo, and the experience ids to hide from it."""

    query: QueryResult
    photo: Path
    hide: frozenset[int] = frozenset()


def measure(localize: Localize, trial: QueryTrial, *, top: int) -> QueryResult:
    """Localize one photo; a photo that cannot be used is a failed query."""
    try:
        answer = localize(trial.photo, top=top, hide=trial.hide)
    except PhotoError as error:
        return replace(trial.query, error=str(error))
    # Only the best photo's matches are shown later; to keep all would need too much memory.
    return replace(trial.query, answer=replace(answer, evidence=answer.evidence[:1]))


def measure_all(
    pipeline: LocalizationPipeline, trials: Sequence[QueryTrial], *, top: int, progress: Progress
) -> Iterator[QueryResult]:
    """Localize all photos; the results are in their order.

    Raises
    ------
    Cancelled, ProcessLost, ClusterUnavailable, UsageError, MissingPart
    """
    at = ExecutionTarget(pipeline.settings, pipeline.opened.writable)
    if pipeline.around is not None or pipeline.opened.method == "vote":
        at = at.on_this_machine()  # landmarks made on demand are reused for the following photos
    again = RebuiltValue(partial(PipelineFiles.open, PipelineFiles.of(pipeline)), pipeline)
    absolute = [trial._replace(photo=trial.photo.absolute()) for trial in trials]
    return in_order(_measure, absolute, shared=(again, top), at=at, progress=progress)


def _measure(shared: tuple[RebuiltValue[LocalizationPipeline], int], trial: QueryTrial) -> QueryResult:
    pipeline, top = shared
    return measure(pipeline.value().localize, trial, top=top)


@dataclass(frozen=True, slots=True)
class PipelineFiles:
    """All that a Dask worker needs to open a pipeline again."""

    files: MapSource
    calibration: StoredCalibration | None
    fov_deg: float | None
    asked: Method | None
    both: Calibration
    hides: bool
    second: PipelineFiles | None

    @classmethod
    def of(cls, pipeline: LocalizationPipeline) -> PipelineFiles:
        """Collect it from an open pipeline."""
        return cls(
            MapSource.of(pipeline.opened),
            pipeline.calibration,
            pipeline.fov_deg,
            pipeline.asked,
            pipeline.both,
            pipeline.sightings is not None,
            None if pipeline.second is None else cls.of(pipeline.second),
        )

    def open(self) -> LocalizationPipeline:
        """Open the pipeline; raises the same errors as `MapSource.open`."""
        opened = geometry.prepare_geometry(self.files.open(), progress=Progress())
        pipeline = LocalizationPipeline(
            opened,
            self.files.settings,
            self.calibration,
            self.fov_deg,
            asked=self.asked,
            second=None if self.second is None else self.second.open(),
            both=self.both,
        )
        return with_sightings(pipeline) if self.hides else pipeline


def with_hidden_photos(pipeline: LocalizationPipeline) -> LocalizationPipeline:
    """Prepare a pipeline and its second look for queries from its own map, which are hidden.

    Raises
    ------
    StorageError
    """
    second = None if pipeline.second is None else with_hidden_photos(pipeline.second)
    return with_sightings(replace(pipeline, second=second))


def with_sightings(pipeline: LocalizationPipeline) -> LocalizationPipeline:
    """Attach depth observations to one look, for depths without the hidden photos.

    Raises
    ------
    StorageError
    """
    known = pipeline.calibration
    if known is None:
        return pipeline
    return replace(pipeline, sightings=orient_map.sightings(pipeline.opened, map_fov_deg=known.map_fov_deg))
