"""Builds the index of a map and calibrates its probabilities."""

from __future__ import annotations

import time
from dataclasses import dataclass, replace
from pathlib import Path

from webapp.files.localize.models import with_weights
from webapp.files.maps.folder import read_map
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.localize import build_index, calibrate, open_map, orient_map
from webapp.tasks.localize.build_index import BuildReport, BuildRequest
from webapp.tasks.localize.index_location import index_bases, index_folder
from webapp.tasks.localize.open_map import OpenOptions


@dataclass(frozen=True, slots=True)
class MapBuildReport:
    """What was built.

    Attributes
    ----------
    features : str
        `auto` resolved.
    orientation_seconds, calibration_seconds : float or None
        To work out how the photos were held, and to calibrate; None where the method does neither, or no
        photo could be used. A calibration that still fits keeps the seconds that it took.
    """

    index: BuildReport
    features: str
    orientation_seconds: float | None
    calibration_seconds: float | None


def build_map(cfg: Path, options: OpenOptions, *, settings: Settings, progress: Progress) -> MapBuildReport:
    """Bring the index of a map up to date, and its calibration.

    Raises
    ------
    MapError, UsageError, MissingPart, InputError, StorageError, Cancelled
    """
    choice = with_weights(options.choice(), settings.models, method=options.method)
    the_map = read_map(cfg)
    choice = open_map.within_memory(choice, the_map, options=options, settings=settings)
    folder = index_folder(index_bases(cfg, options.index)[-1], choice, extract=settings.extract)
    request = BuildRequest(cfg, the_map, folder, choice, options.jobs)
    report = build_index.update_index(request, settings=settings, progress=progress)
    if options.method == "vote" or not report.descriptors:
        return MapBuildReport(report, choice.name, None, None)
    resolved = replace(options, detector=choice.detector, extractor=choice.extractor, matcher=choice.matcher)
    opened = open_map.open_index(cfg, resolved, settings=settings, progress=progress)
    started = time.perf_counter()
    opened = orient_map.estimate_orientations(opened, map_fov_deg=options.map_fov_deg, progress=progress)
    orientation_seconds = time.perf_counter() - started
    stored = calibrate.calibrate_map(opened, map_fov_deg=options.map_fov_deg, progress=progress)
    return MapBuildReport(report, choice.name, orientation_seconds, stored.seconds)
