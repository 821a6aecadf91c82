"""Builds the index of a map and calibrates its probabilities."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path

from webapp.core.features.table import choose
from webapp.core.mapmodel.model import Map
from webapp.files.localize.models import with_weights
from webapp.files.maps.folder import read_map
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.landmarks.on_demand import options_for_retrieval
from webapp.tasks.localize import build_index, calibrate, cascade, describe_photos, geometry, open_map
from webapp.tasks.localize.build_index import BuildReport, BuildRequest
from webapp.tasks.localize.index_location import index_bases, index_folder
from webapp.tasks.localize.open_map import OpenOptions
from webapp.tasks.localize.pipeline import LocalizationPipeline, with_second_look


@dataclass(frozen=True, slots=True)
class MapBuildReport:
    """What was built.

    Attributes
    ----------
    features : str
        Name of the features, `auto` resolved.
    orientation_seconds, calibration_seconds : float or None
        Time to estimate orientations and to calibrate (that of the original run, if a stored calibration
        still fits); None if the method needs neither, or no photo could be used.
    second : MapBuildReport or None
        Report of the second look of method `auto`.
    global_descriptor : bool
        Whether the photos have global descriptors.
    """

    index: BuildReport
    features: str
    orientation_seconds: float | None
    calibration_seconds: float | None
    second: MapBuildReport | None = None
    global_descriptor: bool = False


def build_map(cfg: Path, options: OpenOptions, *, settings: Settings, progress: Progress) -> MapBuildReport:
    """Update the indexes of a map and their calibrations, one for each look of the method.

    Raises
    ------
    MapError, UsageError, MissingPart, InputError, StorageError, Cancelled
    """
    options.choice()  # fail early: check the options before reading any file
    the_map = read_map(cfg)
    options = options_for_retrieval(cfg, options, settings=settings)
    one, *further = cascade.look_options(options, first=choose("verified"), settings=settings)
    first = _build_look(cfg, one, the_map=the_map, settings=settings, progress=progress)
    if not further:
        return first.report
    look = further[0] if first.pipeline is None else cascade.with_same_kind(further[0], first.pipeline.opened)
    progress.note(f"second look: {look.features}")
    second = _build_look(cfg, look, the_map=the_map, settings=settings, progress=progress)
    if first.pipeline is not None and second.pipeline is not None:
        with_second_look(first.pipeline, second.pipeline, progress=progress)
    return replace(first.report, second=second.report)


@dataclass(frozen=True, slots=True, eq=False)
class _BuiltLook:
    """One look that was built; without a pipeline if there is nothing to calibrate."""

    report: MapBuildReport
    pipeline: LocalizationPipeline | None = None


def _build_look(
    cfg: Path, options: OpenOptions, *, the_map: Map, settings: Settings, progress: Progress
) -> _BuiltLook:
    choice = with_weights(options.choice(), settings.models, method=options.method)
    choice = open_map.within_memory(choice, the_map, options=options, settings=settings)
    folder = index_folder(index_bases(cfg, options.index)[-1], choice, extract=settings.extract)
    request = BuildRequest(cfg, the_map, folder, choice, options.jobs)
    report = build_index.update_index(request, settings=settings, progress=progress)
    if options.method == "vote" or not report.descriptors:
        return _BuiltLook(MapBuildReport(report, choice.name, None, None))
    resolved = replace(options, detector=choice.detector, extractor=choice.extractor, matcher=choice.matcher)
    opened = open_map.open_index(cfg, resolved, settings=settings, progress=progress, the_map=the_map)
    opened = describe_photos.describe_photos(opened, settings=settings, progress=progress)
    started = time.perf_counter()
    opened = geometry.prepare_geometry(opened, progress=progress)
    orientation_seconds = time.perf_counter() - started
    stored = calibrate.calibrate_map(opened, map_fov_deg=options.map_fov_deg, progress=progress)
    return _BuiltLook(
        MapBuildReport(
            report,
            choice.name,
            orientation_seconds,
            stored.seconds,
            global_descriptor=opened.indexed.global_descriptors is not None,
        ),
        LocalizationPipeline(opened, settings, stored),
    )
