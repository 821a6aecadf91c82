"""Localizes photos with known positions, and evaluates the answers."""

from __future__ import annotations

import math
import platform
import sys
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import faiss
import numpy as np

from webapp import __version__
from webapp.core.evaluation.metrics import WITHIN_PX, QueryResult, summarise
from webapp.core.geo.georeference import Georeference
from webapp.core.geo.local import LocalFrame
from webapp.core.geo.types import MapPixel
from webapp.core.hypotheses.jsonform import answer_to_json, failure_to_json
from webapp.core.hypotheses.model import AnswerSource
from webapp.core.mapmodel.model import Experience, Map
from webapp.errors import PhotoError, UsageError
from webapp.files.exchange.tum import PlanarPose
from webapp.files.localize import queries_csv
from webapp.files.localize.calibration import StoredCalibration
from webapp.progress import Progress
from webapp.tasks.computing.in_order import ExecutionTarget, in_order
from webapp.tasks.evaluation.types import (
    EvaluateOptions,
    Evaluation,
    Localize,
    Localizer,
    Scheme,
    Subject,
)
from webapp.tasks.localize import geometry, orient_map
from webapp.tasks.localize.open_index import MapSource, RebuiltValue
from webapp.tasks.localize.pipeline import LocalizationPipeline, Look


def evaluate_queries(
    localizer: Localizer,
    queries: Path,
    *,
    map_folder: Path,
    localize: Localize | None = None,
    options: EvaluateOptions | None = None,
    progress: Progress | None = None,
) -> Evaluation:
    """Evaluate on a list of photos with known positions.

    Args:
        map_folder: Folder to which the map's paths are relative.
        localize: Used instead of the localizer's own method, such as a filter over a sequence.

    Returns:
        A photo that cannot be used counts as a failed query.

    Raises:
        TableError: The list is invalid.
        Cancelled: The user stopped it; nothing is kept.
    """
    options, progress = options or EvaluateOptions(), progress or Progress()
    trials = [
        QueryTrial(QueryResult(query.name, query.truth, None), query.path)
        for query in queries_csv.select(queries_csv.read(queries), options.limit)
    ]
    progress.size(len(trials))
    measured = _measure(trials, localizer, localize=localize, top=options.top, progress=progress)
    results = [*measured]
    return _evaluation(
        localizer, results, map_folder=map_folder, query_folder=queries.parent, options=options
    )


def evaluate_self(
    localizer: Localizer,
    *,
    map_folder: Path,
    options: EvaluateOptions | None = None,
    progress: Progress | None = None,
) -> list[Evaluation]:
    """Evaluate on the map's own photos, each hidden from the map.

    Returns:
        One with `hide_within_px`. By default two: with only the photo itself hidden (leave-one-out), and with
            all photos within the place radius of it hidden (leave-one-place-out).

    Raises:
        UsageError: The map has no photos.
        Cancelled: The user stopped it; nothing is kept.
    """
    options, progress = options or EvaluateOptions(), progress or Progress()
    chosen = queries_csv.select(localizer.map.experiences, options.limit)
    if not chosen:
        raise UsageError("the map has no photos to evaluate on", hint="place photos on it first")
    given = options.hide_within_px
    schemes: list[tuple[Scheme, float | None]] = [("leave-one-out", None)] if given is None else []
    schemes.append(("leave-one-place-out", localizer.place_radius_px if given is None else given))
    progress.size(len(chosen) * len(schemes))
    evaluations = []
    for scheme, within in schemes:
        progress.note(scheme)
        trials = [
            QueryTrial(
                QueryResult(
                    own.photo,
                    own.position,
                    None,
                    truth_heading_deg=own.heading_deg,
                    truth_floor=own.floor,
                ),
                map_folder / own.photo,
                hidden(localizer.map, own, within_px=within),
            )
            for own in chosen
        ]
        results = [*_measure(trials, localizer, localize=None, top=options.top, progress=progress)]
        done = _evaluation(
            localizer, results, map_folder=map_folder, query_folder=map_folder, options=options
        )
        evaluations.append(replace(done, scheme=scheme, hide_within_px=within))
    return evaluations


