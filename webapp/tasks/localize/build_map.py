"""Builds the index of a map and calibrates its probabilities."""

from __future__ import annotations

from dataclasses import dataclass, replace
from pathlib import Path

from webapp.core.mapmodel.model import Map
from webapp.files.maps.folder import read_map
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.localize import build_index
from webapp.tasks.localize.build_index import BuildRequest
from webapp.tasks.localize.index_location import index_bases, index_folder
from webapp.tasks.localize.open_index import features_for
from webapp.tasks.localize.open_map import BuildReport
from webapp.tasks.localize.open_pipeline import join_looks, make_plan, open_look
from webapp.tasks.localize.pipeline import Look
from webapp.tasks.localize.plan import LookPlan, OpenOptions


@dataclass(frozen=True, slots=True)
class MapBuildReport:
    """What was built."""

    index: BuildReport
    features: str  # Name of the features, `auto` resolved
    # `orientation_seconds`, `calibration_seconds`: Time to estimate orientations and to calibrate (that of
    # the original run, if a stored calibration still fits); None if the method needs neither, or no photo
    # could be used.
    orientation_seconds: float | None
    calibration_seconds: float | None
    second: MapBuildReport | None = None  # Report of the second look of method `auto`
    global_descriptor: bool = False  # Whether the photos have global descriptors


def build_map(cfg: Path, options: OpenOptions, *, settings: Settings, progress: Progress) -> MapBuildReport:
    """Update the indexes of a map and their calibrations, one for each look of the method.

    Raises MapError, UsageError, MissingPart, InputError, StorageError, Cancelled.
    """
    plan = make_plan(cfg, options, settings=settings)
    the_map = read_map(cfg)
    first, report = _build_look(cfg, plan.looks[0], the_map=the_map, settings=settings, progress=progress)
    if len(plan.looks) == 1:
        return report
    look = plan.looks[1]
    if first is not None:
        look = look.with_kind_of(first.opened.indexed.kind)
    progress.note(f"second look: {look.choice.name}")
    second, further = _build_look(cfg, look, the_map=the_map, settings=settings, progress=progress)
    if first is not None and second is not None:
        join_looks(first, second, budget_s=plan.budget_s, progress=progress)
    return replace(report, second=further)


def _build_look(
    cfg: Path, plan: LookPlan, *, the_map: Map, settings: Settings, progress: Progress
) -> tuple[Look | None, MapBuildReport]:
    """Build one look; it is None if there is nothing to calibrate."""
    choice = features_for(plan, the_map, settings=settings)
    folder = index_folder(index_bases(cfg, plan.index)[-1], choice, extract=settings.extract)
    request = BuildRequest(cfg, the_map, folder, choice, plan.jobs)
    index = build_index.update_index(request, settings=settings, progress=progress)
    if plan.method == "vote" or not index.descriptors:
        return None, MapBuildReport(index, choice.name, None, None)
    look = open_look(cfg, plan, the_map=the_map, settings=settings, progress=progress)
    return look, MapBuildReport(
        index,
        choice.name,
        look.orientation_seconds,
        None if look.calibration is None else look.calibration.seconds,
        global_descriptor=look.opened.indexed.global_descriptors is not None,
    )
