"""Asks a localizer about photos whose places are known, here or by Dask."""

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
from webapp.tasks.computing.in_order import Workplace, in_order
from webapp.tasks.evaluation.types import Localize
from webapp.tasks.localize import geometry, orient_map
from webapp.tasks.localize.open_again import MadeAgain, MapFiles
from webapp.tasks.localize.pipeline import LocalizationPipeline


class QueryTrial(NamedTuple):
    """A query that has no answer yet, its photo, and the ids it must be found without."""

    query: QueryResult
    photo: Path
    hide: frozenset[int] = frozenset()


def measure(localize: Localize, trial: QueryTrial, *, top: int) -> QueryResult:
    """Ask about one photo; one that cannot be used is a failed query."""
    try:
        answer = localize(trial.photo, top=top, hide=trial.hide)
    except PhotoError as error:
        return replace(trial.query, error=str(error))
    # Only the best photo's matches are shown later; those of all would fill the memory.
    return replace(trial.query, answer=replace(answer, evidence=answer.evidence[:1]))


def measure_all(
    pipeline: LocalizationPipeline, trials: Sequence[QueryTrial], *, top: int, progress: Progress
) -> Iterator[QueryResult]:
    """Ask about all photos; the results are in their order.

    Raises
    ------
    Cancelled, ProcessLost, ClusterUnavailable, UsageError, MissingPart
    """
    at = Workplace(pipeline.settings, pipeline.opened.writable)
    if pipeline.around is not None or pipeline.opened.method == "vote":
        at = at.on_this_machine()  # landmarks that are made on the way serve the next photos, too
    again = MadeAgain(partial(PipelineFiles.open, PipelineFiles.of(pipeline)), pipeline)
    absolute = [trial._replace(photo=trial.photo.absolute()) for trial in trials]
    return in_order(_measure, absolute, shared=(again, top), at=at, progress=progress)


def _measure(shared: tuple[MadeAgain[LocalizationPipeline], int], trial: QueryTrial) -> QueryResult:
    pipeline, top = shared
    return measure(pipeline.value().localize, trial, top=top)


@dataclass(frozen=True, slots=True)
class PipelineFiles:
    """What a pipeline is opened from, by a worker of Dask."""

    files: MapFiles
    calibration: StoredCalibration | None
    fov_deg: float | None
    asked: Method | None
    both: Calibration
    hides: bool
    second: PipelineFiles | None

    @classmethod
    def of(cls, pipeline: LocalizationPipeline) -> PipelineFiles:
        """Find them for a pipeline that is open."""
        return cls(
            MapFiles.of(pipeline.opened),
            pipeline.calibration,
            pipeline.fov_deg,
            pipeline.asked,
            pipeline.both,
            pipeline.sightings is not None,
            None if pipeline.second is None else cls.of(pipeline.second),
        )

    def open(self) -> LocalizationPipeline:
        """Open the pipeline; errors as `MapFiles.open`."""
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
    """Prepare a pipeline for the photos of its own map, which are hidden in turn.

    Raises
    ------
    StorageError
    """
    second = None if pipeline.second is None else with_hidden_photos(pipeline.second)
    return with_sightings(replace(pipeline, second=second))


def with_sightings(pipeline: LocalizationPipeline) -> LocalizationPipeline:
    """Prepare one look for that.

    Raises
    ------
    StorageError
    """
    known = pipeline.calibration
    if known is None:
        return pipeline
    return replace(pipeline, sightings=orient_map.sightings(pipeline.opened, map_fov_deg=known.map_fov_deg))