def hidden(themap: Map, own: Experience, *, within_px: float | None) -> frozenset[int]:
    """Return the ids to hide when a map's own photo is the query: itself, and those within `within_px`."""
    if within_px is None:
        return frozenset({own.id})
    return frozenset(e.id for e in themap.experiences if math.dist(e.position, own.position) <= within_px)


def to_json(evaluation: Evaluation) -> dict[str, Any]:
    """Make the object that `evaluate --json` prints.

    Returns:
        Plain values only; None if unknown.
    """
    subject, summary = evaluation.subject, evaluation.summary
    source = AnswerSource(
        subject.method,
        subject.features,
        subject.map.georeference,
        subject.map.revision,
        map_kind=subject.map_kind,
        place_radius_px=subject.place_radius_px,
        sequence=subject.sequence,
        floors=subject.map.floors,
    )
    return {
        "method": subject.method,
        "features": subject.features,
        "scheme": evaluation.scheme,
        "hide_within_px": evaluation.hide_within_px,
        "sequence": subject.sequence,
        "map_photos": len(subject.map.experiences),
        "map_revision": subject.map.revision,
        "queries": summary.queries,
        "failed": summary.failed,
        "abstained": summary.abstained,
        "second_looks": summary.second_looks,
        "map_kind": subject.map_kind,
        "place_radius_px": subject.place_radius_px,
        "median_px": summary.median_px,
        "mean_px": summary.mean_px,
        **{f"within_{radius}px": summary.within[radius] for radius in WITHIN_PX},
        "top5_within_50px": summary.top5_within_50px,
        "ece": summary.ece,
        "radius_coverage": summary.radius_coverage,
        "answered_at_99_precision": summary.answered_at_99_precision,
        "intervals_95": {name: list(interval) for name, interval in summary.intervals.items()},
        "grades": dict(summary.grades),
        "build_seconds": subject.build_seconds,
        "calibration_seconds": subject.calibration_seconds,
        "index_bytes": subject.index_bytes,
        "peak_rss_mb": evaluation.peak_rss_mb,
        "seconds_per_query_p50": summary.seconds_per_query_p50,
        "seconds_per_query_p95": summary.seconds_per_query_p95,
        "extract_seconds_p50": summary.extract_seconds_p50,
        "match_seconds_p50": summary.match_seconds_p50,
        "seed": evaluation.seed,
        "versions": evaluation.versions,
        "map_hash": subject.map_hash,
        "per_query": [_query_to_json(result, source) for result in evaluation.results],
    }


def _query_to_json(result: QueryResult, source: AnswerSource) -> dict[str, Any]:
    return {
        "path": result.path,
        "truth": {"x_px": result.truth.x, "y_px": result.truth.y},
        "error_px": result.error_px,
        "answer": failure_to_json(query=result.path, error=result.error or "")
        if result.answer is None
        else answer_to_json(result.answer, query=result.path, source=source),
    }


def _measure(
    trials: Sequence[QueryTrial],
    localizer: Localizer,
    *,
    localize: Localize | None,
    top: int,
    progress: Progress,
) -> Iterator[QueryResult]:
    """Localize all photos, on Dask if configured and the answers are independent of each other."""
    if localize is None and isinstance(localizer, LocalizationPipeline):
        found = measure_all(localizer, trials, top=top, progress=progress)
    else:
        found = (measure(localize or localizer.localize, trial, top=top) for trial in trials)
    progress.check()
    for result in found:
        yield result
        progress.advance()
        progress.check()


