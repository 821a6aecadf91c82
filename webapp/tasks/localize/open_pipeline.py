"""Opens a map for localization: one complete map for each look of a plan, and the pipeline of its looks."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

from webapp.core.mapmodel.model import Map
from webapp.errors import InputError, MapError, MissingPart
from webapp.files.localize.global_model import usable_global_descriptor
from webapp.files.maps.folder import read_map
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.landmarks.on_demand import LandmarksAround
from webapp.tasks.localize import calibrate, cascade, describe_photos, geometry
from webapp.tasks.localize.make_plan import make_plan
from webapp.tasks.localize.open_index import open_index
from webapp.tasks.localize.open_map import OpenMap
from webapp.tasks.localize.pipeline import LocalizationPipeline, Look
from webapp.tasks.localize.plan import LookPlan, OpenOptions


def open_pipeline(
    cfg: Path,
    options: OpenOptions,
    *,
    settings: Settings,
    progress: Progress,
    fov_deg: float | None = None,
) -> LocalizationPipeline:
    """Open a map for localization: update its index and orientations, and calibrate its probabilities.

    Raises MapError, UsageError, StorageError, IndexDamaged, Cancelled.

    Args:
        fov_deg: Horizontal field of view of the queries, instead of the one in their EXIF.
    """
    options.choose(options.method)  # fail early: check the options before reading any file
    plan = make_plan(cfg, options, settings=settings, newest=True)
    the_map = read_map(cfg)
    first = open_look(cfg, plan.looks[0], the_map=the_map, settings=settings, progress=progress)
    if plan.landmarks_on_demand:
        first = replace(first, around=LandmarksAround(settings, progress, build=True))
    pipeline = LocalizationPipeline(plan.method, (first,), fov_deg=fov_deg)
    if len(plan.looks) == 1:
        return pipeline
    look = plan.looks[1].with_kind_of(first.opened.indexed.kind)
    try:
        progress.note(f"second look: {look.choice.name}")
        second = open_look(cfg, look, the_map=the_map, settings=settings, progress=progress)
    except (MapError, MissingPart, InputError) as error:
        progress.note(f"without a second look: {error}")
        return pipeline
    joined = join_looks(first, second, budget_s=plan.budget_s, progress=progress)
    return replace(pipeline, looks=joined.looks, both=joined.calibration)


def join_looks(first: Look, second: Look, *, budget_s: float, progress: Progress) -> cascade.JoinedLooks:
    """Combine two looks, and calibrate both together; see `cascade.join_looks`.

    Raises StorageError, Cancelled.
    """
    calibrated = partial(cascade.calibrate_looks, progress=progress)
    joined = cascade.join_looks((first, second), budget_s=budget_s, calibrated=calibrated)
    # constant texts, as pages translate them
    if joined.reason == cascade.OTHER_AREAS:
        progress.note("without a second look: its features show other areas")
    elif joined.reason == cascade.TOO_SLOW:
        progress.note("without a second look: it would exceed the time budget")
    elif joined.reason:
        progress.note(f"without a second look: {joined.reason}")
    return joined


def open_look(cfg: Path, plan: LookPlan, *, the_map: Map, settings: Settings, progress: Progress) -> Look:
    """Open a map for one look, and update everything that it consists of.

    Raises MapError, UsageError, MissingPart, InputError, StorageError, IndexDamaged, Cancelled.
    """
    opened = open_index(cfg, plan, the_map=the_map, settings=settings, progress=progress)
    if plan.method == "vote":
        return Look(opened)
    opened = describe_photos.describe_photos(opened, progress=progress)
    started = time.perf_counter()
    opened = geometry.prepare_geometry(opened, progress=progress)
    seconds = time.perf_counter() - started
    return Look(opened, calibrate.calibrate_map(opened, progress=progress), orientation_seconds=seconds)


class StoredLook(NamedTuple):
    """A look on what is stored, and whether a calibration is due: it is missing or does not fit any more."""

    look: Look
    to_calibrate: bool


def stored_look(opened: OpenMap) -> StoredLook:
    """Attach to an open map what is stored for its look, without updating anything.

    Global descriptors are used once the map is calibrated with them.

    Raises:
        UsageError: See `geometry.prepare_geometry`.
    """
    if opened.method == "vote":
        return StoredLook(Look(opened), to_calibrate=False)
    opened = geometry.with_stored_geometry(opened)
    network, due = usable_global_descriptor(opened.settings.models), False
    if network is not None:
        described = describe_photos.with_stored_vectors(opened, network)
        due = described is opened or calibrate.newest(described) is None
        opened = opened if due else described
    stored = calibrate.newest(opened)
    return StoredLook(Look(opened, stored), due or stored is None or not calibrate.still_fits(stored, opened))
