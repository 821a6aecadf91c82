"""Opens a map for localization: plans a request, opens a complete map for each look, joins the looks."""

from __future__ import annotations

import time
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import NamedTuple

from webapp.core.features.table import Method, choose
from webapp.core.mapmodel.model import Map
from webapp.errors import InputError, MapError, MissingPart
from webapp.extras import is_installed
from webapp.files.localize.models import second_look_features, usable_global_descriptor
from webapp.files.maps.folder import read_map
from webapp.progress import Progress
from webapp.settings import Settings
from webapp.tasks.landmarks.on_demand import LandmarksAround
from webapp.tasks.localize import calibrate, cascade, describe_photos, geometry
from webapp.tasks.localize.index_location import has_landmarks, index_bases, newest_choice
from webapp.tasks.localize.open_index import open_index
from webapp.tasks.localize.open_map import OpenMap
from webapp.tasks.localize.pipeline import LocalizationPipeline, Look, TaggedMap
from webapp.tasks.localize.plan import LookPlan, MapPlan, OpenOptions
from webapp.tasks.tags.answer import has_tags


def make_plan(cfg: Path, options: OpenOptions, *, settings: Settings, newest: bool = False) -> MapPlan:
    """Resolve a request to open a map.

    Args:
        newest: `auto` selects the features of the newest index that can be used, not the default ones.

    Raises:
        UsageError: The combination of features is not possible.
    """
    on_demand = options.method == "landmarks" and not has_landmarks(cfg) and can_reconstruct(settings)
    method: Method = "verified" if on_demand or options.method == "auto" else options.method
    if newest and not on_demand and not options.names_features:
        bases = index_bases(cfg, options.index)
        models, matcher = settings.models, options.matcher
        choice = newest_choice(bases, settings.extract, method=method, matcher=matcher, models=models)
    else:
        choice = options.choose(options.method)
    first = LookPlan(
        method,
        choice,
        keeps_matcher=on_demand or options.matcher is not None,
        is_second=False,
        index=options.index,
        jobs=options.jobs,
        map_fov_deg=options.map_fov_deg,
        right_within_px=options.right_within_px,
        map_kind=options.map_kind,
        build=options.build,
    )
    looks = (first, *_second(options, first, settings))
    return MapPlan(options.method, looks, on_demand, settings.retrieval.budget_s)


def _second(options: OpenOptions, first: LookPlan, settings: Settings) -> tuple[LookPlan, ...]:
    """Plan the second look of `auto`; none with explicitly requested features or without its models."""
    if options.method != "auto" or options.names_features or options.matcher:
        return ()
    features = second_look_features(settings.models)
    if features in (None, first.choice.name) or settings.retrieval.budget_s == 0.0:
        return ()
    return (replace(first, choice=choose(first.method, features=features), is_second=True),)


def can_reconstruct(settings: Settings) -> bool:
    """Return whether the surroundings of a place are reconstructed on demand."""
    return settings.landmarks.around_s > 0.0 and is_installed("sfm")


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
    if not the_map.experiences and has_tags(the_map):
        return LocalizationPipeline(
            plan.method, (), fov_deg=fov_deg, tags_alone=TaggedMap(cfg, the_map, settings)
        )
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