def _evaluation(
    localizer: Localizer,
    results: Sequence[QueryResult],
    *,
    map_folder: Path,
    query_folder: Path,
    options: EvaluateOptions,
) -> Evaluation:
    subject = Subject(
        map_folder=map_folder,
        method=localizer.method,
        features=localizer.features,
        map=localizer.map,
        map_hash=localizer.map_hash,
        place_radius_px=localizer.place_radius_px,
        map_kind=localizer.map_kind,
        build_seconds=localizer.build_seconds,
        calibration_seconds=localizer.calibration_seconds,
        index_bytes=localizer.index_bytes,
        sequence=options.sequence,
    )
    rng = np.random.default_rng(options.seed)
    return Evaluation(
        subject=subject,
        scheme="queries",
        hide_within_px=None,
        query_folder=query_folder,
        results=tuple(results),
        summary=summarise(results, place_radius_px=subject.place_radius_px, rng=rng),
        seed=options.seed,
        peak_rss_mb=peak_rss_mb(),
        versions=versions(),
    )


def peak_rss_mb() -> float | None:
    """Return the peak resident memory of this process, MiB; None on Windows."""
    if sys.platform == "win32":
        return None
    import resource

    unit = 1 if sys.platform == "darwin" else 1024
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss * unit / 2**20


def versions() -> dict[str, str]:
    """Return the versions of the software that determines the results."""
    return {
        "python": platform.python_version(),
        "numpy": np.__version__,
        "opencv": cv2.__version__,
        "faiss": faiss.__version__,
        "experience-map": __version__,
    }


_Sight = tuple[int, MapPixel, float | None]


@dataclass(frozen=True, slots=True)
class Trajectories:
    """Estimated and true poses, with the number of the query as timestamp."""

    estimate: list[PlanarPose]  # Poses of the first hypotheses; queries without one are left out
    truth: list[PlanarPose]
    frame: str  # Description of axes and units, for people


def trajectories(results: Iterable[QueryResult], themap: Map) -> Trajectories:
    """Convert the first hypotheses and the truth to a common frame.

    With a georeference: metres east (x) and north (y) of the first true position; without one: map pixels, x
    to the right and y down. Yaw is from x towards y in both.
    """
    found: list[_Sight] = []
    true: list[_Sight] = []
    for number, result in enumerate(results):
        true.append((number, result.truth, result.truth_heading_deg))
        hypotheses = () if result.answer is None else result.answer.hypotheses[:1]
        found.extend((number, first.position, first.heading_deg) for first in hypotheses)
    if themap.georeference is None:
        frame = "map pixels: x to the right, y down; yaw from x towards y"
        return Trajectories([_in_pixels(s) for s in found], [_in_pixels(s) for s in true], frame)
    origins = [themap.georeference.latlon_of(position) for _, position, _ in true]
    origin = next((one for one in origins if math.isfinite(one.lat)), None)
    if origin is None:
        return Trajectories([], [], "no query has a place on the ground")
    local = LocalFrame(origin)
    frame = f"metres east (x) and north (y) of {origin.lat:.8f}, {origin.lon:.8f}; yaw from x towards y"
    return Trajectories(
        _in_metres(found, themap.georeference, local), _in_metres(true, themap.georeference, local), frame
    )


def _in_pixels(sight: _Sight) -> PlanarPose:
    number, position, heading = sight
    yaw = None if heading is None else math.radians(heading - 90)
    return PlanarPose(float(number), position.x, position.y, yaw)


def _in_metres(sights: list[_Sight], georeference: Georeference, local: LocalFrame) -> list[PlanarPose]:
    places = georeference.enu_from_pixel([position for _, position, _ in sights], local)
    poses = []
    for (number, _, heading), (east, north) in zip(sights, places, strict=True):
        # A position beyond the horizon of a tilted image has no coordinates on the ground.
        if math.isfinite(east):
            yaw = None if heading is None else math.radians(90 - heading)
            poses.append(PlanarPose(float(number), float(east), float(north), yaw))
    return poses


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
    return in_order(_measure_trial, absolute, shared=(again, top), at=at, progress=progress)


def _measure_trial(shared: tuple[RebuiltValue[LocalizationPipeline], int], trial: QueryTrial) -> QueryResult:
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
