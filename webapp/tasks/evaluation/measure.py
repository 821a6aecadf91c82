"""Localizes photos with known positions, in this process or on Dask."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

from webapp.core.evaluation.metrics import QueryResult
from webapp.errors import PhotoError
from webapp.files.localize.calibration import StoredCalibration
from webapp.progress import Progress
from webapp.tasks.computing.in_order import ExecutionTarget, in_order
from webapp.tasks.evaluation.types import Localize
from webapp.tasks.localize import geometry, orient_map
from webapp.tasks.localize.open_index import MapSource, RebuiltValue
from webapp.tasks.localize.pipeline import LocalizationPipeline, Look


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

    Raises Cancelled, ProcessLost, ClusterUnavailable, UsageError, MissingPart.
    """
    at = ExecutionTarget(pipeline.settings, pipeline.opened.writable)
    first = pipeline.looks[0]
    if first.around is not None or first.opened.method == "vote":
        at = at.on_this_machine()  # landmarks made on demand are reused for the following photos
    files = [
        _LookFiles(MapSource.of(look.opened), look.calibration, look.sightings is not None)
        for look in pipeline.looks
    ]
    again = RebuiltValue(partial(_open_again, replace(pipeline, looks=()), files), pipeline)
    absolute = [trial._replace(photo=trial.photo.absolute()) for trial in trials]
    return in_order(_measure, absolute, shared=(again, top), at=at, progress=progress)


def _measure(shared: tuple[RebuiltValue[LocalizationPipeline], int], trial: QueryTrial) -> QueryResult:
    pipeline, top = shared
    return measure(pipeline.value().localize, trial, top=top)


class _LookFiles(NamedTuple):
    """All that a Dask worker needs to open a look again."""

    files: MapSource
    calibration: StoredCalibration | None
    hides: bool

    def open(self) -> Look:
        opened = geometry.prepare_geometry(self.files.open(), progress=Progress())
        look = Look(opened, self.calibration)
        return _with_sightings(look) if self.hides else look


def _open_again(pipeline: LocalizationPipeline, files: Sequence[_LookFiles]) -> LocalizationPipeline:
    """Open the looks of a pipeline that has none; raises the same errors as `MapSource.open`."""
    return replace(pipeline, looks=tuple(look.open() for look in files))


def with_hidden_photos(pipeline: LocalizationPipeline) -> LocalizationPipeline:
    """Prepare a pipeline for queries from its own map, which are hidden: depths are computed without them.

    Raises StorageError.
    """
    return replace(pipeline, looks=tuple(map(_with_sightings, pipeline.looks)))


def _with_sightings(look: Look) -> Look:
    if look.calibration is None:
        return look
    return replace(look, sightings=orient_map.sightings(look.opened))
